"""Trainings that take turns, so that whatever else the machine does meets them all."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import cast

import gymnasium as gym
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecNormalize
from tqdm import tqdm

from agents.training.loop import make_env, make_model
from agents.training.sac import LeanSAC
from benchmarks.trainers import Trainer
from capsule_gym import ENV_ID

ONE_BY_ONE = {"DummyVecEnv": DummyVecEnv, "SubprocVecEnv": SubprocVecEnv}


def make(trainer: Trainer) -> BaseAlgorithm:
    """The agent with its environments."""
    config = trainer.config
    if trainer.vec_env == "native":
        env = make_env(config, 0)
    else:
        # As most tutorials have them.
        kind = ONE_BY_ONE[trainer.vec_env]
        alone = kind([lambda: gym.make(ENV_ID, **config.env_kwargs()) for _ in range(config.num_envs)])
        env = VecNormalize(alone, norm_reward=False, gamma=config.gamma)
    return make_model(config, env, sac=LeanSAC if trainer.lean else SAC, fused=trainer.fused)


def unit(model: BaseAlgorithm) -> int:
    """The fewest environment steps that the agent learns from at once."""
    return model.n_envs * (model.n_steps if isinstance(model, OnPolicyAlgorithm) else 1)


def learn(model: BaseAlgorithm, units: int) -> float:
    """Goes on training for so many of its units; returns the seconds."""
    start = time.perf_counter()
    model.learn(units * unit(model), reset_num_timesteps=False)
    return time.perf_counter() - start


def _prepare(trainer: Trainer, seconds: float) -> tuple[BaseAlgorithm, int]:
    """The agent past its first update, and how many of its units fill a turn of that many seconds."""
    torch.set_num_threads(trainer.config.torch_threads)
    model = make(trainer)
    if not isinstance(model, OnPolicyAlgorithm):
        learn(model, 40)
    trial = 1 if isinstance(model, OnPolicyAlgorithm) else 20
    return model, max(1, round(seconds * trial / learn(model, trial)))


@contextmanager
def _torch_threads_kept() -> Iterator[None]:
    """Gives torch its number of threads back at the end."""
    before = torch.get_num_threads()
    try:
        yield
    finally:
        torch.set_num_threads(before)


def take_turns(
    trainers: Sequence[Trainer],
    turns: int,
    seconds: float,
    title: str,
    turn: Callable[[Trainer, BaseAlgorithm, int], str],
) -> None:
    """Lets trainings take turns. Ctrl-C ends it; what was measured until then counts.

    Args:
        trainers: what takes turns.
        turns: how many turns each takes.
        seconds: about how long a turn is.
        title: for the progress bar.
        turn: takes the trainer, its agent and the number of its units to train; returns what the bar shows.
    """
    models: list[BaseAlgorithm] = []
    with _torch_threads_kept(), tqdm(total=turns * len(trainers), desc=title, unit=" turns", dynamic_ncols=True) as bar:
        try:
            counts = []
            for trainer in trainers:
                model, count = _prepare(trainer, seconds)
                models.append(model)
                counts.append(count)
            for _ in range(turns):
                for trainer, model, count in zip(trainers, models, counts, strict=True):
                    torch.set_num_threads(trainer.config.torch_threads)
                    bar.set_postfix_str(turn(trainer, model, count), refresh=False)
                    bar.update()
        except KeyboardInterrupt:
            print("\nStopped; what was measured:", file=sys.stderr)
        finally:
            for model in models:
                cast(VecEnv, model.get_env()).close()
