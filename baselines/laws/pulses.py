"""Laws for the tasks `goal` and `velocity`: a gait towards the goal, then pulses whose size adapts to the floor.

On smooth floors the law for the task `goal` uses the strokes of `baselines.laws.strokes` instead.

Far from the goal the torque is that of `baselines:gait`, mirrored if the goal lies behind the platform. Near the goal
the law repeats three phases: it returns the pendulum to the start of a pulse, slowly enough for the platform to stick;
it accelerates the pendulum with full torque to the rate w that should move the platform by the error; and it brakes
the pendulum slowly. A pulse moves the platform by about gain w^2 / mu; every pulse corrects the gain. M and mu, which
limit the acceleration in stick, are identified online (`capsule_gym.observation.identify`).

In the task `velocity` the goal is the position of the target 0.3 s later. The numbers were chosen by hand on 300 plants
of the tasks' own distribution, with seeds from 1000 on. A law reads the goal's position, which follows its reference,
and the exact position of the platform.
"""

from __future__ import annotations

import math
from typing import Any

from baselines.laws.gait import NO_REFERENCE, guarded_torque, known_parameters
from baselines.laws.strokes import CREEP, NEAR, STROKE, held_back, stroke_torque
from capsule_gym.compilation import inlined
from capsule_gym.config import LAW_DT
from capsule_gym.controller import Controller
from capsule_gym.elementary import clip, exp
from capsule_gym.observation import CELLS, estimates, identify
from capsule_gym.parameters import NOMINAL
from capsule_gym.task import TORQUE_LIMIT
from capsule_gym.tasks import goal, velocity

# Phases of the law.
RUN, RETURN, PULSE, BRAKE = 0.0, 1.0, 2.0, 3.0
# Distance from the goal beyond which the platform runs, m.
FAR = 0.05
# The run ends earlier by this share of the sliding distance, x'^2 / (2 mu g).
SLIDE = 0.15
# Rate of the pendulum, rad/s, below which a run on the roughest floors has ended in an equilibrium.
STALL = 1e-3
# Share of the friction that the pendulum uses while the platform must stick, and its least and largest acceleration;
# the acceleration of a return before a run, when the platform may move, rad/s^2.
GRIP, LEAST_GRIP, LARGEST_GRIP, FAST = 0.9, 0.5, 80.0, 40.0
# mu while the standard deviation of log(mu) is above DOUBT; and the range to which the estimate is clipped.
UNKNOWN_MU, DOUBT, LEAST_MU, LARGEST_MU = 0.15, 0.5, 0.01, 0.7
# A pulse moves the platform by gain w^2 / mu: the first gain, m s^2, the share of its error that a pulse corrects, and
# the smallest and largest factor of a correction.
GAIN, LEARNING, LESS, MORE = 1e-4, 0.4, 0.6, 3.0
# Least and largest rate w of a pulse, rad/s, and the acceleration of its torque, rad/s^2.
SLOWEST, FASTEST, ACCELERATION = 0.6, 9.0, 240.0
# Angles, rad, positive in the direction of the pulse. A pulse starts at -HOME, on rough floors nearer to the upright,
# where full torque moves the platform; at most EARLIEST before this angle, and before START_END. It ends at PULSE_END;
# the pendulum should stop before BRAKED.
HOME, LEAST_HOME, ROUGHNESS, EARLIEST, START_END, PULSE_END, BRAKED = 0.9, 0.2, 2.2, 0.1, 0.3, 0.8, 0.9
# The platform moves to a goal by strokes if mu is below the first number, until mu is above the second.
SMOOTH, LEAVE = 0.035, 0.06
# The memory of the filter, then that of the law: the phase, and of the pulse the direction, the rate, the start, the
# gain and the time since its end.
MEMORY = (0.0,) * CELLS + (RETURN, 1.0, 0.0, 0.0, GAIN, 0.0)
m, l, g, k, c = NOMINAL.m, NOMINAL.l, NOMINAL.g, NOMINAL.k, NOMINAL.c


@inlined
def approach(theta: float, theta_dot: float, aim: float, grip: float) -> float:
    """The acceleration, rad/s^2, that takes the pendulum to an angle and stops it there, within +-grip."""
    way = aim - theta
    rate = min(math.sqrt(1.6 * grip * abs(way)), 8.0 * abs(way))
    return clip(40.0 * ((rate if way > 0.0 else -rate) - theta_dot), grip)


