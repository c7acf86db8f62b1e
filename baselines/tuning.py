"""Tunes control laws on random plants, and designs the policy `lqr`: `python -m baselines.tuning pd`.

A CMA-ES searches the parameters of a law. In each generation all candidates run on the same newly drawn plants. At
regular intervals the mean of the distribution runs in fixed validation episodes; it replaces the parameters on file if
it scores better. The seeds of both are far from those of the frozen evaluation sets.

The episodes of `gait` are on plants of `wide`, evenly over M and log(mu). Each changes its plant twice, and every
second one has a random residual torque: the law must be fast, tolerate changes and support a policy.
"""

import json
import math
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any, Literal

import numpy as np

from baselines import lqr
from baselines.laws import gains, periodic
from baselines.laws.gait import LIGHTEST, PARAMETERS
from baselines.policies import ScriptedPolicy
from capsule_gym import CapsuleVectorEnv
from capsule_gym.command_line import Positional, command
from capsule_gym.controller import Controller, CoreLaw
from capsule_gym.files import write_atomically
from capsule_gym.layout import ROWS
from capsule_gym.parameters import NOMINAL, RANDOMIZATIONS
from capsule_gym.resets import plant_at, plant_ranges
from capsule_gym.task import HORIZON, TORQUE_LIMIT

Name = Literal["open-loop", "open-loop-real", "pd", "oscillator", "gait", "lqr"]

# s: a trial, and the agent step.
TRIAL, CONTROL_DT = 12.0, 0.1
# Generations between two validations.
INTERVAL = 50

POPULATION, PLANTS = 20, 32
# Seeds of the trials' plants are drawn from 2**40 on.
FIRST_SEED, VALIDATION_SEED, VALIDATION_PLANTS = 2**40, 2**50, 1024
# cm/s: deduction for a failure, in which the distance moved so far already counts over the whole horizon.
FAILURE = 10.0
PAPER = {"randomization": "paper"}
REAL = {"randomization": "real", "disturbances": "real"}

GAIT_POPULATION, GAIT_PLANTS = 24, 64
# Validation episodes of gaits, their seed, and the number of plants of an episode, one after the other.
GAIT_EPISODES, GAIT_SEED, PLANTS_PER_EPISODE = 512, (20186, 1), 3
# N m: limit of the random residual torque, which is constant over an agent step.
RESIDUAL_LIMIT = 0.3
# cm/s: score of a failed gait, doubled at the start of an episode.
GAIT_FAILURE = -30.0
# The coefficients of a gait that an earlier search found on the nominal plant: of its gaits, the fastest at the slowest
# of its speeds with M 10 % and mu about 20 % off.
START_COEFFICIENTS = (
    *(0.768173415, -1.52557133, 0.45381311, 0.0205869179, 0.78444579, 2.36305225, 0.415021591, 0.102463659),
    *(-1.23348699, -0.787626445, -0.687351086, -0.689480601, -0.615375647, 0.361390553, -0.608135802, 0.84640501),
    *(-2.1999663, -0.244974388, -0.0201974728, -2.62489784, 0.837836861),
)
# The guard starts with 0.05 N m for every 1/s^2 beyond 0.8 of the value that lifts the lightest platform of `wide`.
START_GUARD = (0.05, 0.8 * (LIGHTEST + NOMINAL.m) * NOMINAL.g / (NOMINAL.m * NOMINAL.l))

Metrics = dict[str, float]


@dataclass(frozen=True)
class Problem:
    """A tuning problem.

    Attributes:
        start: parameters with which the search starts.
        units: scales of the parameters in the search.
        run: runs candidates, shape (n, parameters), on plants drawn from a generator, or without one in the validation
            episodes. It returns their scores, shape (n,), and the mean speed, cm/s, and the failures of a single one.
    """

    start: np.ndarray
    units: np.ndarray
    run: Callable[[np.ndarray, np.random.Generator | None], tuple[np.ndarray, Metrics]]


