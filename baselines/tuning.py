"""Tunes control laws on random plants, and designs the policy `lqr`.

`python -m baselines.tuning pd` tunes a law.

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

TRIAL = 12.0  # s
CONTROL_DT = 0.1  # s: the agent step
# Generations between two validations.
INTERVAL = 50

POPULATION = 20
PLANTS = 32
FIRST_SEED = 2**40  # seeds of the trials' plants are drawn from here on
VALIDATION_SEED = 2**50
VALIDATION_PLANTS = 1024
# cm/s: deduction for a failure, in which the distance moved so far already counts over the whole
# horizon.
FAILURE = 10.0
PAPER = {"randomization": "paper"}
REAL = {"randomization": "real", "disturbances": "real"}
Make = Callable[[Sequence[float]], Controller]
# The functions of the laws, and the plants and disturbances on which they are tuned. `gains.TUNED`
# contains, by name, the parameters with which a search starts and their scales in the search.
PROBLEMS: dict[str, tuple[Make, Mapping[str, Any]]] = {
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
    speed = float(scores(episodes, "mean_speed").mean())
    failed = failures(episodes)
    metrics = {"mean_speed": round(speed, 4), "failures": failed}
    return speed - FAILURE * failed / plants, metrics


def score_law(
    name: str, parameters: np.ndarray, seed: int, plants: int, seconds: float
) -> tuple[float, Metrics]:
    """`score` of a law with parameters on the plants of its problem."""
    make, env_kwargs = PROBLEMS[name]
    kwargs = {"controller": make(parameters.tolist()), "control_dt": CONTROL_DT}
    return score(ScriptedPolicy(name, "", kwargs), env_kwargs, seed, plants, seconds)


def tune(name: str, generations: int, seed: int, step: float) -> None:
    """Runs a search.

    A mean of the distribution that scores better than the parameters on file replaces them.
    """
    import cma  # needs an extra of the package

    own = json.loads(gains.TUNED.read_text(encoding="utf-8"))[name]
    units = np.array(own["units"])
    rng = np.random.default_rng([seed, 4])
    options = {
        "popsize": POPULATION,
        "verbose": -9,
        # The package would otherwise seed numpy's global generator.
        "seed": math.nan,
        "randn": lambda *shape: rng.standard_normal(shape),
    }
    strategy = cma.CMAEvolutionStrategy(np.array(own["start"]) / units, step, options)
    origin = (
        f"python -m baselines.tuning {name} --generations {generations} --seed {seed} "
        f"--step {step:g}"
    )
    best = -math.inf
    if "parameters" in own:
        best, _ = _validate(name, np.array(own["parameters"]))
    for generation in range(generations + 1):
        if generation > 0:
            points = strategy.ask()
            first = FIRST_SEED + PLANTS * int(rng.integers(2**30))
            trials = [score_law(name, point * units, first, PLANTS, TRIAL) for point in points]
            strategy.tell(points, [-score for score, _ in trials])
        if generation % INTERVAL > 0 and generation < generations:
            continue
        # As on file.
        rounded = [float(f"{value:.9g}") for value in strategy.mean * units]
        mean = np.array(rounded)
        reached, metrics = _validate(name, mean)
        progress = f"generation {generation}: score {reached:.3f}, on file {best:.3f}"
        print(f"{progress}; {metrics}", flush=True)
        if reached > best:
            best = reached
            found = {"command": origin, **metrics, "episodes": VALIDATION_PLANTS}
            _write(name, {**own, "parameters": mean.tolist(), "found": found})


def _validate(name: str, parameters: np.ndarray) -> tuple[float, Metrics]:
    return score_law(name, parameters, VALIDATION_SEED, VALIDATION_PLANTS, HORIZON)


def _write(name: str, parameters: dict[str, Any]) -> None:
    # Read again, since the searches of other laws may have written theirs.
    content = json.loads(gains.TUNED.read_text(encoding="utf-8"))
    content[name] = parameters
    write_atomically(gains.TUNED, _one_line_each(dict(sorted(content.items()))))


def _one_line_each(content: Mapping[str, Any]) -> str:
    """A JSON object with a line for each entry."""
    lines = ",\n".join(f' "{name}": {json.dumps(values)}' for name, values in content.items())
    return "{\n" + lines + "\n}\n"


@command("python -m baselines.tuning", ValueError)
def main(
    law: Positional[Name], generations: Count = 200, seed: Count = 0, step: float = 0.5
) -> None:
    """Tunes a law on random plants.

    capsule_gym/data/laws/tuned.json keeps the best parameters, also after Ctrl-C.

    Examples:
      python -m baselines.tuning pd --generations 200

    Args:
        law: The law; lqr compares its designs.
        generations: Generations of the search, of 20 candidates on 32 plants each.
        seed: Seed of the search.
        step: Initial standard deviation of the parameters in their units.
    """
    check_number("--step", step, "a finite number > 0", 0.0, open_low=True)
    if law == "lqr":
        _design_lqr()
    else:
        tune(law, generations, seed, step)


def _design_lqr() -> None:
    """Writes the design of `lqr` with the best score, after all have been tried."""
    best = -math.inf
    chosen: dict[str, list] = {}
    for content in lqr.candidates():
        start = partial(lqr.start, regulator=lqr.interpolate(content))
        policy = ScriptedPolicy("lqr", "", {}, start)
        reached, metrics = score(policy, REAL, VALIDATION_SEED, VALIDATION_PLANTS // 4, HORIZON)
        intervals = len(content["torques"])
        print(f"{intervals} control intervals: score {reached:.3f}; {metrics}", flush=True)
        if reached > best:
            best = reached
            chosen = content
    write_atomically(lqr.FILE, _one_line_each(chosen))


if __name__ == "__main__":
    sys.exit(main())
