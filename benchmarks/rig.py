"""From a rig to a policy, on hidden plants: `python -m benchmarks.rig`.

Every hidden plant, drawn from `real-wide` with the disturbances `real`, is recorded for 20 s and
identified. An agent with the settings of `direct-ppo` and the last 4 observations is trained on the
identified ranges and drives the plant for one episode, as do agents trained on `paper` without
disturbances, and on `real-wide` with the disturbances `real`.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from agents.training.presets import PRESETS
from capsule_gym import CapsuleEnv, Excitation, Policy, identify, record
from capsule_gym.command_line import PositiveCount, command
from capsule_gym.evaluation.episodes import evaluate, validation_set

HIDDEN: dict[str, Any] = {"randomization": "real-wide", "disturbances": "real"}
CONFIG = replace(PRESETS["direct", "ppo"], stack_size=4)
# Seed of the first hidden plant.
SEED = 7000
# Period of the log, and the duration that it must have, s: `record` ends after 20 s.
LOGGED_DT = 0.01
WHOLE = 19.9
# Amplitudes, N m, of which smaller ones follow where the excitation ends the episode.
AMPLITUDES = (0.45, 0.35, 0.25)
# The agents that are compared.
NAMES = ("identified", "paper", "real-wide")


def train(seed: int, total_steps: int, **env_kwargs: Any) -> Policy:
    """Trains an agent with direct torque on other plants and disturbances."""
    from agents.training.algorithms import make_env, make_model
    from agents.training.export import export

    config = replace(CONFIG, seed=seed, total_steps=total_steps)
    model = make_model(config, make_env(config, seed, **env_kwargs))
    return export("agent", model.learn(total_steps), config, "none")


def drive(agent: Policy, seed: int) -> tuple[float, float]:
    """The mean speed of an episode on a hidden plant, cm/s, and 1 if the episode fails."""
    hidden = validation_set("real-wide", "hidden", seed, 1, disturbances="real")
    (episode,) = evaluate(agent, hidden)
    return episode["mean_speed"], episode["failed"]


def identified(seed: int) -> dict[str, Any]:
    """Arguments of the environment that stands for a hidden plant."""
    env = CapsuleEnv(**HIDDEN, control_dt=LOGGED_DT)
    for amplitude in AMPLITUDES:
        log = record(env, Excitation(seed=seed, amplitude=amplitude), seed=seed)
        if len(log["t"]) * LOGGED_DT > WHOLE:
            break
    return identify(log).env_kwargs(0.95)


@command("python -m benchmarks.rig")
def main(plants: PositiveCount = 20, total_steps: PositiveCount = 1_000_000) -> None:
    """Compares agents trained on identified, on the paper's and on wide ranges, on hidden plants.

    Examples:
      python -m benchmarks.rig --plants 20

    Args:
        plants: Number of hidden plants.
        total_steps: Environment steps of a training.
    """
    paper = train(0, total_steps)
    wide = train(0, total_steps, **HIDDEN)
    found = []
    for seed in range(SEED, SEED + plants):
        own = train(seed, total_steps, **identified(seed))
        episodes = [drive(agent, seed) for agent in (own, paper, wide)]
        texts = [
            f"{name} {speed:.2f} cm/s" for name, (speed, _) in zip(NAMES, episodes, strict=True)
        ]
        print(seed, *texts)
        found.append(episodes)
    # Axes after these: agent, plant.
    speeds, failed = np.transpose(found)
    for name, speed, failures in zip(NAMES, speeds, failed, strict=True):
        summary = f"mean {speed.mean():6.2f} cm/s, lowest {speed.min():6.2f}"
        print(f"{name:10s} {summary}, {failures.sum():.0f} of {plants} fail;")
        print(f"    the identified agent is faster on {(speed < speeds[0]).sum()}")


if __name__ == "__main__":
    main()
