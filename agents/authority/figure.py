"""Draws speed and failures over the torque that an agent may add to its law, a column per way to learn."""

from __future__ import annotations

from typing import Any

from agents.authority.design import BASES, DIRECT, LIMITS, RECIPES, Arm, Plants, direct
from agents.authority.results import Results
from agents.evaluation.statistics import estimate
from baselines.drawing import BLUE, GREEN, INK, MUTED, VERMILION, Pen, add_note, new_figure

COLOURS = {"adaptive": VERMILION, "compliant": GREEN, "gait-guarded": BLUE}
DASHES: dict[Plants, Any] = {"paper": "-", "wide": (0.0, (5.0, 1.6))}
MARKERS: dict[Plants, str] = {"paper": "o", "wide": "s"}
# Between lines that would lie on each other, in places of the axis.
ASIDE = 0.06


def draw(results: Results) -> Any:
    """The figure, to be called in the house style."""
    figure = new_figure(5.0)
    grid = figure.subplots(2, len(RECIPES), sharex=True, sharey="row", height_ratios=(1.6, 1.0), squeeze=False)
    present = results.arms()
    places = {limit: place for place, limit in enumerate((0.0, *LIMITS))}
    lines = [(base, plants) for base, (_, examined) in BASES.items() for plants in examined]
    for (speed, failed), recipe in zip(grid.T, RECIPES, strict=True):
        for n, (base, plants) in enumerate(lines):
            arms = [Arm(base, plants, 0.0), *(Arm(base, plants, limit, recipe) for limit in LIMITS)]
            arms = [arm for arm in arms if arm in present]
            x = [places[arm.limit] + ASIDE * (n - 0.5 * (len(lines) - 1)) for arm in arms]
            pen = Pen(COLOURS[base], DASHES[plants])
            found = [estimate(results.speeds(arm)) for arm in arms]
            label = f"{BASES[base][0]} law, {plants}"
            speed.plot(
                x, [each.value for each in found], **pen.line(marker=MARKERS[plants], markersize=3.5, label=label)
            )
            shares = [100.0 * results.failed(arm).mean(axis=1) for arm in arms]
            failed.plot(x, [share.mean() for share in shares], **pen.line(marker=MARKERS[plants], markersize=3.5))
            for place, each, share in zip(x, found, shares, strict=True):
                # What is resampled of a law alone are plants: that is no interval over trainings.
                if each.resampled == "seeds":
                    speed.plot([place] * 2, [each.low, each.high], color=pen.colour, linewidth=1.0)
                    failed.plot([place] * 2, [share.min(), share.max()], color=pen.colour, linewidth=1.0)
        for plants in DIRECT:
            if direct(plants) in present:
                pen = Pen(MUTED, DASHES[plants])
                value = estimate(results.speeds(direct(plants))).value
                speed.axhline(value, **pen.line(linewidth=1.0, label=f"no law, {plants}"))
                failed.axhline(100.0 * results.failed(direct(plants)).mean(), **pen.line(linewidth=1.0))
        speed.set_title(f"Learning {recipe}ly")
        speed.set_ylim(0.0, None)
        # Where none fails, the axis is no axis of thousandths.
        failed.set_ylim(0.0, max(5.0, failed.get_ylim()[1]))
        failed.set_xticks(list(places.values()), [f"{limit:g}" for limit in places])
        failed.set_xlabel("limit of the agent's torque (N m)", color=INK)
    grid[0][0].set_ylabel("mean speed (cm/s)")
    grid[1][0].set_ylabel("failed (%)")
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=3)
    add_note(
        figure,
        f"At 0 the law alone; at 3 N m an agent can put any torque in its place. {results.steps / 1e6:g} M steps "
        "each; bars: 95 % over training seeds (with few of them their range), for failures the range.",
    )
    return figure