def problem(name: Name) -> Problem:
    """The problem of a law."""
    if name == "gait":
        start, units = [*START_COEFFICIENTS, *START_GUARD], [*(1.0 for _ in PARAMETERS[:-2]), 0.03, 20.0]
        return Problem(np.array(start), np.array(units), run_gaits)
    units = [0.05, 0.05, *[0.1] * (2 * periodic.HARMONICS)]
    make: Callable[..., Controller] = periodic.open_loop
    env_kwargs = PAPER
    if name == "pd":
        # The angle in the limit cycle of dynamic programming, and gains.
        start = [0.62, -0.034932978479912336, -0.5409089676101233, -0.1670787041696912, 0.010524606243151453]
        start += [0.0017962854262352284, 0.3023075972267763, -0.09558691482482391, -0.03623329917012773]
        start += [0.01615240371464403, 6.0, 0.3]
        make, env_kwargs, units = periodic.pd, REAL, [*units, 2.0, 0.2]
    elif name == "oscillator":
        # omega and alpha; the effect of theta, theta_dot and x_dot on a and b; bias and polynomial; spring and damper.
        start = [30.0, 95.0, 47.0, -11.0, -63.0, -4.0, -2.5, 10.0, -1.5, -1.0, 2.6, 1.9, -8.0, 9.3, -2.1, 14.2, 2.3]
        make, units = periodic.oscillator, [2.0, 3.0, *[3.0, 0.6, 6.0] * 2, 0.15, *[0.45] * 6, 0.45, 0.09]
    else:
        # Results of earlier searches: without feedback most torques near the optimum's drop the pendulum.
        start = [0.581, 0.022, -0.697, 0.736, -0.215, -0.266, 0.254, -0.267, -0.005, 0.013]
        units = [units[0], *(TORQUE_LIMIT * unit for unit in units[1:])]
        if name == "open-loop-real":
            start = [0.5949, 0.018, -0.68, 0.762, -0.368, -0.13, 0.244, -0.249, -0.004, 0.053]
            env_kwargs = REAL

    def run(candidates: np.ndarray, rng: np.random.Generator | None) -> tuple[np.ndarray, Metrics]:
        seed, plants, seconds = VALIDATION_SEED, VALIDATION_PLANTS, HORIZON
        if rng is not None:
            seed, plants, seconds = FIRST_SEED + PLANTS * int(rng.integers(2**30)), PLANTS, TRIAL
        kwargs = [{"controller": make(parameters), "control_dt": CONTROL_DT} for parameters in candidates.tolist()]
        found = [score(ScriptedPolicy(name, "", each), env_kwargs, seed, plants, seconds) for each in kwargs]
        return np.array([reached for reached, _ in found]), {**found[0][1], "episodes": plants}

    return Problem(np.array(start), np.array(units), run)


def score(
    policy: ScriptedPolicy, env_kwargs: Mapping[str, Any], seed: int, plants: int, seconds: float
) -> tuple[float, Metrics]:
    """Runs a policy on random plants, the first with this seed.

    Returns:
        The mean speed less a deduction for failures, cm/s; and the mean speed and the number of failures.
    """
    control_dt = policy.env_kwargs.get("control_dt", 0.02)
    steps = round(seconds / control_dt)
    options: dict[str, Any] = {**policy.env_kwargs, **env_kwargs, "max_episode_steps": steps}
    env = CapsuleVectorEnv(plants, autoreset_mode="DISABLED", **options)
    observations, _ = env.reset(seed=seed)
    act = policy.start(range(plants))
    for _ in range(steps):
        observations, *_ = env.step(act(observations))
    metrics = env.episode_metrics()
    env.close()
    speed, failures = float(metrics["mean_speed"].mean()), int(metrics["failed"].sum())
    return speed - FAILURE * failures / plants, {"mean_speed": round(speed, 4), "failures": failures}


