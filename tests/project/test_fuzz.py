"""The fuzzing of `tests/fuzz`: each kind of failure is recognised, and nothing else."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, CapsuleVectorEnv
from capsule_gym.simulation import Simulation
from tests.fuzz import values
from tests.fuzz.__main__ import fuzz, main
from tests.fuzz.cases import Case, run


@pytest.fixture(autouse=True)
def one_kernel(monkeypatch) -> None:
    # Compiled for other tests as well.
    for pool in (values.ARGUMENTS, values.BATCH_ARGUMENTS):
        monkeypatch.setitem(pool, "controller", lambda rng: None)
        monkeypatch.setitem(pool, "capsule", lambda rng: None)


def first_failure() -> str:
    return next(failure for _, failure in map(run, range(100)) if failure is not None)


def test_sound_cases_pass() -> None:
    assert [run(number)[1] for number in range(40)] == [None] * 40


@pytest.mark.parametrize("kind", [CapsuleEnv, CapsuleVectorEnv])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda result: (result[0], result[1] * math.nan, *result[2:]), "BrokenError: the reward is not finite"),
        (lambda result: (result[0] + 1e3, *result[1:]), "BrokenError: the observation .* lies outside"),
        (lambda result: (*result[:4], {**result[4], "mu": result[4]["mu"] * math.inf}), r"info\['mu'\] is not finite"),
        (lambda result: (*result[:4], {**result[4], "mu": 0.5 < result[4]["mu"]}), "BrokenError: the info's layout"),
        (lambda result: result[5], "IndexError: "),
        (lambda result: float("x"), "ValueError that names none of .*'action'"),
    ],
)
def test_a_wrong_result_is_recognised(kind, change, words, monkeypatch) -> None:
    step = kind.step
    monkeypatch.setattr(kind, "step", lambda self, actions: change(step(self, actions)))
    assert re.search(words, first_failure(), re.DOTALL)


def test_a_wrong_metric_and_a_wrong_copy_are_recognised(monkeypatch) -> None:
    metrics, state = Simulation.metrics, Simulation.__getstate__
    with monkeypatch.context() as patch:
        patch.setattr(Simulation, "metrics", lambda *args: metrics(*args) | {"cost_of_transport": np.full(99, -np.inf)})
        assert "['cost_of_transport'] is not finite" in first_failure()
    monkeypatch.setattr(Simulation, "__getstate__", lambda self: state(self) | {"world": 0.9 * self.world})
    monkeypatch.setattr(Case, "chance", lambda self, probability: self.rng.random() < max(probability, 0.05))
    assert "a copy gives other results than its original" in first_failure()


# A case of each kind.
BREAKS = """
import os, time

def run(number):
    if number == 3:
        os.abort()
    if number == 5:
        time.sleep(600.0)
    return 1, "wrong" if number == 7 else None
"""


def test_an_end_of_the_interpreter_and_a_hang_are_recognised(tmp_path, monkeypatch) -> None:
    (tmp_path / "breaks.py").write_text(BREAKS, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    cases, steps, failures = fuzz(1, 2, 6, module="breaks", hang_seconds=4.0)
    assert failures == {3: "ends the interpreter (exit status -6)", 5: "hangs", 7: "wrong"}
    assert (cases, steps) == (6, 6)


def test_one_case_is_run_again(monkeypatch, capsys) -> None:
    assert main(["--replay", "0"]) == 0
    assert "nothing broke" in capsys.readouterr().out
    monkeypatch.setattr(CapsuleEnv, "reset", lambda self, **_: [][0])
    monkeypatch.setattr(CapsuleVectorEnv, "reset", lambda self, **_: [][0])
    with pytest.raises(IndexError):
        main(["--replay", "0"])
