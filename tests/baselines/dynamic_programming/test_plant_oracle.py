"""The expert that knows every constant of its plants, and the motor."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from baselines.dynamic_programming.archive import known_results, solve_near
from baselines.dynamic_programming.grid import Grid
from baselines.dynamic_programming.policy import (
    FAILURE_SCORE,
    NUM_TORQUES,
    TORQUES,
    Oracle,
    PlantOracle,
    StoredValues,
)
from baselines.dynamic_programming.problem import Problem, plant_problems
from baselines.dynamic_programming.solver import Solution
from capsule_gym import CapsuleVectorEnv
from capsule_gym.core.layout import Row
from capsule_gym.evaluation.optimum import GRID
from capsule_gym.parameters import NOMINAL, REAL

SECONDS = 0.02
PENDULUM = {"m": 0.15, "l": 0.33, "k": 0.33, "c": 0.085}
OWN = Problem(motor_friction=0.05, **PENDULUM)
STATE = np.array([0.3, 2.0, 0.0, 0.05])


def make_env(count, disturbances="none", energy_weight=0.0):
    return CapsuleVectorEnv(
        num_envs=count,
        energy_weight=energy_weight,
        randomization="real" if disturbances != "none" else "broad",
        disturbances=disturbances,
        autoreset_mode=AutoresetMode.DISABLED,
    )


@pytest.fixture(scope="module")
def nodes():
    return [known_results().solution(problem) for problem in plant_problems(GRID)]


def test_stored_values_are_those_of_the_solutions():
    rng = np.random.default_rng(0)
    solutions = []
    for shape in ((13, 18, 7), (9, 12, 10)):
        grid = Grid(shape, (-6.0, 20.0), (-2.0, 5.0), Problem().q)
        values = rng.uniform(-5.0, 20.0, shape).astype(np.float32)
        solutions.append(Solution(Problem(), grid, values, 0.4, 20.0))
    stored = StoredValues(solutions, 2, corners=2)
    stored.corners[:] = [[0, 1], [1, 0]]
    stored.weights[:] = [[0.75, 0.25], [0.5, 0.5]]
    states = rng.uniform([[-1.0], [-3.0], [-0.1]], [[1.0], [0.3], [0.1]], (3, 50))
    first, second = (solution.at(states) for solution in solutions)
    expected = [0.75 * first + 0.25 * second, 0.5 * first + 0.5 * second]
    found = stored.add(np.zeros((2, 50)), np.tile(states[:, None], (1, 2, 1)))
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-3)
    # Off the grid they are those of its edge.
    edge = np.array([[0.5 * np.pi - 1e-6], [0.0], [0.0]])
    beyond = np.array([[2.0], [0.0], [0.0]])
    first, second = (solution.at(edge) for solution in solutions)
    expected = [0.75 * first + 0.25 * second, 0.5 * first + 0.5 * second]
    found = stored.add(np.zeros((2, 1)), np.tile(beyond[:, None], (1, 2, 1)))
    np.testing.assert_allclose(found, expected, atol=0.02)


def test_on_a_node_of_the_grid_the_scores_are_those_of_the_oracle(nodes):
    plants = [(0.5, 0.01), (0.35, 0.3), (0.75, 0.1)]
    # From slow to so fast that the platform is lifted.
    states = np.tile(STATE, (60, 1))
    states[:, 1] = np.linspace(2.0, 14.0, 60)
    M, mu = np.tile(plants, (20, 1)).T
    env = make_env(60, energy_weight=2.0)
    env.reset(seed=0, options={"M": M.tolist(), "mu": mu.tolist(), "state": states})
    observed = np.column_stack([states[:, [0, 1, 3]], M, mu])
    oracle = Oracle(60)
    expected = oracle.scores(observed)
    scores = PlantOracle(env.simulation, nodes).scores()
    assert scores.shape == (60, NUM_TORQUES)
    np.testing.assert_allclose(scores, expected, rtol=1e-9)
    # Contact that the rounding of an observation could lose counts as lost.
    hardly = (oracle.normal_force > 0.0) & (oracle.normal_force <= 0.02)
    assert hardly.any()
    assert (scores[hardly] == FAILURE_SCORE).all()
    assert (scores[oracle.normal_force > 0.02] != FAILURE_SCORE).any()


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


@pytest.mark.parametrize("M", [0.35, 0.5])
def test_a_change_of_the_plant_changes_its_values(nodes, M):
    change = {"t": 2 * SECONDS, "M": M, "mu": 0.1}
    env = make_env(2)
    options = {"M": [0.5, M], "mu": [0.01, 0.1], "state": STATE, "changes": [[change], []]}
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


def test_a_solution_with_room_extends_the_ranges_of_the_plants_around_it(nodes, own_solution):
    corners, *_ = GRID.cell(OWN.M, OWN.mu)
    grids = [nodes[corner].grid for corner in corners]
    for name in ("y", "w"):
        low, high = np.transpose([getattr(grid, name) for grid in grids])
        assert low.max() < 0.0 < high.min()
        expected = 1.15 * low.min(), 1.15 * high.max()
        assert getattr(own_solution.grid, name) == pytest.approx(expected)


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
