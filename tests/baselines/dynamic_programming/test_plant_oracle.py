"""The expert that knows every constant of its plants, and the motor."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from baselines.dynamic_programming.archive import known_results, solve_near
from baselines.dynamic_programming.policy import NUM_TORQUES, TORQUES, Oracle, PlantOracle
from baselines.dynamic_programming.problem import Problem, plant_problems
from capsule_gym import CapsuleVectorEnv
from capsule_gym.core.layout import Row
from capsule_gym.evaluation.optimum import GRID
from capsule_gym.parameters import NOMINAL, REAL

SECONDS = 0.02
PENDULUM = {"m": 0.15, "l": 0.33, "k": 0.33, "c": 0.085}
OWN = Problem(motor_friction=0.05, **PENDULUM)
STATE = np.array([0.3, 2.0, 0.0, 0.05])


def make_env(count, disturbances="none"):
    return CapsuleVectorEnv(
        num_envs=count,
        randomization="real" if disturbances != "none" else "broad",
        disturbances=disturbances,
        autoreset_mode=AutoresetMode.DISABLED,
    )


@pytest.fixture(scope="module")
def nodes():
    return [known_results().solution(problem) for problem in plant_problems(GRID)]


def test_on_a_node_of_the_grid_the_scores_are_those_of_the_oracle(nodes):
    plants = [(0.5, 0.01), (0.35, 0.3), (0.75, 0.1)]
    M, mu = zip(*plants, strict=True)
    env = make_env(3)
    env.reset(seed=0, options={"M": M, "mu": mu, "state": STATE})
    theta, theta_dot, _, x_dot = STATE
    observed = [[theta, theta_dot, x_dot, *plant] for plant in plants]
    expected = Oracle(3).scores(np.array(observed, np.float64))
    scores = PlantOracle(env.simulation, nodes).scores()
    assert scores.shape == (3, NUM_TORQUES)
    np.testing.assert_allclose(scores, expected, rtol=1e-9)


def test_the_lookahead_is_the_step_of_the_disturbed_environment(nodes):
    count = 8
    disturbances = {"lag": 0.02, "motor_friction": 0.05}
    options = {
        "M": [0.5] * count,
        "mu": [0.01] * count,
        "state": STATE,
        "capsule": [PENDULUM] * count,
        "disturbances": [disturbances] * count,
    }
    env = make_env(count, "real")
    env.reset(seed=1, options=options)
    for _ in range(3):
        env.step(np.full((count, 1), 0.4, np.float32))
    expert = PlantOracle(env.simulation, nodes)
    expert.scores()
    chosen = np.linspace(0, NUM_TORQUES - 1, count).astype(int)
    predicted = expert.normal_force[np.arange(count), chosen]
    env.step(TORQUES[chosen][:, None])
    assert (predicted == env.simulation.row(Row.normal_force)).all()


def test_the_lookahead_leaves_the_environment_as_it_is(nodes):
    env = make_env(4)
    env.reset(seed=0, options={"M": [0.5] * 4, "mu": [0.01] * 4})
    before = env.simulation.world.copy()
    PlantOracle(env.simulation, nodes).scores()
    assert (env.simulation.world == before).all()


def test_a_change_of_the_plant_changes_its_values(nodes):
    change = {"t": 2 * SECONDS, "M": 0.35, "mu": 0.1}
    env = make_env(2)
    options = {"M": [0.5, 0.35], "mu": [0.01, 0.1], "state": STATE, "changes": [[change], []]}
    env.reset(seed=0, options=options)
    expert = PlantOracle(env.simulation, nodes)
    first, other = expert.scores()
    assert (first != other).any()
    for _ in range(3):
        env.step(np.zeros((2, 1), np.float32))
    env.simulation.write(Row.theta, np.full(2, 0.3))
    env.simulation.write(Row.theta_dot, np.full(2, 2.0))
    env.simulation.write(Row.x_dot, np.full(2, 0.05))
    first, other = expert.scores()
    np.testing.assert_allclose(first, other, atol=1e-9)


@pytest.fixture(scope="module")
def own_solution():
    return solve_near(OWN, known_results(), shape=(13, 18, 7), room=0.15)


def mean_speed(solution, seconds=12.0):
    """The speed of the expert on the plant `OWN` with the lag and friction of `real`, cm/s."""
    env = make_env(1, "real")
    capsule = PENDULUM | {"static_ratio": NOMINAL.static_ratio}
    disturbances = {"lag": REAL.lag, "motor_friction": OWN.motor_friction}
    options = {"M": [OWN.M], "mu": [OWN.mu], "capsule": [capsule], "disturbances": [disturbances]}
    env.reset(seed=0, options=options)
    expert = PlantOracle(env.simulation, [solution])
    for _ in range(round(seconds / SECONDS)):
        env.step(TORQUES[expert.scores().argmax(axis=1)][:, None])
    return env.episode_metrics()["mean_speed"].item()


def test_values_and_lookahead_must_belong_to_the_same_plant(own_solution):
    nominal = known_results().solution(Problem())
    assert mean_speed(own_solution) > 5.0 * mean_speed(nominal)
