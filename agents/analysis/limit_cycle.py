"""The limit cycle of a policy on the paper's plant."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.analysis.data import SPEED, Document
from agents.analysis.figures import write_with
from agents.evaluation.policies import BASELINE, Candidate, Policy, checkpoint_names, find_candidate
from agents.evaluation.statistics import interquartile_mean
from agents.leaderboard.page import RANKING_SET
from agents.leaderboard.rows import RESULTS, load_rows
from baselines.drawing import BLUE, INK, MUTED, add_note, new_figure
from baselines.tables import markdown_table
from capsule_gym.evaluation_sets import EPISODE_SETTINGS, NOMINAL_PLANT, PlantSpec
from capsule_gym.parameters import DIRECT_PHYSICS_DT, NOMINAL, EnvConfig
from capsule_gym.task import CONTROL_DT, HORIZON

ROOT = Path(__file__).resolve().parents[2]
# Seconds at the end in which the cycle is sought: three of the paper's cycles of 6.6 s, and a little.
WINDOW = 20.0
# A motion may need several swings to repeat; the smallest number counts that does nearly as well as the best.
MAX_SWINGS, NEARLY = 6, 1.25
# States closer than this, in standard deviations, count as the same: the error of a section between samples.
SAME = 0.02
# Phases of the contact by the sign of the displacement.
PHASES = {1: "slips forward", 0: "sticks", -1: "slips backward"}
SHADES = {1: "#dcebf5", 0: "#c9ced6", -1: "#fbe3d3"}
# Trained policies that are shown by default, and characters of a title in a panel of a fifth of the width.
TRAINED, TITLE = 3, 17


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One episode, a sample per period of the torque; the first is the start.

    Attributes:
        name: of the policy.
        t: s, shape (n,).
        theta: rad.
        theta_dot: rad/s.
        x: m.
        x_dot: m/s; exactly 0.0 in stick.
        torque: the motor's in the period that ends at t, N m.
        normal_force: the smallest in that period, N.
        torque_limit: N m.
        failed: whether the episode was terminated.
    """

    name: str
    t: np.ndarray
    theta: np.ndarray
    theta_dot: np.ndarray
    x: np.ndarray
    x_dot: np.ndarray
    torque: np.ndarray
    normal_force: np.ndarray
    torque_limit: float
    failed: bool

    def cut(self, first: int, last: int) -> Trajectory:
        """The samples from `first` to `last`, both included, with time and place counted from the first."""
        series = {name: getattr(self, name)[first : last + 1] for name in SERIES}
        return replace(self, **{**series, "t": series["t"] - self.t[first], "x": series["x"] - self.x[first]})


SERIES = [each.name for each in fields(Trajectory) if each.type == "np.ndarray"]


def simulate(name: str, policy: Policy, plant: PlantSpec = NOMINAL_PLANT, *, seconds: float = HORIZON) -> Trajectory:
    """Runs a policy on one plant and records every period of the torque: the motion is that of its episode.

    Args:
        name: for tables.
        policy: acts as often as in its own environment.
        plant: with constant parameters.
        seconds: length of the recording.
    """
    # Imported here, since numba takes most of a second to import.
    from capsule_gym.layout import Row
    from capsule_gym.simulation import Simulation, divide

    names = {each.name for each in fields(EnvConfig)}
    settings = {key: value for key, value in {**policy.env_kwargs, **EPISODE_SETTINGS}.items() if key in names}
    controller = Simulation(1, EnvConfig(**settings)).controller
    # The torque is constant for a period of the law or, without one, for many steps of the integrator.
    dt = controller.dt if controller else settings.get("physics_dt") or DIRECT_PHYSICS_DT
    periods = divide("control_dt", settings.get("control_dt", CONTROL_DT), "a period of the torque", dt)
    simulation = Simulation(1, EnvConfig(**{**settings, "control_dt": dt}))
    start = np.array([(plant.theta, 0.0, 0.0, 0.0)])
    simulation.reset(np.zeros(1, np.int64), M=[plant.M], mu=[plant.mu], state=start)
    act = policy.start([plant.seed])
    wanted = [getattr(Row, each) for each in SERIES[1:]]
    samples = [[simulation.row(row)[0] for row in wanted]]
    action, failed = np.zeros(1), False
    for n in range(round(seconds / dt)):
        if n % periods == 0:
            action = act(simulation.observations.copy())[:, 0].astype(np.float64)
        simulation.step(action)
        samples.append([simulation.row(row)[0] for row in wanted])
        failed = bool(simulation.row(Row.termination)[0] != 0.0)
        if failed:
            break
    series = dict(zip(SERIES[1:], np.array(samples).T, strict=True))
    t, limit = np.arange(len(samples)) * dt, simulation.settings.torque_limit
    return Trajectory(name, t, **series, torque_limit=limit, failed=failed)


