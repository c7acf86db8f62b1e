"""The settings of the core's step that follow from the options of an environment.

They are namespaces with the names of `CAPSULE_SETTINGS` in `core/step/layout.hpp`, but for the constants of the plant.
"""

import math
from types import SimpleNamespace

import numpy as np

from capsule_gym.checks import require
from capsule_gym.control.controller import Controller, CoreLaw
from capsule_gym.envs.config import DIRECT_PHYSICS_DT, LAW_PHYSICS_DT, MOST_SUBSTEPS, EnvConfig
from capsule_gym.parameters import SENSORS, Capsule, Disturbances, Randomization
from capsule_gym.tasks.registry import find_task

DEFAULTS = EnvConfig()
SPEED = find_task(DEFAULTS.task)

# Replaces a missing controller.
NO_CONTROLLER = Controller("none", CoreLaw("none"), np.zeros((1, 2)))
# The half of the disc of this radius that lies to the left of the imaginary axis is in the region of stability of the
# classical Runge-Kutta method (Hairer and Wanner, Solving Ordinary Differential Equations II, Sect. IV.2).
STABLE = 2.6


def divide(name: str, whole: float, part_name: str, part: float) -> int:
    """The whole number of times that `part` fits into `whole`, both in seconds; a ValueError if it does not."""
    count = round(min(whole / part, 2.0 * MOST_SUBSTEPS))
    fits = 1 <= count <= MOST_SUBSTEPS and abs(count * part - whole) <= 1e-9 * whole
    require(fits, part_name, f"{name}={whole!r} s over a whole number, at most {MOST_SUBSTEPS}", part)
    return count


def check_step(capsule: Capsule, M: float, mu: float, settings: SimpleNamespace) -> None:
    """Raises a ValueError for a plant, with its M in kg and mu, that is too stiff for the integrator's step."""
    h, rate = settings.physics_dt, capsule.fastest_rate(M, mu)
    if rate * h <= STABLE:
        return
    held, longest = settings.physics_steps * h, STABLE / rate
    enough = held * rate / STABLE * (1.0 + 1e-9)
    fits = enough * settings.law_steps < MOST_SUBSTEPS
    would_do = f"physics_dt={held / math.ceil(enough)!r} would do" if fits else "no step would do"
    raise ValueError(
        f"physics_dt must be at most {longest:.4g} s for this capsule with M={M:.6g} kg and mu={mu:.6g}, whose fastest "
        f"rate is {rate:.4g} 1/s: beyond {STABLE} / rate the integrator is unstable; {would_do}, got {h!r} s"
    )


def make_settings(options: EnvConfig, controller: Controller | None) -> SimpleNamespace:
    """The settings of the step, with the values that follow from other options.

    Raises:
        ValueError: if the steps of the integrator, the law and the agent do not divide each other, or are too many.
    """
    torque_limit, physics_dt = options.torque_limit, options.physics_dt
    if physics_dt is None:
        physics_dt = LAW_PHYSICS_DT if controller else DIRECT_PHYSICS_DT
    named = Disturbances.named(options.disturbances)
    disturbed, reads = named or Disturbances(stick_threshold=0.0), named is not None
    # The plants differ in more than M and mu, or are disturbed.
    varied = reads or bool(Randomization.named(options.randomization).drawn)
    # A latency, and a motor's lag, need a shorter period than an agent's step.
    law_dt = controller.dt if controller else physics_dt if varied else options.control_dt
    accepted = f"at most {MOST_SUBSTEPS} times physics_dt={physics_dt!r} s"
    require(options.control_dt / physics_dt <= MOST_SUBSTEPS, "control_dt", accepted, options.control_dt)
    law_name, step_name = ("the law's step", "the controller's dt") if controller else ("control_dt", "physics_dt")
    return SimpleNamespace(
        torque_limit=torque_limit,
        residual_limit=torque_limit if options.residual_limit is None else options.residual_limit,
        total_torque=options.total_torque,
        physics_dt=physics_dt,
        physics_steps=divide(law_name, law_dt, "physics_dt", physics_dt),
        law_steps=divide("control_dt", options.control_dt, step_name, law_dt),
        energy_weight=options.energy_weight,
        termination_penalty=options.termination_penalty,
        with_reference=controller is not None,
        with_parameters=options.observe_parameters,
        with_estimates=options.observe_estimates,
        with_task=not options.goal_env,
        stack_size=options.stack_size,
        history=math.ceil(ends(disturbed.latency)[1] / law_dt) + 1 if reads else int(varied),
        law_reads=reads and controller is not None and disturbed.controls != "agent",
        agent_reads=reads and disturbed.controls != "law",
        with_x=disturbed.x_noise is not None,
        x_noise=disturbed.x_noise or 0.0,
        stick_threshold=disturbed.stick_threshold,
        **{f"with_{name}": name not in disturbed.unmeasured for name in SENSORS},
    )


def ends(value: float | tuple[float, float]) -> tuple[float, float]:
    """The ends of a range; a number is both ends of its range."""
    return value if isinstance(value, tuple) else (value, value)
