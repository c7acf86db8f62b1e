"""A rig whose plant is known."""

from capsule_gym import Capsule, CapsuleEnv, Disturbances, Excitation, record

CONSTANTS = {
    "M": 0.6,
    "mu": 0.08,
    "m": 0.13,
    "l": 0.31,
    "k": 0.35,
    "c": 0.095,
    "viscous": 0.2,
    "static_ratio": 1.2,
    "motor_friction": 0.06,
}
MOTOR = {"latency": 0.008, "lag": 0.004}
BIAS = {"x_dot_bias": 0.01}
TRUTH = {**CONSTANTS, **MOTOR, **BIAS}
EXACT = Disturbances(**MOTOR, **BIAS)
WHITE = Disturbances(theta_noise=0.01, theta_dot_noise=0.1, x_dot_noise=0.01, **MOTOR, **BIAS)


def make_env(**options):
    plain = {"randomization": "none", "control_dt": 0.01, "capsule": Capsule(**CONSTANTS)}
    return CapsuleEnv(**{**plain, **options})


def make_log(disturbances, seconds=20.0, **options):
    env = make_env(disturbances=disturbances, **options)
    rest = {"state": [0.0] * 4}
    return record(env, Excitation(amplitude=0.4), seconds=seconds, seed=1, options=rest)
