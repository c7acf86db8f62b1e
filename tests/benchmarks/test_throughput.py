"""Contenders, their turns and what is written of them: nothing here measures a time."""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from benchmarks import contenders, cost, creep, speed_tables, throughput
from benchmarks.frictions import CONTACT, series_name
from benchmarks.output import written_by
from benchmarks.timing import Contender, Rate, Stepper, measure, present

ABSENT = "a_package_that_nobody_has"


def rate(value: float, reset_seconds: float | None = None) -> Rate:
    return Rate(value, 0.9 * value, 1.1 * value, reset_seconds)


def make_stepper(log: list[str], name: str) -> Stepper:
    return Stepper(lambda count: log.append(f"{name} {count}"), lambda: log.append(f"{name} closed"))


def contender(label: str, peer: str | None = None, **kwargs: Any) -> Contender:
    return Contender(label, partial(make_stepper, [], label), peer=peer, **kwargs)


def test_rate_holds_the_quartiles_of_the_turns() -> None:
    found = Rate.of([5.0, 1.0, 3.0, 2.0, 4.0])
    assert (found.low, found.median, found.high) == (2.0, 3.0, 4.0)
    assert found.spread == pytest.approx(2.0 / 3.0)
    assert Rate.of([7.0]) == Rate(7.0, 7.0, 7.0)


def test_contenders_take_turns_and_are_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.timing.CALIBRATION_SECONDS", 0.0)
    log: list[str] = []
    rivals = [Contender(name, partial(make_stepper, log, name)) for name in "ab"]
    rates = measure(rivals, 3, 0.0, "test")
    assert [entry[0] for entry in log[-8:]] == ["a", "b"] * 4
    assert log[-2:] == ["a closed", "b closed"]
    assert set(rates) == {"a", "b"}


def test_a_contender_that_cannot_be_measured_is_named_with_the_reason() -> None:
    everything = [contender("here"), contender("gone", packages=(ABSENT,)), contender("wide", threads=2)]
    found, lines = present(everything, cores=1)
    assert [one.label for one in found] == ["here"]
    assert len(lines) == 2
    assert "capsule-gym[bench]" in lines[0] and ABSENT in lines[0] and "gone" in lines[0]
    assert "2 threads" in lines[1] and "wide" in lines[1]


def test_every_ratio_is_to_a_contender_of_another_name() -> None:
    everything = [*contenders.ours(large=True), *contenders.peers()]
    names = [one.name for one in everything]
    assert len(set(names)) == len(names)
    assert {one.peer for one in everything if one.peer} <= set(names)
    assert all(one.peer for one in contenders.ours(large=True))


def test_the_table_has_a_ratio_only_where_the_peer_was_measured() -> None:
    rivals = [contender("fast", "slow", substeps=10), contender("slow"), contender("lonely", "gone")]
    rows = speed_tables.rate_rows(rivals, {"fast": rate(3000.0), "slow": rate(1500.0), "lonely": rate(1.0)})
    header, *body = rows
    cells = {row[0]: dict(zip(header, row, strict=True)) for row in body}
    assert cells["fast"]["ratio"] == "2" and cells["fast"]["to"] == "slow"
    assert cells["fast"]["substeps/s"] == "30,000" and cells["fast"]["IQR"] == "20%"
    assert cells["lonely"]["ratio"] == cells["lonely"]["to"] == cells["slow"]["ratio"] == ""


@pytest.mark.parametrize(
    ("ours", "own_errors", "holds"),
    [(100.0, (1e-8, 1e-8), True), (99.0, (1e-8, 1e-8), False), (1000.0, (1e-8, 3e-2), False)],
)
def test_the_claim_is_checked(ours: float, own_errors: tuple[float, ...], holds: bool) -> None:
    claim = cost.Claim("peer", 1, ours, 1.0, own_errors, (1e-2, 1e-2))
    assert claim.holds is holds
    assert cost.Claim("peer", 1, ours, 1.0, own_errors, own_errors).ratio == ours


def refuse(*arguments: str) -> None:
    with pytest.raises(SystemExit) as error:
        throughput.main(list(arguments))
    assert error.value.code == 2


def test_an_existing_file_of_numbers_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "numbers.json"
    path.write_text("{}", encoding="utf-8")
    refuse("--json", str(path))
    assert "new file" in capsys.readouterr().err
    assert path.read_text(encoding="utf-8") == "{}"
    refuse("--turns", "0")
    refuse("--figure", str(tmp_path / "chart.svg"))


def test_a_run_writes_tables_numbers_and_chart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    batch = contender(contenders.DIRECT_BATCH, contenders.SINGLE_PEER, environments=contenders.PEER_BATCH)
    peer = contenders.mujoco_contender(CONTACT, contenders.STEPPED_INTEGRATOR, throughput.DIRECT_PHYSICS_DT)
    peer = contender(peer.label, environments=peer.environments)
    gone = contender("a peer", packages=(ABSENT,))
    rates = {batch.name: rate(5e6, reset_seconds=0.1), peer.name: rate(1e4)}
    series = series_name(CONTACT, contenders.STEPPED_INTEGRATOR)
    points = [cost.Point(cost.OURS, 2e-3, 10.0, 0.1, (1e-8, 2e-8)), cost.Point(series, 2e-3, 5e3, 0.1, (1e-2, 2e-2))]
    creeps = {"capsule_gym": [creep.Creep(load, 0.0, 0.0) for load in creep.LOADS]}
    monkeypatch.setattr(contenders, "ours", lambda large: [batch])
    monkeypatch.setattr(contenders, "peers", lambda: [peer, gone])
    monkeypatch.setattr(throughput, "measure", lambda *_: rates)
    monkeypatch.setattr(cost, "measure_points", lambda *_: points)
    monkeypatch.setattr(creep, "table", lambda *_: creeps)
    numbers, page, chart = (tmp_path / name for name in ("numbers.json", "page.md", "chart.png"))
    assert throughput.main(["--json", str(numbers), "--markdown", str(page), "--figure", str(chart)]) == 0

    output = capsys.readouterr().out
    lines = page.read_text(encoding="utf-8").splitlines()
    assert lines[0] == written_by(throughput.COMMAND)
    for text in (output, "\n".join(lines)):
        assert "5,000,000" in text and "1.0e-02 / 2.0e-02" in text and ABSENT in text and "yes" in text
    content = json.loads(numbers.read_text(encoding="utf-8"))
    assert content["rates"][0]["reset_seconds"] == 0.1
    assert content["claims"][0]["ratio"] == 500.0 and content["claims"][0]["holds"] is True
    assert content["left_out"] and content["machine"]["cpu"] and "numba" in content["machine"]["versions"]
    assert chart.read_bytes().startswith(b"\x89PNG")


def test_without_mujoco_every_other_contender_remains(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.setitem(sys.modules, "envpool", None)
    found, lines = present([*contenders.ours(large=False), *contenders.peers()], cores=2)
    assert {one.label for one in found} >= {contenders.SINGLE_PEER, "Pendulum-v1", contenders.DIRECT_BATCH}
    assert not [one for one in found if one.packages]
    assert any("MuJoCo contact" in line for line in lines) and any("EnvPool" in line for line in lines)
