"""The simulation of N environments, which `CapsuleEnv` and `CapsuleVectorEnv` share."""

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from capsule_gym.checks import check_count, check_integer, check_number, check_timed, short_repr
from capsule_gym.control.controller import CoreLaw
from capsule_gym.control.lookup import find_controller
from capsule_gym.control.user_law import bind_user_law
from capsule_gym.core import _core, native
from capsule_gym.core.layout import LANES, NUM_ROWS, STATE, Row
from capsule_gym.envs import contract, resets
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.threads import Threads, single_use
from capsule_gym.parameters import CONSTANTS, DISTURBANCES, NOMINAL, Capsule, Randomization
from capsule_gym.parameters.limits import LARGEST
from capsule_gym.tasks import task
from capsule_gym.tasks.registry import find_task

# Bound of an achieved or a desired goal, m and m/s.
GOAL_BOUND = 1e7

# Largest number of environments in a batch: some 15 GB.
MOST_ENVS = 2**24

# The arrays of a simulation's episodes, which a copy takes over; the copy binds them to the core
# itself.
COPIED_ATTRIBUTES = ("world", "observations", "_keys", "_episodes")


def check_seed(
    seed: Any, accepted: str = "an integer in [0, 2**128) or None", count: int = 1
) -> int:
    """An environment's seed as an int; `count` environments get seeds from this one on.

    Raises a TypeError or ValueError for what is not accepted.
    """
    return check_integer("seed", seed, accepted, 0, 2**128 - count)


def _add_sampling_rows(world: np.ndarray) -> np.ndarray:
    """The world of an older pickle, with zeros in the rows that it lacks."""
    return np.insert(world, [Row.jitter] * (Row.key - Row.jitter), 0.0, axis=1)


