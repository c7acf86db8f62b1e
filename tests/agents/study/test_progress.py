"""The table: what it reads out of logs that are being written, and what it says."""

import io
import time

import pytest

from agents.study import progress
from agents.study.progress import Meter, Progress, last_row
from agents.training.stopping import Stop
from tests.agents.study.small import job


@pytest.mark.parametrize(
    ("content", "row"),
    [
        ("", {}),
        ("a,b", {}),
        ("a,b\n", {}),
        ("a,b\n1,2\n", {"a": "1", "b": "2"}),
        ("a,b\n1,2\n3,", {"a": "1", "b": "2"}),
        ("a,b\n1,2\n3,4\n", {"a": "3", "b": "4"}),
        ("a,b\n" + "1,2\n" * 10_000 + '"3",4\n', {"a": "3", "b": "4"}),
        ("a,b\n1,2,3\n", {}),
    ],
)
def test_the_last_whole_line_of_a_table(tmp_path, content, row):
    assert last_row(tmp_path / "none.csv") == {}
    path = tmp_path / "table.csv"
    path.write_text(content)
    assert last_row(path) == row


def log(job, *lines: str) -> None:
    folder = job.run / "logs"
    folder.mkdir(parents=True, exist_ok=True)
    header = "time/total_timesteps,episodes/mean_speed,episodes/failed"
    (folder / "progress.csv").write_text("\n".join([header, *lines, ""]))


def test_a_meter_counts_from_where_the_study_found_the_run(tmp_path, monkeypatch):
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    tiny = job(tmp_path, total_steps=10_000)
    meter = Meter(tiny)
    meter.look()
    assert (meter.steps, meter.rate, meter.left) == (0, None, 10_000)
    log(tiny, "4000,,")
    meter.look()
    assert (meter.steps, meter.rate, meter.mean_speed) == (4000, None, None)
    now = 110.0
    meter.look()
    assert meter.rate is None
    log(tiny, "4000,,", "6000,1.25,0.5")
    meter.look()
    assert (meter.steps, meter.rate, meter.left) == (6000, 200.0, 4000)
    assert (meter.mean_speed, meter.failed) == (1.25, 0.5)


def test_the_table_says_how_fast_how_good_and_how_long(tmp_path, monkeypatch):
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    jobs = [job(tmp_path, seed, total_steps=10_000) for seed in range(3)]
    shown = Progress(jobs, 4, 2, Stop(), tmp_path / "stop", io.StringIO())
    assert shown.text() == "4 of 7 runs finished, 0 in training"
    for seconds, steps in ((1.0, 1000), (11.0, 3000)):
        now = seconds
        for each in jobs[:2]:
            log(each, f"{steps},12.345,0.01")
            shown.meters[each].look()
    *_, first, second, line = shown.text().splitlines()
    assert first.split() == ["tiny/seed-0", "3,000", "10,000", "200", "35", "s", "12.35", "1.0%"]
    assert second.split()[0] == "tiny/seed-1"
    # 7000 steps of two runs and 10,000 of a third, at 200 a second in two places.
    assert line == "4 of 7 runs finished, 2 in training, about 60 s left"


def test_the_users_wish_to_stop_becomes_the_file_that_runs_look_for(tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "IN_FILE", 0.0)
    stop, file, stream = Stop(), tmp_path / "stop", io.StringIO()
    with Progress([job(tmp_path)], 0, 1, stop, file, stream):
        assert not file.exists()
        stop.requested = True
        deadline = time.monotonic() + 10.0
        while not file.exists():
            assert time.monotonic() < deadline
            time.sleep(0.01)
    assert "0 of 1 runs finished" in stream.getvalue()
