"""Figures of what the paper does not show: proof, principles, sensitivity to plant, contact and integration step."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from baselines.drawing import (
    INK,
    MUTED,
    PENS,
    PUBLISHED_DASHES,
    PURPLE,
    Pen,
    add_note,
    listed,
    mark_published,
    new_figure,
)
from baselines.laws.profiles import EPC, PROPOSED, Profile
from baselines.paper import published
from baselines.paper.principles import RESTORING_PHASES, Margin, principle_3, principle_4
from baselines.paper.printed_profile import ROMAN
from baselines.paper.proofs import swing_envelope
from baselines.paper.variations import (
    ALL_BUT_AT_REST,
    STEPS,
    SpeedMap,
    contact_effect,
    friction_for,
    grid,
    least_mass_in_contact,
    speed_map,
    step_study,
    turning_points,
)
from baselines.tables import printed_above
from capsule_gym.parameters import NOMINAL, NormalForce

STATED = {"proposed": published.PROPOSED, "EPC": published.EPC}
# Every so many samples of a margin, and of an envelope, are drawn.
EVERY, THIN = 20, 200
# Of the phase planes, rad/s.
TOP_RATE = 13.5
SPEED_LEVELS = (0.0, 0.5, 1.0, 1.5, 2.0)
# Where the map's lines carry their number: (mu, M), away from the nominal plant.
LABELS = {
    "proposed": [(0.17, 0.7), (0.055, 0.83), (0.03, 0.61), (0.03, 0.42), (0.005, 0.33)],
    "EPC": [(0.1, 0.8), (0.03, 0.75), (0.04, 0.45), (0.02, 0.36)],
}


def draw_phase_plane() -> Any:
    """The fastest that the published torques can swing the pendulum, beside the published profiles."""
    figure = new_figure(3.7)
    panels = figure.subplots(1, 2, sharey=True)
    peaks, anywhere, stated = [], [], []
    for axes, profile in zip(panels, (PROPOSED, EPC), strict=True):
        pen, numbers = PENS[profile.name], STATED[profile.name]
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
    rival, name = panels[1].get_legend_handles_labels()
    figure.legend([*handles, rival[1]], [*labels, name[1]], loc="outside upper left", ncols=3)
    add_note(
        figure,
        "With the published torques the pendulum, from rest at the profiles' start, stays below "
        f"{' and '.join(peaks)} rad/s, in any contact and under any law; from rest anywhere within the swing to either "
        f"side below {' and '.join(anywhere)} rad/s (certified, rounded up). Published are "
        f"{listed(stated, 1, 'rad/s')}.",
    )
    return figure


def _phase_axis(margin: Margin) -> np.ndarray:
    """The samples' places on an axis that gives every phase the same width."""
    t, phase = margin.cycle.t, margin.cycle.phase
    place = np.empty_like(t)
    for n in range(int(phase[-1]) + 1):
        inside = phase == n
        first, last = t[inside][0], t[inside][-1]
        place[inside] = n + (t[inside] - first) / (last - first)
    return place


def draw_principles() -> Any:
    """Load over limit of Principles 3 and 4 over a cycle, phase by phase."""
    figure = new_figure(4.8)
    rows = figure.subplots(2, 2, sharey="row", sharex="col", width_ratios=(7.0, 6.0))
    plant = NOMINAL.plant()
    forces: tuple[tuple[NormalForce, Pen, str], ...] = (
        ("newton", Pen(INK), "Newton's forces"),
        ("paper", Pen(PURPLE, (0.0, (5.0, 1.6))), "as printed"),
    )
    for column, profile in enumerate((PROPOSED, EPC)):
        for row, principle in zip(rows, (principle_3, principle_4), strict=True):
            _draw_principle(
                row[column], profile, [(principle(profile, plant, force), pen, label) for force, pen, label in forces]
            )
        rows[0][column].set_title(profile.name)
        rows[1][column].set_xlabel("phase, each drawn as wide as the next")
    rows[0][0].set(title="Principle 3 (7): proposed", ylabel="pendulum's lift / weight", ylim=(-1.4, 1.2))
    rows[1][0].set(title="Principle 4 (8)", ylabel="push / static friction", yscale="log", ylim=(0.02, 200.0))
    rows[0][1].legend(loc="upper right", bbox_to_anchor=(1.0, 0.5))
    held = [principle_4(profile, plant).factor_by_phase[-RESTORING_PHASES:] for profile in (PROPOSED, EPC)]
    add_note(
        figure,
        "Above 1 a principle is violated; 4 is asked for in the shaded restoring stage only, before it a violation is "
        "what moves the capsule. Largest there, Newton: "
        f"{listed([float(f[0]) for f in held], 1, 'in its first phase')}, "
        f"{listed([float(f[1:].max()) for f in held], 2, 'in the others')} (proposed and EPC).",
    )
    return figure


