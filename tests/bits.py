"""The bits of whole episodes: `python -m tests.bits` compares them with committed hashes, `--write`
writes new ones.

`bits.json` has hashes of all observations, rewards and states of a batch over a whole episode, and
of its metrics: for the plant under random torques, for every law of `baselines` under random
residuals, and for every other policy.
"""

import hashlib
import itertools
import json
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

import capsule_gym
from baselines.policies import SCRIPTED
from capsule_gym import Capsule, CapsuleVectorEnv, Disturbances, policy_names
from capsule_gym.command_line import command
from capsule_gym.control.laws import LAWS
from capsule_gym.files import write_atomically
from capsule_gym.tasks.task import CONTROL_DT, HORIZON

FILE = Path(__file__).with_name("bits.json")
# One more than fills registers of any width.
NUM_ENVS = 65
# A random torque is held for so many steps; otherwise nothing would move.
HOLD = 5
CYCLE = 400

Act = Callable[[np.ndarray], np.ndarray]


class Subject(NamedTuple):
    """A case with a hash: its key in the file, the environment, and the start of a batch of
    episodes by their seeds."""

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


def subjects():
    """Yields all subjects."""
    wide = {"randomization": "wide"}
    capsule = Capsule(static_ratio=1.4, backward_ratio=1.3)
    yield Subject("plant", {**wide, "observe_parameters": True}, random_actions(0.15))
    total = {**wide, "controller": "baselines:gait", "total_torque": True, "residual_limit": 0.5}
    yield Subject("plant under a total torque", total, random_actions(0.15))
    yield Subject(
        "plant anisotropic",
        {**wide, "capsule": capsule, "initial_noise": 0.1},
        random_actions(0.15),
    )
    rough = Capsule(
        static_ratio=1.3, stribeck_speed=0.1, viscous=0.2, slope=-0.02, motor_friction=0.1
    )
    yield Subject(
        "plant beyond Coulomb",
        {**wide, "capsule": rough, "initial_noise": 0.1},
        random_actions(0.15),
    )
    real = Disturbances.named("real")
    shaken = replace(real, push=(0.0, 0.5), theta_resolution=0.001, torque_resolution=0.01)
    varied = {"randomization": "real-wide", "disturbances": shaken}
    yield Subject("plant disturbed", varied, random_actions(0.15))
    predictive = {**varied, "controller": "baselines:gait_predictive"}
    yield Subject("law gait_predictive disturbed", predictive, random_actions(0.05))
    for name, own in (("goal", shaken), ("velocity", replace(shaken, x_noise=0.001))):
        law = {"task": name, "disturbances": own, "controller": f"baselines:{name}_pulses"}
        yield Subject(f"law {name}_pulses disturbed", law, random_actions(0.05))
    for name, make in LAWS.items():
        # A wide range of floors, so that the platform moves by pulses and by strokes.
        own = {**wide, "task": task} if (task := make().task) else {}
        yield Subject(
            f"law {name}", {"controller": f"baselines:{name}", **own}, random_actions(0.05)
        )
    # On light platforms the guard acts earlier.
    yield Subject(
        "law gait broad",
        {"controller": "baselines:gait", "randomization": "broad"},
        random_actions(0.05),
    )
    for policy in SCRIPTED.values():
        if "controller" not in policy.env_kwargs:
            yield Subject(f"scripted {policy.name}", {**wide, **policy.env_kwargs}, policy.start)
    for name in policy_names(seeds=True):
        trained = capsule_gym.load_policy(name)
        yield Subject(f"policy {name}", trained.env_kwargs, trained.start)


def compute(subject):
    """The hash of a subject; an environment stands still after its episode has ended."""
    kwargs = {**subject.env_kwargs, "max_episode_steps": subject.steps}
    env = CapsuleVectorEnv(NUM_ENVS, autoreset_mode=AutoresetMode.DISABLED, **kwargs)
    observations, _ = env.reset(seed=0)
    act = subject.start(range(NUM_ENVS))
    shown = []
    for _ in range(subject.steps):
        observations, rewards, _, _, info = env.step(act(observations))
        shown.append((observations, rewards, info["state"].copy()))
    digest = hashlib.sha256()
    for array in (*map(np.array, zip(*shown, strict=True)), *env.episode_metrics().values()):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


@command("python -m tests.bits")
def main(write: bool = False, first_seeds: bool = False) -> int:
    """Computes the bits of whole episodes; the exit status is 1 if they differ from the committed
    ones.

    Examples:
      python -m tests.bits
      CAPSULE_GYM_LEVEL=portable python -m tests.bits

    Args:
        write: Write them to tests/bits.json.
        first_seeds: Compare one training seed of each trained policy: `agents.leaderboard --check`
            evaluates all of them.
    """
    if write:
        write_atomically(
            FILE,
            json.dumps({subject.name: compute(subject) for subject in subjects()}, indent=1) + "\n",
        )
    committed = json.loads(FILE.read_text(encoding="utf-8"))
    wanted = {subject.name: subject for subject in subjects()}
    wrong = [f"{name}: unknown subject" for name in committed if name not in wanted]
    if first_seeds:
        wanted = {
            name: subject for name, subject in wanted.items() if not re.search(r"/seed-[1-9]", name)
        }
    for name, subject in wanted.items():
        if (found := compute(subject)) != committed.get(name):
            wrong.append(f"{name}: {found} here, {committed.get(name)} committed")
    print(
        *wrong,
        f"{len(wanted)} subjects in {NUM_ENVS} environments: {len(wrong)} differences",
        sep="\n",
    )
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