def run_gaits(candidates: np.ndarray, rng: np.random.Generator | None) -> tuple[np.ndarray, Metrics]:
    """`Problem.run` of gaits; failures score far below everything else, early ones lowest."""
    if rng is None:
        plants, actions = draw_episodes(np.random.default_rng(GAIT_SEED), GAIT_EPISODES, HORIZON)
    else:
        plants, actions = draw_episodes(rng, GAIT_PLANTS, TRIAL, len(candidates))
    steps, count = actions.shape
    # The law reads its parameters from its memory, so that one batch serves all candidates.
    law = CoreLaw("gait_candidate", torque_limit=TORQUE_LIMIT)
    env = CapsuleVectorEnv(
        count,
        controller=Controller("candidate", law, gains.NO_REFERENCE, memory=(0.0,) * law.cells),
        residual_limit=RESIDUAL_LIMIT,
        randomization="wide",
        control_dt=CONTROL_DT,
        max_episode_steps=steps,
        autoreset_mode="DISABLED",
        threads=os.cpu_count() or 1,
    )
    times = [steps * CONTROL_DT * part / len(plants) for part in range(1, len(plants))]
    changes = [
        [{"t": t, "M": M, "mu": mu} for t, (M, mu) in zip(times, jumps, strict=True)]
        for jumps in plants[1:].transpose(2, 0, 1).tolist()
    ]
    env.reset(seed=0, options={"M": plants[0, 0], "mu": plants[0, 1], "changes": changes})
    # The first millisecond has no torque: a reset calls the law before its memory can be written.
    for cell, values in enumerate(np.transpose([rounded("gait", each) for each in candidates])):
        env.simulation.write(ROWS + cell, np.repeat(values, count // len(candidates)))
    for row in actions.astype(np.float32):
        env.step(row[:, None])
    metrics = env.simulation.metrics(np.arange(count), steps)
    failed = GAIT_FAILURE * (2.0 - metrics["duration"] / (steps * CONTROL_DT))
    scores = np.where(metrics["failed"] > 0.0, failed, metrics["mean_speed"]).reshape(len(candidates), -1)
    speed, failures = round(float(metrics["mean_speed"].mean()), 4), int(metrics["failed"].sum())
    return scores.mean(axis=1), {"mean_speed": speed, "failures": failures, "episodes": count}


def draw_episodes(
    rng: np.random.Generator, count: int, horizon: float, repeats: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Draws the episodes of gaits; every second one has random actions, the residual torques.

    There are `count` sequences of plants, each a Latin hypercube in M and log(mu) over `wide`; they are repeated with
    other actions. An episode lasts `horizon` s.

    Returns:
        M in kg and mu in every part of an episode, shape (parts, 2, episodes), and actions, shape (steps, episodes).
    """
    ranges = plant_ranges(RANDOMIZATIONS["wide"], NOMINAL)

    def draw_plants() -> np.ndarray:
        shares = [(rng.permutation(count) + rng.random(count)) / count for _ in range(2)]
        return np.array([plant_at(ranges, *pair) for pair in np.transpose(shares).tolist()]).T

    plants = np.tile([draw_plants() for _ in range(PLANTS_PER_EPISODE)], repeats)
    disturbed = np.tile(np.arange(count) % 2, repeats)
    return plants, disturbed * rng.uniform(-1.0, 1.0, (round(horizon / CONTROL_DT), disturbed.size))


def rounded(name: Name, parameters: np.ndarray) -> np.ndarray:
    """The parameters of a law with nine digits, as on file; the gain of a gait's guard is not negative."""
    values = np.array([float(f"{value:.9g}") for value in parameters])
    if name == "gait":
        values[-2] = abs(values[-2])
    return values


def tune(name: Name, generations: int, seed: int, step: float) -> None:
    """Runs a search; a mean of the distribution that scores better than the parameters on file replaces them."""
    own, (population, stream) = problem(name), (GAIT_POPULATION, 3) if name == "gait" else (POPULATION, 4)
    rng = np.random.default_rng([seed, stream])
    options: dict[str, Any] = {"popsize": population, "verbose": -9}
    # The package would otherwise seed numpy's global generator.
    options |= {"seed": math.nan, "randn": lambda *shape: rng.standard_normal(shape)}
    strategy = import_module("cma").CMAEvolutionStrategy(own.start / own.units, step, options)
    content = json.loads(gains.TUNED.read_text(encoding="utf-8")) if gains.TUNED.is_file() else {}
    best = own.run(np.array([content[name]["parameters"]]), None)[0][0] if name in content else -math.inf
    for generation in range(generations + 1):
        if generation > 0:
            points = strategy.ask()
            strategy.tell(points, (-own.run(np.array(points) * own.units, rng)[0]).tolist())
        if generation % INTERVAL > 0 and generation < generations:
            continue
        mean = rounded(name, strategy.mean * own.units)
        (reached,), metrics = own.run(mean[None], None)
        print(f"generation {generation}: score {reached:.3f}, on file {best:.3f}; {metrics}", flush=True)
        if reached > best:
            best = reached
            origin = f"python -m baselines.tuning {name} --generations {generations} --seed {seed} --step {step:g}"
            content[name] = {"parameters": mean.tolist(), "found": {"command": origin, **metrics}}
            lines = ",\n".join(f' "{key}": {json.dumps(content[key])}' for key in sorted(content))
            write_atomically(gains.TUNED, "{\n" + lines + "\n}\n")


def design_lqr() -> None:
    """Writes the regulator with the best score under disturbances to its file."""
    best = -math.inf
    for content in lqr.candidates():
        regulator = ScriptedPolicy("lqr", "", {}, partial(lqr.start, regulator=lqr.interpolate(content)))
        reached, metrics = score(regulator, REAL, VALIDATION_SEED, VALIDATION_PLANTS // 4, HORIZON)
        print(f"{len(content['torques'])} control intervals: score {reached:.3f}; {metrics}", flush=True)
        if reached > best:
            best = reached
            lines = ",\n".join(f' "{name}": {json.dumps(values)}' for name, values in content.items())
            write_atomically(lqr.FILE, "{\n" + lines + "\n}\n")


@command("python -m baselines.tuning")
def main(law: Positional[Name], generations: int = 200, seed: int = 0, step: float = 0.5) -> None:
    """Tunes a law on random plants; baselines/laws/tuned.json keeps the best parameters so far, also after Ctrl-C.

    Examples:
      python -m baselines.tuning pd --generations 200
      python -m baselines.tuning gait --generations 700 --step 0.2

    Args:
        law: The law.
        generations: Generations of the search, of 20 candidates on 32 plants each, or of 24 gaits on 64 plants.
        seed: Seed of the search.
        step: Initial standard deviation of the parameters in their units.
    """
    if law == "lqr":
        design_lqr()
    else:
        tune(law, generations, seed, step)


if __name__ == "__main__":
    sys.exit(main())
