"""All figures: `python -m baselines.paper --figures DIR` writes them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from baselines.drawing import save, style
from baselines.dynamic_programming.figure import draw_optimum
from baselines.gaits.figure import draw_gaits
from baselines.paper.figures.adaptive import (
    draw_adaptive_error,
    draw_adaptive_torque,
    draw_adaptive_tracking,
    draw_sliding_variable,
    run_adaptive,
)
from baselines.paper.figures.profiles import PROFILE_FIGURES, run_profiles
from baselines.paper.figures.schematic import draw_capsule, draw_phases
from baselines.paper.figures.studies import draw_contact_and_step, draw_phase_plane, draw_principles, draw_speed_map

SCHEMATICS: dict[str, Callable[[], Any]] = {"fig1_capsule": draw_capsule, "fig2_phases": draw_phases}
ADAPTIVE_FIGURES = {
    "fig6_adaptive_tracking": draw_adaptive_tracking,
    "fig7_adaptive_error": draw_adaptive_error,
    "fig8_adaptive_torque": draw_adaptive_torque,
    "fig9_sliding_variable": draw_sliding_variable,
}
STUDIES: dict[str, Callable[[], Any]] = {
    "phase_plane": draw_phase_plane,
    "principles": draw_principles,
    "speed_map": draw_speed_map,
    "contact_and_step": draw_contact_and_step,
    "gaits": draw_gaits,
    "optimum": draw_optimum,
}
NAMES = (*SCHEMATICS, *PROFILE_FIGURES, *ADAPTIVE_FIGURES, *STUDIES)


def draw_all(directory: Path, progress: Callable[[str], None] | None = None) -> list[Path]:
    """Draws every figure as SVG and as PNG at 200 dpi; repeated runs give identical files.

    Args:
        directory: made if it does not exist.
        progress: is told the name of every figure that is drawn.

    Returns:
        The files written.

    Raises:
        ImportError: if matplotlib is not installed.
    """
    directory.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []

    def finish(name: str, figure: Any) -> None:
        written.extend(save(figure, directory / name))
        if progress is not None:
            progress(name)

    with style():
        for name, draw in SCHEMATICS.items():
            finish(name, draw())
        runs = run_profiles()
        for name, draw_profile in PROFILE_FIGURES.items():
            finish(name, draw_profile(runs))
        adaptive_runs = run_adaptive()
        for name, draw_adaptive in ADAPTIVE_FIGURES.items():
            finish(name, draw_adaptive(adaptive_runs))
        for name, draw_study in STUDIES.items():
            finish(name, draw_study())
    return written
