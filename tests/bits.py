"""The bits of whole episodes: `python -m tests.bits` compares them with committed hashes.

`bits.json` has hashes of all observations, rewards and states of a batch over a whole episode, and
of its metrics: for the plant under random torques, for every law of `baselines` under random
residuals, and for every other policy.
"""

import functools
import hashlib
import itertools
import json
import re
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

import capsule_gym
from baselines.policies import SCRIPTED
from capsule_gym import Capsule, CapsuleVectorEnv, Disturbances, policy_names
from capsule_gym.checks import check_choice
from capsule_gym.command_line import Positional, arg, command
from capsule_gym.control.laws import LAWS
from capsule_gym.files import write_atomically
from capsule_gym.policies.network import Cell
from capsule_gym.tasks.task import CONTROL_DT, HORIZON

FILE = Path(__file__).with_name("bits.json")
RECURRENT = Path(__file__).parent / "capsule_gym" / "policies" / "recurrent-ppo"
# Trained policies of which the episodes begin as in their training.
WIDE_STARTS = ("direct-sac", "efficient", "residual-ppo")
# One more than fills registers of any width.
NUM_ENVS = 65
# A random torque is held for so many steps; otherwise nothing would move.
HOLD = 5
CYCLE = 400

REAL = Disturbances.named("real")
SHAKEN = replace(REAL, push=(0.0, 0.5), theta_resolution=0.001, torque_resolution=0.01)

Act = Callable[[np.ndarray], np.ndarray]


class Subject(NamedTuple):
    """A case with a hash: its key in the file, its environment, and its actions.

    `start` begins a batch of episodes by their seeds.
    """

    name: str
    env_kwargs: dict[str, Any]
    start: Callable[[Sequence[int]], Act]

    @property
    def steps(self):
        """Agent steps of a whole episode."""
        return round(HORIZON / self.env_kwargs.get("control_dt", CONTROL_DT))


