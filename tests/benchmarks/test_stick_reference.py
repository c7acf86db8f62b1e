"""The reference trajectories in the file: their method, this package, and their changes."""

import json
import re

import numpy as np
import pytest

from benchmarks.stick_reference import FILE, HOLD, STEPS, cases, error
from tests.project.test_pages import ROOT

PAGE = (ROOT / "docs/stick_reference.md").read_text(encoding="utf-8")
CASES = cases()


@pytest.fixture(scope="module")
def reference():
    with np.load(FILE, allow_pickle=False) as arrays:
        return dict(arrays)


def test_the_file_holds_the_trajectories_of_the_command(reference):
    assert reference["name"].tolist() == [case.name for case in CASES]
    assert reference["state"].shape == (len(CASES), STEPS + 1, 4)
    for case, plant, torque in zip(CASES, reference["plant"], reference["torque"], strict=True):
        assert json.loads(str(plant)) == vars(case.capsule)
        np.testing.assert_array_equal(torque, case.torque)


@pytest.mark.parametrize("number", [0, 16])
def test_a_trajectory_is_solved_again(number, reference):
    found = CASES[number].solve(100)
    np.testing.assert_allclose(found.states, reference["state"][number, :101], atol=1e-14)


def test_the_package_differs_by_what_the_page_says(reference):
    (bound,) = re.findall(r"differs from them by at most (\S+)\.", PAGE)
    differences = [
        error(case, states) for case, states in zip(CASES, reference["state"], strict=True)
    ]
    assert max(differences) <= float(bound)


def test_the_platform_rests_exactly_in_stick_and_nowhere_else(reference):
    times = HOLD * np.arange(STEPS + 1)
    for number, states in enumerate(reference["state"]):
        own = reference["phase_trajectory"] == number
        starts = reference["phase_start"][own]
        phases = reference["phase"][own]
        assert starts[0] == 0.0
        assert (np.diff(starts) > 0.0).all()
        assert (np.diff(phases) != 0).all()
        # At the start of a phase the velocity is still that of the phase before.
        inside = np.abs(times[:, None] - starts).min(axis=1) > 1e-9
        at = np.searchsorted(starts, times) - 1
        directions = np.sign(states[inside, 3])
        np.testing.assert_array_equal(directions, phases[at[inside]])
