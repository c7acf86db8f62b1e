"""From a rig to a policy, on hidden plants: `python -m benchmarks.rig`.

Every hidden plant, drawn from `real-wide` with the disturbances `real`, is recorded for 20 s and identified. An agent
is trained on the identified ranges and drives the hidden plant for one episode, as do two agents with the same training
on the plants `paper`, without disturbances, and on `real-wide` with the disturbances `real`.
"""

from __future__ import annotations

import json
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capsule_gym import CapsuleEnv, Excitation, identify, record
from capsule_gym.command_line import Count, parse
from capsule_gym.files import to_json, write_atomically
from capsule_gym.task import EPISODE_STEPS

if TYPE_CHECKING:
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

HIDDEN: dict[str, Any] = {"randomization": "real-wide", "disturbances": "real"}
LOGGED_DT = 0.01
# Smaller ones follow where the excitation ends the episode, N m.
AMPLITUDES = (0.45, 0.35, 0.25)
TRAINING: dict[str, Any] = {"stack_size": 4, "initial_range": (1.047, 8.0), "termination_penalty": 30.0}


@dataclass(frozen=True)
class Args:
    """Compares agents trained on identified, on the paper's and on wide ranges, on hidden plants.

    Examples:
      python -m benchmarks.rig --plants 20 --json runs/rig.json
    """

    plants: Count = 20
    """Number of hidden plants."""
    seed: Count = 7000
    """Seed of the first hidden plant."""
    total_steps: Count = 1_000_000
    """Environment steps of a training."""
    json: Path = Path("runs/rig.json")
    """File of the results, which a repeated command completes."""


def train(seed: int, total_steps: int, **env_kwargs: Any) -> tuple[PPO, VecNormalize]:
    """Trains an agent with direct torque, which observes the last 4 observations."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.utils import LinearSchedule
    from stable_baselines3.common.vec_env import VecNormalize

    from capsule_gym.sb3 import CapsuleSB3VecEnv

    batch = CapsuleSB3VecEnv(128, seed=seed, **TRAINING, **env_kwargs)
    env = VecNormalize(batch, gamma=0.995)
    model = PPO(
        "MlpPolicy",
        env,
        learning_rate=LinearSchedule(1e-3, 0.0, 1.0),
        n_steps=128,
        batch_size=1024,
        n_epochs=6,
        gamma=0.995,
        ent_coef=0.003,
        seed=seed,
        device="cpu",
    )
    model.learn(total_steps)
    env.training = False
    return model, env


def drive(agent: tuple[PPO, VecNormalize], seed: int) -> dict[str, float]:
    """The metrics of one episode on a hidden plant."""
    model, normalisation = agent
    env = CapsuleEnv(**HIDDEN, stack_size=TRAINING["stack_size"])
    observation, _ = env.reset(seed=seed)
    for _ in range(EPISODE_STEPS):
        action, _ = model.predict(normalisation.normalize_obs(observation), deterministic=True)
        observation, _, terminated, _, _ = env.step(action)
        if terminated:
            break
    found = env.episode_metrics(EPISODE_STEPS)
    return {name: found[name] for name in ("mean_speed", "failed")}


def identified(seed: int) -> dict[str, Any]:
    """Arguments of the environment that stands for a hidden plant."""
    env = CapsuleEnv(**HIDDEN, control_dt=LOGGED_DT)
    for amplitude in AMPLITUDES:
        log = record(env, Excitation(seed=seed, amplitude=amplitude), seed=seed)
        if len(log["t"]) * LOGGED_DT > 19.9:
            break
    return identify(log).env_kwargs(0.95)


def main() -> None:
    """Prints the speeds on every hidden plant."""
    args = parse(Args, "python -m benchmarks.rig")
    args.json.parent.mkdir(parents=True, exist_ok=True)
    rows = json.loads(args.json.read_text(encoding="utf-8")) if args.json.exists() else []
    done = {row["seed"] for row in rows}
    if missing := [seed for seed in range(args.seed, args.seed + args.plants) if seed not in done]:
        common = {
            "paper": train(0, args.total_steps, randomization="paper"),
            "real_wide": train(0, args.total_steps, **HIDDEN),
        }
    for seed in missing:
        with warnings.catch_warnings(record=True) as doubts:
            warnings.simplefilter("always", UserWarning)
            env_kwargs = identified(seed)
        agents = {**common, "identified": train(seed, args.total_steps, **env_kwargs)}
        row = {name: drive(agent, seed) for name, agent in agents.items()}
        rows.append({"seed": seed, **row, "warnings": [str(doubt.message) for doubt in doubts]})
        write_atomically(args.json, to_json(rows))
        print(seed, {name: round(own["mean_speed"], 2) for name, own in row.items()}, flush=True)
    for name in ("identified", "paper", "real_wide"):
        speeds = np.array([row[name]["mean_speed"] for row in rows])
        failed = sum(row[name]["failed"] for row in rows)
        slower = sum(row[name]["mean_speed"] < row["identified"]["mean_speed"] for row in rows)
        print(
            f"{name:10s} mean {speeds.mean():6.2f} cm/s, lowest {speeds.min():6.2f}, {failed:.0f} of {len(rows)} fail",
            end="",
        )
        print("" if name == "identified" else f"; the identified agent is faster on {slower} of {len(rows)}")


if __name__ == "__main__":
    main()
