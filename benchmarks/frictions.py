"""The ways in which MuJoCo is asked to model the floor. MuJoCo itself is imported by `mujoco_capsule` alone."""

from __future__ import annotations

from dataclasses import dataclass

INTEGRATORS = ("implicitfast", "RK4")


@dataclass(frozen=True)
class Friction:
    """One of MuJoCo's ways to model the floor.

    Attributes:
        name: for tables.
        contact: a sphere on a plane, elliptic cone, whose normal force acts; else the constant mu (M + m) g on the
            joint x (`frictionloss`).
        stiff: constraints as stiff as MuJoCo allows at the step; else its default solver parameters.
        noslip: with MuJoCo's no-slip solver after the main one.
    """

    name: str
    contact: bool
    stiff: bool = False
    noslip: bool = False


def series_name(friction: Friction, integrator: str) -> str:
    """The name of MuJoCo with that friction and integrator, for tables."""
    return f"MuJoCo {friction.name}, {integrator}"


FRICTIONLOSS = Friction("frictionloss", contact=False)
CONTACT = Friction("contact", contact=True)
STIFF_CONTACT = Friction("contact, stiff", contact=True, stiff=True)
FRICTIONS = (FRICTIONLOSS, CONTACT, STIFF_CONTACT)
# These hold a resting platform better, at the same error in motion: no friction of a joint knows the normal force.
HOLDING_FRICTIONS = (
    FRICTIONLOSS,
    Friction("frictionloss, stiff", contact=False, stiff=True),
    Friction("frictionloss, noslip", contact=False, noslip=True),
    CONTACT,
    STIFF_CONTACT,
)
