"""Sampling model-predictive control with the values of dynamic programming, the policy `mpc`.

At every control interval the policy disturbs its previous plan of torques, simulates all plans with
the environment's own step on the nominal plant, and applies the first torque of the best
(predictive sampling, Howell et al. 2022). The value of dynamic programming scores the state at the
end of a plan, which can therefore be short.
"""

from collections.abc import Sequence

import numpy as np

from baselines.dynamic_programming.policy import FAILURE_SCORE, Lookahead
from baselines.dynamic_programming.problem import NOMINAL_MARGIN, Problem, Transitions
from capsule_gym.policies.scripted import Act

PLANS = 32
INTERVALS = 5
# Largest disturbances of the plans after the first, the previous plan itself; each is a share of
# the torque limit.
AMPLITUDES = np.array([0.0, *np.resize([0.1, 0.3, 1.0], PLANS - 1)])[:, None]
SEED = 20187


def start(seeds: Sequence[int]) -> Act:
    """The policy `mpc`.

    The disturbances are the same in all episodes, so that an episode does not depend on others.
    """
    count = len(seeds)
    rng = np.random.default_rng(SEED)
    problem = Problem(margin=NOMINAL_MARGIN)
    transitions = Transitions(problem, count * PLANS)
    optimum = Lookahead(count, NOMINAL_MARGIN, problem)
    share = np.linspace(0.0, 1.0, INTERVALS)
    previous = np.zeros((count, 1, INTERVALS))

    def act(observations: np.ndarray) -> np.ndarray:
        nonlocal previous
        # Linear between the ends of the plan: single torques do not move the pendulum.
        first, last = rng.uniform(-1.0, 1.0, (2, PLANS, 1))
        disturbances = AMPLITUDES * (first + share * (last - first))
        plans = np.clip(previous + disturbances, -1.0, 1.0)
        observed = observations[:, :3].T.astype(np.float64)
        states = np.repeat(observed, PLANS, axis=1)
        scores = np.zeros(count * PLANS)
        failed = np.zeros(count * PLANS, bool)
        for torques in plans.reshape(-1, INTERVALS).T:
            states, rewards, failing = transitions.step(states, torques)
            failed |= failing
            # A failed step may end in NaN.
            states = np.where(failed, 0.0, states)
            scores = scores + np.where(failed, FAILURE_SCORE, rewards)
        ends = states.reshape(3, count, PLANS)
        scores = optimum.values.add(scores.reshape(count, PLANS), ends)
        best = plans[np.arange(count), scores.argmax(axis=1)]
        shifted = np.append(best[:, 1:], best[:, -1:], axis=1)
        previous = shifted[:, None]
        return best[:, :1].astype(np.float32)

    return act
