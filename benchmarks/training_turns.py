"""Trainings that take turns, so that whatever else the machine does meets them all."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import cast

import gymnasium as gym
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecNormalize
from tqdm import tqdm

from agents.training.loop import Falling, make_env, make_model
from agents.training.presets import PPOConfig
from agents.training.sac import LeanSAC
from benchmarks.trainers import Trainer
from capsule_gym import ENV_ID
from capsule_gym.sb3 import CapsuleSB3VecEnv


def make(trainer: Trainer) -> BaseAlgorithm:
    """The agent with its environments."""
    config = trainer.config
    if isinstance(config, PPOConfig) and not trainer.own:
        return make_plain_ppo(config, trainer.vec_env == "native")
    sac = LeanSAC if trainer.own else SAC
    return make_model(config, make_env(config, config.seed), sac=sac, fused=trainer.fused)


def make_plain_ppo(config: PPOConfig, native: bool) -> PPO:
    """Stable-Baselines3's own PPO.

    Args:
        config: of its fields those that Stable-Baselines3 knows.
        native: whether it steps the native batch; else environments of `gym.make` one by one, as most tutorials do.
    """
    kwargs = config.env_kwargs()
    batch = (
        CapsuleSB3VecEnv(config.num_envs, config.seed, threads=config.env_threads, **kwargs)
        if native
        else DummyVecEnv([lambda: gym.make(ENV_ID, **kwargs) for _ in range(config.num_envs)])
    )
    return PPO(
        "MlpPolicy",
        VecNormalize(batch, norm_reward=False, gamma=config.gamma),
        learning_rate=Falling(config.learning_rate, config.final_learning_rate, 1.0),
        n_steps=config.n_steps,
        batch_size=config.batch_size,
        n_epochs=config.n_epochs,
        gamma=config.gamma,
        gae_lambda=config.gae_lambda,
        ent_coef=config.ent_coef,
        policy_kwargs={"net_arch": [config.hidden, config.hidden], "log_std_init": config.log_std_init},
        seed=config.seed,
        device="cpu",
    )


@contextmanager
def training(trainer: Trainer) -> Iterator[BaseAlgorithm]:
    """The agent with its environments until the end, and torch's threads as the trainer has them."""
    with _torch_threads_kept():
        torch.set_num_threads(trainer.config.torch_threads)
        model = make(trainer)
        try:
            yield model
        finally:
            cast(VecEnv, model.get_env()).close()


def unit(model: BaseAlgorithm) -> int:
    """The fewest environment steps that the agent learns from at once."""
    return model.n_envs * (model.n_steps if isinstance(model, OnPolicyAlgorithm) else 1)


def learn(model: BaseAlgorithm, units: int) -> float:
    """Goes on training for so many of its units; returns the seconds of processor time."""
    start = time.process_time()
    model.learn(units * unit(model), reset_num_timesteps=False)
    return time.process_time() - start


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
