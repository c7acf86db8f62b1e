"""The native batch of environments."""

import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from typing_extensions import Unpack

from capsule_gym.checks import check_integer, require, short_repr
from capsule_gym.core.layout import Row
from capsule_gym.envs import env, resets
from capsule_gym.envs.config import EnvConfig, EnvOptions
from capsule_gym.envs.contract import SPEED
from capsule_gym.envs.simulation import check_seed
from capsule_gym.envs.threads import single_use
from capsule_gym.rendering import Renderer


class CapsuleVectorEnv(VectorEnv[Any, np.ndarray, np.ndarray]):
    """N independent `CapsuleEnv`, stepped together by the compiled core.

    `gym.make_vec("CapsuleStickSlip-v0", num_envs=N)` creates one. Spaces, rewards, info and random
    draws are those of `CapsuleEnv`. Environment i of a batch with seed s gives, bit for bit, the
    episodes of a single environment with seed s + i, for any batch size and any number of threads.
    `copy.deepcopy` and `pickle` copy the running episodes.

    The batch truncates episodes itself, after `max_episode_steps`. The autoreset modes are those of
    gymnasium:

    - NEXT_STEP: the step after the end of an episode ignores the action and returns the first
      observation of the next episode with reward 0.
    - SAME_STEP: the last step of an episode returns the first observation of the next one. The last
      observation is in `info["final_obs"]`, its info with the metrics of the episode in
      `info["final_info"]`.
    - DISABLED: an environment whose episode has ended does not change until
      `reset(options={"reset_mask": mask})` resets it. The quantities of a step in its info are 0,
      and their masks False.

    Args:
        num_envs: number of environments.
        max_episode_steps: agent steps until truncation; None takes the task's, `gym.make_vec` the
            id's, and -1 is none.
        autoreset_mode: an `AutoresetMode` or its name, "NEXT_STEP", "SAME_STEP" or "DISABLED".
        render_mode: None or "rgb_array".
        **options: the other arguments of `CapsuleEnv`, and `threads`: number of threads, each for
            at least 128 environments; results do not depend on it.

    Raises:
        TypeError: if an argument is of the wrong type.
        ValueError: if an argument is out of range, or a plant admits Painleve's paradox or is too
            stiff for `physics_dt`.
    """

    # Gymnasium declares it as the instance's, and wrappers change it: each instance gets a copy.
    metadata: dict[str, Any] = {  # noqa: RUF012 (as Gymnasium declares it)
        "render_modes": ["rgb_array"],
        "render_fps": 50,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    compute_reward = property(env.goal_reward)

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **options: Unpack[EnvOptions],
    ) -> None:
        # Nothing to close after an invalid argument: gymnasium 1.1 closes such a batch, too, when
        # it is deleted.
        self.closed = True
        config = EnvConfig(render_mode=render_mode, **options)
        supported = render_mode != "human"
        require(supported, "render_mode of a batch", "None or 'rgb_array'", render_mode)
        self.autoreset_mode = find_autoreset_mode(autoreset_mode)
        self.simulation = env.make_simulation(num_envs, config)
        if max_episode_steps is None:
            max_episode_steps = self.simulation.task.episode_steps
        self.max_episode_steps = check_time_limit(max_episode_steps)
        self.num_envs = self.simulation.num_envs
        self.render_mode = render_mode
        self.metadata = {
            **type(self).metadata,
            "render_fps": env.frames_per_second(self.simulation),
            "autoreset_mode": self.autoreset_mode,
        }
        self.single_action_space, self.single_observation_space = env.make_spaces(self.simulation)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._ended = np.zeros(self.num_envs, np.bool_)
        self._started = False
        self._seeded = False
        self._renderer: Renderer | None = None
        self._spec: EnvSpec | None = None
        self._everyone = np.ones(self.num_envs, np.bool_)
        self._everyone.flags.writeable = False
        # The masks of an info of every environment; building their names takes a third of the
        # info's time.
        self._masks: dict[str, np.ndarray] = {}
        # The drawn values of the running episodes, as in infos, and the count of resets at which
        # they were read.
        self._drawn: dict[str, dict[str, np.ndarray]] = {}
        self._drawn_at = 0
        self.closed = False

    def __getstate__(self) -> dict[str, Any]:
        """The state of the episodes, without the frames."""
        return {**vars(self), "_renderer": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        # A copied array can be written to, and the copied simulation counts its resets from 0 on.
        self._everyone.flags.writeable = False
        self._drawn_at = -1

    @property
    def in_use(self) -> Any:
        """The lock of the methods that change the episodes, for one thread at a time."""
        return self.simulation.in_use

    @property
    def spec(self) -> EnvSpec | None:
        """The spec with which `gym.make_vec` created the batch."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        # make_vec passes the registered spec, whose time limit is not the batch's if the caller has
        # set another one.
        self._spec = spec and replace(spec, max_episode_steps=self.max_episode_steps)

    @single_use
    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begins new episodes.

        Args:
            seed: environment i gets seed + i, or the i-th entry of a sequence; None continues its
                random streams.
            options: options of `CapsuleEnv.reset`, each one value for all environments or one per
                environment ("changes": a list per environment), and "reset_mask", bool of shape
                (num_envs,), which selects the environments.

        Returns:
            Observations, float32 of shape (num_envs, entries), and the infos.
        """
        names = (*self.simulation.task.option_sizes, "reset_mask")
        options = resets.check_options(options, names)
        mask = self._reset_mask(options.get("reset_mask"))
        rows = np.flatnonzero(mask)
        self._seed(seed, rows)
        values = {
            name: self._per_row(name, value, rows)
            for name, value in options.items()
            if value is not None and name != "reset_mask"
        }
        self.simulation.reset(rows, **values)
        self._ended[rows] = False
        # The mask of the first reset need not name every environment; one that has not begun has no
        # mass.
        self._started = self._started or bool(self.simulation.row(Row.M).all())
        info = self._info(self.simulation.rows(0, Row.start_x), mask)
        return self.simulation.observe(), info

    def _reset_mask(self, mask: np.ndarray | None) -> np.ndarray:
        """The environments to reset, bool, shape (num_envs,), from an option of `reset`."""
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        name = "options['reset_mask']"
        accepted = f"a bool array of shape ({self.num_envs},) with at least one True"
        is_mask = isinstance(mask, np.ndarray) and mask.dtype == np.bool_
        require(is_mask, name, accepted, mask, TypeError)
        selects = mask.shape == (self.num_envs,) and bool(mask.any())
        require(selects, name, accepted, mask)
        return mask

    @single_use
    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One agent step of every environment.

        Args:
            actions: shape (num_envs, 1), clipped to [-1, 1].

        Returns:
            Observations (num_envs, entries) float32, rewards (num_envs,) float64, terminated and
            truncated (num_envs,) bool, and infos.

        Raises:
            ValueError: if the actions have another shape or are not finite, or the control law
                returned a torque that is not finite.
            gymnasium.error.ResetNeeded: if an environment was never reset.
        """
        if not self._started:
            raise gym.error.ResetNeeded(
                "call reset() before step(): some environment has no running episode"
            )
        array = self._check_actions(actions)
        simulation = self.simulation
        active = ~self._ended if np.count_nonzero(self._ended) else None
        if active is not None and self.autoreset_mode is AutoresetMode.NEXT_STEP:
            simulation.reset(np.flatnonzero(self._ended))
        simulation.step(array[:, 0], active)

        shown = simulation.rows(0, Row.start_x)
        if active is not None and self.autoreset_mode is AutoresetMode.DISABLED:
            shown[Row.normal_force : Row.reward, ~active] = 0.0
        rewards = shown[Row.reward].copy()
        # An environment that began its next episode in this step has taken no step, and one whose
        # episode has ended keeps its termination.
        terminated = shown[Row.termination] != 0.0
        limit = math.inf if self.max_episode_steps is None else self.max_episode_steps
        truncated = shown[Row.steps] >= limit
        ended = terminated | truncated
        info = self._info(shown, self._everyone)
        if active is not None and self.autoreset_mode is AutoresetMode.DISABLED:
            names = ("normal_force", "energy", "cost", *simulation.task.reward_terms)
            info |= {f"_{name}": active for name in names}
        if self.autoreset_mode is not AutoresetMode.SAME_STEP:
            self._ended = ended
        elif ended.any():
            self._begin_next(info, ended)
        return simulation.observe(), rewards, terminated, truncated, info

    def _check_actions(self, actions: Any) -> np.ndarray:
        """The actions as float32, shape (num_envs, 1); raises a ValueError if they are not."""
        array = env.as_actions(actions)
        # `count_nonzero` takes a fifth of the time of `any` and `all`.
        if (
            array is None
            or array.shape != (self.num_envs, 1)
            or np.count_nonzero(np.isfinite(array)) < self.num_envs
        ):
            accepted = f"finite numbers, clipped to [-1, 1], of shape ({self.num_envs}, 1)"
            raise ValueError(f"actions must be {accepted}, got {short_repr(actions)}")
        return array

    def episode_metrics(self) -> dict[str, np.ndarray]:
        """The metrics of the running episodes, each of shape (num_envs,).

        `task.METRICS` and the task define them. A whole episode takes `max_episode_steps`, or
        without a limit the elapsed time.
        """
        return self.simulation.metrics(np.arange(self.num_envs), self.max_episode_steps)

    def render(self) -> tuple[np.ndarray, ...] | None:
        """One frame (height, width, 3), uint8, per environment; None without a render mode."""
        if self.render_mode is None:
            gym.logger.warn(
                "render() draws nothing without a render_mode: gym.make_vec(.., render_mode='rgb_array')"
            )
            return None
        if self._renderer is None:
            self._renderer = env.make_renderer(self)
        states = (env.shown_state(self.simulation, i) for i in range(self.num_envs))
        frames = (self._renderer.draw(**state) for state in states)
        return tuple(frame for frame in frames if frame is not None)

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the threads."""
        self.simulation.close()

    def _info(self, rows: np.ndarray, mask: np.ndarray) -> dict[str, Any]:
        """The infos of the environments that the mask selects, from the first rows of `Row`."""
        simulation = self.simulation
        states = rows[Row.theta : Row.M].T
        terminations = rows[Row.termination].astype(np.int64)
        info = env.describe(rows[: Row.steps], states, terminations)
        if simulation.task is not SPEED:
            memory = simulation.rows(simulation.layout.task, simulation.layout.task_end)
            env.add_task(info, simulation.task, memory)
        if simulation.settings.varied:
            info["reading"] = simulation.rows(Row.read_theta, Row.late_theta).T
            # Until an episode begins these stay the same.
            if simulation.resets != self._drawn_at:
                self._read_drawn()
        everyone = mask is self._everyone
        if everyone:
            self._masks = self._masks or {f"_{name}": mask for name in info}
            info |= self._masks
        else:
            info |= {f"_{name}": mask for name in info}
        for name, part in self._drawn.items():
            info[name] = part.copy() if everyone else _masked(part, mask)
            info[f"_{name}"] = mask
        return info

    def _read_drawn(self) -> None:
        """Reads what the running episodes have drawn."""
        drawn = self.simulation.rows(Row.drawn_m, Row.delay_of_theta)
        drawn.flags.writeable = False
        capsule, disturbances = env.name_drawn(list(drawn))
        self._drawn = {
            "capsule": _masked(capsule, self._everyone),
            "disturbances": _masked(disturbances, self._everyone),
        }
        self._drawn_at = self.simulation.resets

    def _begin_next(self, info: dict[str, Any], ended: np.ndarray) -> None:
        """Begins the next episodes; the results of the last ones become `final_..` of the info."""
        simulation = self.simulation
        rows = np.flatnonzero(ended)
        metrics = {}
        for name, values in simulation.metrics(rows, self.max_episode_steps).items():
            metrics[name] = np.zeros(self.num_envs)
            metrics[name][rows] = values
        info["final_info"] = _masked({**info, "metrics": metrics}, ended)
        info["final_obs"] = np.full(self.num_envs, None, dtype=object)
        last = simulation.observe()
        for i in rows:
            if isinstance(last, dict):
                info["final_obs"][i] = {name: part[i].copy() for name, part in last.items()}
            else:
                info["final_obs"][i] = last[i].copy()
        info["_final_obs"] = ended
        info["_final_info"] = ended
        simulation.reset(rows)
        info |= self._info(simulation.rows(0, Row.start_x), self._everyone)

    def _seed(self, seed: int | Sequence[int | None] | None, rows: np.ndarray) -> None:
        """Gives seeds to the environments `rows`, the first time to all.

        With a seed s, environment i gets s + i.
        """
        n = self.num_envs
        accepted = (
            f"an integer from 0 to 2**128 - {n}, None, "
            f"or a sequence of {n} integers in [0, 2**128) or None"
        )
        given: list[int | None] = [None] * n
        # Reading `np_random` seeds the generator, but no environment.
        first_time = not self._seeded
        fresh = first_time
        if isinstance(seed, (Sequence, np.ndarray)):
            flat = not isinstance(seed, np.ndarray) or seed.ndim == 1
            require(flat and len(seed) == n, "seed", accepted, seed)
            given = [None if each is None else check_seed(each, accepted) for each in seed]
        elif seed is not None:
            super().reset(seed=check_seed(seed, accepted, n))
            fresh = True
        # Without a seed the first reset draws one from the system's entropy.
        first = self.np_random_seed
        assert first is not None
        self._seeded = True
        for i in range(n) if first_time else rows.tolist():
            chosen = given[i]
            if chosen is not None:
                self.simulation.seed(i, chosen)
            elif fresh:
                self.simulation.seed(i, first + i)

    def _per_row(self, name: str, values: Any, rows: np.ndarray) -> Any:
        """One value per environment to be reset, from one for all or one for each of the batch."""
        if name == "state":
            return self._states(values, rows)
        option = f"options[{name!r}]"
        accepted = f"a sequence of one entry per environment ({self.num_envs})"
        scalar = isinstance(values, np.ndarray) and values.ndim == 0
        if scalar or not isinstance(values, (Sequence, np.ndarray)):
            require(name != "changes", option, accepted, values, TypeError)
            return [values] * len(rows)
        require(len(values) == self.num_envs, option, accepted, len(values))
        return [values[i] for i in rows]

    def _states(self, states: Any, rows: np.ndarray) -> Any:
        """The states of the environments to be reset, if there is one for each of the batch."""
        if not isinstance(states, (Sequence, np.ndarray)):
            return states
        try:
            array = np.asarray(states)
        except ValueError:
            # Rows of several lengths raise an error with the other invalid states.
            return states
        return array[rows] if array.ndim == 2 and len(array) == self.num_envs else states


def check_time_limit(steps: Any) -> int | None:
    """The agent steps until truncation, or None for -1, which is no limit."""
    accepted = "an integer >= 1, or -1 for no limit"
    steps = check_integer("max_episode_steps", steps, accepted, -1, sys.maxsize)
    require(steps != 0, "max_episode_steps", accepted, steps)
    return None if steps == -1 else steps


def find_autoreset_mode(mode: Any) -> AutoresetMode:
    """The autoreset mode, from itself, its name or its value."""
    modes = {key: each for each in AutoresetMode for key in (each, each.name, each.value)}
    accepted = f"an AutoresetMode or one of {list(AutoresetMode.__members__)}"
    known = isinstance(mode, (AutoresetMode, str)) and mode in modes
    require(known, "autoreset_mode", accepted, mode)
    return modes[mode]


def _masked(values: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Gymnasium's form of batched infos: every key has a mask of the environments that have it."""
    info: dict[str, Any] = {}
    for key, value in values.items():
        if key.startswith("_"):
            continue
        info[key] = _masked(value, mask) if isinstance(value, dict) else value
        info[f"_{key}"] = mask
    return info
