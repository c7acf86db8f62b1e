"""Whole episodes of a trained policy inside the core, without Python between the steps."""

import numpy as np

from capsule_gym.checks import check_count
from capsule_gym.core import native
from capsule_gym.envs.simulation import Simulation
from capsule_gym.policies.policy import Policy


def rollout(simulation: Simulation, policy: Policy, steps: int) -> dict[str, np.ndarray]:
    """Runs a policy in every environment of a simulation to the end of its episode.

    The simulation starts from `reset`, or from where steps and rollouts have left it.
    The results are those of a batch that is stepped with the policy, bit for bit. The memory of a
    recurrent policy is clear at the beginning of every rollout.

    Args:
        simulation: the simulation, which is changed.
        policy: the policy.
        steps: number of agent steps, at least 1, and length of a whole episode in the metrics.

    Returns:
        `simulation.metrics` of every environment.

    Raises:
        ValueError: if the policy does not fit the observation; errors of a law are those of
            `Simulation.step`.
    """
    check_count("steps", steps)
    entries = simulation.observations.shape[1]
    if policy.entries != entries:
        accepted = f"the observations of the simulation, {entries} entries"
        got = f"{policy.name!r}, which takes {policy.entries}"
        raise ValueError(f"policy must take {accepted}, got {got}")

    memory = native.aligned_zeros((simulation.num_envs, policy.memory_size))

    def run_episodes(first: int, last: int) -> int:
        batch = simulation._fields
        return native.call("run_episodes", batch, first, last, steps, policy._network, memory)

    simulation._everyone = False
    simulation.run(run_episodes)
    return simulation.metrics(np.arange(simulation.num_envs), steps)
