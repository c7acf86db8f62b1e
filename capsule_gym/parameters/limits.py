"""Limits of the plant's constants, of time steps and of numbers by which the core divides."""

from capsule_gym.checks import require

# Range of a plant's constants, in SI units, within which every force and acceleration is finite.
SMALLEST, LARGEST = 1e-12, 1e12
# s. Beyond this range, rounding would keep steps from dividing each other.
SHORTEST_STEP, LONGEST_STEP = 1e-9, 1e6

# Numbers by which the core divides where they are not 0.
DIVISORS = (
    "stribeck_speed",
    "lag",
    "torque_resolution",
    "theta_resolution",
    "theta_dot_resolution",
    "x_dot_resolution",
)


def check_divisor(field: str, name: str, number: float) -> float:
    """Returns the value of a field, or raises a ValueError if a quotient by it might overflow."""
    overflows = field in DIVISORS and 0.0 < number < SMALLEST
    require(not overflows, name, f"0 or at least {SMALLEST:g}", number)
    return number
