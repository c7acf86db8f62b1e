"""Policies and training runs for the tests of the evaluation, quick to run and quick to write."""

import json
from dataclasses import dataclass, field

import numpy as np

PLANTS = {
    "name": "tiny",
    "plants": [
        {"M": 0.5, "mu": 0.01, "seed": 0},
        {"M": 0.6, "mu": 0.1, "seed": 1},
        {"M": 0.5, "mu": 0.01, "seed": 2, "changes": [{"t": 0.5, "M": 0.7, "mu": 0.3}]},
    ],
}


@dataclass
class Sine:
    """A sine of torque, in parts of the limit of 1.5 N m."""

    amplitude: float
    period: float = 0.7
    name: str = "sine"
    description: str = "A sine of torque."
    env_kwargs: dict = field(default_factory=dict)

    def start(self, seeds):
        step = 0

        def act(observations):
            nonlocal step
            assert observations.shape[0] == len(seeds)
            torque = self.amplitude / 1.5 * np.cos(2.0 * np.pi * 0.02 * step / self.period)
            step += 1
            return np.full((len(seeds), 1), torque, np.float32)

        return act


@dataclass
class Twitch:
    """A torque whose sign hangs on the last digits of the rate: chaotic from its second step on."""

    amplitude: float = 0.4
    name: str = "twitch"
    description: str = "Chaos."
    env_kwargs: dict = field(default_factory=dict)

    def start(self, seeds):
        return lambda observations: (self.amplitude * np.sign(np.sin(1e6 * observations[:, 1:2]))).astype(np.float32)


def write_run(folder, seed, algo="ppo", model=b"model"):
    """The folder of a training run, with a model that nothing can load."""
    folder.mkdir(parents=True, exist_ok=True)
    env = {"controller": "baselines:adaptive", "residual_limit": 3.0, "randomization": "wide"}
    config = {"algo": algo, "env": env, "seed": seed, "revision": "0123456789ab", "versions": {}}
    (folder / "config.json").write_text(json.dumps(config))
    (folder / "model.zip").write_bytes(model)
