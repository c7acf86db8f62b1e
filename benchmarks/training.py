"""Processor time until an agent moves the capsule at 15 cm/s: `python -m benchmarks.training`.

Contenders are the preset of `train.py`, Stable-Baselines3 and SBX (Stable-Baselines3 in JAX) on
`make_vec_env` with their default hyperparameters and `VecNormalize`, as their documentation
advises, and a loop on one environment with the wrappers, network and hyperparameters of CleanRL's
`ppo_continuous_action.py`. All learn by PPO, with direct torque, in the environment of the preset;
evaluations, on its validation plants, do not count. What is not installed is skipped.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.training.presets import PRESETS
from benchmarks.measurement import machine, report
from capsule_gym.command_line import PositiveCount, check_output, command
from capsule_gym.evaluation.candidates import wrap_policy
from capsule_gym.evaluation.episodes import evaluate, scores
from capsule_gym.evaluation.sets import EvaluationSet
from capsule_gym.tasks.task import ENV_ID

COMMAND = "python -m benchmarks.training"
CONFIG = PRESETS["direct", "ppo"]
ID = f"capsule_gym:{ENV_ID}"
ENV_KWARGS = CONFIG.env_kwargs()
# Mean speed on validation plants that ends a training, cm/s.
SPEED = 15.0
# Processor time after which a training is given up, s.
MOST_SECONDS = 300.0
# Agent steps between evaluations.
EVERY = 32_768
# Environments of Stable-Baselines3 and SBX, whose documentation advises several.
NUM_ENVS = 8
# Agent steps of a training that the clock ends.
ENDLESS = 10**9


@dataclass
class Clock:
    """Measures the processor time of a training until its policy is fast enough.

    Evaluations do not count.

    Attributes:
        plants: validation plants.
        seconds: processor time so far, s.
        steps: agent steps so far.
        speed: mean speed in the last evaluation, cm/s.
    """

    plants: EvaluationSet
    seconds: float = 0.0
    steps: int = 0
    speed: float = -np.inf
    _began: float = field(default_factory=time.process_time)

    def check(self, steps: int, policy: Callable[[], Any]) -> bool:
        """Evaluates the policy if an evaluation is due; returns whether the training goes on."""
        if steps - self.steps >= EVERY:
            self.seconds += time.process_time() - self._began
            self.steps = steps
            speeds = scores(evaluate(policy(), self.plants), "mean_speed")
            self.speed = float(speeds.mean())
            self._began = time.process_time()
        return self.speed < SPEED and self.seconds < MOST_SECONDS


def wrapped(act: Callable[[np.ndarray], np.ndarray]) -> Callable[[], Any]:
    """Creates the policy that is evaluated, from a function of observations."""
    return partial(wrap_policy, act, name="agent", env_kwargs=ENV_KWARGS)


def train_model(library: str, seed: int, clock: Clock) -> None:
    """Trains as `train.py` or, with `VecNormalize`, with the defaults of Stable-Baselines3 or SBX.

    Args:
        library: "stable_baselines3", "sbx", or "" for `train.py`.
        seed: seed of the training.
        clock: measures the training.
    """
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecNormalize

    from agents.training.algorithms import make_env, make_model
    from agents.training.export import export

    steps = ENDLESS
    if library:
        env = VecNormalize(make_vec_env(ID, NUM_ENVS, seed, env_kwargs=ENV_KWARGS))
        if library == "sbx":
            from sbx import PPO
        else:
            from stable_baselines3 import PPO
        model: Any = PPO("MlpPolicy", env, seed=seed, device="cpu")
    else:
        env = make_env(CONFIG, seed)
        model = make_model(replace(CONFIG, seed=seed), env)
        steps = CONFIG.total_steps

    def act(observations: np.ndarray) -> np.ndarray:
        return model.predict(env.normalize_obs(observations), deterministic=True)[0]

    policy: Callable[[], Any] = partial(export, "agent", model, CONFIG, revision="none")
    if library == "sbx":
        # Networks of JAX cannot be exported.
        policy = wrapped(act)
    # A callback that returns False ends the training.
    model.learn(steps, callback=lambda *_: clock.check(model.num_timesteps, policy))


def train_loop(seed: int, clock: Clock) -> None:
    """Trains by a loop like CleanRL's `ppo_continuous_action.py`."""
    from benchmarks import ppo_loop

    env = gym.make(ID, **ENV_KWARGS)
    ppo_loop.train(env, seed, lambda steps, act: clock.check(steps, wrapped(act)))


CONTENDERS: dict[str, Callable[[int, Clock], None]] = {}
CONTENDERS["train.py"] = partial(train_model, "")
CONTENDERS["SB3, make_vec_env"] = partial(train_model, "stable_baselines3")
if find_spec("sbx"):
    CONTENDERS["SBX, make_vec_env"] = partial(train_model, "sbx")
CONTENDERS["CleanRL's loop"] = train_loop


@command(COMMAND, ValueError)
def main(markdown: Path | None = None, seeds: PositiveCount = 3) -> None:
    """Processor time until an agent moves the capsule at 15 cm/s, for several trainers.

    Examples:
      python -m benchmarks.training --markdown docs/speed_training.md

    Args:
        markdown: Write the table to this file.
        seeds: Training seeds, from 0 on.
    """
    check_output("--markdown", markdown, overwrite=True)
    import torch

    from agents.training.callbacks import validation_plants

    torch.set_num_threads(1)
    columns = [f"seed {seed}, s" for seed in range(seeds)]
    rows = [["trainer", *columns, "thousands of steps"]]
    for name, train in CONTENDERS.items():
        row, steps = [name], []
        for seed in range(seeds):
            clock = Clock(validation_plants(replace(CONFIG, seed=seed)))
            train(seed, clock)
            time_used = f"{clock.seconds:.0f}"
            if clock.speed < SPEED:
                time_used = f"> {time_used} ({clock.speed:.1f} cm/s)"
            row.append(time_used)
            steps.append(f"{1e-3 * clock.steps:.0f}")
            print(f"{name}, seed {seed}: {time_used} s", file=sys.stderr, flush=True)
        rows.append([*row, ", ".join(steps)])
    note = (
        "Processor time, without evaluations, until the mean speed on validation plants is "
        f"{SPEED:g} cm/s; > where it was not, with the last speed. Direct torque, PPO, one thread "
        f"of torch. {machine()}."
    )
    report(COMMAND, markdown, rows, note)


if __name__ == "__main__":
    sys.exit(main())
