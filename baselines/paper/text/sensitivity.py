"""The report's sections on what the speeds depend on: EPC's assumed shape, friction, normal force, steps."""

from __future__ import annotations

from collections.abc import Sequence

from baselines.laws.profiles import EPC, PROPOSED
from baselines.paper import published
from baselines.paper.reproduction import Reproduction
from baselines.paper.shapes import ShapeSpeed
from baselines.paper.text.layout import paragraph, table, title
from baselines.paper.variations import (
    ALL_BUT_AT_REST,
    STEPS,
    contact_effect,
    friction_for,
    grid,
    least_mass_in_contact,
    speed_map,
    step_study,
    turning_points,
)
from capsule_gym.parameters import NOMINAL


def shapes_section(shapes: Sequence[ShapeSpeed]) -> list[str]:
    """Other shapes of both profiles."""
    cells = [["profile", "phases I to III", "P2, rad/s", "cm/s"]]
    cells += [[row.profile, row.shape, f"{row.P2:.3f}", f"{row.mean_speed:.3f}"] for row in shapes]
    epc, proposed = ([row.mean_speed for row in shapes if row.profile == name] for name in ("EPC", "proposed"))
    order = "EPC is the faster in every pair" if min(epc) > max(proposed) else "the order depends on the shape"
    return [
        *title("The order of the speeds under other shapes (exact tracking, nominal plant)"),
        *table(cells, left=2, last_left=False),
        "",
        *paragraph(
            "Of EPC the paper gives the times, the peak and the swing, not the shape, which is assumed; of the "
            "proposed profile phase III is mended. Each alternative keeps times, peak and swing, P2 following from "
            f"them. EPC {min(epc):.3f} to {max(epc):.3f} cm/s, proposed {min(proposed):.3f} to {max(proposed):.3f}: "
            f"{order}."
        ),
    ]


def sensitivity_section(result: Reproduction) -> list[str]:
    """Friction, normal force, steps."""
    cells = [["normal force", *(f"mu = {mu:g}" for mu in result.contacts[0].mu)]]
    for effect in result.contacts:
        cells.append([f"{effect.profile}, newton, cm/s", *(f"{speed:.3f}" for speed in effect.newton)])
        cells.append([f"{effect.profile}, paper, cm/s", *(f"{speed:.3f}" for speed in effect.paper)])
    lines = [*title("Sensitivity"), *table(cells, last_left=False), ""]
    cells = [["step, ms", "proposed\ncm/s", "\nN m", "EPC\ncm/s", "\nN m", "held 10 ms: proposed\ncm/s", "\nN m"]]
    cells[0] += ["EPC\ncm/s", "\nN m"]
    for n, step in enumerate(result.steps[0].steps):
        row = [f"{1e3 * step:g}"]
        for study in (*result.steps, *result.physics_steps):
            row += [f"{study.speed[n]:.5f}", f"{study.peak_torque[n]:.5f}"]
        cells.append(row)
    lines += [*table(cells, last_left=False), ""]
    return lines + paragraph(
        "First four columns: law and physics at the same step, as a simulation with one fixed step has it; what "
        "changes is the torque's hold, not the integrator. Last four: the law at 10 ms throughout, the physics alone "
        "refined. The law runs at 1 kHz everywhere else."
    )


def study_text() -> str:
    """All that `python -m baselines.paper.sensitivity` prints: speed map, normal force and steps, computed here."""
    return "\n".join([*_map_lines(), *_contact_lines(), *_step_lines()]).lstrip("\n")


def _map_lines() -> list[str]:
    """The speed map in numbers."""
    M, mu = grid()
    maps = [speed_map(profile, M, mu) for profile in (PROPOSED, EPC)]
    moving = maps[1].speed > ALL_BUT_AT_REST
    ratio = maps[0].speed[moving] / maps[1].speed[moving]
    turns = turning_points(*maps)
    lines = [
        *title(f"Mean speed, M = {M[0]:g} to {M[-1]:g} kg, mu = {mu[0]:g} to {mu[-1]:g}, exact tracking, five cycles"),
        f"proposed / EPC: {ratio.min():.3f} to {ratio.max():.3f}",
        f"the faster profile changes at {len(turns) or 'no'} points of the map",
    ]
    for speeds, numbers in zip(maps, (published.PROPOSED, published.EPC), strict=True):
        stated = numbers["mean_speed"].value
        fits = friction_for(speeds, NOMINAL.M, stated)
        lines.append(f"{speeds.profile} gives the published {stated} cm/s at mu = {fits:.3f} (M = {NOMINAL.M:g} kg)")
        if speeds.smallest_normal_ratio.min() <= 0.0:
            lines.append(f"{speeds.profile} loses contact below M = {least_mass_in_contact(speeds):.3f} kg")
    return lines


def _contact_lines() -> list[str]:
    """What the normal force of (7) changes."""
    cells = [["profile", "mu", "newton\ncm/s", "paper\ncm/s", "difference"]]
    for profile in (PROPOSED, EPC):
        effect = contact_effect(profile, (0.003, 0.01, 0.03, 0.1, 0.2))
        for mu, newton, paper in zip(effect.mu, effect.newton, effect.paper, strict=True):
            change = f"{100.0 * (paper / newton - 1.0):+.2f} %"
            cells.append([effect.profile, f"{mu:.3f}", f"{newton:.3f}", f"{paper:.3f}", change])
    return [*title("Normal force of (7) against Newton's, M = 0.5 kg"), *table(cells, last_left=False)]


def _step_lines() -> list[str]:
    """What the integration step and the hold of the torque change."""
    held = f"held {1e3 * STEPS[-1]:g} ms:"
    cells = [["profile", "step", "speed\ncm/s", "torque\nN m", f"{held} speed\ncm/s", "torque\nN m"]]
    for profile in (PROPOSED, EPC):
        columns = [*step_study(profile).errors(), *step_study(profile, law_step=STEPS[-1]).errors()]
        for step, *errors in zip(STEPS[1:], *columns, strict=True):
            cells.append([profile.name, f"{1e3 * step:g} ms", *(f"{error:.1e}" for error in errors)])
    return [*title(f"Error against the step of {1e3 * STEPS[0]:g} ms"), *table(cells, last_left=False)]
