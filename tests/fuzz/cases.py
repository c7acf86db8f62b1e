"""One case: an environment or a batch, what is done to it, and what must hold."""

from __future__ import annotations

import copy
import pickle
import re
import warnings
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from capsule_gym import CapsuleEnv, CapsuleVectorEnv
from capsule_gym.parameters import written
from tests.fuzz import values

SEED = 20_261_121
# Of an episode without forward travel; and of one that has not been stepped.
INFINITE = ("cost_of_transport", "backward_ratio", "smallest_normal_ratio")
FINAL = ("final_obs", "final_info", "_final_obs", "_final_info")


class BrokenError(AssertionError):
    """Something that must never happen, in words."""


def check_finite(where: str, value: Any) -> None:
    """Raises an error for numbers that are not finite, also inside dictionaries and arrays of objects."""
    if isinstance(value, dict):
        for name, entry in value.items():
            if name in INFINITE:
                # NaN and minus infinity stay what they are, infinity becomes 0.
                entry = np.where(np.isposinf(entry), 0.0, entry)
            check_finite(f"{where}[{name!r}]", entry)
    elif isinstance(value, np.ndarray) and value.dtype == object:
        for entry in value.ravel():
            check_finite(where, entry)
    elif value is not None and not np.isfinite(value).all():
        raise BrokenError(f"{where} is not finite: {value}")


def check_inside(space: gym.Space[Any], observation: Any) -> None:
    """Raises an error for an observation outside its space."""
    if not space.contains(observation):
        raise BrokenError(f"the observation {observation!r} lies outside {space}")


def layout(info: dict[str, Any]) -> dict[str, Any]:
    """Keys, types and shapes of an info."""
    return {
        name: layout(value) if isinstance(value, dict) else (type(value), value.dtype, value.shape)
        for name, value in info.items()
    }


