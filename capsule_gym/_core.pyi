# The module that capsule_gym/core/module.cpp defines. Arrays are passed by their addresses.
from typing import Any

LEVELS: tuple[str, ...]
ROWS: tuple[str, ...]
SETTINGS: tuple[str, ...]
PLANT: tuple[str, ...]
PLANT_FUNCTIONS: tuple[str, ...]
ELEMENTARY_FUNCTIONS: tuple[str, ...]
LAWS: dict[str, tuple[str, int, int]]
TASKS: dict[str, tuple[str, int]]
LANES: int
HISTORY_ROWS: int
MOST_CELLS: int
COMMANDS: int
THETA_LIMIT: float
THETA_DOT_BOUND: float
X_DOT_BOUND: float
RATE_LIMIT: float
MOTOR_WIDTH: float
MOTOR_SLOPE: float
ERROR_BOUND: float
HOLD: float
TOLERANCE: float
TIME_TOLERANCE: float
SPEED_BOUND: float
SETTLING: float
MEASURED: float

def bind(level: str, fields: dict[str, int]) -> Any: ...
def advance(batch: Any, first: int, last: int, begin: bool) -> int: ...
def step_one(batch: Any, action: float) -> int: ...
def draw_episodes(batch: Any, count: int) -> None: ...
def begin_episodes(batch: Any, count: int) -> None: ...
def evaluate(level: str, function: int, inputs: int, outputs: int, count: int, settings: int) -> None: ...
def law_torques(
    level: str, law: int, constants: int, states: int, memory: int, rows: int, torques: int, count: int
) -> None: ...
def platform_motion(
    level: str, angle: int, velocity: int, acceleration: int, plant: int, motion: int, count: int, h: float
) -> None: ...
def plain_law(law: Any, memory_size: int, reference_size: int, lanes: int) -> tuple[Any, int, int]: ...

NETWORK: tuple[str, ...]
PADDING: int
CELLS: int

def act_batch(level: str, network: int, observations: int, entries: int, n: int, memory: int, actions: int) -> None: ...
def write_inputs(
    level: str, header: int, observations: int, entries: int, n: int, memory: int, inputs: int
) -> None: ...
def run_episodes(
    batch: Any,
    first: int,
    last: int,
    steps: int,
    control_dt: float,
    network: int,
    memory: int,
    changes: int,
    num_changes: int,
) -> int: ...
