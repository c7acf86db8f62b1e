"""Whole episodes of a trained policy in one compiled call: network, control law and physics, and no Python between."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import types

from capsule_gym import kernels, layout
from capsule_gym.compilation import compile_now, fingerprint, kernel
from capsule_gym.layout import AT, LANES
from capsule_gym.network import act_lanes, workspace
from capsule_gym.parameters import check_count
from capsule_gym.policy import Policy
from capsule_gym.simulation import Simulation

# The columns of the changes of M and mu: the environment, or -1 where the change is done, and the rest in SI units.
ENVIRONMENT, TIME, NEW_M, NEW_MU = range(4)


def run_episodes(
    advance: Any,
    world: np.ndarray,
    first: int,
    last: int,
    steps: int,
    control_dt: float,
    fixed: np.ndarray,
    observations: np.ndarray,
    network: np.ndarray,
    memory: np.ndarray,
    inputs: np.ndarray,
    changes: np.ndarray,
) -> int:
    """Takes the environments first..last-1 through agent steps, each until its episode ends.

    Args:
        advance: `kernels.advance`, compiled with the law.
        world: with the rest below as `kernels.advance` takes it; changed.
        first: first environment, a multiple of LANES.
        last: one past the last environment.
        steps: how many agent steps.
        control_dt: length of one, s.
        fixed: plant, settings and the controller's table.
        observations: shape (environments, entries), float32; changed.
        network: from `network.pack`.
        memory: as `network.write_inputs` takes it; changed.
        inputs: as `network.write_inputs` takes it; changed.
        changes: shape (changes, 4), those of an environment in order of time; changed.

    Returns:
        Index of an environment whose law returned no finite torque, or -1.
    """
    lanes = workspace(network)
    for b in range(first // LANES, (last + LANES - 1) // LANES):
        block, start = world[b], b * LANES
        n = min(LANES, last - start)
        for _ in range(steps):
            going = 0
            for j in range(n):
                active = block[AT.termination + j] == 0.0
                block[AT.active + j] = 1.0 if active else 0.0
                going += active
            actions = act_lanes(network, observations, start, n, memory, inputs, lanes)
            for j in range(n):
                # As coarse as an action that is handed to the environment.
                block[AT.action + j] = np.float32(actions[j])
            for change in changes:
                j = int(change[ENVIRONMENT]) - start
                if 0 <= j < n and change[TIME] <= block[AT.steps + j] * control_dt + 1e-9:
                    block[AT.M + j], block[AT.mu + j] = change[NEW_M], change[NEW_MU]
                    change[ENVIRONMENT] = -1.0
            broken = advance(world, start, start + n, False, fixed, observations)
            if broken >= 0:
                return broken
            # One step more than they need: it leaves what a loop in Python leaves.
            if going == 0:
                break
    return -1


@lru_cache(maxsize=1)
def _compiled() -> Any:
    """`run_episodes`, compiled once for all laws, whose steps it takes as functions."""
    compiled = kernel(run_episodes, fingerprint(run_episodes)[:16], {})
    world, first, last, _, fixed, observations = kernels.SIGNATURE
    step = types.FunctionType(types.int64(*kernels.SIGNATURE))
    numbers, changes = types.float64[::1], types.float64[:, ::1]
    policy = (numbers, numbers, observations)
    signature = (step, world, first, last, types.int64, types.float64, fixed, observations, *policy, changes)
    compile_now(compiled, signature, "the episodes of trained policies")
    # numba's dispatcher would compile it anew for the type of every law's step.
    return next(iter(compiled.overloads.values())).entry_point


def rollout(simulation: Simulation, policy: Policy, steps: int) -> dict[str, np.ndarray]:
    """Runs a policy in every environment of a simulation, whose episodes have begun.

    An environment whose episode ends stands still from then on. The bits are those of a batch that is stepped with
    `policy.start(..)`; the memory of the policy begins with the call.

    Args:
        simulation: after `reset`; changed. Its threads share the environments.
        policy: what acts.
        steps: how many agent steps, at least 1; they are also the length of a whole episode in the metrics.

    Returns:
        `simulation.metrics` of every environment.

    Raises:
        ValueError: if the policy does not fit the observation, or a user's control law returned a torque that is not
            finite.
    """
    check_count("steps", steps)
    entries = simulation.observations.shape[1]
    if policy.entries != entries:
        raise ValueError(
            f"policy must take the observations of the simulation, {entries} entries, got {policy.name!r}, which takes "
            f"{policy.entries}"
        )
    changes = np.array(
        [(i, *change) for i, schedule in simulation._changes.items() for change in schedule], np.float64
    ).reshape(-1, 4)
    memory = policy.new_memory(simulation.num_envs)
    inputs = np.empty((simulation.num_envs, len(policy.mean)), np.float32)
    blocks = simulation.world.reshape(len(simulation.world), -1)
    layout.check_arrays(
        world=(blocks, np.float64, (None, simulation.world[0].size)),
        observations=(simulation.observations, np.float32, (simulation.num_envs, entries)),
        network=(policy._network, np.float64, (None,)),
        changes=(changes, np.float64, (None, 4)),
    )
    compiled = _compiled()

    def run(first: int, last: int) -> int:
        broken: int = compiled(
            simulation._kernel,
            blocks,
            first,
            last,
            steps,
            simulation.options.control_dt,
            simulation.fixed,
            simulation.observations,
            policy._network,
            memory,
            inputs,
            changes,
        )
        return broken

    broken = max(simulation.share(run))
    simulation._everyone = False
    simulation._changes = {}
    simulation._due[:] = math.inf
    for i, *change in changes[changes[:, ENVIRONMENT] >= 0.0].tolist():
        simulation._changes.setdefault(int(i), []).append((change[0], change[1], change[2]))
    for i, schedule in simulation._changes.items():
        simulation._due[i] = schedule[0][0]
    if broken >= 0:
        simulation._report(broken)
    return simulation.metrics(np.arange(simulation.num_envs), steps)
