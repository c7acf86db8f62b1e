"""Gaits for the tests."""

from baselines.gaits.archive import Gait
from baselines.gaits.families import FAMILIES


def some_gait(mean_speed=10.0, cost_of_transport=3.0, M=0.5, mu=0.01, family="harmonics", worst_speed=None):
    """A gait that nobody has found, with numbers that nobody has measured."""
    return Gait(
        M=M,
        mu=mu,
        family=family,
        parameters=FAMILIES[family].start,
        mean_speed=mean_speed,
        cost_of_transport=cost_of_transport,
        sensitivity=1e-3,
        seed=(0, 0),
        evaluations=1,
        seconds=1.0,
        command="test",
        worst_speed=worst_speed,
    )
