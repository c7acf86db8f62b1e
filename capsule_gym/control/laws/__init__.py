"""The control laws: functions that return a `Controller`."""

from collections.abc import Callable

from capsule_gym.control.controller import Controller
from capsule_gym.control.laws import adaptive, feedback_linearisation, gait, periodic

# Laws by the names of their functions: the environment's argument `controller` takes
# "baselines:NAME".
LAWS: dict[str, Callable[..., Controller]] = {
    law.__name__: law
    for law in (
        feedback_linearisation.feedback_linearising,
        feedback_linearisation.feedback_linearising_optimal_profile,
        feedback_linearisation.epc,
        adaptive.adaptive,
        adaptive.adaptive_as_published,
        adaptive.adaptive_optimal_profile,
        gait.gait,
        gait.gait_predictive,
        gait.goal_pulses,
        gait.velocity_pulses,
        periodic.open_loop,
        periodic.open_loop_real,
        periodic.pd,
        periodic.oscillator,
    )
}


def find_law(name: str) -> Callable[..., Controller]:
    """The function of a law; an AttributeError if there is none."""
    if name not in LAWS:
        raise AttributeError(f"module 'baselines' has no attribute {name!r}")
    return LAWS[name]
