"""The result of an identification, without one."""

import numpy as np

from capsule_gym import Capsule, Disturbances, Fit

RANGES = {
    "M": (0.6, 0.62),
    "mu": (0.05, 0.06),
    "l": (0.31, 0.32),
    "motor_friction": (0.01, 0.02),
    "latency": (0.004, 0.006),
}


def make_fit():
    """A result whose intervals are nearly `RANGES`."""
    samples = np.transpose([np.linspace(*ends, 1000) for ends in RANGES.values()])
    return Fit(
        estimates={name: sum(ends) / 2.0 for name, ends in RANGES.items()},
        samples=samples,
        capsule=Capsule(m=0.15),
        disturbances=Disturbances(lag=0.004),
        chi2=1.0,
        minima=(1.0,),
        widths=dict.fromkeys(RANGES, 0.1),
        ranges=RANGES,
    )
