"""The command: every published number and claim with its verdict, and figures of the same
numbers."""

import re
from dataclasses import replace

import numpy as np
import pytest

from baselines import drawing
from baselines.paper import __main__ as paper
from baselines.paper import figures, published, report, tracking
from baselines.paper.adaptive import sliding
from tests import ROOT

matplotlib = pytest.importorskip("matplotlib")
# Other versions draw other letters.
PINNED = (
    f"matplotlib=={matplotlib.__version__} ; python_version >="
    in (ROOT / "constraints.txt").read_text()
)


@pytest.fixture(scope="module")
def made(laws):
    """The results; parts that other modules test are shared with them or replaced by a few
    numbers."""
    studied = iter(laws)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "study_law", lambda *_: next(studied))
        patch.setattr(report, "study_variants", lambda: [(0.01, 1.0, 1, 1000, 24)])
        patch.setattr(report, "run_cycles", lambda *_, **options: (None, np.full((3, 3, 5), 1e-3)))
        patch.setattr(tracking, "grid", lambda: ([0.3, 0.5, 1.0], [0.003, 0.01, 0.1]))
        return report.compute()


def text_of(figure):
    """All text of a figure in one line."""
    from matplotlib.text import Text

    return " ".join(" ".join(text.get_text() for text in figure.findobj(Text)).split())


def test_verdicts(made):
    rows = {(row["run"], row["quantity"]): row for row in made["numbers"]}
    for run in ("proposed", "EPC"):
        assert rows[run, "largest theta'"][""] == "reproduced"
        for quantity in ("mean speed, five cycles", "largest torque"):
            assert (
                rows[run, quantity][""] == "NOT reproduced"
                and rows[run, quantity]["kind"] == "predicted"
            )
    # 0.138 (0.3)^2 = 0.01242 kg m^2 is not the printed 0.01424.
    constants = [row[""] for row in made["numbers"] if row["kind"] == "constant"]
    assert constants == ["reproduced", "NOT reproduced", *["reproduced"] * 8]
    assert [holds for _, holds in made["claims"].values()] == [False, True, True, True] + [
        False
    ] * 5
    assert all(
        word in claim
        for word, claim in zip(("torque", "energy", "back"), [*made["claims"]][1:4], strict=True)
    )


@pytest.mark.parametrize(("share", "holds"), [(0.05, True), (0.5, False)])
def test_the_claims_about_a_law_that_does_what_they_say_hold(made, share, holds):
    law = replace(made["laws"][0], runs=[{**run, "rise": 0.0} for run in made["laws"][0].runs])
    # Errors that fall on all plants but the nominal one, which does not count; on one plant to
    # another share.
    errors = np.ones((3, 3, 5))
    errors[-1, :, 1:] = 0.05
    errors[-1, 2, 1] = share
    own = {"laws": [law] * 3, "variants": [(0.01, 1.0, 1, 1000, 0)], "long_runs": errors}
    tracked = made["tracking"].items()
    own["tracking"] = {
        name: {"newton": {**by["newton"], "backward_ratio": share}} for name, by in tracked
    }
    judged = [each for _, each in report.judge_claims({**made, **own}).values()]
    assert judged == [False, True, True, holds, True, True, True, holds, True]


def test_command_prints_every_published_number(made, monkeypatch, capsys, tmp_path, refused):
    monkeypatch.setattr(report, "compute", lambda: made)
    monkeypatch.setattr(figures, "FIGURES", {"one": lambda: drawing.new_figure(1.0)})
    folder = tmp_path / "new" / "figures"
    assert paper.main(["--figures", str(folder)]) == 0
    text = capsys.readouterr().out
    assert text.endswith(f"\n2 files drawn to {folder}\n")
    assert {path.name for path in folder.iterdir()} == {"one.png", "one.svg"}
    numbers = [*published.PROPOSED.values(), *published.EPC.values(), *published.BASE_PARAMETERS]
    numbers += [
        published.SWING_DIFFERENCE,
        published.ADAPTIVE_PEAK_VELOCITY,
        published.NATURAL_FREQUENCY,
    ]
    printed = "7.8 68.75 0.642 0.5367 11.0 85.85 0.629 0.6246 "
    printed += "0.01424 0.0414 0.36 0.0923 0.40527 0.0414 0.638 0.01 0.0414 17.1 7.9 5.7184"
    for number, shown in zip(numbers, printed.split(), strict=True):
        assert any(number.quantity in line and f" {shown} " in line for line in text.splitlines())
    for kind, choose, quantity in (("largest", max, "error_rms"), ("smallest", min, "mean_speed")):
        for law, line in zip(
            made["laws"], re.findall(f".*the {kind} {quantity}.*", text), strict=True
        ):
            assert f" {choose(run[quantity] for run in law.runs):.4g}" in line
    words = " ".join(text.split())
    assert all(
        each in words
        for each in (*made["claims"], "in the cycles (1, 60, 600)", "leaves open on 24 to 24")
    )
    # Every fastest profile is limited by a demand, but not by one that it need not satisfy.
    for optimum in made["optimal_profiles"]:
        binding = report.optimum_row(optimum)["binding"]
        assert binding and not (
            "without Principle 4" in optimum.problem.label and "principle_4_force" in binding
        )
    (tmp_path / "file").touch()
    refused(paper.main, ["--figures", str(tmp_path / "file")])


