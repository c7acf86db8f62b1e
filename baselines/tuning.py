"""Tunes the laws of `baselines.laws.periodic` and designs the policy `lqr`: `python -m baselines.tuning pd`.

A CMA-ES searches the parameters of a law. In each generation all candidates run on the same newly drawn plants. At the
end the mean of the distribution runs on fixed validation plants, and replaces the parameters on file if it scores
better. The seeds of both are far from those of the frozen evaluation sets.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np

from baselines import lqr
from baselines.archive import make_strategy
from baselines.dynamic_programming.archive import cycle
from baselines.laws import periodic
from baselines.policies import ScriptedPolicy
from capsule_gym import CapsuleVectorEnv
from capsule_gym.command_line import Positional, command
from capsule_gym.controller import Controller
from capsule_gym.files import write_atomically
from capsule_gym.task import HORIZON, TORQUE_LIMIT

Name = Literal["open-loop", "open-loop-real", "pd", "oscillator", "lqr"]

POPULATION, PLANTS, TRIAL = 20, 32, 12.0
# s: agent step of a law without a residual.
CONTROL_DT = 0.1
# Seeds of the trials' plants are drawn from 2**40 on.
FIRST_SEED, VALIDATION_SEED, VALIDATION_PLANTS = 2**40, 2**50, 1024
# cm/s: deduction for a failure, in which the distance moved so far already counts over the whole horizon.
FAILURE = 10.0
PAPER = {"randomization": "paper"}
REAL = {"randomization": "real", "disturbances": "real"}


class Problem(NamedTuple):
    """A tuning problem: the law from its parameters, their start and units, and the plants' environment."""

    make: Callable[[Sequence[float]], Controller]
    start: np.ndarray
    units: np.ndarray
    env_kwargs: Mapping[str, Any]


def problem(name: Name) -> Problem:
    """The problem of a law."""
    series_units = np.array([0.05, 0.05, *[0.1] * (2 * periodic.HARMONICS)])
    if name == "pd":
        # The angle in the limit cycle of dynamic programming.
        theta, period = cycle()["theta"][:-1], cycle()["time"][-1]
        harmonics = np.fft.rfft(theta)[1 : periodic.HARMONICS + 1] * 2.0 / len(theta)
        start = [period, theta.mean(), *harmonics.real, *-harmonics.imag, 6.0, 0.3]
        units = [*series_units, 2.0, 0.2]
        return Problem(periodic.pd, np.array(start), np.array(units), REAL)
    if name == "oscillator":
        # omega and alpha; the effect of theta, theta_dot and x_dot on a and b; bias and polynomial; spring and damper.
        start = [30.0, 95.0, 47.0, -11.0, -63.0, -4.0, -2.5, 10.0, -1.5, -1.0, 2.6, 1.9, -8.0, 9.3, -2.1, 14.2, 2.3]
        units = [2.0, 3.0, *[3.0, 0.6, 6.0] * 2, 0.15, *[0.45] * 6, 0.45, 0.09]
        return Problem(periodic.oscillator, np.array(start), np.array(units), PAPER)
    # Results of earlier searches: without feedback most torques near the optimum's drop the pendulum.
    if name == "open-loop-real":
        start, condition = [0.5949, 0.018, -0.68, 0.762, -0.368, -0.13, 0.244, -0.249, -0.004, 0.053], REAL
    else:
        start, condition = [0.581, 0.022, -0.697, 0.736, -0.215, -0.266, 0.254, -0.267, -0.005, 0.013], PAPER
    return Problem(periodic.open_loop, np.array(start), series_units * [1.0, *[TORQUE_LIMIT] * 9], condition)


def score(
    policy: ScriptedPolicy, env_kwargs: Mapping[str, Any], seed: int, plants: int, seconds: float
) -> tuple[float, dict[str, float]]:
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


def tune(name: Name, generations: int, seed: int, first_step: float) -> None:
    """Runs a search and writes its result to the file if it scores better there."""
    rng, own = np.random.default_rng([seed, 4]), problem(name)

    def evaluate(parameters: np.ndarray, *arguments: Any) -> tuple[float, dict[str, float]]:
        kwargs = {"controller": own.make(parameters.tolist()), "control_dt": CONTROL_DT}
        return score(ScriptedPolicy(name, "", kwargs), own.env_kwargs, *arguments)

    strategy = make_strategy(own.start / own.units, first_step, POPULATION, rng)
    for generation in range(1, generations + 1):
        points, plants = strategy.ask(), FIRST_SEED + PLANTS * int(rng.integers(2**30))
        reached = [evaluate(point * own.units, plants, PLANTS, TRIAL)[0] for point in points]
        strategy.tell(points, [-each for each in reached])
        if generation % 20 == 0:
            print(f"generation {generation}: best score {max(reached):.2f}, step {strategy.sigma:.3f}", flush=True)
    mean = np.array([float(f"{value:.9g}") for value in strategy.mean * own.units])
    validation = VALIDATION_SEED, VALIDATION_PLANTS, HORIZON
    found, metrics = evaluate(mean, *validation)
    content = json.loads(periodic.FILE.read_text(encoding="utf-8")) if periodic.FILE.is_file() else {}
    known = evaluate(np.array(content[name]["parameters"]), *validation)[0] if name in content else -math.inf
    print(f"{name}: score {found:.3f}, on file {known:.3f}; {metrics}")
    if found > known:
        command = f"python -m baselines.tuning {name} --generations {generations} --seed {seed} --step {first_step:g}"
        origin = {"command": command, **metrics, "episodes": VALIDATION_PLANTS}
        content[name] = {"parameters": mean.tolist(), "found": origin}
        lines = ",\n".join(f' "{key}": {json.dumps(content[key])}' for key in sorted(content))
        write_atomically(periodic.FILE, "{\n" + lines + "\n}\n")


@command("python -m baselines.tuning")
def main(law: Positional[Name], generations: int = 200, seed: int = 0, step: float = 0.5) -> None:
    """Tunes a law on random plants; baselines/laws/periodic.json keeps the better parameters.

    Examples:
      python -m baselines.tuning pd --generations 200

    Args:
        law: The law.
        generations: Generations of the search, of 20 candidates on 32 plants each.
        seed: Seed of the search.
        step: Initial standard deviation of the parameters in their units.
    """
    if law == "lqr":
        design_lqr()
    else:
        tune(law, generations, seed, step)


if __name__ == "__main__":
    sys.exit(main())
