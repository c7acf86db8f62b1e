import itertools
from dataclasses import dataclass, field

import numpy as np

from capsule_gym import Controller
from capsule_gym.policies.policy import POLICY
from capsule_gym.tasks.task import CONTROL_DT, TORQUE_LIMIT
from tests.capsule_gym.policies import test_policy as policies

FIRST = {"M": 0.5, "mu": 0.01, "seed": 0}
SECOND = {"M": 0.6, "mu": 0.1, "seed": 1}
CHANGED = {"M": 0.5, "mu": 0.01, "seed": 2, "changes": [{"t": 0.5, "M": 0.7, "mu": 0.3}]}
PLANTS = {"name": "tiny", "plants": [FIRST, SECOND, CHANGED]}


@dataclass
class Sine:
    """A sine of torque, with its amplitude in N m and its period in s."""

    amplitude: float
    period: float = 0.7
    name: str = "sine"
    description: str = "A sine of torque."
    env_kwargs: dict = field(default_factory=dict)
    senses: str = "nothing"
    told: str = "nothing"

    def start(self, seeds):
        steps = itertools.count()

        def act(observations):
            assert observations.shape[0] == len(seeds)
            phase = 2.0 * np.pi * CONTROL_DT * next(steps) / self.period
            action = self.amplitude / TORQUE_LIMIT * np.cos(phase)
            return np.full((len(seeds), 1), action, np.float32)

        return act


def no_torque(theta, theta_dot, x, x_dot, memory, reference):
    return 0.0, memory


quiet = Controller("quiet", no_torque, np.zeros((1, 2)))


def make_policy(seed=0, **changes):
    """A policy with one layer that pumps energy into the pendulum, a little more with each seed."""
    weights = np.array([[-1.0, 0.05 + 0.02 * seed, 0.0, 0.0, 0.0]], np.float32)
    fields = {
        "name": "learnt",
        "layers": ((weights, np.full(1, 0.1, np.float32)),),
        "training_seed": seed,
        "mean": np.zeros(5),
        "variance": np.ones(5),
        "env_kwargs": {"randomization": "wide"},
    }
    return policies.make_policy(**fields | changes)


def write_run(folder, seed, **changes):
    """Writes the files of a training run that an evaluation needs."""
    folder.mkdir(parents=True, exist_ok=True)
    make_policy(seed, **changes).save(folder / POLICY)
