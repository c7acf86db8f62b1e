"""The distribution from which every episode draws its plant, with its checks."""

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from capsule_gym.checks import check_flag, check_name, check_pair, require
from capsule_gym.parameters.capsule import CONSTANTS, NOMINAL, Capsule

# Limit of the exponential in the core.
LARGEST_RATIO = 1e300
Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Randomization:
    """Ranges (low, high) from which every episode draws its plant uniformly.

    None keeps the value of the `Capsule`, whose fields have the same names and units.

    Attributes:
        log_mu: draw log(mu) instead of mu uniformly.

    Raises:
        TypeError: if a range is not a pair of numbers.
        ValueError: if a range is not finite or not ordered, or contains values that are invalid for
            a `Capsule`.

    Examples:
        >>> heavy = Randomization(M=(0.8, 1.0), mu=(0.01, 0.1), log_mu=True)
        >>> print(heavy)
        M in [0.8, 1] kg, mu log-uniform in [0.01, 0.1]
    """

    M: Range | None = None
    mu: Range | None = None
    log_mu: bool = False
    m: Range | None = None
    l: Range | None = None
    g: Range | None = None
    k: Range | None = None
    c: Range | None = None
    static_ratio: Range | None = None
    backward_ratio: Range | None = None
    viscous: Range | None = None
    stribeck_speed: Range | None = None
    slope: Range | None = None
    motor_friction: Range | None = None

    def __post_init__(self) -> None:
        logarithmic = check_flag("Randomization.log_mu", self.log_mu)
        fits = self.mu is not None or not logarithmic
        require(fits, "Randomization.log_mu", "False without a range of mu", logarithmic)
        for name in ("M", "mu", *CONSTANTS):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, self._checked_range(name))

    def _checked_range(self, name: str) -> Range:
        """The range of a constant after its check."""
        value, whose = getattr(self, name), f"Randomization.{name}"
        logarithmic = name == "mu" and self.log_mu
        order = "low <= high"
        limits: dict[str, Any] = {}
        # A Stribeck speed of 0 means none: just above it the friction is as steep as can be.
        if logarithmic or name in ("M", "stribeck_speed"):
            order = "0 < low <= high"
            limits = {"low": 0.0, "open_low": True}
        elif name == "mu":
            order = "0 <= low <= high"
            limits = {"low": 0.0}
        accepted = f"a pair (low, high) of finite numbers with {order}"
        low, high = check_pair(whose, value, accepted, **limits)
        if logarithmic:
            accepted = f"within a factor of {LARGEST_RATIO:g} with log_mu"
            require(high / low <= LARGEST_RATIO, whose, accepted, value)
        return low, high

    @property
    def drawn(self) -> list[str]:
        """The names of `CONSTANTS` that have a range."""
        return [name for name in CONSTANTS if getattr(self, name) is not None]

    @classmethod
    def named(cls, name: "str | Randomization", argument: str = "randomization") -> "Randomization":
        """The `Randomization` of a name; a `Randomization` is returned unchanged."""
        if isinstance(name, cls):
            return name
        return RANDOMIZATIONS[check_name(argument, name, cls, RANDOMIZATIONS)]

    def corners(self, capsule: Capsule) -> list[Capsule]:
        """The capsules at the ends of all ranges, with the lightest platform and most friction.

        Both are the worst case of Painleve's condition and of the integrator's stability, and every
        other constant is at one end of its range.

        Raises:
            ValueError: if one of them, or the heaviest platform with the least friction, is
                invalid.
        """
        lightest, heaviest = self.M or (capsule.M, capsule.M)
        least, most = self.mu or (capsule.mu, capsule.mu)
        try:
            capsule.check_plant(heaviest, least)
            ranges = [getattr(self, name) for name in self.drawn]
            corners = [dict(zip(self.drawn, ends, strict=True)) for ends in product(*ranges)]
            return [replace(capsule, M=lightest, mu=most, **corner) for corner in corners]
        except ValueError as error:
            raise ValueError(f"Randomization({self}): {error}") from None

    def __str__(self) -> str:
        if self == Randomization():
            return "the capsule's own M and mu"
        mu = "mu log-uniform" if self.log_mu else "mu"
        texts = [
            f"M in {_interval(self.M)} kg" if self.M else "the capsule's own M",
            f"{mu} in {_interval(self.mu)}" if self.mu else "the capsule's own mu",
        ]
        texts += [f"{name} in {_interval(getattr(self, name))}" for name in self.drawn]
        return ", ".join(texts)


def _interval(ends: Range) -> str:
    low, high = ends
    return f"[{low:g}, {high:g}]"


# The constants that are hard to measure on a robot, within 10 % of the paper's.
_WITHIN_A_TENTH: dict[str, Any] = {
    name: (0.9 * getattr(NOMINAL, name), 1.1 * getattr(NOMINAL, name))
    for name in ("m", "l", "k", "c")
}
RANDOMIZATIONS = {
    "none": Randomization(),
    "paper": Randomization(M=(0.45, 0.55), mu=(0.009, 0.011)),
    "wide": Randomization(M=(0.35, 0.75), mu=(0.005, 0.3), log_mu=True),
    "broad": Randomization(M=(0.25, 1.2), mu=(0.002, 0.6), log_mu=True),
    "sticky": Randomization(M=(0.35, 0.75), mu=(0.2, 0.6)),
    "real": Randomization(M=(0.45, 0.55), mu=(0.009, 0.011), **_WITHIN_A_TENTH),
    "real-wide": Randomization(M=(0.35, 0.75), mu=(0.005, 0.3), log_mu=True, **_WITHIN_A_TENTH),
}