class Simulation:
    """The state of N environments and its evolution; everything is float64 and in SI units.

    Attributes:
        options: options of the environments.
        capsule: the plant's constants.
        controller: the law inside the step, or None.
        settings: the settings of the step, which follow from the options.
        layout: the first rows of the parts of `world`, and sizes.
        world: shape (blocks, rows, lanes): environment i is lane i % lanes of block i // lanes, and
            `lanes` is LANES or, for a single environment, 1. `layout` names the rows; `row`, `rows`
            and `columns` read it by environments.
        observations: shape (num_envs, entries), float32, of the present state.
        entries: the bounds of the observation's entries by name, in order.
        fields: the numbers and arrays of the core's `Batch` by name.
        in_use: the lock of the methods that change the episodes, for one thread at a time.

    Raises:
        TypeError: if an option is of the wrong type.
        ValueError: if an option is out of range.
    """

    def __init__(self, num_envs: int, options: EnvConfig = contract.DEFAULTS) -> None:
        self.num_envs = check_count("num_envs", num_envs, MOST_ENVS)
        self.options = options
        self.capsule = options.capsule or NOMINAL
        self.randomization = Randomization.named(options.randomization)
        self.controller = find_controller(options.controller)
        self.task = find_task(options.task)
        contract.check_law_task(self.controller, self.task)
        self._description = contract.describe(options, self.controller)
        self.settings = self._description.settings
        self.layout = self._description.layout
        self.entries = contract.bounds(self._description)
        contract.check_options(options, self.settings, law=self.controller is not None)
        self.lanes = 1 if self.num_envs == 1 else LANES
        self._allocate()
        # Whether `Row.active` is 1 everywhere.
        self._everyone = False
        self.resets = 0
        self._threads = Threads(self.num_envs, self.lanes, options.threads)
        self.in_use = threading.RLock()
        self._bind()

    @single_use
    def __getstate__(self) -> dict[str, Any]:
        """The state of the episodes, without code and threads."""
        state: dict[str, Any] = {"rows": NUM_ROWS}
        for name in ("num_envs", "options", "_changes"):
            state[name] = getattr(self, name)
        for name in COPIED_ATTRIBUTES:
            state[name] = getattr(self, name).copy()
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        options = state["options"]
        # A function that returns the controller may return another one the second time: a copy
        # passes its own.
        controller = state.get("controller", options.controller)
        Simulation.__init__(self, state["num_envs"], replace(options, controller=controller))
        self.options = options
        if "rows" not in state:
            state = {**state, "world": _add_sampling_rows(state["world"])}
        if self.world.shape != state["world"].shape:
            raise ValueError(
                f"controller={options.controller!r} must be as it was when the simulation was "
                "pickled, with as much memory and as many columns of the reference"
            )
        for name in COPIED_ATTRIBUTES:
            getattr(self, name)[...] = state[name]
        self._set_changes(state["_changes"])

    def __deepcopy__(self, memo: dict[int, Any]) -> "Simulation":
        twin = memo[id(self)] = type(self).__new__(type(self))
        twin.__setstate__({**self.__getstate__(), "controller": self.controller})
        return twin

    def _allocate(self) -> None:
        """Allocates the arrays of the episodes.

        A MemoryError becomes a ValueError for `num_envs`.
        """
        blocks = -(-self.num_envs // self.lanes)
        try:
            self.world = native.aligned_zeros((blocks, self.layout.rows, self.lanes))
            self.observations = np.zeros((self.num_envs, len(self.entries)), np.float32)
        except MemoryError as error:
            message = f"num_envs must fit into memory, got {self.num_envs}: {error}"
            raise ValueError(message) from None
        self._keys = np.zeros((self.num_envs, 2), np.uint64)
        self._episodes = np.zeros(self.num_envs, np.int64)

    def _bind(self) -> None:
        """Binds the arrays and the law to the core."""
        acting = self.controller or contract.NO_CONTROLLER
        self.reference = acting.reference
        self.memory = acting.memory
        # The environments that begin, and what their episodes draw.
        self._rows = np.zeros(self.num_envs, np.int64)
        self._drawn = np.zeros((self.layout.draws, self.num_envs))
        self.fields: dict[str, Any] = {
            "world": self.world,
            "num_envs": self.num_envs,
            "lanes": self.lanes,
            "observations": self.observations,
            "task": self.task.number,
            "memory": np.array(self.memory),
            "reference": self.reference,
            "reference_rows": len(self.reference),
            "keys": self._keys,
            "episodes": self._episodes,
            "rows": self._rows,
            "drawn": self._drawn,
        }
        self.fields |= contract.as_arrays(self._description)
        self.fields |= self._law_fields()
        values = [self.fields.get(name, 0) for name in _core.BATCH]
        self._fields = np.array(native.addressed(values))
        self._batch = native.address(self._fields)
        self._set_changes(np.zeros((0, 4)))
        # Looking the arguments up each time takes a tenth of a step.
        self._advance = partial(_core.call, "advance", self._batch)
        # Steps a single environment with an action, without the arrays; returns as the `work` of
        # `run`.
        self.step_one = partial(_core.call_locked, "step_one", self._batch)

    def _law_fields(self) -> dict[str, Any]:
        """The fields of the core's `Batch` that follow from the law."""
        # Exceptions of a law that Python calls.
        self._raised: list[Exception] = []
        acting = self.controller or contract.NO_CONTROLLER
        if isinstance(acting.law, CoreLaw):
            constants = np.array([*acting.law.constants, 0.0])
            return {"law": acting.law.number, "law_constants": constants}
        observed = Row.read_theta if self.settings.law_reads else Row.theta
        user_law = bind_user_law(acting, self.lanes, observed, self._raised)
        return {"law": len(_core.LAWS), **user_law}

    def row(self, row: int) -> np.ndarray:
        """A copy of one quantity of every environment, shape (num_envs,)."""
        return self.world[:, row].flatten()[: self.num_envs]

    def rows(self, first: int, last: int) -> np.ndarray:
        """A copy of the rows first..last-1 of every environment, (last - first, num_envs)."""
        part = self.world[:, first:last].transpose(1, 0, 2)
        return np.array(part, order="C").reshape(last - first, -1)[:, : self.num_envs]

    def columns(self, environments: np.ndarray) -> np.ndarray:
        """A copy of every quantity of some environments, shape (rows, n)."""
        return self.world[environments // self.lanes, :, environments % self.lanes].T

    def write(self, row: int, values: np.ndarray) -> None:
        """Sets one quantity of every environment, from an array of shape (num_envs,)."""
        whole, rest = divmod(self.num_envs, self.lanes)
        self.world[:whole, row] = values[: whole * self.lanes].reshape(whole, self.lanes)
        if rest:
            self.world[whole, row, :rest] = values[whole * self.lanes :]

    def seed(self, i: int, seed: int) -> None:
        """Gives environment i a seed; its next episode is the first of that seed."""
        self._keys[i] = resets.make_key(seed)
        self._episodes[i] = 0

    @single_use
    def reset(
        self,
        rows: np.ndarray,
        M: Sequence[float] | None = None,
        mu: Sequence[float] | None = None,
        state: np.ndarray | None = None,
        **options: Sequence[Any],
    ) -> None:
        """Begins a new episode in some environments. Values that are not given are drawn.

        Args:
            rows: indices of the environments, shape (n,).
            M: masses of their platforms, kg.
            mu: their friction coefficients.
            state: shape (n, 4), or one state for all.
            **options: the other options of `CapsuleEnv.reset`, one value per environment.

        Raises:
            TypeError: if a value is of the wrong type.
            ValueError: if a value is out of range, or the law returned a torque that is not finite.
            IndexError: if there is no such environment.
        """
        self._check_varied(options)
        count = len(rows)
        drawn = self._draw(rows)
        resets.write_options(drawn, options, self.task, self._description)
        changes: list[tuple[int, float, float, float]] = []
        plant_options = map(options.get, ("changes", "capsule", "disturbances"))
        if M is not None or mu is not None or any(plant_options):
            masses = drawn[Row.M].tolist() if M is None else M
            frictions = drawn[Row.mu].tolist() if mu is None else mu
            schedules = options.get("changes", [()] * count)
            capsules = map(self._episode_capsule, drawn[self.layout.constant_draws :].T.tolist())
            given = zip(rows.tolist(), masses, frictions, capsules, schedules, strict=True)
            for row, mass, friction, capsule, schedule in given:
                self._check_plant(mass, friction, capsule)
                changes += [(row, *change) for change in self._schedule(schedule, capsule)]
            drawn[Row.M] = masses
            drawn[Row.mu] = frictions
        if state is not None:
            drawn[: Row.M] = resets.check_state("options['state']", state, count).T

        # Nothing above changes the environments, so a reset that raises an error leaves them
        # unchanged.
        if changes or len(self._changes):
            self._replace_changes(rows, changes)
        _core.call("begin_episodes", self._batch, count)
        self._everyone = False
        self.resets += 1
        self.run(lambda first, last: self._advance(first, last, True))

    def _check_varied(self, options: dict[str, Sequence[Any]]) -> None:
        """Raises a ValueError for values of constants or disturbances that no episode draws."""
        if self.settings.varied:
            return
        for name in ("capsule", "disturbances"):
            # An empty dict sets nothing.
            if any(not isinstance(value, dict) or value for value in options.get(name, ())):
                raise ValueError(
                    f"options[{name!r}] needs an environment with disturbances other than 'none', "
                    "or with a Randomization of constants besides M and mu"
                )

    def _draw(self, rows: np.ndarray) -> np.ndarray:
        """What the next episodes of these environments draw, shape (draws, n), a view.

        Raises an IndexError if there is no such environment.
        """
        count = len(rows)
        fits = count <= self.num_envs
        if fits:
            self._rows[:count] = rows
        if not fits or _core.call("draw_episodes", self._batch, count) >= 0:
            raise IndexError(
                f"rows must be indices of environments, from 0 to {self.num_envs - 1}, "
                f"each at most once, got {short_repr(rows.tolist())}"
            )
        return self._drawn[:, :count]

    @single_use
    def step(self, actions: np.ndarray, active: np.ndarray | None = None) -> None:
        """One agent step.

        Args:
            actions: shape (num_envs,), finite; clipped to [-1, 1].
            active: shape (num_envs,), bool: the environments that take part; the others do not
                change. None means all.

        Raises:
            ValueError: if a control law returned a torque that is not finite. A law's own exception
                is raised as it is.
        """
        self.write(Row.action, actions)
        if active is not None:
            self.write(Row.active, active)
        elif not self._everyone:
            self.world[:, Row.active] = 1.0
        self._everyone = active is None
        self.run(lambda first, last: self._advance(first, last, False))

    @single_use
    def run(self, work: Callable[[int, int], int]) -> None:
        """Runs the core on all environments, distributed over the threads.

        Args:
            work: function of the first environment and one past the last, which releases the
                interpreter's lock and returns the index of an environment whose law has failed, or
                -1.

        Raises:
            ValueError: as `step`.
        """
        try:
            broken = max(self._threads.share(work))
        except BaseException:
            self.discard_failed()
            raise
        if broken >= 0:
            self.report(broken)

    def report(self, broken: int) -> None:
        """Raises the exception of an environment's failed law, or an error for its torque."""
        column = self.columns(np.array([broken]))[:, 0]
        raised = self._raised[:]
        self.discard_failed()
        if raised:
            raise raised[0]
        prefix = "read_" if self.settings.law_reads else ""
        state = {name: float(column[getattr(Row, prefix + name)]) for name in STATE}
        assert self.controller is not None
        law = self.controller.law
        if not isinstance(law, CoreLaw):
            # Compiled code catches the law's exceptions. The arguments are still those of the call
            # that has failed.
            layout = self.layout
            task_rows = 0 if self.controller.task is None else self.task.rows
            memory = column[layout.law_memory : layout.reference]
            row = column[layout.reference : layout.reference_end + task_rows]
            call = getattr(law, "py_func", law)
            call(*state.values(), tuple(memory.tolist()), tuple(row.tolist()))
        raise ValueError(
            f"the control law {self.controller.name!r} returned a torque that is not finite in "
            f"environment {broken} (step {column[Row.steps]:.0f}, state {state}); "
            "a law must return finite numbers"
        )

    def discard_failed(self) -> None:
        """Discards the exceptions and torques of failed laws, which a later reset would return."""
        self._raised.clear()
        lost = np.flatnonzero(~np.isfinite(self.row(Row.law_torque)))
        self.world[lost // self.lanes, Row.law_torque, lost % self.lanes] = 0.0
        self.observations[lost] = np.nan_to_num(self.observations[lost])

    @single_use
    def metrics(self, rows: np.ndarray, horizon: int | None = None) -> dict[str, np.ndarray]:
        """The metrics of running episodes: those of `METRICS`, and those of the task.

        Args:
            rows: indices of the environments, int64, shape (n,).
            horizon: agent steps of a whole episode. The mean speed of a failed episode is over all
                of them, so that an early failure is no advantage; None takes the elapsed time.

        Returns:
            One float64 array of shape (n,) for each metric.
        """
        seconds = horizon * self.options.control_dt if horizon else math.nan
        names = [*task.METRICS, *self.task.metrics]
        values = np.empty((len(names), len(rows)))
        indices = np.ascontiguousarray(rows, np.int64)
        native.call("episode_metrics", self._batch, indices, len(rows), seconds, values)
        return dict(zip(names, values, strict=True))

    def observe(self) -> Any:
        """A copy of the observations; with `goal_env` a dict with achieved and desired goals."""
        observations = self.observations.copy()
        if not self.options.goal_env:
            return observations
        reads = self.settings.agent_reads
        x = self.row(Row.read_x if reads else Row.x)
        x_dot = self.row(Row.read_x_dot if reads else Row.x_dot)
        goal = self.row(self.layout.task + self.task.fields.index("goal"))
        achieved = np.stack((x, x_dot), axis=1)
        desired = np.stack((goal, np.zeros(self.num_envs)), axis=1)
        return {
            "observation": observations,
            "achieved_goal": np.clip(achieved, -GOAL_BOUND, GOAL_BOUND),
            "desired_goal": np.clip(desired, -GOAL_BOUND, GOAL_BOUND),
        }

    @single_use
    def close(self) -> None:
        """Ends the threads."""
        self._threads.close()

    def _episode_capsule(self, drawn: Sequence[float]) -> Capsule:
        """The capsule of an episode for any M and mu, with the whole friction of the motor."""
        constants: dict[str, Any] = dict(zip(CONSTANTS, drawn, strict=False))
        if constants:
            disturbances = drawn[len(CONSTANTS) :]
            constants["motor_friction"] += disturbances[DISTURBANCES.index("motor_friction")]
        # Heavy and smooth: the check of M and mu is `_check_plant`'s.
        return replace(self.capsule, M=LARGEST, mu=0.0, **constants)

    def _check_plant(self, M: float, mu: float, capsule: Capsule) -> None:
        """Raises an error for M and mu that are invalid, too stiff, or beyond what is observed."""
        capsule.check_plant(M, mu)
        contract.check_step(capsule, float(M), float(mu), self.settings)
        if not self.settings.with_parameters:
            return
        M_bound = self.settings.M_bound
        mu_bound = self.settings.mu_bound
        shown = "where observe_parameters shows it (a wider randomization shows more)"
        check_number("M", M, f"at most {M_bound:g} {shown}", 0.0, M_bound)
        check_number("mu", mu, f"at most {mu_bound:g} {shown}", 0.0, mu_bound)

    def _schedule(
        self, changes: Sequence[dict[str, float]], capsule: Capsule
    ) -> list[tuple[float, float, float]]:
        """The changes of one episode, with the other constants of `capsule`, as (t, M, mu)."""
        accepted = "a list of dicts {'t': s, 'M': kg, 'mu': ..}, each later than the one before"
        schedule: list[tuple[float, float, float]] = []
        for name, t, change in check_timed("options['changes']", changes, accepted, task.CHANGE):
            try:
                self._check_plant(change["M"], change["mu"], capsule)
            except (TypeError, ValueError) as error:
                raise type(error)(f"{name}: {error}") from None
            schedule.append((t, float(change["M"]), float(change["mu"])))
        return schedule

    def _replace_changes(
        self, rows: np.ndarray, changes: list[tuple[int, float, float, float]]
    ) -> None:
        """Replaces the changes of M and mu of these environments."""
        kept = self._changes[~np.isin(self._changes[:, 0], rows)]
        merged = np.concatenate([kept, np.reshape(changes, (-1, 4))])
        self._set_changes(merged[np.argsort(merged[:, 0], kind="stable")])

    def _set_changes(self, changes: np.ndarray) -> None:
        """Sets the changes of M and mu, as `changes` of the core's `Batch`."""
        self._changes = changes
        self._fields[_core.BATCH.index("changes")] = native.address(changes)
        self._fields[_core.BATCH.index("num_changes")] = len(changes)
