"""The control laws; an entry of `LAWS` or `TASK_LAWS` makes a law a controller and a scripted policy."""

from importlib import import_module
from typing import Any, NamedTuple


class Law(NamedTuple):
    """The location, name and description of a control law.

    Attributes:
        module: module of this package that contains the function.
        policy: the name of the scripted policy, the law with a zero residual.
        description: description in one line.
        senses: the measurements that the law reads; "state" stands for theta, theta_dot and x_dot.
        told: its knowledge of the plant.
        task: name of the task of the law.
    """

    module: str
    policy: str
    description: str
    senses: str = "state"
    told: str = "nothing"
    task: str = "speed"


_ADAPTIVE = {"senses": "state, x", "told": "nominal plant"}
# Laws by the names of their functions: the environment's argument `controller` takes "baselines:NAME".
LAWS = {
    "feedback_linearising": Law(
        "feedback_linearisation",
        "feedback-linearising",
        "the paper's profile (9), feedback linearisation (35)",
        told="nominal plant",
    ),
    "adaptive": Law("adaptive", "adaptive", "the paper's profile (9), adaptive law (39), regularised", **_ADAPTIVE),
    "adaptive_as_published": Law(
        "adaptive",
        "adaptive-as-published",
        "the paper's profile (9), adaptive law (39), corrected, unregularised",
        **_ADAPTIVE,
    ),
    "adaptive_optimal_profile": Law(
        "adaptive",
        "adaptive-optimal-profile",
        "the fastest profile (9) with 1.5 N m, adaptive law (39), regularised",
        **_ADAPTIVE,
    ),
    "feedback_linearising_optimal_profile": Law(
        "feedback_linearisation",
        "feedback-linearising-optimal-profile",
        "the fastest profile (9) with 1.5 N m and without Principle 4, feedback linearisation (35)",
        told="nominal plant",
    ),
    "epc": Law("feedback_linearisation", "epc", "the EPC profile, feedback linearisation (35)", told="nominal plant"),
    "gait": Law(
        "gait",
        "gait-guarded",
        "a gait at 1 kHz that does not observe the plant; a guard of the contact estimates M",
        told="nominal pendulum",
    ),
    "gait_predictive": Law(
        "predictive",
        "gait-predictive",
        "gait-guarded on a state that an observer and a predictor of the latency give",
        told="nominal plant",
    ),
    "open_loop": Law(
        "periodic", "open-loop", "torque as a function of time alone, tuned without disturbances", senses="nothing"
    ),
    "open_loop_real": Law(
        "periodic", "open-loop-real", "torque as a function of time alone, tuned under disturbances", senses="nothing"
    ),
    "pd": Law(
        "periodic",
        "pd",
        "PD control of the pendulum's angle along a periodic reference",
        senses="theta, theta_dot",
    ),
    "oscillator": Law("periodic", "oscillator", "a Hopf oscillator that the state entrains"),
}
# Laws for one of the other tasks only.
TASK_LAWS = {
    "goal_pulses": Law(
        "pulses",
        "goal-pulses",
        "gait-guarded towards the goal, then pulses that adapt; strokes on smooth floors",
        task="goal",
    ),
    "velocity_pulses": Law(
        "pulses", "velocity-pulses", "gait-guarded after the target, and pulses that adapt", task="velocity"
    ),
}


def find_law(name: str) -> Any:
    """The function of a law, whose module is imported at the first use; an AttributeError if there is none."""
    law = LAWS.get(name) or TASK_LAWS.get(name)
    if law is None:
        raise AttributeError(f"module 'baselines' has no attribute {name!r}")
    return getattr(import_module(f"baselines.laws.{law.module}"), name)
