# The module that capsule_gym/core/bindings/module.cpp defines. Arrays are passed by their addresses.
from typing import Any

LEVELS: list[str]
ROW_NAMES: list[str]
SETTINGS: list[str]
PLANT: list[str]
TRAJECTORY: list[str]
CONSTANTS: list[str]
OBSERVED: list[str]
LAWS: dict[str, tuple[str, int, int]]
TASKS: dict[str, str]
ESTIMATES: dict[str, tuple[float, float]]
LANES: int
HISTORY_ROWS: int
MOST_CELLS: int
COMMANDS: int
DIRECTIONS: int
MOST_RESULTS: int
CENTRED: int
LOGARITHMIC: int
THETA_LIMIT: float
THETA_DOT_BOUND: float
X_DOT_BOUND: float
MOTOR_WIDTH: float
MOTOR_SLOPE: float
ROUNDING: float
ERROR_BOUND: float
HOLD: float
TIME_TOLERANCE: float
SPEED_BOUND: float
MEASURED: float

PADDING: int
ESTIMATOR_CELLS: int
PLAIN_LAW: int
BATCH: list[str]

def select_level(place: int) -> None: ...  # in LEVELS

# Both call a function of core/bindings/level.cpp: the result is the index of an environment whose law has failed, or
# -1; of functions over arrays it is the number of their results. `call` releases the lock.
def call(name: str, /, *arguments: float) -> int: ...
def call_locked(name: str, /, *arguments: float) -> int: ...

# A function of core/bindings/recorded_functions.hpp, with the address of the constants; returns the rows.
def trace(function: str, number: int, constants: int, /) -> list[tuple[Any, ...]]: ...