def pulse_law(
    parameters: tuple[float, ...], position: int, rate_of_it: int, lead: float, near: float, stop: float
) -> Any:
    """The law, with its numbers in its closure.

    Args:
        parameters: parameters of the gait.
        position: column of the goal's position, m, in the law's argument `reference`.
        rate_of_it: column of the goal's velocity, m/s.
        lead: time by which the goal's position is extrapolated, s.
        near: error that is not corrected, m.
        stop: error at which a run ends, m.
    """

    def law(theta: float, theta_dot: float, x: float, x_dot: float, memory: Any, reference: Any) -> Any:
        cells = identify(memory[:CELLS], theta, theta_dot, x_dot, m, l, g, LAW_DT)
        phase, side, rate, start_x, gain, timer = memory[CELLS:]
        M, log_mu, _, deviation = estimates(cells)
        mu = UNKNOWN_MU if deviation > DOUBT else min(LARGEST_MU, max(LEAST_MU, exp(log_mu)))
        error = reference[position] + lead * reference[rate_of_it] - x
        size, rests = abs(error), x_dot == 0.0
        grip = min(LARGEST_GRIP, max(LEAST_GRIP, GRIP * mu * (M + m) * g / (m * l)))
        home, aims = 0.0, False
        timer += LAW_DT
        if phase == RUN:
            slide = SLIDE * x_dot * x_dot / (2.0 * mu * g) if x_dot * side > 0.0 else 0.0
            stalls = rests and abs(theta_dot) < STALL and side * theta > 0.0
            if stalls or error * side < stop + slide:
                phase, timer, rate = BRAKE, 0.0, 0.0
        elif phase == BRAKE and rests and abs(theta_dot) < 2.0 and timer > 0.005:
            if rate > 0.0:
                observed = max(0.0, side * (x - start_x)) * mu / (rate * rate)
                gain = max(LESS * gain, min(MORE * gain, gain + LEARNING * (observed - gain)))
            phase = RETURN
        if phase == RETURN and size > near and (rests or size > FAR):
            side = 1.0 if error > 0.0 else -1.0
            rate = min(FASTEST, max(SLOWEST, math.sqrt(size * mu / gain)))
            nearer = 0.0 if size > FAR else ROUGHNESS * (mu - 0.1)
            home, aims = -side * min(HOME, max(LEAST_HOME, HOME - nearer)), True
            # The fastest pulse from here after which the pendulum stops in time.
            room = max(0.0, BRAKED - side * theta - rate * rate / ACCELERATION)
            fastest = math.sqrt(2.0 * grip * room)
            if size > FAR:
                grip = max(grip, FAST)
                if side * theta < -0.5 and abs(theta_dot) < 3.0:
                    phase = RUN
            elif abs(theta_dot) < 0.5 + 0.1 * rate and -EARLIEST < side * (theta - home) and side * theta < START_END:
                if rate <= fastest or abs(theta - home) < 0.1:
                    phase, rate, start_x = PULSE, max(SLOWEST, min(rate, fastest)), x
        if phase == PULSE and (side * theta_dot >= rate or side * theta > PULSE_END):
            phase, timer = BRAKE, 0.0
        if phase == RUN:
            torque = side * guarded_torque(side * theta, side * theta_dot, side * x_dot, parameters)
        elif phase == PULSE:
            torque = side * TORQUE_LIMIT
        else:
            returns = phase == RETURN and aims
            wanted = approach(theta, theta_dot, home, grip) if returns else clip(-20.0 * theta_dot, grip)
            torque = held_back(theta, theta_dot, wanted, grip)
        own = phase, side, rate, start_x, gain, timer
        return torque, cells + own

    return law


def goal_pulses() -> Controller:
    """The law of the task `goal`: the gait and torque pulses, or strokes on smooth floors."""
    position = NO_REFERENCE.shape[1] + goal.Memory._fields.index("goal")
    pulses = inlined(pulse_law(known_parameters(), position, position, lead=0.0, near=NEAR, stop=0.025))

    def law(theta: float, theta_dot: float, x: float, x_dot: float, memory: Any, reference: Any) -> Any:
        phase, side, rate, start_x, gain, timer = memory[CELLS:]
        M, log_mu, _, _ = estimates(memory[:CELLS])
        mu = exp(log_mu)
        if mu > (LEAVE if phase >= CREEP else SMOOTH) or memory[0] == 0.0:
            if phase >= CREEP:
                phase, rate = BRAKE, 0.0
            own = phase, side, rate, start_x, gain, timer
            return pulses(theta, theta_dot, x, x_dot, memory[:CELLS] + own, reference)
        cells = identify(memory[:CELLS], theta, theta_dot, x_dot, m, l, g, LAW_DT)
        error = reference[position] - x
        if phase < CREEP:
            phase = STROKE if x_dot * side > 0.0 else CREEP
        if phase == CREEP and x_dot == 0.0 and abs(error) > NEAR:
            side = 1.0 if error > 0.0 else -1.0
        torque, phase = stroke_torque(side * theta, side * theta_dot, side * x_dot, side * error, M, mu, phase)
        return side * torque, (*cells, phase, side, rate, start_x, gain, timer)

    return Controller("goal_pulses", law, NO_REFERENCE, MEMORY, task="goal")


def velocity_pulses() -> Controller:
    """The law of the task `velocity`: the gait and torque pulses towards the target."""
    position, rate = (NO_REFERENCE.shape[1] + velocity.Memory._fields.index(name) for name in ("target", "command"))
    law = pulse_law(known_parameters(), position, rate, lead=0.3, near=0.004, stop=0.0)
    return Controller("velocity_pulses", law, NO_REFERENCE, MEMORY, task="velocity")