# What a panel shows, by the label of its axis.
QUANTITIES = {
    "rate θ' (rad/s)": lambda run: run.theta_dot,
    "angle θ (deg)": lambda run: np.degrees(run.theta),
    "displacement x (cm)": lambda run: 100.0 * run.x,
    "torque u (N m)": lambda run: run.torque,
    r"angle error $\theta - \theta_d$ (mrad)": lambda run: 1e3 * (run.theta - run.reference[:, 0]),
    r"rate error $\dot\theta - \dot\theta_d$ (mrad/s)": lambda run: (
        1e3 * (run.theta_dot - run.reference[:, 1])
    ),
    r"$\delta_\theta$ (mrad/s)": lambda run: 1e3 * sliding(run)[0],
}
# Heights of lines at published numbers, and the number of the table that a figure shows for both
# profiles.
STATED = {
    "fig3_tracking": {7.8, 11.0, 68.75, 85.85},
    "fig5_torque": {0.5367, -0.5367, 0.6246, -0.6246},
    "fig6_adaptive_tracking": {7.9},
    "fig8_adaptive_torque": {0.5367},
}
TABLE = {
    "fig3_tracking": "peak_velocity",
    "fig4_displacement": "mean_speed",
    "fig5_torque": "peak_torque",
}


@pytest.mark.parametrize("name", figures.FIGURES)
def test_curves_are_the_runs_in_the_units_of_their_axes_as_on_the_page(name, made, tmp_path):
    profiles = dict(
        zip(
            (drawing.PENS[each]["color"] for each in published.RUNS),
            figures.profile_runs(),
            strict=True,
        )
    )
    laws = [
        dict(zip(figures.PLANT_COLOURS, runs, strict=True))
        for runs in figures.adaptive_runs().values()
    ]
    with drawing.style():
        figure = figures.FIGURES[name]()
        drawing.save(figure, tmp_path / name)
    drawn, shown = (
        matplotlib.image.imread(each / f"{name}.png")
        for each in (tmp_path, ROOT / "docs" / "figures")
    )
    assert not PINNED or (
        drawn.shape == shown.shape and (np.abs(drawn - shown) > 0.2).mean() < 1e-5
    )
    columns, heights = 1 if name == "fig4_displacement" else 2, set()
    for n, axes in enumerate(figure.axes):
        quantity = QUANTITIES[figure.axes[n - n % columns].get_ylabel()]
        runs = profiles if name[3] in "345" else laws[n % columns]
        (start, end), (low, high) = axes.get_xlim(), axes.get_ylim()
        seen = []
        for line in (each for each in axes.lines if len(each.get_xdata())):
            x, y = line.get_xydata().T
            if len(x) > 2 and line.get_color() in runs:
                run = runs[line.get_color()]
                np.testing.assert_allclose(
                    y, quantity(run)[np.searchsorted(run.t, x - 1e-9)], atol=1e-9
                )
                assert x[0] < start + 2e-3 and x[-1] >= min(end, run.t[-1]) - 1e-9
                seen.append(line.get_color())
            elif len(x) == 2 and y[0] == y[1]:
                heights.add(y[0])
            shown = y[(x >= start) & (x <= end)] if len(x) > 2 else y
            assert len(x) == 1 or low <= shown.min() <= shown.max() <= high
        # In Figure 5, every profile has a row of its own.
        assert seen == ([[*runs][n // 2]] if name == "fig5_torque" else [*runs])
    assert heights == STATED.get(name, set())
    if name in TABLE:
        key, digits = TABLE[name], 2 if name == "fig3_tracking" else 3
        for profile, numbers in published.RUNS.items():
            found = made["tracking"][profile]["newton"][key]
            assert f"{numbers[key].value:g}" in text_of(
                figure
            ) and f"{found:.{digits}f}" in text_of(figure)
    else:
        assert f" {max(np.abs(quantity(run)).max() for run in runs.values()):.3g}" in text_of(
            figure
        )
        assert "1 of 3 runs loses contact with the floor, at 0.10 s" in text_of(figure)
    assert all(axes.get_xlabel().startswith("time") for axes in figure.axes[-columns:])
