"""The fuzzing of `tests/fuzz`: each kind of failure is recognised, and nothing else."""

from __future__ import annotations

import math
import os
import re
import time

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, CapsuleVectorEnv
from capsule_gym.command_line import parse
from capsule_gym.simulation import Simulation
from tests.fuzz import values
from tests.fuzz.__main__ import Options, main, replay
from tests.fuzz.cases import Case, run
from tests.fuzz.workers import fuzz


@pytest.fixture(autouse=True)
def one_kernel(monkeypatch):
    # Compiled for other tests as well.
    for pool in (values.ARGUMENTS, values.BATCH_ARGUMENTS):
        monkeypatch.setitem(pool, "controller", lambda rng: None)
        monkeypatch.setitem(pool, "capsule", lambda rng: None)


def found() -> str:
    """The first failure."""
    return next(failure for _, failure in map(run, range(100)) if failure is not None)


def test_sound_cases_pass():
    assert [run(number)[1] for number in range(40)] == [None] * 40


def without_mu(result):
    return (*result[:4], {name: value for name, value in result[4].items() if name != "mu"})


@pytest.mark.parametrize("kind", [CapsuleEnv, CapsuleVectorEnv])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda result: (result[0], result[1] * math.nan, *result[2:]), "BrokenError: the reward is not finite"),
        (lambda result: (result[0] + 1e3, *result[1:]), "BrokenError: the observation .* lies outside"),
        (lambda result: (result[0].astype(np.float64), *result[1:]), "BrokenError: the observation .* lies outside"),
        (lambda result: (*result[:4], {**result[4], "mu": result[4]["mu"] * math.inf}), r"info\['mu'\] is not finite"),
        (lambda result: (*result[:4], {**result[4], "mu": 0.5 < result[4]["mu"]}), "BrokenError: the info's layout"),
        (without_mu, "BrokenError: the info's layout changes"),
        (lambda result: result[5], "IndexError: "),
        (lambda result: float("x"), "ValueError that names none of .*'action'"),
    ],
)
def test_a_wrong_result_is_recognised(kind, change, words, monkeypatch):
    step = kind.step
    monkeypatch.setattr(kind, "step", lambda self, actions: change(step(self, actions)))
    assert re.search(words, found(), re.DOTALL)


def test_a_metric_and_the_end_of_another_episode_are_recognised(monkeypatch):
    metrics = Simulation.metrics
    # An episode that has failed moves nowhere, in the words of a metric that may be infinite.
    with monkeypatch.context() as patch:
        patch.setattr(Simulation, "metrics", lambda *args: metrics(*args) | {"cost_of_transport": np.full(99, -np.inf)})
        assert "['cost_of_transport'] is not finite" in found()
    step = CapsuleVectorEnv.step
    ended = {"final_obs": np.full(1, None), "_final_obs": np.zeros(1, np.bool_)}
    monkeypatch.setattr(CapsuleVectorEnv, "step", lambda *args: (*step(*args)[:4], step(*args)[4] | ended))
    assert "the info tells of an end where there was none" in found()


def test_a_copy_that_goes_another_way_is_recognised(monkeypatch):
    state = Simulation.__getstate__
    monkeypatch.setattr(Simulation, "__getstate__", lambda self: state(self) | {"world": 0.9 * self.world})
    monkeypatch.setattr(Case, "chance", lambda self, probability: self.rng.random() < max(probability, 0.05))
    assert "a copy goes another way than its original" in found()


def odd(number: int) -> tuple[int, str | None]:
    """A case of each kind."""
    if number == 1:
        os.abort()
    if number == 2:
        time.sleep(600.0)
    return 1, "wrong" if number == 3 else None


def test_an_end_of_the_interpreter_and_a_hang_are_recognised(capfd):
    told = []
    tally = fuzz(odd, 4, 1, hang_seconds=0.5, tell=lambda tally: told.append(tally.cases))
    assert tally.failures == {
        1: "ends the interpreter (exit status -6)",
        2: "hangs: no answer in 0.5 s",
        3: "wrong",
    }
    assert (tally.steps, tally.cases, told) == (4, 6, [1, 2, 3, 4, 5, 6])
    # Both say where they stand.
    assert capfd.readouterr().err.count("in odd") == 2


def broken(number: int) -> tuple[int, str | None]:
    return 1, "wrong"


def test_it_ends_where_too_much_is_broken():
    assert len(fuzz(broken, 10_000, 1).failures) == 100


def test_the_command_line(monkeypatch, capsys):
    assert parse(Options, "python -m tests.fuzz", ["--steps", "1e6"]).steps == 1_000_000
    with pytest.raises(SystemExit):
        main(["--jobs", "0"])
    assert replay(0) == 0
    assert main(["--steps", "10", "--jobs", "1"]) == 0
    assert "0 failures" in capsys.readouterr().out
    monkeypatch.setattr(CapsuleEnv, "reset", lambda self, **_: [][0])
    monkeypatch.setattr(CapsuleVectorEnv, "reset", lambda self, **_: [][0])
    assert replay(0) == 1
    assert "IndexError" in capsys.readouterr().err
