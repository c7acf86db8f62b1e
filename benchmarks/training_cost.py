"""What training costs: environment steps per second with one setting changed at a time."""

from __future__ import annotations

import dataclasses
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, cast

import gymnasium as gym
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecNormalize
from tqdm import tqdm

import agents.training.sac
import capsule_gym
from agents.training.loop import make_env, make_model
from agents.training.presets import PPOConfig, SACConfig

# What Stable-Baselines3 does where nothing is said, on eight environments.
UNTUNED: dict[str, Any] = {
    "num_envs": 8,
    "n_steps": 2048,
    "batch_size": 64,
    "n_epochs": 10,
    "learning_rate": 3e-4,
    "final_learning_rate": 3e-4,
    "gamma": 0.99,
    "gae_lambda": 0.95,
    "ent_coef": 0.0,
    "log_std_init": 0.0,
}
# As many steps in an update as the preset, from four times the environments.
BROAD: dict[str, Any] = {"num_envs": 256, "n_steps": 64, "batch_size": 4096}


@dataclass(frozen=True)
class Contender:
    """Something that trains.

    Attributes:
        name: for the table.
        make: makes the agent with its environments.
        threads: of torch.
        updates: gradient steps per environment step.
    """

    name: str
    make: Callable[[], BaseAlgorithm]
    threads: int = 1
    updates: float = 0.0


def ppo(name: str, vec_env: Callable[[PPOConfig], VecEnv] | None = None, **changes: Any) -> Contender:
    """The PPO preset of the residual task with some fields changed."""
    config = dataclasses.replace(PPOConfig(), **changes)

    def make() -> BaseAlgorithm:
        if vec_env is None:
            return make_model(config, make_env(config, 0))
        return make_model(config, VecNormalize(vec_env(config), norm_reward=False, gamma=config.gamma))

    return Contender(name, make, config.torch_threads, config.n_epochs / config.batch_size)


def sac(name: str, kind: type[SAC] = agents.training.sac.LeanSAC, fused: bool = True, **changes: Any) -> Contender:
    """The SAC preset of the residual task with some fields changed, or another class; updates begin at once."""
    config = dataclasses.replace(SACConfig(), **{"learning_starts": 1000, **changes})

    def make() -> BaseAlgorithm:
        return make_model(config, make_env(config, 0), sac=kind, fused=fused)

    return Contender(name, make, config.torch_threads, config.gradient_steps / config.num_envs)


def one_by_one(kind: type[DummyVecEnv] | type[SubprocVecEnv]) -> Callable[[PPOConfig], VecEnv]:
    """Environments of gym.make, as most tutorials have them."""

    def make(config: PPOConfig) -> VecEnv:
        return kind([lambda: gym.make(capsule_gym.ENV_ID, **config.env_kwargs()) for _ in range(config.num_envs)])

    return make


ROLLOUT = 16_384