def _draw_principle(axes: Any, profile: Profile, cases: list[tuple[Margin, Pen, str]]) -> None:
    """One principle of one profile: load over limit, each phase as wide as the next."""
    count = len(profile.segments)
    axes.axvspan(count - RESTORING_PHASES, count, color="#eef1f5", linewidth=0.0)
    for margin, pen, label in cases:
        place, ratio = _phase_axis(margin), margin.load / margin.limit
        for n in range(count):
            inside = np.flatnonzero(margin.cycle.phase == n)[::EVERY]
            axes.plot(place[inside], ratio[inside], **pen.line(label=label if n == 0 else None))
    axes.axhline(1.0, color=INK, linewidth=0.9)
    axes.set_xlim(0.0, count)
    axes.set_xticks(np.arange(count) + 0.5, ROMAN[:count])
    axes.set_xticks(np.arange(1, count), minor=True)
    axes.tick_params(axis="x", which="major", length=0.0)
    axes.grid(False, axis="x")
    axes.grid(True, axis="x", which="minor")


def draw_speed_map() -> Any:
    """Mean speed over mass and friction for both profiles, and the ratio of the two."""
    figure = new_figure(3.3)
    panels = figure.subplots(1, 3, sharey=True)
    M, mu = grid()
    maps = [speed_map(profile, M, mu) for profile in (PROPOSED, EPC)]
    for axes, speeds in zip(panels, maps, strict=False):
        _draw_map(figure, axes, speeds)
    ratio = np.full_like(maps[0].speed, np.nan)
    np.divide(maps[0].speed, maps[1].speed, out=ratio, where=maps[1].speed > ALL_BUT_AT_REST)
    levels = np.arange(-0.4, 0.91, 0.1)
    drawn = panels[2].contourf(mu, M, ratio, levels=levels, cmap="cividis")
    lines = panels[2].contour(mu, M, ratio, levels=(0.0, 0.5, 0.8), colors=("white", "white", INK), linewidths=0.8)
    panels[2].clabel(lines, fmt="%g", fontsize=6.5)
    figure.colorbar(
        drawn,
        ax=panels[2],
        location="bottom",
        aspect=30,
        shrink=0.95,
        label="proposed / EPC",
        ticks=(-0.4, 0, 0.4, 0.8),
    )
    panels[2].set_title("Ratio of the speeds")
    panels[0].set(ylabel="mass of the platform M (kg)")
    for axes in panels:
        axes.set(xscale="log", xlabel="friction coefficient μ")
        axes.grid(False)
        axes.plot(NOMINAL.mu, NOMINAL.M, "*", color="white", mec=INK, mew=0.7, ms=9)
    turns = turning_points(*maps)
    order = f"the order turns at {len(turns)} points" if turns else "the order turns nowhere"
    fits = [
        friction_for(speeds, NOMINAL.M, numbers["mean_speed"].value)
        for speeds, numbers in zip(maps, STATED.values(), strict=True)
    ]
    add_note(
        figure,
        "Exact tracking, five cycles; star: nominal plant; dashed: the published speed, which M = 0.5 kg gives at μ = "
        f"{listed(fits, 3, '').strip()}. EPC is faster on all of it ({order}; largest ratio {np.nanmax(ratio):.2f}); "
        f"hatched, below M = {least_mass_in_contact(maps[1]):.2f} kg, it lifts the platform off the floor. "
        "White: both all but at rest.",
    )
    return figure


def _set_off(labels: Any) -> None:
    """Gives labels on a map a dark edge, so that hatching and lines do not run into them."""
    from matplotlib.patheffects import withStroke

    for label in labels:
        label.set_path_effects([withStroke(linewidth=1.6, foreground="#4a4f5a")])
        label.set_zorder(5.0)


