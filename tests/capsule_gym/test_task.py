"""Properties that all tasks share: termination, bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from capsule_gym import task


@pytest.mark.parametrize(
    ("theta", "normal_force", "ends"),
    [
        (0.0, 5.0, task.Termination.none),
        (np.nextafter(math.pi / 2, 0.0), 5.0, task.Termination.none),
        (math.pi / 2, 5.0, task.Termination.pendulum),
        (-math.pi / 2, 5.0, task.Termination.pendulum),
        (0.0, np.nextafter(0.0, 1.0), task.Termination.none),
        (0.0, 0.0, task.Termination.contact),
        (math.pi / 2, 0.0, task.Termination.pendulum),
    ],
)
def test_termination_is_at_the_limit_itself(theta, normal_force, ends):
    assert task.termination(theta, normal_force) == ends
    assert task.continues(theta, normal_force) == (ends == task.Termination.none)


@pytest.mark.parametrize(("theta", "normal_force"), [(math.nan, 5.0), (math.inf, 5.0), (0.0, math.nan)])
def test_what_is_no_number_does_not_continue(theta, normal_force):
    assert not task.continues(theta, normal_force)


@pytest.mark.parametrize(
    ("theta_dot", "x_dot", "resolved"),
    [(-1e3, 1e3, True), (1e4, 0.0, True), (0.0, -1.1e4, False), (6e3, 6e3, False), (math.nan, 0.0, False)],
)
def test_rates_that_no_step_resolves_are_not_bounded(theta_dot, x_dot, resolved):
    assert task.bounded(theta_dot, x_dot) is resolved
