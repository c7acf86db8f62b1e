"""The report's sections on what the speeds depend on: EPC's assumed shape, friction, normal force, steps."""

from __future__ import annotations

from collections.abc import Sequence

from baselines.paper.reproduction import Reproduction
from baselines.paper.shapes import ShapeSpeed
from baselines.paper.text.layout import paragraph, table, title


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