def _draw_map(figure: Any, axes: Any, speeds: SpeedMap) -> None:
    """One profile's speeds with the published one as a dashed line, hatched where contact is lost."""
    drawn = axes.contourf(speeds.mu, speeds.M, speeds.speed, levels=np.arange(-0.25, 2.76, 0.25), cmap="cividis")
    # A profile that never slides back has a wide floor of exactly 0, and no line at it.
    levels = SPEED_LEVELS if speeds.speed.min() < -ALL_BUT_AT_REST else SPEED_LEVELS[1:]
    lines = axes.contour(speeds.mu, speeds.M, speeds.speed, levels=levels, colors="white", linewidths=0.7)
    _set_off(axes.clabel(lines, fmt="%g", fontsize=6.5, manual=LABELS[speeds.profile]))
    value = STATED[speeds.profile]["mean_speed"].value
    axes.contour(speeds.mu, speeds.M, speeds.speed, levels=(value,), colors=INK, linestyles="dashed", linewidths=1.2)
    if speeds.smallest_normal_ratio.min() <= 0.0:
        least = least_mass_in_contact(speeds)
        axes.fill_between(
            speeds.mu, speeds.M[0], least, facecolor="none", edgecolor="white", hatch="////", linewidth=0.0
        )
    figure.colorbar(
        drawn, ax=axes, location="bottom", aspect=30, shrink=0.95, label="mean speed (cm/s)", ticks=(0, 1, 2)
    )
    axes.set_title(speeds.profile)


def draw_contact_and_step() -> Any:
    """The paper's normal force against Newton's, and what the integration step changes."""
    figure = new_figure(5.0)
    (speed, speed_error), (change, torque_error) = figure.subplots(2, 2, sharex="col")
    mu = np.geomspace(0.003, 1.0, 61)
    for profile in (PROPOSED, EPC):
        pen = PENS[profile.name]
        effect = contact_effect(profile, mu)
        speed.plot(mu, effect.newton, **pen.line(label=profile.name))
        speed.plot(mu, effect.paper, color=INK, lw=0.6)
        change.plot(mu, effect.paper - effect.newton, **pen.line())
        for law_step, marker in ((None, "o"), (STEPS[-1], "s")):
            study = step_study(profile, law_step=law_step)
            face = pen.colour if law_step is None else "white"
            for axes, errors in zip((speed_error, torque_error), study.errors(), strict=True):
                axes.plot(
                    1e3 * study.steps[1:],
                    errors,
                    **pen.line(marker=marker, ms=4.0, mfc=face),
                )
    speed.set(title="Normal force", xscale="log", ylabel="mean speed (cm/s)", ylim=(-0.15, 1.9))
    speed.axvline(NOMINAL.mu, color=INK, linestyle=PUBLISHED_DASHES, linewidth=1.0)
    change.axvline(NOMINAL.mu, color=INK, linestyle=PUBLISHED_DASHES, linewidth=1.0)
    change.set(xlabel="friction coefficient μ (M = 0.5 kg)", ylabel="(7) minus Newton (cm/s)")
    speed_error.set(title="Integration step", xscale="log", yscale="log", ylabel="error of the speed (cm/s)")
    torque_error.set(xscale="log", yscale="log", ylabel="error of the largest torque (N m)")
    torque_error.set(xlabel="integration step (ms); error against 0.1 ms")
    torque_error.set_xticks([0.2, 0.5, 1, 2, 5, 10], ["0.2", "0.5", "1", "2", "5", "10"])
    torque_error.minorticks_off()
    handles, labels = speed.get_legend_handles_labels()
    extra: tuple[tuple[str, dict[str, Any]], ...] = (
        ("with the normal force of (7)", {"color": INK, "lw": 0.6}),
        ("torque held for the step", {"color": MUTED, "marker": "o", "ms": 4.0}),
        (f"for {1e3 * STEPS[-1]:g} ms", {"color": MUTED, "marker": "s", "ms": 4.0, "mfc": "white"}),
    )
    handles += [speed.plot([], [], **line)[0] for _, line in extra]
    labels += [label for label, _ in extra]
    figure.legend(handles, labels, loc="outside upper left", ncols=len(labels), columnspacing=1.4)
    nominal = [contact_effect(profile, (NOMINAL.mu,)) for profile in (PROPOSED, EPC)]
    shares = [100.0 * float(effect.paper[0] / effect.newton[0] - 1.0) for effect in nominal]
    add_note(
        figure,
        f"At the nominal friction (dotted) the normal force of (7) changes the speeds by {listed(shares, 2, '%')}. The "
        "integrator's own error (open squares) falls with the fourth power of the step; holding the torque for the "
        "step costs the first power (filled).",
    )
    return figure