def axes() -> dict[str, list[Contender]]:
    """What --sweep measures; the first of each axis is what the ratios are to."""
    threads = ((1, 1), (1, 2), (2, 1), (2, 2))
    # Shorter rollouts cost the same per step, and let a turn end sooner.
    quick = {**UNTUNED, "n_steps": 512}
    return {
        "environments": [
            ppo("64 (preset)"),
            *(ppo(str(count), num_envs=count, n_steps=ROLLOUT // count) for count in (16, 256, 1024)),
        ],
        "minibatch": [
            ppo("2048 (preset)"),
            *(ppo(str(size), batch_size=size) for size in (64, 256, 1024, 4096, 8192)),
        ],
        "threads": [
            ppo(
                f"environment {env}, torch {own}" + (" (preset)" if env == own == 1 else ""),
                env_threads=env,
                torch_threads=own,
            )
            for env, own in threads
        ],
        "broad-threads": [
            ppo(f"environment {env}, torch {own}", env_threads=env, torch_threads=own, **BROAD) for env, own in threads
        ],
        "vec-env": [
            ppo("preset"),
            ppo("broad", **BROAD),
            ppo("untuned, native batch of 8", **quick),
            ppo("untuned, DummyVecEnv of 8", one_by_one(DummyVecEnv), **quick),
            ppo("untuned, SubprocVecEnv of 8", one_by_one(SubprocVecEnv), **quick),
        ],
        "sac": [
            sac("SB3's SAC", SAC, fused=False),
            sac("SB3's SAC, fused Adam", SAC),
            sac("LeanSAC", fused=False),
            sac("LeanSAC, fused Adam (preset)"),
            sac("preset, torch 2", torch_threads=2),
            sac("preset, batch 2048, 2 updates", batch_size=2048, gradient_steps=2),
            sac("preset, 64 environments, 16 updates", num_envs=64, gradient_steps=16),
        ],
    }


def vector_step(model: BaseAlgorithm) -> int:
    """The fewest environment steps that the agent learns from at once."""
    return model.n_envs * (model.n_steps if isinstance(model, OnPolicyAlgorithm) else 1)


def learn(model: BaseAlgorithm, count: int) -> float:
    """Goes on training for `count` of its own units; returns the seconds."""
    start = time.perf_counter()
    model.learn(count * vector_step(model), reset_num_timesteps=False)
    return time.perf_counter() - start


def prepare(rival: Contender, seconds: float) -> tuple[BaseAlgorithm, int]:
    """The agent past its first update, and how many of its units fill a turn of that many seconds."""
    torch.set_num_threads(rival.threads)
    model = rival.make()
    if not isinstance(model, OnPolicyAlgorithm):
        learn(model, 40)
    trial = 1 if isinstance(model, OnPolicyAlgorithm) else 20
    return model, max(1, round(seconds * trial / learn(model, trial)))


@contextmanager
def torch_threads_kept() -> Iterator[None]:
    """Gives torch its number of threads back at the end."""
    before = torch.get_num_threads()
    try:
        yield
    finally:
        torch.set_num_threads(before)


def take_turns(
    rivals: Sequence[Contender],
    turns: int,
    seconds: float,
    title: str,
    turn: Callable[[Contender, BaseAlgorithm, int], str],
) -> None:
    """Lets contenders train in turns. Ctrl-C ends it; what was measured until then counts.

    Args:
        rivals: what takes turns.
        turns: how many turns each takes.
        seconds: about how long a turn is.
        title: for the progress bar.
        turn: takes the contender, its agent and the number of its units to train; returns what the bar shows.
    """
    models: list[BaseAlgorithm] = []
    with torch_threads_kept(), tqdm(total=turns * len(rivals), desc=title, unit=" turns", dynamic_ncols=True) as bar:
        try:
            counts = []
            for rival in rivals:
                model, count = prepare(rival, seconds)
                models.append(model)
                counts.append(count)
            for _ in range(turns):
                for rival, model, count in zip(rivals, models, counts, strict=True):
                    torch.set_num_threads(rival.threads)
                    bar.set_postfix_str(turn(rival, model, count), refresh=False)
                    bar.update()
        except KeyboardInterrupt:
            print("\nStopped; what was measured:", file=sys.stderr)
        finally:
            for model in models:
                cast(VecEnv, model.get_env()).close()


def sweep(rivals: Sequence[Contender], turns: int, seconds: float, title: str = "") -> dict[str, list[float]]:
    """Environment steps per second of each, updates included, one number per turn; arguments as for `take_turns`."""
    rates: dict[str, list[float]] = defaultdict(list)

    def turn(rival: Contender, model: BaseAlgorithm, count: int) -> str:
        rates[rival.name].append(count * vector_step(model) / learn(model, count))
        return f"{rival.name}: {rates[rival.name][-1]:,.0f} steps/s"

    take_turns(rivals, turns, seconds, title, turn)
    return dict(rates)


def sweep_rows(rivals: Sequence[Contender], rates: dict[str, list[float]]) -> list[list[str]]:
    """The sweep of one axis as a table; ratios are medians over the turns, each to the first contender's turn."""
    rows = [["", "env steps/s", "gradient updates/s", "ratio", "range of the ratio"]]
    first = rates[rivals[0].name]
    for rival in rivals:
        if rival.name not in rates:
            continue
        rate = statistics.median(rates[rival.name])
        ratios = [own / other for own, other in zip(rates[rival.name], first, strict=False)]
        rows.append(
            [
                rival.name,
                f"{rate:,.0f}",
                f"{rate * rival.updates:,.0f}",
                f"{statistics.median(ratios):.2f}",
                f"{min(ratios):.2f} to {max(ratios):.2f}" if rival is not rivals[0] else "",
            ]
        )
    return rows