def same(a: Any, b: Any) -> bool:
    """Whether two results are equal, bit for bit."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[name], b[name]) for name in a)
    if isinstance(a, (tuple, list)) or (isinstance(a, np.ndarray) and a.dtype == object):
        return len(a) == len(b) and all(map(same, a, b))
    return np.array_equal(a, b)


class Case:
    """One number's worth of fuzzing.

    Args:
        number: of the case.

    Attributes:
        steps: agent steps so far, over all environments.
        last: the last call with its arguments.
    """

    def __init__(self, number: int) -> None:
        self.rng = np.random.default_rng([SEED, number])
        self.steps = 0
        self.last = ""
        self._batch = self.chance(0.4)
        self._layouts: dict[bool, dict[str, Any]] = {}
        self._env: Any = None

    def run(self) -> None:
        """Makes, resets, steps and closes.

        Raises:
            BrokenError: where something happens that must not. What else comes out of a call is a failure as well.
        """
        with warnings.catch_warnings():
            # That a call is odd may be said.
            warnings.simplefilter("ignore")
            if any(self._make() for _ in range(4)):
                for _ in range(int(self.rng.integers(1, 4))):
                    self._reset()
                    self._episode()
                self._env.close()

    def chance(self, probability: float) -> bool:
        """True that often."""
        return bool(self.rng.random() < probability)

    def call(self, names: Iterable[Any], what: str, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Calls; returns the result, or None where the call was refused.

        Args:
            names: of which the message of a refusal must hold one.
            what: name of the function.
            function: what is called, with the arguments behind it.

        Raises:
            BrokenError: if it is refused in a way that a user could not make sense of.
        """
        said = [*map(written, args), *(f"{name}={written(value)}" for name, value in kwargs.items())]
        self.last = f"{what}({', '.join(said)})"
        try:
            return function(*args, **kwargs)
        except gym.error.ResetNeeded:
            return None
        except (ValueError, TypeError) as error:
            words = {word.lower() for word in re.findall(r"\w+", str(error))}
            if words.isdisjoint(str(name).lower() for name in names):
                raise BrokenError(f"{type(error).__name__} that names none of {list(names)}: {error}") from error
            return None

    def _make(self) -> bool:
        """Makes the environment; returns whether it may be made."""
        pools = values.BATCH_ARGUMENTS if self._batch else values.ARGUMENTS
        arguments = {"num_envs": 2} if self._batch else {}
        arguments |= {name: draw(self.rng) for name, draw in pools.items() if self.chance(0.4)}
        for name, value in arguments.items():
            # What is made of values that may be refused.
            if isinstance(value, partial):
                arguments[name] = self.call(value.keywords, value.func.__name__, value.func, **value.keywords)
        if arguments.get("randomization", "") is None:
            del arguments["randomization"]
        if self.chance(0.3):
            name = values.one(self.rng, list(pools))
            arguments[name] = values.one(self.rng, values.HOSTILE_ARGUMENTS.get(name, values.HOSTILE))
        kind = CapsuleVectorEnv if self._batch else CapsuleEnv
        # The defaults of the last two need not go with what is given.
        self._env = self.call([*arguments, "randomization", "physics_dt"], kind.__name__, kind, **arguments)
        return self._env is not None

    def _options(self) -> dict[str, Any]:
        """Options of a reset."""
        rng, n = self.rng, getattr(self._env, "num_envs", 0)
        options: dict[str, Any] = {}
        for name, draw in values.OPTIONS.items():
            if self.chance(0.25):
                each = n and (name == "changes" or self.chance(0.5))
                options[name] = [draw(rng) for _ in range(n)] if each else draw(rng)
        if n and self.chance(0.2):
            options["reset_mask"] = rng.integers(0, 2, n).astype(np.bool_)
        if self.chance(0.15):
            name = values.one(rng, (*values.OPTIONS, "reset_mask", "seed", 3))
            options[name] = values.one(rng, values.HOSTILE)
            if name == "changes" and self.chance(0.5):
                options[name] = [values.one(rng, values.HOSTILE_CHANGES)]
                options[name] = [options[name]] * n if n else options[name]
        return options

    def _reset(self) -> None:
        """Resets, or not, if that is refused."""
        options: Any = self._options()
        seed = values.one(self.rng, values.SEEDS)
        if self.chance(0.05):
            seed = values.one(self.rng, values.HOSTILE_SEEDS)
        if self._batch and self.chance(0.1):
            seed = list(range(self._env.num_envs))
        names = ["options", "seed", *options]
        if self.chance(0.02):
            options = values.one(self.rng, values.HOSTILE)
        result = self.call(names, "reset", self._env.reset, seed=seed, options=options)
        if result is not None:
            self._check(*result)

    def _episode(self) -> None:
        """Steps for a while."""
        rng, n = self.rng, getattr(self._env, "num_envs", 1)
        drive = values.one(rng, values.DRIVES)
        for step in range(int(rng.integers(1, 40 if self._batch else 200))):
            if self.chance(0.01):
                self._disturb()
            actions: Any = drive(rng, step, n).astype(np.float32)
            if not self._batch:
                actions = actions[0]
            if self.chance(0.04):
                actions = values.hostile_actions(rng, actions)
            twin = self._copied() if self.chance(0.005) else None
            result = self.call(("action", "actions", "law"), "step", self._env.step, actions)
            if result is None:
                continue
            self.steps += n
            if twin is not None and not same(result, twin.step(actions)):
                raise BrokenError("a copy gives other results than its original")
            observation, reward, terminated, _, info = result
            self._check(observation, info)
            check_finite("the reward", reward)
            if not self._batch and terminated and self.chance(0.8):
                break
        check_finite("metrics", self._env.episode_metrics())

    def _disturb(self) -> None:
        """What may be done to an environment between two steps."""
        what = int(self.rng.integers(3))
        if what == 0:
            self._env = self._copied()
        elif what == 1:
            self._env.close()
        elif getattr(self._env, "num_envs", 1) < 10:
            self._env.render()

    def _copied(self) -> Any:
        """The environment as `deepcopy` or pickle makes it."""
        return copy.deepcopy(self._env) if self.chance(0.5) else pickle.loads(pickle.dumps(self._env))

    def _check(self, observation: Any, info: dict[str, Any]) -> None:
        """What must hold of the result of every reset and step."""
        check_inside(self._env.observation_space, observation)
        check_finite("info", info)
        final = "final_obs" in info
        if final:
            if self._env.autoreset_mode is not AutoresetMode.SAME_STEP or not info["_final_obs"].any():
                raise BrokenError("the info tells of an end where there was none")
            for last in info["final_obs"][info["_final_obs"]]:
                check_inside(self._env.single_observation_space, last)
        found, known = layout(info), self._layouts.setdefault(final, layout(info))
        if found != known:
            raise BrokenError(f"the info's layout changes from {known} to {found}")


def run(number: int) -> tuple[int, str | None]:
    """Runs one case; returns its agent steps, and what is wrong in words."""
    case = Case(number)
    try:
        case.run()
    except Exception as error:
        return case.steps, f"{type(error).__name__}: {error}; {case.last[:300]}"
    return case.steps, None
