"""Draws the best-known gaits: speed over friction beside the bound that needs no search, and the front of the costs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from baselines.gaits.archive import GRID_M, GRID_MU, known_gaits, pareto_front
from baselines.gaits.bound import speed_bound
from capsule_gym.parameters import Capsule

SIZE_INCHES = (11.0, 4.6)
DOTS_PER_INCH = 150
BOUND_POINTS = 25


def _import_figure() -> Any:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError(
            'drawing the gaits needs matplotlib, which is not installed: pip install "capsule-gym[paper]"'
        ) from error
    return Figure


def draw_gaits(path: Path) -> list[Path]:
    """Draws the figure and writes it as PNG and SVG.

    Args:
        path: of the figure; its suffix is replaced by .png and .svg.

    Returns:
        The paths written.

    Raises:
        ImportError: without matplotlib.
    """
    # A figure of its own needs no display and leaves the state of pyplot alone.
    figure = _import_figure()(figsize=SIZE_INCHES, layout="constrained")
    speeds, front = figure.subplots(1, 2, width_ratios=(3, 2))
    _draw_speeds(speeds)
    _draw_front(front)
    written = []
    for suffix in (".png", ".svg"):
        target = path.with_suffix(suffix)
        target.parent.mkdir(parents=True, exist_ok=True)
        # Without the date the same data gives the same file.
        figure.savefig(target, dpi=DOTS_PER_INCH, metadata={"Date": None} if suffix == ".svg" else None)
        written.append(target)
    return written


def _draw_speeds(axes: Any) -> None:
    """Best-known speed and bound over mu, one colour for each M."""
    table = known_gaits().table()
    friction = np.geomspace(GRID_MU[0], GRID_MU[-1], BOUND_POINTS)
    for index, M in enumerate(GRID_M):
        colour = f"C{index}"
        known = [table[M, mu].mean_speed for mu in GRID_MU]
        axes.plot(GRID_MU, known, "o-", color=colour, label=f"M = {M:g} kg")
        axes.plot(friction, [speed_bound(M, mu) for mu in friction.tolist()], "--", color=colour)
    axes.plot([], [], "k--", label="upper bound")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="friction coefficient μ",
        ylabel="mean speed over 33 s (cm/s)",
        title="Best-known gaits, torque limit 1.5 N m",
    )
    ticks = (1, 2, 5, 10, 20, 50, 100)
    low = axes.get_ylim()[0]
    axes.set_yticks([tick for tick in ticks if tick >= low])
    axes.set_yticklabels([str(tick) for tick in ticks if tick >= low])
    axes.set_yticks([], minor=True)
    axes.set_xticks(GRID_MU)
    axes.set_xticklabels([f"{mu:g}" for mu in GRID_MU])
    axes.set_xticks([], minor=True)
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")


def _draw_front(axes: Any) -> None:
    """Speed against cost of transport at the nominal plant."""
    nominal = Capsule()
    gaits = pareto_front()
    axes.plot([gait.cost_of_transport for gait in gaits], [gait.mean_speed for gait in gaits], "-", color="0.7")
    for index, name in enumerate(sorted({gait.family for gait in gaits})):
        own = [gait for gait in gaits if gait.family == name]
        x, y = [gait.cost_of_transport for gait in own], [gait.mean_speed for gait in own]
        axes.plot(x, y, "osD"[index % 3], color=f"C{index + len(GRID_M)}", label=name)
    axes.set(
        xlabel="cost of transport",
        ylabel="mean speed over 33 s (cm/s)",
        title=f"Pareto front at M = {nominal.M:g} kg, μ = {nominal.mu:g}",
    )
    # Both from zero, so that twice the height is twice the speed; the rest keeps the outermost points whole.
    axes.set_xlim(0.0, 1.08 * max(gait.cost_of_transport for gait in gaits))
    axes.set_ylim(0.0, 1.08 * max(gait.mean_speed for gait in gaits))
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