def random_actions(scale):
    """Uniform actions, the same for one environment alone and in any batch."""

    def start(seeds):
        draws = np.array([np.random.default_rng([seed, 2]).random(CYCLE) for seed in seeds])
        actions = (scale * (2.0 * draws - 1.0)).astype(np.float32)
        steps = itertools.count()
        return lambda observations: actions[:, next(steps) // HOLD % CYCLE, None]

    return start


def plant(name, **env_kwargs):
    """A plant under random torques."""
    return Subject(f"plant{name}", env_kwargs, random_actions(0.15))


def law(name, controller, **env_kwargs):
    """A control law under random residuals."""
    env_kwargs["controller"] = f"baselines:{controller}"
    return Subject(f"law {name}", env_kwargs, random_actions(0.05))


def plants():
    """Yields the plants."""
    yield plant("", randomization="wide", observe_parameters=True)
    yield plant(
        " under a total torque",
        randomization="wide",
        controller="baselines:gait",
        total_torque=True,
        residual_limit=0.5,
    )
    anisotropic = Capsule(static_ratio=1.4, backward_ratio=1.3)
    yield plant(" anisotropic", randomization="wide", capsule=anisotropic, initial_noise=0.1)
    rough = Capsule(
        static_ratio=1.3, stribeck_speed=0.1, viscous=0.2, slope=-0.02, motor_friction=0.1
    )
    yield plant(" beyond Coulomb", randomization="wide", capsule=rough, initial_noise=0.1)
    yield plant(" disturbed", randomization="real-wide", disturbances=SHAKEN)


def laws():
    """Yields the control laws."""
    yield law(
        "gait_predictive disturbed",
        "gait_predictive",
        randomization="real-wide",
        disturbances=SHAKEN,
    )
    yield law("goal_pulses disturbed", "goal_pulses", task="goal", disturbances=SHAKEN)
    measured = replace(SHAKEN, x_noise=0.001)
    yield law(
        "velocity_pulses disturbed", "velocity_pulses", task="velocity", disturbances=measured
    )
    for name, make in LAWS.items():
        task = make().task
        # A wide range of floors, so that the platform moves by pulses and by strokes.
        own = {"task": task, "randomization": "wide"} if task else {}
        yield law(name, name, **own)
    # On light platforms the guard acts earlier.
    yield law("gait broad", "gait", randomization="broad")


def recurrent():
    """Yields a trained LSTM, and a GRU with random weights next to a feedback of the state."""
    trained = capsule_gym.load_policy(RECURRENT)
    yield Subject(f"policy {trained.name}", trained.env_kwargs, trained.start)
    draws = np.random.default_rng(3)

    def weights(*shape):
        return (2.0 * draws.random(shape) - 1.0).astype(np.float32)

    cell = Cell(weights(33, 7), weights(33, 11), weights(33), weights(33))
    feedback = np.array([[-1.0, 0.02, 0.0, 0.0, 0.0]], np.float32)
    last = np.concatenate([0.1 * weights(1, 11), feedback], axis=1)
    made = replace(
        trained,
        layers=((weights(7, 5), weights(7)),),
        cell=cell,
        head=((last, np.full(1, 0.1, np.float32)),),
    )
    yield Subject("policy gru", {"randomization": "wide"}, made.start)


def subjects():
    """Yields all subjects."""
    yield from plants()
    yield from laws()
    for policy in SCRIPTED.values():
        if "controller" not in policy.env_kwargs:
            env_kwargs = {"randomization": "wide", **policy.env_kwargs}
            yield Subject(f"scripted {policy.name}", env_kwargs, policy.start)
    for name in policy_names(seeds=True):
        trained = capsule_gym.load_policy(name)
        env_kwargs = dict(trained.env_kwargs)
        if name.partition("/")[0] in WIDE_STARTS:
            env_kwargs["initial_range"] = (1.047, 8.0)
        yield Subject(f"policy {name}", env_kwargs, trained.start)
    yield from recurrent()


@functools.cache
def subjects_by_name() -> dict[str, Subject]:
    """All subjects by name."""
    return {subject.name: subject for subject in subjects()}


def compute(name):
    """The hash of a subject; an environment stands still after its episode has ended."""
    subject = subjects_by_name()[name]
    kwargs = {**subject.env_kwargs, "max_episode_steps": subject.steps}
    env = CapsuleVectorEnv(NUM_ENVS, autoreset_mode=AutoresetMode.DISABLED, **kwargs)
    observations, _ = env.reset(seed=0)
    act = subject.start(range(NUM_ENVS))
    shown = []
    for _ in range(subject.steps):
        observations, rewards, _, _, info = env.step(act(observations))
        shown.append((observations, rewards, info["state"].copy()))
    digest = hashlib.sha256()
    for array in (*zip(*shown, strict=True), *env.episode_metrics().values()):
        values = np.array(array)
        # In one byte order on every machine.
        digest.update(values.astype(values.dtype.newbyteorder("<")).tobytes())
    return digest.hexdigest()


def compute_all(names: Sequence[str]) -> dict[str, str]:
    """The hashes of subjects by name, on all cores."""
    with ProcessPoolExecutor() as pool:
        hashes = pool.map(compute, names)
        return dict(zip(names, hashes, strict=True))


def compare(found, committed):
    """Yields what differs from the committed hashes."""
    for name, digest in found.items():
        wanted = committed.get(name)
        if digest != wanted:
            yield f"{name}: {digest} here, {wanted} committed"


@command("python -m tests.bits", ValueError)
def main(
    names: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME")] = (),
    write: bool = False,
    first_seeds: bool = False,
) -> int:
    """Computes the bits of whole episodes; the exit status is 1 if they differ.

    Examples:
      python -m tests.bits
      CAPSULE_GYM_LEVEL=portable python -m tests.bits plant "law pd"

    Args:
        names: Subjects to compare; all by default.
        write: Write those of all subjects to tests/bits.json instead.
        first_seeds: Compare one training seed of each trained policy: `agents.leaderboard --check`
            evaluates all of them.
    """
    known = list(subjects_by_name())
    if write:
        write_atomically(FILE, json.dumps(compute_all(known), indent=1) + "\n")
        return 0
    committed = json.loads(FILE.read_text(encoding="utf-8"))
    wrong = [f"{name}: unknown subject" for name in committed if name not in known]
    for name in names:
        check_choice("NAME", name, list(committed), f"one of {list(committed)}")
    chosen = [name for name in known if not names or name in names]
    if first_seeds:
        chosen = [name for name in chosen if not re.search(r"/seed-[1-9]", name)]
    wrong += compare(compute_all(chosen), committed)
    summary = f"{len(chosen)} subjects in {NUM_ENVS} environments: {len(wrong)} differences"
    print(*wrong, summary, sep="\n")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
