"""One steady cycle of some policies on the paper's plant: a table and a figure."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from baselines.drawing import BLUE, INK, MUTED, add_note, new_figure
from baselines.tables import markdown_table
from capsule_gym import CapsuleEnv
from capsule_gym.evaluation.candidates import find_candidate
from capsule_gym.parameters import NOMINAL
from capsule_gym.tasks.task import CONTROL_DT, HORIZON, TORQUE_LIMIT

# Columns of samples.
THETA, THETA_DOT, X, X_DOT, NORMAL_FORCE, TORQUE = range(6)
POLICIES = ("adaptive", "pd", "gait-guarded", "direct-ppo", "dp-nominal")
# The last part of an episode, in which a cycle is searched, s: two of the paper's cycles fit.
WINDOW = 20.0
# Time between samples, s.
DT = 0.002
# Phases of the contact by the sign of the displacement, in the colours of the rendered robot, pale.
PHASES = {
    1: ("slips forward", "#fde3cc"),
    0: ("sticks", "#c8d9f0"),
    -1: ("slips backward", "#fbf2e9"),
}
LABELS = ("θ (deg)", "x' (cm/s)", "N / ((M + m) g)", "u (N m)", "θ' (rad/s)")


def sample_episode(policy: Any) -> np.ndarray:
    """Samples an episode on the paper's plant: its columns, `DT` apart.

    The policy acts every `CONTROL_DT`; its action is held in between.
    """
    env = CapsuleEnv(**{**policy.env_kwargs, "randomization": "none", "control_dt": DT})
    act = policy.start([0])
    observation, info = env.reset(seed=0)
    samples = []
    for step in range(round(HORIZON / DT)):
        if step % round(CONTROL_DT / DT) == 0:
            action = act(observation[None])[0]
        observation, _, terminated, _, info = env.step(action)
        assert not terminated
        samples.append([*info["state"], info["normal_force"], info["torque"]])
    return np.array(samples)


def find_cycle(samples: np.ndarray) -> np.ndarray:
    """The cycle in the last `WINDOW` that is closest to periodic, from its smallest theta on."""
    samples = samples[-round(WINDOW / DT) :]
    theta = samples[:, THETA]
    middle = 0.5 * (theta.min() + theta.max())
    above = theta >= middle
    rises = 1 + np.flatnonzero(~above[:-1] & above[1:])
    periods = np.diff(rises)
    # The cycle from the smallest theta on reaches up to a period further.
    fits = rises[1:] + periods < len(theta)
    rates = samples[:, [THETA_DOT, X_DOT]]
    steps = np.abs(np.diff(rates[rises], axis=0))
    changes = (steps / rates.std(axis=0)).max(axis=1)
    chosen = int(np.where(fits, changes, np.inf).argmin())
    first, last = rises[chosen], rises[chosen + 1]
    begin = first + int(theta[first:last].argmin())
    return samples[begin : begin + periods[chosen] + 1]


def document() -> tuple[dict[str, str], dict[str, Callable[[], Any]]]:
    """The table and the figure."""
    head = "policy", "period (s)", "distance (cm)", "speed (cm/s)", "time in stick"
    lines: list[Sequence[str]] = [(*head, "time at 1.5 N m")]
    cycles = {}
    for name in POLICIES:
        policy = find_candidate(name).policies[0]
        cycle = cycles[name] = find_cycle(sample_episode(policy))
        period = DT * (len(cycle) - 1)
        distance = 100.0 * (cycle[-1, X] - cycle[0, X])
        stuck = cycle[1:, X_DOT] == 0.0
        limited = np.abs(cycle[1:, TORQUE]) >= TORQUE_LIMIT
        line = [name, f"{period:.2f}", f"{distance:.2f}", f"{distance / period:.2f}"]
        line.append(f"{100.0 * stuck.mean():.0f} %")
        line.append(f"{100.0 * limited.mean():.0f} %")
        lines.append(line)
    return {"cycles": markdown_table(lines)}, {"limit_cycle": lambda: draw(cycles)}


def draw(cycles: dict[str, np.ndarray]) -> Any:
    """Draws angle, velocity, normal force and torque over time, and the phase portrait.

    There is a column of panels per cycle.
    """
    from matplotlib.patches import Patch

    figure = new_figure(8.2)
    grid = figure.subplots(5, len(cycles), sharey="row")
    for column, (name, cycle) in zip(grid.T, cycles.items(), strict=True):
        column[0].set_title(name)
        draw_column(column, cycle)
    for axes, label in zip(grid[:, 0], LABELS, strict=True):
        axes.set_ylabel(label)
    figure.align_ylabels(grid[:, 0])
    patches = [Patch(facecolor=shade, label=phase) for phase, shade in PHASES.values()]
    figure.legend(handles=patches, loc="outside upper left", ncols=len(patches))
    add_note(figure, "The time axes differ. A growing θ pushes the platform forward.")
    return figure


def draw_column(panels: np.ndarray, cycle: np.ndarray) -> None:
    """Draws a cycle into its five panels: four over time, and the phase portrait."""
    *over_time, portrait = panels
    t = DT * np.arange(len(cycle))
    begin = 0
    for phase, group in itertools.groupby(np.sign(np.diff(cycle[:, X])).tolist()):
        end = begin + len(list(group))
        for axes in over_time:
            axes.axvspan(t[begin], t[end], facecolor=PHASES[phase][1])
        begin = end
    degrees = np.degrees(cycle[:, THETA])
    weight = (NOMINAL.M + NOMINAL.m) * NOMINAL.g
    # Each with the level of its grey line.
    series = (
        (degrees, 0.0),
        (100.0 * cycle[:, X_DOT], 0.0),
        (cycle[:, NORMAL_FORCE] / weight, 1.0),
        (cycle[:, TORQUE], 0.0),
    )
    for axes, (values, level) in zip(over_time, series, strict=True):
        axes.axhline(level, color=MUTED)
        axes.plot(t, values, color=INK)
        axes.set_xlim(0.0, t[-1])
        axes.grid(visible=False)
        axes.tick_params(labelbottom=axes is over_time[-1])
    over_time[-1].set_xlabel("time (s)")
    portrait.plot(degrees, cycle[:, THETA_DOT], color=BLUE)
    portrait.set_xlabel("θ (deg)")
