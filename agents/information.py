"""Trains the policies of the table of information: `python -m agents.information`.

The environment hides M and mu, and disturbances hide the state. A cell of the table is a set, what
a policy observes, and how it learns. The results of all cells are in `information.npz`, beside this
file: for each cell the arrays `mean_speed` (cm/s) and `failed`, of shape (training seeds,
episodes), and `core_seconds`, the processor time of each run.
"""

import csv
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from gymnasium.vector import AutoresetMode

from agents.distillation.config import STUDENTS, Student
from agents.distillation.plants import solve_problems
from agents.study import Job, train_all
from agents.training.config import BEST, EVALUATIONS, Config, RunError
from agents.training.presets import DIRECT_PPO
from baselines.dynamic_programming.policy import TORQUES, PlantOracle
from baselines.dynamic_programming.problem import Problem
from capsule_gym import CapsuleVectorEnv, load_policy
from capsule_gym.command_line import Count, Positional, arg, command
from capsule_gym.evaluation.candidates import find_candidate
from capsule_gym.evaluation.episodes import evaluate, scores
from capsule_gym.evaluation.sets import batch_options, load_set
from capsule_gym.files import load_arrays, replacing
from capsule_gym.policies.policy import POLICY
from capsule_gym.tasks.registry import TASKS

COMMAND = "python -m agents.information"
RECORD = Path(__file__).with_suffix(".npz")
METRICS = ("mean_speed", "failed")
# What a policy observes: the columns of the table, and the arguments of the environment.
OBSERVATIONS: dict[str, dict[str, Any]] = {
    "nothing": {},
    "history": {"stack_size": 16},
    "estimates": {"observe_estimates": True},
    "plant": {"observe_parameters": True},
}
MEMORY = "memory"
SETS = ("wide", "real-wide")
# Cells that are rows of the leaderboard, with all their training seeds.
ROWS = {
    "wide-estimates-ppo": "direct-ppo-wide",
    "wide-memory-ppo": "direct-recurrent-ppo",
    "wide-optimum": "dp-oracle",
}
# The optimum of dynamic programming on the plants of `real-wide`, without disturbances and with the
# nominal pendulum.
REFERENCE = "real-wide-optimum"
# The expert of distillation at the true state, on the first plants of these sets.
CEILED = ("real", "real-wide")
CEILING = "ceiling"
CEILING_PLANTS = 100
Results = dict[str, np.ndarray]


@dataclass(frozen=True)
class Cell:
    """A cell that is trained for the table.

    Attributes:
        set_name: set on which it is evaluated.
        name: its key in the record.
        settings: those of its runs, without the seed.
    """

    set_name: str
    name: str
    settings: Config | Student


def all_cells() -> dict[str, Cell]:
    """The cells that are no rows of the leaderboard, by name."""
    found = []
    for information, observation in OBSERVATIONS.items():
        ppo = replace(DIRECT_PPO, randomization="wide", **observation)
        found.append(Cell("wide", f"wide-{information}-ppo", ppo))
        for set_name in SETS:
            student = replace(_reader(set_name), observation=observation)
            found.append(Cell(set_name, f"{set_name}-{information}-distilled", student))
    for set_name in SETS:
        student = _recurrent(_reader(set_name))
        found.append(Cell(set_name, f"{set_name}-{MEMORY}-distilled", student))
    ppo = replace(DIRECT_PPO, randomization="wide", privileged=False, **OBSERVATIONS["history"])
    found.append(Cell("wide", "wide-history-ppo-same-critic", ppo))
    return {cell.name: cell for cell in found if cell.name not in ROWS}


def _reader(set_name: str) -> Student:
    """The student of a set without a memory."""
    student = STUDENTS["dp-distilled-wide"]
    if set_name == "wide":
        return replace(student, hidden=128)
    return replace(
        student,
        randomization="real-wide",
        disturbances="real",
        groups=64,
        plants={"real-wide": 2},
        severities=(1.0,),
        change_rate=0.0,
        spare_share=0.0,
        hidden=128,
        validation=("real-wide",),
    )


def _recurrent(reader: Student) -> Student:
    """A student with a GRU, as large as that of `dp-distilled-real`, on a student's plants."""
    like = STUDENTS["dp-distilled-real"]
    names = ("units", "hidden", "updates", "final_updates", "batch_size", "sequence", "burn_in")
    sizes = {name: getattr(like, name) for name in (*names, "learning_rate")}
    return replace(reader, observation={}, **sizes)


def train_cell(cell: Cell, seeds: Sequence[int], runs: Path, jobs: int | None) -> Results:
    """Trains or continues the runs of a cell, and evaluates their policies on the set.

    Raises:
        RunError: if a run fails, or its folder holds another run.
    """
    folders = [runs / cell.set_name / f"{cell.name}-{seed}" for seed in seeds]
    settings = cell.settings
    if isinstance(settings, Config):
        planned = []
        for seed, folder in zip(seeds, folders, strict=True):
            planned.append(Job(cell.name, replace(settings, seed=seed), folder))
        for job, reason in train_all(planned, jobs).items():
            raise RunError(f"{job.name}: {reason}")
        seconds = [_ppo_seconds(folder) for folder in folders]
        folders = [folder / BEST for folder in folders]
    else:
        seconds = [_distil(cell.name, settings, *each) for each in zip(seeds, folders, strict=True)]
    policies = [load_policy(folder / POLICY) for folder in folders]
    episodes = [evaluate(policy, cell.set_name) for policy in policies]
    found = {"core_seconds": np.array(seconds)}
    for metric in METRICS:
        found[metric] = np.concatenate([scores(each, metric) for each in episodes])
    return found


