"""Results that several modules test, computed once."""

from __future__ import annotations

import pytest

from baselines.paper.adaptive import study_law
from baselines.paper.proofs import check_proof_2
from capsule_gym.task import TORQUE_LIMIT


@pytest.fixture(scope="session")
def laws():
    """The adaptive law over the ranges: regularised; corrected, unregularised; the latter with a torque limit."""
    return [study_law(True), study_law(False), study_law(False, TORQUE_LIMIT)]


@pytest.fixture(scope="session")
def rates():
    """Proof 2 for both profiles."""
    return check_proof_2()
