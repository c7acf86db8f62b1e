"""The figures: all there, drawn, the same at every run, and in step with the numbers beside them."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest

from baselines import drawing
from baselines.laws.profiles import PROPOSED
from baselines.paper import published
from baselines.paper.figures.adaptive import draw_adaptive_error, draw_adaptive_tracking, run_adaptive, sliding_variable
from baselines.paper.figures.gallery import NAMES, SCHEMATICS, STUDIES, draw_all
from baselines.paper.figures.profiles import PROFILE_FIGURES, run_profiles
from baselines.paper.figures.studies import draw_principles
from baselines.paper.proofs import largest_rates

pytest.importorskip("matplotlib")
IMAGE = pytest.importorskip("PIL.Image")

SIGNATURES = {".svg": b"<?xml", ".png": b"\x89PNG"}


@pytest.fixture(scope="module")
def runs():
    return run_profiles()


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    directory = tmp_path_factory.mktemp("figures") / "made"
    told = []
    # Coarse pictures: what is drawn does not depend on the resolution, the time does.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drawing, "DPI", 60)
        files = draw_all(directory, told.append)
    return directory, files, told


def test_every_figure_comes_as_vector_and_as_picture(drawn):
    directory, files, told = drawn
    assert told == list(NAMES)
    assert sorted(files) == sorted(directory / f"{name}{suffix}" for name in NAMES for suffix in (".svg", ".png"))
    assert sorted(directory.iterdir()) == sorted(files), "temporary files are left"
    for path in files:
        content = path.read_bytes()
        assert content.startswith(SIGNATURES[path.suffix])
        assert len(content) < 400_000


def test_figures_one_to_nine_are_there():
    assert [name.split("_")[0] for name in sorted(NAMES) if name.startswith("fig")] == [f"fig{n}" for n in range(1, 10)]


def test_schematics_name_what_the_paper_names():
    with drawing.style():
        capsule, phases = (text_of(draw()) for draw in SCHEMATICS.values())
    for word in ("platform, M", "ball, m", "spring k and damper c", " l ", " x ", "θ", " u ", "m g", "N", "f, "):
        assert word in capsule
    for number in (*PROPOSED.times, PROPOSED.restoring_speed):
        assert f"{number:.3g}" in phases
    assert all(f"t{sign}" in phases for sign in "₀₁₂₃₄₅₆₇")
    assert all(f" {numeral} " in f" {phases} " for numeral in ("I", "II", "III", "IV", "V", "VI", "VII"))


def test_pictures_are_not_empty(drawn):
    _, files, _ = drawn
    for path in files:
        if path.suffix == ".png":
            pixels = np.asarray(IMAGE.open(path).convert("L"))
            assert min(pixels.shape) > 150
            # Something dark in every quarter, and paper around it.
            for part in (half for rows in np.array_split(pixels, 2) for half in np.array_split(rows, 2, axis=1)):
                assert part.min() < 128
            assert np.median(pixels) > 200


def test_drawing_again_gives_the_same_bytes(drawn, runs, tmp_path, monkeypatch):
    directory, _, _ = drawn
    monkeypatch.setattr(drawing, "DPI", 60)
    with drawing.style():
        for name, draw in {**{n: lambda d=d: d(runs) for n, d in PROFILE_FIGURES.items()}, **STUDIES}.items():
            if name in ("fig4_displacement", "phase_plane"):
                for path in drawing.save(draw(), tmp_path / name):
                    assert path.read_bytes() == (directory / path.name).read_bytes()


def test_files_carry_no_date_and_no_version(drawn):
    directory, _, _ = drawn
    text = (directory / "fig4_displacement.svg").read_text(encoding="utf-8")
    assert "<dc:date>" not in text
    assert b"Matplotlib version" not in (directory / "fig4_displacement.png").read_bytes()


def text_of(figure):
    """Everything written in a figure, one line."""
    from matplotlib.text import Text

    return " ".join(" ".join(text.get_text() for text in figure.findobj(Text)).split())


def test_notes_set_found_beside_published(runs):
    with drawing.style():
        texts = {name: text_of(draw(runs)) for name, draw in PROFILE_FIGURES.items()}
    assert sum("curves are not available as data" in text for text in texts.values()) == 3
    for name, key in (
        ("fig3_tracking", "peak_velocity"),
        ("fig4_displacement", "mean_speed"),
        ("fig5_torque", "peak_torque"),
    ):
        for numbers in (published.PROPOSED, published.EPC):
            assert f"{numbers[key].value:g}" in texts[name]
    assert f"{runs.proposed.metrics['mean_speed']:.3f}" in texts["fig4_displacement"]
    assert f"{runs.epc.metrics['peak_torque']:.3f}" in texts["fig5_torque"]


def test_both_forms_of_the_adaptive_law_are_what_they_are_called():
    adaptive_runs = run_adaptive()
    assert all(run.completed for run in adaptive_runs.regularised)
    # Nominal, light and heavy: unregularised, the law lifts the light platform off the floor in its first push.
    assert [run.completed for run in adaptive_runs.corrected] == [True, False, True]
    with drawing.style():
        tracking, errors = draw_adaptive_tracking(adaptive_runs), draw_adaptive_error(adaptive_runs)
    for figure in (tracking, errors):
        text = text_of(figure)
        assert "1 of 3 runs loses contact with the floor, at 0.10 s" in text
        assert "corrected, unregularised" in text and "curves are not available as data" in text
    # Five cycles, and the first swing in an inset.
    for axes in tracking.axes:
        assert axes.get_xlim()[1] == pytest.approx(33.0) and len(axes.child_axes) == 1
        assert axes.child_axes[0].get_xlim() == (0.0, 0.9)
    assert [axes.get_ylabel().split()[0] for axes in errors.axes if axes.get_ylabel()] == ["angle", "rate"]
    drawn = {line.get_label(): line.get_ydata() for line in errors.axes[2].lines}
    nominal = adaptive_runs.regularised[0]
    np.testing.assert_allclose(drawn["M = 0.5 kg, μ = 0.01"], 1e3 * (nominal.theta_dot - nominal.theta_d_dot))


def test_labels_name_their_units(runs):
    with drawing.style():
        figures = [draw(runs) for draw in PROFILE_FIGURES.values()]
    for figure in figures:
        labels = [axes.get_ylabel() for axes in figure.axes if axes.get_ylabel()]
        assert labels and all("(" in label for label in labels)
        assert any("(s)" in axes.get_xlabel() for axes in figure.axes)


def test_principles_note_gives_the_factors_of_the_restoring_stage():
    with drawing.style():
        text = text_of(draw_principles())
    assert "3.5 and 2.0 in its first phase, 0.35 and 0.40 in the others" in text


def test_sliding_variable_is_rate_error_plus_filtered_error(runs):
    run = runs.proposed
    expected = (run.theta_dot - run.theta_d_dot) + 12.0 * (run.theta - run.theta_d)
    np.testing.assert_allclose(sliding_variable(run), expected, atol=1e-15)


def test_house_style_leaves_the_users_settings_alone():
    import matplotlib

    with matplotlib.rc_context({"font.size": 31.0}):
        with drawing.style():
            assert matplotlib.rcParams["font.size"] == 8.0
        assert matplotlib.rcParams["font.size"] == 31.0


def test_failed_drawing_leaves_no_half_file(tmp_path, monkeypatch):
    with drawing.style():
        figure = drawing.new_figure(1.0)
        monkeypatch.setattr(figure, "savefig", lambda path, **_: (path.write_bytes(b"half"), 1 / 0))
        with pytest.raises(ZeroDivisionError):
            drawing.save(figure, tmp_path / "figure")
    assert list(tmp_path.iterdir()) == []


def test_missing_matplotlib_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r'pip install "capsule-gym\[paper\]"'):
        draw_all(tmp_path)


def test_bounds_in_the_phase_plane_are_rounded_up():
    proposed, epc = largest_rates()
    with drawing.style():
        text = text_of(STUDIES["phase_plane"]())
    found = re.search(r"below ([\d.]+) and ([\d.]+) rad/s, in any contact.* below ([\d.]+) and ([\d.]+) rad/s", text)
    bounds = (proposed.from_start, epc.from_start, proposed.bound, epc.bound)
    for printed, bound in zip(found.groups(), bounds, strict=True):
        assert bound <= float(printed) < bound + 0.001
