"""Results that several modules test, computed once."""

import pytest

from baselines.paper import adaptive
from capsule_gym.tasks.task import TORQUE_LIMIT


@pytest.fixture(scope="session")
def laws():
    """The adaptive law on 3 x 3 plants: regularised; corrected, unregularised; the latter with a
    torque limit."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(adaptive, "GRID", 3)
        regularised = adaptive.study_law(True)
        corrected = adaptive.study_law(False)
        limited = adaptive.study_law(False, TORQUE_LIMIT)
    return [regularised, corrected, limited]
