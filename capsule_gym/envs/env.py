"""The Gymnasium environment."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, SupportsFloat, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from typing_extensions import Unpack

from capsule_gym.checks import check_count, short_repr
from capsule_gym.core.layout import Row
from capsule_gym.envs import resets
from capsule_gym.envs.config import RENDER_MODES, EnvConfig, EnvOptions
from capsule_gym.envs.contract import SPEED, check_effects
from capsule_gym.envs.simulation import GOAL_BOUND, Simulation, check_seed
from capsule_gym.parameters import CONSTANTS, DISTURBANCES
from capsule_gym.rendering import Renderer
from capsule_gym.tasks import goal, task

Value = TypeVar("Value")
# Constants: looking them up in `Row` and numpy takes a tenth of a step.
_STATE = slice(Row.theta, Row.M)
_REWARD = Row.reward
_TERMINATION = Row.termination
_ARRAY = np.ndarray
_FLOAT32 = np.dtype(np.float32)
_FIRST = np.zeros(1, np.int64)
# Entries of a task's info that are places on the floor, m; renderings mark them.
_PLACES = ("goal", "target")
# Attributes that a copy of an environment does not take over.
_VIEWS = ("_rows", "_state", "_memory", "_reading", "_drawn", "_observe", "_step", "_renderer")


def goal_reward(env: Any) -> Callable[[Any, Any, Any], Any]:
    """`capsule_gym.tasks.goal.compute_reward`, only with `goal_env=True`.

    Libraries recognise goal environments by this attribute.
    """
    if not env.simulation.options.goal_env:
        raise AttributeError("compute_reward needs goal_env=True")
    return partial(goal.compute_reward, env.simulation.settings)


class CapsuleEnv(gym.Env[Any, np.ndarray]):
    """A capsule robot that moves by stick and slip, driven by a pendulum.

    ## Description

    The capsule is a rigid platform on a floor with Coulomb friction. It carries an inverted
    pendulum with a motor, a torsional spring and a damper at the pivot. Only the pendulum is
    actuated. A fast swing in one direction pushes the platform forwards against friction; during a
    slow swing back, friction holds it. The goal is to move forwards as fast as possible. The robot
    is that of Liu, Yu and Cang, "Optimized adaptive tracking control for an underactuated
    vibro-driven capsule system" (Nonlinear Dynamics 94, 2018).

    The ball of the pendulum is at x - l sin(theta): a growing theta swings it backwards and pushes
    the platform forwards (+x). Contact is exact: the platform sticks with a velocity of exactly 0.0
    while the load is below the friction limit, and each transition between stick and slip is
    located inside the integration step.

    The mass M of the platform and the friction coefficient mu are drawn at every reset.

    ## Action Space

    A `ndarray` of shape `(1,)`, dtype `float32`, in [-1, 1]. Values outside are clipped.

    | control | meaning of the action a | applied torque u |
    |---|---|---|
    | direct (`controller=None`) | motor torque | clip(residual_limit a); `residual_limit` defaults to `torque_limit` |
    | residual (`controller="module:attribute"`) | torque on top of a control law that runs inside the step at 1 kHz | clip(clip(u_law) + residual_limit a) |
    | the same with `total_torque=True` | total torque | torque_limit a, kept within `residual_limit` of clip(u_law) |

    Torques are clipped to +-`torque_limit`. A residual of zero gives the control law itself, bit
    for bit. A law that tracks a reference counteracts the residual; with `residual_limit = 2
    torque_limit` the agent can override the law, which it learns sooner with `total_torque=True`.

    ## Observation Space

    A `ndarray` of dtype `float32`, in SI units. Values are clipped to the bounds.

    | Num | Observation | Min | Max | present |
    |---|---|---|---|---|
    | 0 | theta: angle of the pendulum from the upright (rad) | -pi/2 | pi/2 | always |
    | 1 | theta_dot: angular velocity (rad/s) | -20 | 20 | always |
    | 2 | x_dot: velocity of the platform (m/s) | -2 | 2 | always |
    | 3 | stick: 1 where the platform sticks (x_dot is exactly 0), else 0 | 0 | 1 | always |
    | 4 | last action, after clipping | -1 | 1 | always |
    | 5 | theta_d: reference angle (rad) | -pi/2 | pi/2 | with a controller |
    | 6 | theta_d_dot: reference angular velocity (rad/s) | -20 | 20 | with a controller |
    | 7 | sine of the phase of the reference cycle | -1 | 1 | with a controller |
    | 8 | cosine of that phase | -1 | 1 | with a controller |
    | 9 | present torque of the control law (N m) | -torque_limit | torque_limit | with a controller |
    | next two | M (kg), mu | 0 | 4 Capsule.M, 1; or the limits of `randomization` and `capsule`, if larger | `observe_parameters=True` |
    | next two | estimates of M (kg) and log(mu) | 0.15, -7 | 2, 0 | `observe_estimates=True` |
    | next two | standard deviations of these estimates | 0 | 0.2, 1.5 | `observe_estimates=True` |

    With `stack_size=n` the observations of the n - 1 previous steps follow, the newest first; after
    a reset all n are the first observation. The position x is not observed, since the reward does
    not depend on it; `info["state"]` contains it. With `observe_parameters=True`,
    `reset(options=..)` accepts M and mu only within these bounds. The estimates are those of an
    extended Kalman filter over the observed theta, theta_dot and x_dot, which begins with the same
    prior in every episode and assumes the m, l and g of `capsule`.

    ## Rewards

    The reward is the sum of three terms, which `info` contains under these names:

    - `reward_progress`: forward displacement of the platform in this step, in centimetres;
    - `reward_energy`: -`energy_weight` times the energy of this step, the integral of |u theta_dot|, in J;
    - `reward_termination`: -`termination_penalty` if the episode terminates, else 0.

    ## Cost

    `info["cost"]` is the cost of a constrained problem, as in Safety-Gymnasium: 1.0 in a step that
    terminates the episode or leaves less than a tenth of a margin: |theta| > 0.9 pi/2 at its end,
    or a normal force below 0.1 of the weight at any time in it; else 0.0. It is true with
    disturbances, too, and not part of the reward.

    ## Starting State

    theta = -pi/3, at rest, x = 0. `initial_noise` adds uniform noise to theta; `initial_range`
    draws theta and theta_dot from uniform distributions around 0 instead. M, mu, the initial state
    and the disturbances come from separate random streams. `reset(options={..})` sets values
    instead:

    | option | value |
    |---|---|
    | `"state"` | [theta, theta_dot, x, x_dot]: theta within pi/2 rad of 0, the others within 1000 rad/s, 1e6 m and 1000 m/s |
    | `"M"`, `"mu"` | mass (kg), friction coefficient |
    | `"changes"` | [{"t": s, "M": kg, "mu": ..}, ..]: changes of M and mu during the episode |
    | `"capsule"` | {"m": kg, ..}: constants that a `Randomization` would draw |
    | `"disturbances"` | {"latency": s, ..}: values that `disturbances` would draw |

    ## Episode End

    1. Termination "pendulum": |theta| reaches pi/2, where the ball meets the platform.
    2. Termination "contact": the normal force reaches zero; the platform leaves the floor.
    3. Termination "diverged": the integrator cannot resolve the motion (a result that is not
       finite, or an event above
       |theta_dot| + |x_dot| = 1e4). The environment keeps the last state before.
    4. Truncation: after 1650 steps, 33 s.

    An episode cannot go on after a termination: the impacts of the ball on the platform, and of the
    platform on the floor after its flight, are outside the model.

    `env.unwrapped.episode_metrics(horizon)` returns the metrics of the episode so far.
    `copy.deepcopy` and `pickle` copy the episode; the copy continues bit for bit. A pickle stores
    the argument `controller`, which must be picklable: an import string or a function of a module.

    ## Info

    `info` has the same keys and dtypes after every reset and step:

    | key | value |
    |---|---|
    | `state` | theta, theta_dot, x, x_dot (float64) |
    | `stick` | whether the platform sticks |
    | `M`, `mu` | mass (kg) and friction coefficient of the episode |
    | `torque` | last applied torque, N m |
    | `law_torque` | torque of the control law for the next interval, N m |
    | `normal_force` | smallest normal force in the step, N; after a reset the weight |
    | `energy` | energy of the step, J |
    | `reward_progress`, `reward_energy`, `reward_termination` | terms of the reward |
    | `termination` | `capsule_gym.tasks.task.Termination`: 0 running, 1 "pendulum", 2 "contact", 3 "diverged" |
    | `cost` | 1.0 if the step terminated the episode or came close to that, else 0.0; see "Cost" |
    | `reading` | last readings of theta, theta_dot, x, x_dot; only with disturbances or drawn constants |
    | `disturbances`, `capsule` | dicts of what the episode has drawn, as in the options of `reset`; only then |

    ## Arguments

    ```python
    import gymnasium as gym

    env = gym.make("capsule_gym:CapsuleStickSlip-v0", controller="baselines:adaptive")
    ```

    The prefix `capsule_gym:` imports the package, which registers the environment, also in spawned
    and remote workers.

    | argument | default | meaning |
    |---|---|---|
    | `controller` | `None` | control law inside the step: an import string "module:attribute", a `Controller`, or a function that returns one |
    | `residual_limit` | `torque_limit` | torque of an action of 1, N m |
    | `total_torque` | `False` | whether the action is the total torque, in units of torque_limit, kept within residual_limit of the law's torque |
    | `torque_limit` | `1.5` | largest motor torque, N m |
    | `randomization` | `"paper"` | distribution of the plant, drawn at every reset: "none": the capsule's own M and mu; "paper": M in [0.45, 0.55] kg, mu in [0.009, 0.011]; "wide": M in [0.35, 0.75] kg, mu log-uniform in [0.005, 0.3]; "broad": M in [0.25, 1.2] kg, mu log-uniform in [0.002, 0.6]; "sticky": M in [0.35, 0.75] kg, mu in [0.2, 0.6]; "real": M in [0.45, 0.55] kg, mu in [0.009, 0.011], m in [0.1242, 0.1518], l in [0.27, 0.33], k in [0.324, 0.396], c in [0.08307, 0.10153]; "real-wide": M in [0.35, 0.75] kg, mu log-uniform in [0.005, 0.3], m in [0.1242, 0.1518], l in [0.27, 0.33], k in [0.324, 0.396], c in [0.08307, 0.10153]; or a `Randomization` |
    | `disturbances` | `"none"` | imperfect sensors and motor: "none"; "real": noise, bias and drift of the sensors, 5 to 15 ms of latency, lag and friction of the motor; or a `Disturbances` |
    | `capsule` | `Capsule()` | the plant's constants |
    | `observe_parameters` | `False` | whether the observation contains M and mu |
    | `observe_estimates` | `False` | whether the observation contains online estimates of M and log(mu), and their standard deviations |
    | `stack_size` | `1` | number of observations, the newest first, that one observation stacks |
    | `energy_weight` | `0.1` | weight of the energy in the reward, cm/J |
    | `termination_penalty` | `10` | penalty of a termination in the reward, cm |
    | `initial_noise` | `0` | half width of the uniform noise on the initial angle, rad |
    | `initial_range` | `None` | half widths (rad, rad/s) of uniform distributions around 0 of the initial theta and theta_dot; None starts at rest at -pi/3 |
    | `control_dt` | `0.02` | agent step, s |
    | `physics_dt` | at most 2 ms, with a controller 1 ms | step of the fourth-order integrator, s; at most a million steps per agent step |
    | `threads` | `1` | number of threads that step a batch, each at least 128 environments; results do not depend on it |
    | `render_mode` | `None` | "human" or, also of a batch, "rgb_array" |
    | `task` | `"speed"` | the task: speed, goal, velocity, or what `velocity.with_commands` returns |
    | `goal_env` | `False` | only with the task "goal": observations with achieved and desired goals, for hindsight experience replay |

    Raises:
        TypeError: if an argument is of the wrong type.
        ValueError: if an argument is out of range, or a plant admits Painleve's paradox or is too
            stiff for `physics_dt`.
    """

    # Gymnasium declares it as the instance's, and wrappers change it: each instance gets a copy.
    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 50}  # noqa: RUF012 (as Gymnasium declares it)
    compute_reward = property(goal_reward)

    def __init__(self, *, render_mode: str | None = None, **options: Unpack[EnvOptions]) -> None:
        self.simulation = make_simulation(1, EnvConfig(render_mode=render_mode, **options))
        self.render_mode = render_mode
        self.metadata = {**type(self).metadata, "render_fps": frames_per_second(self.simulation)}
        self.action_space, self.observation_space = make_spaces(self.simulation)
        self._running = False
        self._seeded = False
        self._bind()

    def __getstate__(self) -> dict[str, Any]:
        """The state of the episode, without the window."""
        return {name: value for name, value in vars(self).items() if name not in _VIEWS}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._bind()

    def _bind(self) -> None:
        """Creates views of the only environment, which take a considerable part of a step."""
        simulation = self.simulation
        world = simulation.world[0, :, 0]
        self._rows = world[: Row.steps]
        self._state = self._rows[_STATE]
        # Further entries of `info` in tasks other than speed.
        self._memory = None if simulation.task is SPEED else world[simulation.layout.task :]
        # Further entries of `info` for varied plants.
        self._reading = world[Row.read_theta : Row.late_theta]
        self._bind_drawn()
        self._observe: Callable[[], Any] = simulation.observations[0].copy
        if simulation.options.goal_env:
            self._observe = lambda: {name: part[0] for name, part in simulation.observe().items()}
        self._step = simulation.step_one
        self._renderer: Renderer | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begins a new episode.

        Args:
            seed: an integer in [0, 2**128) that restarts the random streams; None continues them.
            options: values that replace random draws, see "Starting State".

        Returns:
            Observation and info.

        Raises:
            TypeError: if the seed or an option is of the wrong type.
            ValueError: if the seed is out of range, an option is unknown or out of range, or the
                control law returned a torque that is not finite.
        """
        if seed is not None:
            seed = check_seed(seed)
        super().reset(seed=seed)
        # Reading `np_random` seeds the generator, but not the simulation.
        if seed is not None or not self._seeded:
            self.simulation.seed(0, self.np_random_seed)
            self._seeded = True
        task_options = self.simulation.task.option_sizes
        options = resets.check_options(options, task_options)
        # One environment is a batch of one.
        given: dict[str, Any] = {
            name: [value] for name, value in options.items() if value is not None
        }
        if "state" in given:
            given["state"] = options["state"]
        self.simulation.reset(_FIRST, **given)
        self._bind_drawn()
        self._running = True
        if self.render_mode == "human":
            self.render()
        return self._observe(), self._info(self._rows.tolist())

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, SupportsFloat, bool, bool, dict[str, Any]]:
        """One agent step: `Step::run` in `capsule_gym/core/step/step.hpp`.

        Args:
            action: shape (1,), torque in units of `residual_limit`, or with `total_torque` of
                `torque_limit`; clipped to [-1, 1].

        Returns:
            Observation, reward, terminated, truncated (always False, as gymnasium's TimeLimit
            truncates) and info.

        Raises:
            ValueError: if the action has another shape or is not finite, or the control law
                returned a torque that is not finite.
            gymnasium.error.ResetNeeded: before the first reset, and after termination.
        """
        if not self._running:
            raise gym.error.ResetNeeded("call reset() before step(): there is no running episode")
        plain = type(action) is _ARRAY and action.dtype is _FLOAT32
        array = action if plain else as_actions(action)
        if array is None or array.shape != (1,) or not math.isfinite(value := array.item()):
            accepted = "one finite number, clipped to [-1, 1], of shape (1,)"
            raise ValueError(f"action must be {accepted}, got {short_repr(action)}")
        try:
            broken = self._step(value)
        except BaseException:
            self.simulation.discard_failed()
            raise
        if broken >= 0:
            self.simulation.report(broken)
        values = self._rows.tolist()
        self._running = values[_TERMINATION] == 0.0
        if self.render_mode == "human":
            self.render()
        return self._observe(), values[_REWARD], not self._running, False, self._info(values)

    def _info(self, values: list[float]) -> dict[str, Any]:
        """The info of a reset or a step, from the first values of `Row`."""
        termination = 0 if self._running else int(values[_TERMINATION])
        info = describe(values, self._state.copy(), termination)
        if self._memory is not None:
            add_task(info, self.simulation.task, self._memory.tolist())
        if self._drawn:
            capsule, disturbances = self._drawn
            info["reading"] = self._reading.copy()
            info["capsule"] = capsule.copy()
            info["disturbances"] = disturbances.copy()
        return info

    def _bind_drawn(self) -> None:
        """Keeps the drawn values of the episode as dicts, which are copied faster than arrays."""
        drawn = self.simulation.world[0, Row.drawn_m : Row.delay_of_theta, 0]
        self._drawn = name_drawn(drawn.tolist()) if self.simulation.settings.varied else ()

    def episode_metrics(self, horizon: int | None) -> dict[str, float]:
        """The metrics of the episode so far: those of `task.METRICS`, and those of the task.

        Args:
            horizon: agent steps of a whole episode, `env.spec.max_episode_steps`, since gymnasium's
                `TimeLimit` truncates: the mean speed of an episode that failed is over all of them.
                None, without a limit, takes the elapsed time.
        """
        steps = None if horizon is None else check_count("horizon", horizon)
        metrics = self.simulation.metrics(_FIRST, steps)
        return {name: float(value[0]) for name, value in metrics.items()}

    def render(self) -> np.ndarray | None:
        """Draws the current state.

        Returns:
            A frame (height, width, 3), uint8, in the mode "rgb_array", else None.
        """
        if self.render_mode is None:
            gym.logger.warn(
                "render() draws nothing without a render_mode: gym.make(.., render_mode='rgb_array')"
            )
            return None
        if self._renderer is None:
            self._renderer = make_renderer(self)
        return self._renderer.draw(**shown_state(self.simulation, 0))

    def close(self) -> None:
        """Closes the window."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def make_simulation(num_envs: int, config: EnvConfig) -> Simulation:
    """The simulation of an environment; raises an error if an argument has no effect."""
    # `Simulation` itself accepts 0, to run a control law alone.
    if config.residual_limit == 0.0:
        message = "residual_limit must be > 0 (N m), got 0.0: the action would have no effect"
        raise ValueError(message)
    simulation = Simulation(num_envs, config)
    check_effects(config, law=simulation.controller is not None)
    return simulation


def make_renderer(env: Any) -> Renderer:
    """The renderer of a single environment or a batch."""
    simulation = env.simulation
    fps = env.metadata["render_fps"]
    return Renderer(simulation.capsule, env.render_mode, fps, simulation.settings.torque_limit)


def frames_per_second(simulation: Simulation) -> float:
    """The frames per second of real time, one frame per agent step; an int if it is whole."""
    # Limits of what ffmpeg accepts.
    fps = min(max(1.0 / simulation.options.control_dt, 0.01), 1000.0)
    return round(fps) if math.isclose(fps, round(fps)) else fps


def describe(values: Any, state: np.ndarray, termination: Any) -> dict[str, Any]:
    """The info of a reset or a step in the speed task.

    `values` are the rows of `Row` before `steps`: a list of floats for one environment, shape
    (rows, num_envs) for a batch, with the state of shape (num_envs, 4) and the terminations, int64.
    """
    # Unpacking and a literal: with subscripts or a dict of pairs a step takes a sixth longer.
    (
        _theta,
        _theta_dot,
        _x,
        x_dot,
        M,
        mu,
        torque,
        law_torque,
        normal_force,
        energy,
        progress,
        energy_cost,
        penalty,
        cost,
        _reward,
        _termination,
    ) = values
    return {
        "state": state,
        "stick": x_dot == 0.0,
        "M": M,
        "mu": mu,
        "torque": torque,
        "law_torque": law_torque,
        "normal_force": normal_force,
        "energy": energy,
        "reward_progress": progress,
        "reward_energy": energy_cost,
        "reward_termination": penalty,
        "termination": termination,
        "cost": cost,
    }


def add_task(info: dict[str, Any], current: task.Task, memory: Any) -> None:
    """Adds the entries of a task other than speed to an info.

    `memory` is the task's memory: a list, or the rows of a batch.
    """
    info[current.term] = info.pop("reward_progress")
    for name, place in current.places:
        info[name] = memory[place]


def name_drawn(drawn: Sequence[Value]) -> tuple[dict[str, Value], dict[str, Value]]:
    """The drawn constants of the plant and disturbances, from the row `drawn_m` on."""
    constants = dict(zip(CONSTANTS, drawn, strict=False))
    disturbances = dict(zip(DISTURBANCES, drawn[len(CONSTANTS) :], strict=True))
    return constants, disturbances


def make_spaces(simulation: Simulation) -> tuple[spaces.Box, spaces.Space[Any]]:
    """The action and the observation space of one environment."""
    action = spaces.Box(-1.0, 1.0, (1,), np.float32)
    low, high = np.array(list(simulation.entries.values()), np.float32).T
    observation = spaces.Box(low, high, dtype=np.float32)
    if not simulation.options.goal_env:
        return action, observation
    goal = partial(spaces.Box, -GOAL_BOUND, GOAL_BOUND, (2,), np.float64)
    parts: dict[str, spaces.Space[Any]] = {
        "observation": observation,
        "achieved_goal": goal(),
        "desired_goal": goal(),
    }
    return action, spaces.Dict(parts)


def as_actions(actions: Any) -> np.ndarray | None:
    """Actions as contiguous float32, or None if they are not numbers."""
    try:
        if np.iscomplexobj(actions):
            return None
        return np.asarray(actions, np.float32, order="C")
    except (TypeError, ValueError, OverflowError):
        return None


def shown_state(simulation: Simulation, i: int) -> dict[str, Any]:
    """The arguments of `Renderer.draw` for environment i."""
    row = simulation.columns(np.array([i]))[:, 0].tolist()
    found = {name: row[getattr(Row, name)] for name in ("theta", "x", "x_dot", "torque", "M", "mu")}
    found["time"] = row[Row.duration]
    for name, place in simulation.task.places:
        if name in _PLACES:
            position = row[simulation.layout.task + place]
            found["ghost"] = (name, 0.0, position)
    return found