@dataclass(frozen=True, eq=False)
class Cycle:
    """One cycle of a motion that is periodic, or nearly so.

    Attributes:
        trajectory: its samples, the first and the last one cycle apart; it begins where theta is smallest.
        swings: number of swings of the pendulum to and fro.
        mismatch: the larger of the changes of theta_dot and x_dot over the cycle, in their standard deviations.
        window_speed: mean speed over the window that the cycle was found in, cm/s.
    """

    trajectory: Trajectory
    swings: int
    mismatch: float
    window_speed: float


def find_cycle(trajectory: Trajectory, window: float = WINDOW) -> Cycle:
    """Finds the cycle at the end of an episode that comes closest to closing.

    A swing begins whenever theta rises through the middle of its range. The cycle is the smallest number of swings
    after which the motion nearly repeats.

    Args:
        trajectory: longer than the window.
        window: seconds at the end that are searched.

    Raises:
        ValueError: if the episode failed, is shorter than the window, or does not hold two cycles there.
    """
    t, name = trajectory.t, trajectory.name
    if trajectory.failed or t[-1] < window:
        raise ValueError(f"trajectory must last for {window:g} s without failure, got {name} until {t[-1]:g}")
    first = len(t) - 1 - round(window / (t[1] - t[0]))
    theta = trajectory.theta[first:]
    middle = 0.5 * (theta.min() + theta.max())
    rises = first + 1 + np.flatnonzero((theta[:-1] < middle) & (theta[1:] >= middle))
    rates = np.array([trajectory.theta_dot, trajectory.x_dot])
    deviations = rates[:, first:].std(axis=1)
    if len(rises) < 2 or not (deviations > 0.0).all():
        raise ValueError(f"trajectory must swing at least twice in its last {window:g} s, got {name}")
    states = rates[:, rises] / deviations[:, None]
    most = min(MAX_SWINGS, len(rises) - 1)
    gaps = {n: np.abs(states[:, n:] - states[:, :-n]).max(axis=0) for n in range(1, most + 1)}
    typical = {n: float(np.median(gap)) for n, gap in gaps.items()}
    swings = next(n for n in typical if typical[n] <= max(SAME, NEARLY * min(typical.values())))
    # Its beginning is moved to the smallest theta in it: the samples must reach further.
    fits = [i for i in range(len(gaps[swings])) if 2 * rises[i + swings] - rises[i] < len(t)]
    if not fits:
        raise ValueError(f"trajectory must hold two cycles in its last {window:g} s, got {name}")
    i = min(fits, key=lambda i: gaps[swings][i])
    begin = int(rises[i] + np.argmin(trajectory.theta[rises[i] : rises[i + swings]]))
    speed = 100.0 * (trajectory.x[-1] - trajectory.x[first]) / (t[-1] - t[first])
    cycle = trajectory.cut(begin, begin + int(rises[i + swings] - rises[i]))
    return Cycle(cycle, swings, float(gaps[swings][i]), float(speed))


class Summary(NamedTuple):
    """A cycle in numbers.

    Attributes:
        period: s.
        speed: mean over the cycle, cm/s.
        saturated: share of the time at the torque limit.
        centre: smallest and largest speed of the centre of mass of platform and pendulum, cm/s.
    """

    period: float
    speed: float
    saturated: float
    centre: tuple[float, float]


def summarize(trajectory: Trajectory, plant: PlantSpec = NOMINAL_PLANT) -> Summary:
    """Sums a cycle up.

    Args:
        trajectory: of a cycle, with the paper's pendulum.
        plant: mass and friction of the platform.
    """
    m, l, total = NOMINAL.m, NOMINAL.l, plant.M + NOMINAL.m
    momentum = total * trajectory.x_dot - m * l * np.cos(trajectory.theta) * trajectory.theta_dot
    return Summary(
        period=float(trajectory.t[-1]),
        speed=100.0 * float(trajectory.x[-1] / trajectory.t[-1]),
        saturated=float((np.abs(trajectory.torque[1:]) >= trajectory.torque_limit).mean()),
        centre=(100.0 * float(momentum.min()) / total, 100.0 * float(momentum.max()) / total),
    )


def document(policies: Sequence[str] = ()) -> Document:
    """The table and the figure.

    Args:
        policies: names or paths; by default the paper's law, the fastest rows that learnt from reward, and the optimum.

    Raises:
        ValueError: if there is no such policy, or its motion has no cycle.
    """
    cycles = [find_cycle(median_run(find_candidate(name))) for name in policies or default_policies()]
    return Document({"shapes": table(cycles)}, {"figures/limit_cycle": write_with(draw, cycles)})


