import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from baselines.gaits import __main__ as gait_search
from baselines.gaits import archive, performance, rounds, simulation
from baselines.gaits.__main__ import check
from baselines.gaits.archive import Archive, known_gaits
from baselines.gaits.families import FAMILIES
from baselines.gaits.rounds import PURPOSES, Search
from baselines.gaits.simulation import simulate
from capsule_gym import Capsule
from tests.baselines.gaits.fakes import some_gait

NOMINAL = Capsule()


@pytest.fixture
def quick(monkeypatch):
    """A search of seconds: two plants, short episodes, few candidates."""
    pytest.importorskip("cma")
    for name, value in (("RANDOM_STARTS", 8), ("SHORT_HORIZON", 1.0), ("HORIZON", 2.0)):
        monkeypatch.setattr(rounds, name, value)
    purposes = {name: replace(purpose, generations=2, restarts=1) for name, purpose in PURPOSES.items()}
    monkeypatch.setattr(rounds, "PURPOSES", purposes)
    monkeypatch.setattr(rounds, "robust_metrics", short_metrics)
    monkeypatch.setattr(rounds, "worst_speeds", lambda *args, **kwargs: short_metrics(*args, **kwargs)[0])
    return Archive(plants=((0.5, 0.01), (0.5, 0.1)))


def short_metrics(family, parameters, M, mu, *, threads):
    results = simulate(family, parameters, M, mu, horizon=1.0)
    speeds = np.where(results["failed"] > 0.0, -1.0, results["mean_speed"])
    return speeds, results["cost_of_transport"], np.zeros(len(speeds))


def test_a_search_finds_and_never_worsens(quick):
    lines, saved = [], []
    search = Search(quick, report=lines.append, command="test")
    search.run(rounds=15, save=lambda archive: saved.append(archive.to_json()))
    assert len(saved) == quick.rounds == 15
    assert len(quick.gaits) == 6
    assert len(quick.tolerant) == 6
    assert quick.evaluations > 0
    assert "round 0 (explore, harmonics): 2 entries better" in lines[0]
    history = [{(g["M"], g["mu"], g["family"]): g["mean_speed"] for g in json.loads(text)["gaits"]} for text in saved]
    for before, after in pairwise(history):
        assert all(after[key] >= speed for key, speed in before.items())
    unbeatable = some_gait(1000.0)
    quick.offer(unbeatable)
    Search(quick, report=lines.append).run(rounds=3, save=lambda archive: None)
    assert quick.table()[0.5, 0.01] is unbeatable


def test_an_interrupted_search_keeps_what_it_has_and_goes_on(quick, monkeypatch):
    def interrupted_after(calls):
        search = Search(quick, report=lambda line: None)
        scores = search._scores

        def count(*args):
            nonlocal calls
            calls -= 1
            if calls < 0:
                raise KeyboardInterrupt
            return scores(*args)

        monkeypatch.setattr(search, "_scores", count)
        return search

    saved = []
    # Interrupted while it looks for its starts: nothing found, nothing lost.
    assert interrupted_after(0).run(rounds=5, save=saved.append)
    assert (len(saved), quick.rounds, quick.gaits) == (1, 1, [])
    # Interrupted within the generations of round 1: their candidates count.
    interrupted_after(2).run(rounds=5, save=saved.append)
    assert (len(saved), quick.rounds) == (2, 2)
    assert quick.evaluations > 0
    assert {g.family for g in quick.gaits} == {"bang-bang"}
    assert {g.seed for g in quick.gaits} == {(0, 1)}
    assert not Search(quick, report=lambda line: None).run(rounds=1, save=saved.append)
    assert (len(saved), quick.rounds) == (3, 3)


def test_command_line(quick, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(
        simulation, "choose", lambda library, threads: performance.Choice((0.5,), (0.01,), ((library[0],),))
    )
    common = ["--folder", str(tmp_path), "--threads", "1"]
    assert gait_search.main([*common, "--oracle"]) == 1
    assert gait_search.main([*common, "--rounds", "1", "--families", "bang-bang", "--seed", "7"]) == 0
    output = capsys.readouterr().out
    assert "holds no gait" in output
    assert "searched for " in output
    first = archive.load_archive(tmp_path)
    assert {gait.seed for gait in first.gaits} == {(7, 0)}
    assert "--seed 7 --families bang-bang" in first.gaits[0].command
    assert json.loads((tmp_path / "oracle.json").read_text())["choice"] == [[0]]
    # The next call goes on with the next round; an interrupted one leaves the map alone.
    (tmp_path / "oracle.json").unlink()
    monkeypatch.setattr(Search, "_evolve", interrupt)
    assert gait_search.main([*common, "--families", "bang-bang"]) == 130
    assert archive.load_archive(tmp_path).rounds == 2
    assert not (tmp_path / "oracle.json").exists()
    for option, value in (("--minutes", "0"), ("--threads", "0"), ("--families", "hop"), ("--purposes", "win")):
        with pytest.raises(SystemExit):
            gait_search.main([option, value])
        assert f"{option} must be" in capsys.readouterr().err


def interrupt(*args):
    raise KeyboardInterrupt


def test_the_same_seed_gives_the_same_search(quick):
    runs = [Search(Archive(plants=quick.plants), report=lambda line: None) for _ in range(2)]
    for search in runs:
        search.run(rounds=1, save=lambda archive: None)
    first, second = ([(g.parameters, g.mean_speed) for g in search.archive.gaits] for search in runs)
    assert first == second


def test_check_names_what_differs():
    gait = known_gaits().of_plant(NOMINAL.M, NOMINAL.mu)[0]
    wrong = replace(gait, mean_speed=gait.mean_speed * 1.1)
    assert check(Archive(gaits=[gait], front=[gait]), 1) == []
    (line,) = check(Archive(gaits=[wrong]), 1)
    assert line.startswith(f"{gait.family} at M=0.5, mu=0.01: mean_speed is ")


def test_failures_score_below_everything_and_better_late(quick):
    results = {
        "late_speed": np.array([5.0, 50.0, 50.0]),
        "cost_of_transport": np.array([3.0, 3.0, np.inf]),
        "mean_speed": np.array([5.0, 5.0, 5.0]),
        "failed": np.array([0.0, 1.0, 1.0]),
        "duration": np.array([10.0, 9.0, 1.0]),
    }
    scores = rounds.score(results, 10.0)
    assert scores[0] == 5.0 > scores[1] > scores[2]
    # On the front transport counts, and missing the asked speed costs more.
    asked = rounds.score(results, 10.0, np.array([6.0, 5.0, 5.0]))
    assert asked[0] == -3.0 - rounds.FRONT_PENALTY
    assert asked[1] > asked[2]


def test_the_help_names_families_and_purposes(capsys):
    with pytest.raises(SystemExit):
        gait_search.main(["--help"])
    text = capsys.readouterr().out
    assert all(name in text for name in (*FAMILIES, *PURPOSES))
