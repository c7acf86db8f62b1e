import re

import numpy as np
import pytest

from benchmarks import recurrent


@pytest.fixture(autouse=True)
def few_steps(monkeypatch):
    monkeypatch.setattr(recurrent, "STEPS", 4)


def test_contenders_do_the_same_work():
    found = {}
    for name, drive in recurrent.contenders().items():
        env, observations = recurrent.begin()
        # A second batch begins with a clear memory.
        drive(*recurrent.begin())
        drive(env, observations)
        found[name] = env.simulation.observations
    expected = found.pop(recurrent.CORE)
    np.testing.assert_allclose(found.pop("torch, float32"), expected, rtol=0.0, atol=1e-5)
    for name, observations in found.items():
        np.testing.assert_array_equal(observations, expected, err_msg=name)


def test_ratios_have_intervals(capsys):
    recurrent.main(["--turns", "2"])
    out = capsys.readouterr().out
    assert re.search(r"^core +\d+\.\d\d *$", out, re.MULTILINE)
    assert re.search(r"^torch, float32 +\d+\.\d\d +\d+\.\d\d \[.+, .+\]$", out, re.MULTILINE)