def default_policies() -> list[str]:
    """The paper's law, the fastest rows that learnt from reward, and the optimum."""
    # Imported here, since numba takes most of a second to import.
    from capsule_gym.policy import IMITATION, load_policy

    # A network that imitates the optimum moves as the optimum does.
    learnt = [name for name in checkpoint_names() if load_policy(name).algorithm != IMITATION]
    rows = load_rows(ROOT / RESULTS, learnt)
    speeds = {row.name: float(interquartile_mean(row.score(RANKING_SET, SPEED).ravel())) for row in rows}
    best = sorted(speeds, key=lambda name: (-speeds[name], name))[:TRAINED]
    return [BASELINE, *best, "optimum-nominal"]


def median_run(candidate: Candidate) -> Trajectory:
    """The trajectory of the training seed with the median speed; the lower of two."""
    found = [simulate(candidate.name, policy) for policy in candidate.policies]
    chosen = sorted(range(len(found)), key=lambda i: found[i].x[-1])[(len(found) - 1) // 2]
    if len(found) == 1:
        return found[0]
    return replace(found[chosen], name=f"{candidate.name} (seed {candidate.trained[chosen].training_seed})")


def table(cycles: Sequence[Cycle]) -> str:
    """The cycles in numbers, those of the first as the reference."""
    first = summarize(cycles[0].trajectory)
    speeds, factors = ("speed (cm/s)", f"over {WINDOW:g} s (cm/s)"), ("as often", "as far")
    head = ["policy", "period (s)", "swings", "step (cm)", *factors, *speeds, "centre of mass (cm/s)"]
    lines = [[*head, "at the limit", "closes within"]]
    for cycle in cycles:
        found = summarize(cycle.trajectory)
        lines.append(
            [
                cycle.trajectory.name,
                f"{found.period:.2f}",
                str(cycle.swings),
                f"{found.period * found.speed:.2f}",
                f"x {first.period / found.period:.2f}",
                f"x {found.period * found.speed / (first.period * first.speed):.2f}",
                f"{found.speed:.2f}",
                f"{cycle.window_speed:.2f}",
                f"{found.centre[0]:.1f} to {found.centre[1]:.1f}",
                f"{100.0 * found.saturated:.0f} %",
                f"{cycle.mismatch:.3f}",
            ]
        )
    return markdown_table(lines)


def draw(cycles: Sequence[Cycle]) -> Any:
    """Cycles side by side: angle, speed, normal force and torque over time, and the phase portrait."""
    from matplotlib.patches import Patch

    figure = new_figure(8.2)
    grid = figure.subplots(5, len(cycles), sharey="row", squeeze=False, height_ratios=(1.0, 1.0, 1.0, 1.0, 1.35))
    weight = (NOMINAL_PLANT.M + NOMINAL.m) * NOMINAL.g
    for column, trajectory in zip(grid.T, (cycle.trajectory for cycle in cycles), strict=True):
        angle, speed, load, torque, portrait = column
        t, degrees = trajectory.t, np.degrees(trajectory.theta)
        begin = 0
        for phase, group in itertools.groupby(np.sign(np.diff(trajectory.x)).tolist()):
            end = begin + len(list(group))
            for axes in column[:-1]:
                axes.axvspan(t[begin], t[end], color=SHADES[phase], linewidth=0.0)
            begin = end
        for axes in column[:-1]:
            axes.set_xlim(0.0, t[-1])
            axes.grid(visible=False)
            axes.tick_params(labelbottom=axes is torque)
        angle.plot(t, degrees, color=INK)
        speed.plot(t, 100.0 * trajectory.x_dot, color=INK)
        load.plot(t[1:], trajectory.normal_force[1:] / weight, color=INK)
        torque.step(t, trajectory.torque, color=INK, where="pre", linewidth=1.0)
        for axes, level in ((speed, 0.0), (load, 1.0), (torque, 0.0)):
            axes.axhline(level, color=MUTED, linewidth=0.6)
        torque.set_xlabel("time (s)")
        portrait.plot(degrees, trajectory.theta_dot, color=BLUE)
        portrait.set_xlabel("angle θ (deg)")
        name, _, seed = trajectory.name.partition(" (")
        angle.set_title("\n".join(textwrap.wrap(name, TITLE) + ([f"({seed}"] if seed else [])), fontsize=8.0)
    labels = ("θ (deg)", "speed x' (cm/s)", "N / ((M + m) g)", "torque u (N m)", "θ' (rad/s)")
    for axes, label in zip(grid[:, 0], labels, strict=True):
        axes.set_ylabel(label)
    figure.align_ylabels(grid[:, 0])
    patches = [Patch(color=SHADES[phase], label=name) for phase, name in PHASES.items()]
    figure.legend(handles=patches, loc="outside upper left", ncols=len(patches))
    add_note(
        figure,
        "One cycle each on the paper's plant, from the smallest θ on; the time axes differ. A growing θ pushes the "
        "platform forward.",
    )
    return figure
