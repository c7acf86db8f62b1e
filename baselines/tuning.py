"""Tunes control laws on random plants, and designs the policy `lqr`: `python -m baselines.tuning
pd`.

A CMA-ES searches the parameters of a law. In each generation all candidates run on the same newly
drawn plants. At regular intervals the mean of the distribution runs in fixed validation episodes;
it replaces the parameters on file if it scores better. The seeds of both are far from those of the
frozen evaluation sets.
"""

import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np

from baselines import lqr
from capsule_gym.checks import check_number
from capsule_gym.command_line import Count, Positional, command
from capsule_gym.control.controller import Controller
from capsule_gym.control.laws import gains, gait, periodic
from capsule_gym.evaluation.episodes import evaluate, failures, scores, validation_set
from capsule_gym.files import write_atomically
from capsule_gym.policies.scripted import ScriptedPolicy
from capsule_gym.tasks.task import HORIZON

Name = Literal["open-loop", "open-loop-real", "pd", "oscillator", "gait", "lqr"]

# s: a trial, and the agent step.
TRIAL, CONTROL_DT = 12.0, 0.1
# Generations between two validations.
INTERVAL = 50

POPULATION, PLANTS = 20, 32
# Seeds of the trials' plants are drawn from 2**40 on.
FIRST_SEED, VALIDATION_SEED, VALIDATION_PLANTS = 2**40, 2**50, 1024
# cm/s: deduction for a failure, in which the distance moved so far already counts over the whole
# horizon.
FAILURE = 10.0
PAPER = {"randomization": "paper"}
REAL = {"randomization": "real", "disturbances": "real"}
# The functions of the laws, and the plants and disturbances on which they are tuned. `gains.TUNED`
# contains, by name, the parameters with which a search starts and their scales in the search.
PROBLEMS: dict[str, tuple[Callable[[Sequence[float]], Controller], Mapping[str, Any]]] = {
    "open-loop": (periodic.open_loop, PAPER),
    "open-loop-real": (periodic.open_loop, REAL),
    "pd": (periodic.pd, REAL),
    "oscillator": (periodic.oscillator, PAPER),
    "gait": (gait.gait, {"randomization": "wide"}),
}

Metrics = dict[str, float]


def score(
    policy: ScriptedPolicy, env_kwargs: Mapping[str, Any], seed: int, plants: int, seconds: float
) -> tuple[float, Metrics]:
    """Runs a policy on random plants, the first with this seed.

    Returns:
        The mean speed less a deduction for failures, cm/s; and the mean speed and the number of
        failures.
    """
    drawn = validation_set(name="random plants", first_seed=seed, count=plants, **env_kwargs)
    episodes = evaluate(policy, drawn, horizon=seconds)
    speed, failed = float(scores(episodes, "mean_speed").mean()), failures(episodes)
    return speed - FAILURE * failed / plants, {"mean_speed": round(speed, 4), "failures": failed}


def score_law(
    name: str, parameters: np.ndarray, seed: int, plants: int, seconds: float
) -> tuple[float, Metrics]:
    """`score` of a law with parameters on the plants of its problem."""
    make, env_kwargs = PROBLEMS[name]
    kwargs = {"controller": make(parameters.tolist()), "control_dt": CONTROL_DT}
    return score(ScriptedPolicy(name, "", kwargs), env_kwargs, seed, plants, seconds)


def tune(name: str, generations: int, seed: int, step: float) -> None:
    """Runs a search; a mean of the distribution that scores better than the parameters on file
    replaces them.
    """
    import cma  # needs an extra of the package

    own = json.loads(gains.TUNED.read_text(encoding="utf-8"))[name]
    rng, units = np.random.default_rng([seed, 4]), np.array(own["units"])
    validate = partial(
        score_law, name, seed=VALIDATION_SEED, plants=VALIDATION_PLANTS, seconds=HORIZON
    )
    options: dict[str, Any] = {"popsize": POPULATION, "verbose": -9}
    # The package would otherwise seed numpy's global generator.
    options |= {"seed": math.nan, "randn": lambda *shape: rng.standard_normal(shape)}
    strategy = cma.CMAEvolutionStrategy(np.array(own["start"]) / units, step, options)
    best = validate(np.array(own["parameters"]))[0] if "parameters" in own else -math.inf
    for generation in range(generations + 1):
        if generation > 0:
            points, first = strategy.ask(), FIRST_SEED + PLANTS * int(rng.integers(2**30))
            strategy.tell(
                points,
                [-score_law(name, point * units, first, PLANTS, TRIAL)[0] for point in points],
            )
        if generation % INTERVAL > 0 and generation < generations:
            continue
        # As on file.
        mean = np.array([float(f"{value:.9g}") for value in strategy.mean * units])
        reached, metrics = validate(mean)
        print(
            f"generation {generation}: score {reached:.3f}, on file {best:.3f}; {metrics}",
            flush=True,
        )
        if reached > best:
            best = reached
            origin = f"python -m baselines.tuning {name} --generations {generations} --seed {seed} --step {step:g}"
            found = {"command": origin, **metrics, "episodes": VALIDATION_PLANTS}
            # Read again, since the searches of other laws may have written theirs.
            content = json.loads(gains.TUNED.read_text(encoding="utf-8"))
            content[name] = {**own, "parameters": mean.tolist(), "found": found}
            lines = ",\n".join(f' "{key}": {json.dumps(content[key])}' for key in sorted(content))
            write_atomically(gains.TUNED, "{\n" + lines + "\n}\n")


@command("python -m baselines.tuning", ValueError)
def main(
    law: Positional[Name], generations: Count = 200, seed: Count = 0, step: float = 0.5
) -> None:
    """Tunes a law on random plants; capsule_gym/data/laws/tuned.json keeps the best parameters,
    also after Ctrl-C.

    Examples:
      python -m baselines.tuning pd --generations 200

    Args:
        law: The law; lqr compares its designs.
        generations: Generations of the search, of 20 candidates on 32 plants each.
        seed: Seed of the search.
        step: Initial standard deviation of the parameters in their units.
    """
    check_number("--step", step, "a finite number > 0", 0.0, open_low=True)
    if law != "lqr":
        tune(law, generations, seed, step)
        return
    # Only the best of all designs replaces the one on file.
    best, chosen = -math.inf, dict[str, list]()
    for content in lqr.candidates():
        regulator = ScriptedPolicy(
            "lqr", "", {}, partial(lqr.start, regulator=lqr.interpolate(content))
        )
        reached, metrics = score(regulator, REAL, VALIDATION_SEED, VALIDATION_PLANTS // 4, HORIZON)
        print(
            f"{len(content['torques'])} control intervals: score {reached:.3f}; {metrics}",
            flush=True,
        )
        if reached > best:
            best, chosen = reached, content
    lines = ",\n".join(f' "{name}": {json.dumps(values)}' for name, values in chosen.items())
    write_atomically(lqr.FILE, "{\n" + lines + "\n}\n")


if __name__ == "__main__":
    sys.exit(main())
