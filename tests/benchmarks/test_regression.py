"""The guards: how a ratio is taken, measured again and judged. Nothing here measures a time."""

from __future__ import annotations

import math
import re
from itertools import chain, repeat
from pathlib import Path

import pytest

from benchmarks import ratios, regression
from benchmarks.ratios import Guard, Turn, beyond

ROOT = Path(__file__).resolve().parents[2]


def turn(*seconds: float) -> Turn:
    """A turn of ten steps that takes these seconds one after the other, the last for ever."""
    times = chain(seconds, repeat(seconds[-1]))
    return lambda: (next(times), 10)


def test_the_ratio_is_that_of_the_rates_and_its_median_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ratios, "TURNS", 3)
    assert Guard("", None, turn(1.0), turn(4.0)).measure() == 4.0
    assert Guard("", None, turn(1.0, 100.0, 2.0), turn(4.0)).measure() == 2.0


def test_a_ratio_below_its_floor_is_measured_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ratios, "TURNS", 1)
    disturbed = Guard("disturbed", 3.0, turn(2.0, 2.0, 1.0), turn(4.0))
    assert disturbed.best() == 4.0
    slow = Guard("slow", 3.0, turn(2.0), turn(4.0))
    assert slow.best() == 2.0 and slow.misses(2.0)
    assert slow.row(2.0) == ["slow", "2.00", "3", "below its floor"]
    assert not Guard("shown", None, turn(2.0), turn(4.0)).misses(0.0)


def test_what_is_beyond_the_physics_is_the_law_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ratios, "TURNS", 1)
    physics = turn(3.0)
    assert Guard("", None, beyond(turn(5.0), physics), physics).measure() == 1.5
    # Noise may make the law seem to take no time at all, which is no reason to fail.
    assert Guard("", 1.0, beyond(turn(3.0), physics), physics).measure() == math.inf


def test_the_command_fails_where_a_ratio_is_below_its_floor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(ratios, "TURNS", 1)
    good, bad = Guard("good", 1.0, turn(1.0), turn(4.0)), Guard("bad", 5.0, turn(1.0), turn(4.0))
    for found, status in (([good], 0), ([good, bad], 1)):
        monkeypatch.setattr(ratios, "guards", lambda found=found: found)
        assert regression.main(["--markdown", str(tmp_path / "ratios.md")]) == status
        assert ("below its floor" in capsys.readouterr().out) == bool(status)
    assert "below its floor" in (tmp_path / "ratios.md").read_text(encoding="utf-8")


def test_the_page_shows_the_guards_and_their_floors(monkeypatch: pytest.MonkeyPatch) -> None:
    # The guards without what they measure.
    measured = ("ours", "one_at_a_time", "whole_steps", "resets", "episodes_in_one_call", "episodes_with_torch")
    for name in measured:
        monkeypatch.setattr(ratios, name, lambda *_, **__: turn(1.0))
    monkeypatch.setattr(ratios, "available_cores", lambda: 2)
    page = (ROOT / "docs" / "speed_ratios.md").read_text(encoding="utf-8")
    lines = [[cell.strip() for cell in line.strip("| ").split("|")] for line in page.splitlines() if "|" in line][2:]
    assert [(line[0], line[2] if len(line) > 2 else "") for line in lines] == [
        (guard.name, "" if guard.floor is None else f"{guard.floor:g}") for guard in ratios.guards()
    ]
    assert all(re.fullmatch(r"\d+\.\d\d", line[1]) for line in lines)
