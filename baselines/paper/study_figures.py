"""Figures beyond the paper's own: proof 2 and the speeds over mass and friction."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from baselines.drawing import INK, PENS, add_note, listed, mark_published, new_figure
from baselines.paper import published
from baselines.paper.proofs import swing_envelope
from baselines.paper.tracking import AT_REST, PROFILES, SpeedMap, grid, speed_map, speed_ratio
from baselines.tables import printed_above
from capsule_gym.parameters import NOMINAL

# Every so many samples of a demand, and of an envelope, are drawn.
EVERY, THIN = 20, 200
TOP_RATE = 13.5  # of the phase planes, rad/s
SPEED_LEVELS = (0.0, 0.5, 1.0, 1.5, 2.0)
# Where the map's lines carry their number: (mu, M), away from the nominal plant.
LABELS = {
    "proposed": [(0.17, 0.7), (0.055, 0.83), (0.03, 0.61), (0.03, 0.42), (0.005, 0.33)],
    "EPC": [(0.1, 0.8), (0.03, 0.75), (0.04, 0.45), (0.02, 0.36)],
}


def draw_phase_plane() -> Any:
    """The upper envelopes of the published torques with the published profiles."""
    figure = new_figure(3.7)
    panels = figure.subplots(1, 2, sharey=True)
    peaks, anywhere, stated = [], [], []
    for axes, profile in zip(panels, PROFILES, strict=True):
        pen, numbers = PENS[profile.name], published.RUNS[profile.name]
        torque, peak = numbers["peak_torque"].value, numbers["peak_velocity"].value
        swing = math.radians(numbers["swing"].value)
        envelope = swing_envelope(torque, profile.start, swing)
        degrees, fastest = np.degrees(envelope.theta[::THIN]), envelope.theta_dot[::THIN]
        axes.fill_between(degrees, fastest, TOP_RATE, color="#eef1f5", linewidth=0.0)
        axes.plot(degrees, fastest, color=INK, lw=1.6, label="upper envelope for the published torque")
        peaks.append(printed_above(envelope.fastest, 3))
        anywhere.append(printed_above(swing_envelope(torque, -swing, swing).fastest, 3))
        stated.append(peak)
        angle, rate, _ = profile.evaluate(np.linspace(0.0, profile.period, 4001))
        axes.plot(np.degrees(angle), rate, **pen.line(label=f"{profile.name} profile"))
        mark_published(axes, peak, f"published largest rate: {peak:g} rad/s", pen)
        axes.annotate(
            "out of reach", (0.0, 12.3), ha="center", va="center", fontsize=8.0, color="#5b6573", style="italic"
        )
        axes.set(xlabel="angle θ (deg)", xlim=(-62.0, 90.0), ylim=(-1.0, TOP_RATE))
        axes.set_title(f"{profile.name}: |u| ≤ {torque:g} N m")
    panels[0].set_ylabel("rate θ' (rad/s)")
    handles, labels = panels[0].get_legend_handles_labels()
    others, names = panels[1].get_legend_handles_labels()
    figure.legend([*handles, others[1]], [*labels, names[1]], loc="outside upper left", ncols=3)
    add_note(
        figure,
        "With the published torques the pendulum, from rest at the profiles' start, stays below "
        f"{' and '.join(peaks)} rad/s, in any contact and under any law; from rest anywhere within the swing to either "
        f"side below {' and '.join(anywhere)} rad/s (certified, rounded up). Published are "
        f"{listed(stated, 1, 'rad/s')}.",
    )
    return figure


def draw_speed_map() -> Any:
    """Mean speed over mass and friction for both profiles, and the ratio of the two."""
    figure = new_figure(3.3)
    panels = figure.subplots(1, 3, sharey=True)
    M, mu = grid()
    maps = [speed_map(profile, M, mu) for profile in PROFILES]
    for axes, speeds in zip(panels, maps, strict=False):
        _draw_map(figure, axes, speeds)
    ratio = speed_ratio(*maps)
    levels = np.arange(-0.4, 0.91, 0.1)
    drawn = panels[2].contourf(mu, M, ratio, levels=levels, cmap="cividis")
    lines = panels[2].contour(mu, M, ratio, levels=(0.0, 0.5, 0.8), colors=("white", "white", INK), linewidths=0.8)
    panels[2].clabel(lines, fmt="%g", fontsize=6.5)
    _add_colorbar(figure, drawn, panels[2], "proposed / EPC", (-0.4, 0, 0.4, 0.8))
    panels[2].set_title("Ratio of the speeds")
    panels[0].set(ylabel="mass of the platform M (kg)")
    for axes in panels:
        axes.set(xscale="log", xlabel="friction coefficient μ")
        axes.grid(False)
        axes.plot(NOMINAL.mu, NOMINAL.M, "*", color="white", mec=INK, mew=0.7, ms=9)
    fits = [speeds.friction_for(published.RUNS[speeds.profile]["mean_speed"].value)[0] for speeds in maps]
    add_note(
        figure,
        "Exact tracking, five cycles; star: nominal plant; dashed: the published speed, which M = 0.5 kg gives at μ = "
        f"{listed(fits, 3, '').strip()}. EPC is faster on all of it (the order turns nowhere; largest "
        f"ratio {np.nanmax(ratio):.2f}); hatched, below M = {maps[1].least_mass_in_contact:.2f} kg, it lifts the "
        f"platform off the floor. White: both all but at rest.",
    )
    return figure


def _add_colorbar(figure: Any, drawn: Any, axes: Any, label: str, ticks: tuple[float, ...]) -> None:
    """A colour bar below a map."""
    figure.colorbar(drawn, ax=axes, location="bottom", aspect=30, shrink=0.95, label=label, ticks=ticks)


def _draw_map(figure: Any, axes: Any, speeds: SpeedMap) -> None:
    """One profile's speeds with the published one as a dashed line, hatched where contact is lost."""
    from matplotlib.patheffects import withStroke

    drawn = axes.contourf(speeds.mu, speeds.M, speeds.speed, levels=np.arange(-0.25, 2.76, 0.25), cmap="cividis")
    # A profile that never slides back has a wide area of exactly 0, and no line at it.
    levels = SPEED_LEVELS if speeds.speed.min() < -AT_REST else SPEED_LEVELS[1:]
    lines = axes.contour(speeds.mu, speeds.M, speeds.speed, levels=levels, colors="white", linewidths=0.7)
    # A dark edge separates the labels from hatching and lines.
    for label in axes.clabel(lines, fmt="%g", fontsize=6.5, manual=LABELS[speeds.profile]):
        label.set(path_effects=[withStroke(linewidth=1.6, foreground="#4a4f5a")], zorder=5.0)
    value = published.RUNS[speeds.profile]["mean_speed"].value
    axes.contour(speeds.mu, speeds.M, speeds.speed, levels=(value,), colors=INK, linestyles="dashed", linewidths=1.2)
    if speeds.smallest_normal_ratio.min() <= 0.0:
        hatched = {"facecolor": "none", "edgecolor": "white", "hatch": "////", "linewidth": 0.0}
        axes.fill_between(speeds.mu, speeds.M[0], speeds.least_mass_in_contact, **hatched)
    _add_colorbar(figure, drawn, axes, "mean speed (cm/s)", (0, 1, 2))
    axes.set_title(speeds.profile)


STUDIES: dict[str, Callable[[], Any]] = {
    "phase_plane": draw_phase_plane,
    "speed_map": draw_speed_map,
}
