"""From a rig to a policy, on hidden plants: `python -m benchmarks.rig`.

Every hidden plant, drawn from `real-wide` with the disturbances `real`, is recorded for 20 s and identified. An agent
with the settings of `direct-ppo` and the last 4 observations is trained on the identified ranges and drives the hidden
plant for one episode, as do two agents with the same training on the plants `paper`, without disturbances, and on
`real-wide` with the disturbances `real`.
"""

from __future__ import annotations

import json
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.training.presets import PRESETS
from capsule_gym import CapsuleEnv, Excitation, Policy, identify, record
from capsule_gym.command_line import Count, parse
from capsule_gym.files import to_json, write_atomically
from capsule_gym.task import EPISODE_STEPS

HIDDEN: dict[str, Any] = {"randomization": "real-wide", "disturbances": "real"}
CONFIG = replace(PRESETS["direct", "ppo"], stack_size=4)
LOGGED_DT = 0.01
# Smaller ones follow where the excitation ends the episode, N m.
AMPLITUDES = (0.45, 0.35, 0.25)


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


def train(seed: int, total_steps: int, **env_kwargs: Any) -> Policy:
    """Trains an agent with direct torque on other plants and disturbances."""
    from agents.training.algorithms import make_env, make_model
    from agents.training.export import export

    config = replace(CONFIG, seed=seed, total_steps=total_steps)
    model = make_model(config, make_env(config, seed, **env_kwargs))
    return export("agent", model.learn(total_steps), config, "none")


def drive(agent: Policy, seed: int) -> dict[str, float]:
    """The metrics of one episode on a hidden plant."""
    env = CapsuleEnv(**{**CONFIG.env_kwargs(), **HIDDEN})
    observation, _ = env.reset(seed=seed)
    terminated = False
    for _ in range(EPISODE_STEPS):
        if not terminated:
            observation, _, terminated, _, _ = env.step(agent(observation))
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
    if missing := sorted(set(range(args.seed, args.seed + args.plants)) - {row["seed"] for row in rows}):
        common = {"paper": train(0, args.total_steps), "real_wide": train(0, args.total_steps, **HIDDEN)}
    for seed in missing:
        with warnings.catch_warnings(record=True) as doubts:
            warnings.simplefilter("always", UserWarning)
            env_kwargs = identified(seed)
        agents = {**common, "identified": train(seed, args.total_steps, **env_kwargs)}
        row = {name: drive(agent, seed) for name, agent in agents.items()}
        rows.append({"seed": seed, **row, "warnings": [str(doubt.message) for doubt in doubts]})
        write_atomically(args.json, to_json(rows))
        print(seed, {name: round(own["mean_speed"], 2) for name, own in row.items()}, flush=True)
    fastest = np.array([row["identified"]["mean_speed"] for row in rows])
    for name in ("identified", "paper", "real_wide"):
        speeds, failed = (np.array([row[name][metric] for row in rows]) for metric in ("mean_speed", "failed"))
        print(
            f"{name:10s} mean {speeds.mean():6.2f} cm/s, lowest {speeds.min():6.2f}, {failed.sum():.0f} of {len(rows)} "
            f"fail; the identified agent is faster on {(speeds < fastest).sum()}"
        )


if __name__ == "__main__":
    main()
