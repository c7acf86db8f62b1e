"""What the profile (9) is optimised for, and what an optimisation finds: `Problem` and `Solution`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from baselines.laws.profiles import Profile, seven_phases
from baselines.paper import published
from baselines.paper.exact_tracking import STANDSTILLS, Assessment, Demands, assess, published_bounds
from capsule_gym.parameters import Capsule, Plant

TORQUE_LIMITS = (0.54, 1.0, 1.5)


@dataclass(frozen=True)
class Problem:
    """One optimisation.

    Attributes:
        torque_limit: N m.
        plants: "nominal", or "ranges" for the worst plant of the paper's ranges.
        dropped: number of the principle that is left out, 0 for none.
        standstill: reading of Principle 4, a key of `STANDSTILLS`.
        free_start: whether the angle at the start is free; else it is the paper's -pi/3.
    """

    torque_limit: float
    plants: str = "nominal"
    dropped: int = 0
    standstill: str = "return"
    free_start: bool = False

    @property
    def label(self) -> str:
        """For tables and progress."""
        parts = [f"{self.torque_limit:g} N m", self.plants]
        parts += [f"without Principle {self.dropped}"] if self.dropped else []
        parts += [f"Principle 4: {self.standstill}"] if self.standstill != "return" else []
        parts += ["start free"] if self.free_start else []
        return ", ".join(parts)

    def demands(self) -> Demands:
        """Its constraints."""
        demands = Demands(self.torque_limit, *published_bounds(), True, STANDSTILLS[self.standstill])
        velocity_and_acceleration = {"v_theta": None, "a_theta": None}
        left_out: tuple[dict[str, Any], ...]
        left_out = ({}, {"theta_0": None}, velocity_and_acceleration, {"contact": False}, {"standstill": None})
        return replace(demands, **left_out[self.dropped])

    def plant_list(self) -> list[Plant]:
        """The plants that it is judged on."""
        capsule = Capsule()
        if self.plants == "nominal":
            return [capsule.plant()]
        # Speed and demands are monotonic enough for the corners; a test looks between them.
        return [capsule.plant(M, mu) for M in published.M_RANGE for mu in published.MU_RANGE]


@dataclass(frozen=True)
class Solution:
    """What a search found.

    Attributes:
        problem: what was asked.
        times: t1 to t7, s.
        V1: rad/s.
        P2: rad/s.
        start: rad.
        feasible: whether it meets every demand; where not, it is the nearest that the search came.
        mean_speed: of the worst plant, m/s.
        cost_of_transport: of the worst plant; None where it gets nowhere.
        peak_torque: of the worst plant, N m.
        backward_ratio: distance backwards over forwards on the worst plant; None where it only moves backwards.
        shares: load over limit by demand, on the worst plant.
        found_by: the problem and the seed of the search that it comes from.
        evaluations: profiles that the problem's own search looked at.
        seconds: that it took.
    """

    problem: Problem
    times: tuple[float, ...]
    V1: float
    P2: float
    start: float
    feasible: bool
    mean_speed: float
    cost_of_transport: float | None
    peak_torque: float
    backward_ratio: float | None
    shares: dict[str, float]
    found_by: str = ""
    evaluations: int = 0
    seconds: float = 0.0

    @property
    def rank(self) -> tuple[float, float]:
        """Sorts solutions of one problem, the best first: by violations, then by speed."""
        excess = sum(max(0.0, share - 1.0) for share in self.shares.values())
        return (0.0 if self.feasible else excess), -self.mean_speed

    @property
    def profile(self) -> Profile:
        """The profile itself."""
        name = "optimal" if self.feasible else "infeasible"
        return replace(seven_phases(self.times, self.V1, self.P2, name), start=self.start)

    def assess(self) -> Assessment:
        """Judges it anew."""
        return assess(self.profile, self.problem.demands(), self.problem.plant_list())


def problems() -> list[Problem]:
    """All that the command solves, each after those whose solutions it can start from."""
    variants: list[dict[str, Any]] = [{}, *({"dropped": n} for n in (1, 2, 3, 4)), {"free_start": True}]
    variants += [{"standstill": "strict-return"}, {"plants": "ranges"}]
    # From -pi/3 the spring's torque alone, which (8) counts as a force, exceeds the static friction three times.
    variants += [{"standstill": "printed", "free_start": True}, {"standstill": "restoring"}]
    return [Problem(limit, **variant) for variant in variants for limit in TORQUE_LIMITS]