def _ppo_seconds(folder: Path) -> float:
    """The processor time of a complete run of PPO."""
    with (folder / EVALUATIONS).open(newline="", encoding="utf-8") as file:
        *_, last = csv.DictReader(file)
    return float(last["core_seconds"])


def _distil(name: str, student: Student, seed: int, folder: Path) -> float:
    """Trains or continues a student; the processor time of its run."""
    # Imported here, since it needs torch.
    from agents.distillation import dagger

    finished = folder / dagger.FINISHED
    if not finished.is_file():
        dagger.Run(name, student, seed, folder).train()
    return float(json.loads(finished.read_text(encoding="utf-8"))["core_seconds"])


def evaluate_reference() -> Results:
    """`dp-oracle` on the plants of `real-wide`, without disturbances and with nominal pendulums."""
    disturbed = load_set("real-wide")
    plants = tuple(replace(plant, capsule=None) for plant in disturbed.plants)
    (policy,) = find_candidate("dp-oracle").policies
    episodes = evaluate(policy, replace(disturbed, plants=plants, disturbances="none"))
    return {metric: scores(episodes, metric) for metric in METRICS}


def evaluate_ceiling(set_name: str, folder: Path) -> Results:
    """The expert of distillation at the true state, on the first plants of a set.

    The values of each plant's own problem are solved first and kept in the folder.
    """
    evaluation_set = load_set(set_name)
    plants = evaluation_set.plants[:CEILING_PLANTS]
    steps = TASKS["speed"].episode_steps
    env = CapsuleVectorEnv(
        num_envs=len(plants),
        autoreset_mode=AutoresetMode.DISABLED,
        disturbances=evaluation_set.disturbances,
    )
    _, info = env.reset(seed=[plant.seed for plant in plants], options=batch_options(plants))
    problems = []
    for plant, friction in zip(plants, info["disturbances"]["motor_friction"], strict=True):
        constants = {"M": plant.M, "mu": plant.mu, **(plant.capsule or {})}
        problems.append(Problem(motor_friction=float(friction), **constants))
    expert = PlantOracle(env.simulation, solve_problems(problems, folder))
    for _ in range(steps):
        env.step(TORQUES[expert.scores().argmax(axis=1)][:, None])
    metrics = env.episode_metrics()
    return {metric: metrics[metric][None] for metric in METRICS}


def read_record() -> dict[str, Results]:
    """The results of all cells by name."""
    found: dict[str, Results] = {}
    if RECORD.is_file():
        for key, values in load_arrays(RECORD).items():
            name, _, metric = key.partition("/")
            found.setdefault(name, {})[metric] = values
    return found


def _write_record(record: Mapping[str, Results]) -> None:
    """Writes the results of all cells."""
    arrays: dict[str, Any] = {}
    for name, results in sorted(record.items()):
        for metric, values in results.items():
            arrays[f"{name}/{metric}"] = values
    with replacing(RECORD) as temporary:
        np.savez_compressed(temporary, **arrays)


@command(COMMAND, OSError, ValueError)
def main(
    names: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME")] = (),
    seeds: Annotated[tuple[Count, ...], arg(metavar="N")] = (0, 1, 2),
    jobs: int | None = None,
    runs: Path = Path("runs/information"),
) -> int:
    """Trains and evaluates the policies of the table of information.

    Every finished cell is added to the record, agents/information.npz, from which
    `python -m agents.analysis information` makes the table. Ctrl-C stops; the same command
    continues, and skips finished runs.

    Examples:
      python -m agents.information
      python -m agents.information wide-nothing-ppo wide-memory-distilled --seeds 7

    Args:
        names: Cells; all by default.
        seeds: Training seeds.
        jobs: Number of runs of PPO in parallel; one per core by default.
        runs: Folder of the runs.
    """
    cells = all_cells()
    ceilings = {f"{set_name}-{CEILING}": set_name for set_name in CEILED}
    known = [*cells, REFERENCE, *ceilings]
    for name in names or known:
        if name not in known:
            raise ValueError(f"NAME must be one of {', '.join(known)}, got {name!r}")
        if name in cells:
            results = train_cell(cells[name], seeds, runs, jobs)
        elif name == REFERENCE:
            results = evaluate_reference()
        else:
            results = evaluate_ceiling(ceilings[name], runs / name / "plants")
        # Read again, since another process may have added cells.
        _write_record({**read_record(), name: results})
        speed, failed = (results[metric].mean() for metric in METRICS)
        print(f"{name}: {speed:.2f} cm/s, {100.0 * failed:.1f} % failed", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
