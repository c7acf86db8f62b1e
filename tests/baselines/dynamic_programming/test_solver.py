"""Grid, transitions and solver: the environment, closed forms, and value iteration in numpy."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from baselines.dynamic_programming import solver
from baselines.dynamic_programming.grid import FAILED, Grid
from baselines.dynamic_programming.problem import Problem, Transitions
from baselines.dynamic_programming.solver import (
    Solution,
    final_solutions,
    run_policy,
    solve,
    transitions,
)
from capsule_gym import CapsuleEnv
from capsule_gym.tasks.task import START_THETA

SHAPE = (13, 18, 7)
STARTS = np.array([START_THETA])
ORIGIN = np.array([[START_THETA], [0.0], [0.0]])


def make_grid(shape=SHAPE, w=(-2.0, 5.0)):
    return Grid(shape, (-6.0, 20.0), w, Problem().q)


@pytest.fixture
def coarse(monkeypatch):
    """Five torques at every node, without refinement."""
    monkeypatch.setattr(solver, "TORQUES", 5)
    monkeypatch.setattr(solver, "REFINEMENTS", 0)


def run(solution, final=()):
    """The first episode's states, shape (steps, 4), and distance, m, in 4 s."""
    trajectory = run_policy(solution, STARTS, final=final, horizon=4.0)
    return trajectory.states[..., 0], trajectory.metrics["distance"][0]


def test_a_transition_is_a_step_of_the_environment_bit_for_bit():
    rng = np.random.default_rng(1)
    starts = rng.uniform([-1.2, -6.0, 0.0, -0.3], [1.2, 6.0, 0.0, 0.6], (40, 4))
    starts[::3, 3] = 0.0
    actions = rng.uniform(-1.0, 1.0, 40).astype(np.float32)
    M = rng.uniform(0.4, 0.6, 40)
    model = Transitions(Problem(mu=0.2, energy_weight=0.3), 40)
    # A batch can be used again, and every state may have its own plant.
    model.step(rng.uniform(-1.0, 1.0, (3, 40)), np.ones(40))
    model.set_plants(M, np.full(40, 0.2))

    ends, rewards, failed = model.step(starts[:, [0, 1, 3]].T, actions.astype(np.float64))

    env = CapsuleEnv(randomization="none", energy_weight=0.3, termination_penalty=0.0)
    for i in range(40):
        env.reset(seed=0, options={"M": M[i], "mu": 0.2, "state": starts[i]})
        _, reward, terminated, _, info = env.step(actions[i : i + 1])
        assert (ends[:, i] == info["state"][[0, 1, 3]]).all()
        assert rewards[i] == reward
        assert failed[i] == terminated


def test_stick_states_lie_on_nodes():
    (position,) = make_grid().positions(np.array([[0.3], [2.0], [0.0]]))
    assert position[1] == pytest.approx(round(position[1]), abs=1e-5)


def failures(margin=0.0):
    """Nodes of the grid, and whether steps from them with both largest torques fail."""
    grid = make_grid()
    nodes = grid.nodes()
    torques = np.tile([-1.0, 1.0], (nodes.shape[1], 1))
    positions, _ = transitions(Problem(margin=margin), grid, torques)
    return nodes, positions[..., 0] == FAILED


def test_some_states_fail():
    _, failed = failures()
    assert 0.2 < failed.mean() < 0.8


def test_the_end_of_the_swing_fails():
    (theta, theta_dot, _), failed = failures()
    falling = (theta > 1.5) & (theta_dot > 5.0)
    assert falling.any()
    assert failed[falling].all()


def test_lost_contact_fails():
    (theta, theta_dot, _), failed = failures()
    # (M + m) g = m l theta_dot^2 at the upright.
    thrown = (np.abs(theta) < 0.1) & (theta_dot > 13.0)
    assert thrown.any()
    assert failed[thrown].all()


def test_with_a_margin_more_states_fail():
    _, failed = failures()
    _, with_margin = failures(margin=3.0)
    assert (with_margin >= failed).all()
    assert with_margin.sum() > failed.sum()


def test_values_between_nodes_are_linear_with_a_parabola_along_w():
    grid = make_grid()
    a, b, c = np.indices(SHAPE).astype(np.float64)
    values = (2.0 * a - 3.0 * b + 0.5 * c * c).astype(np.float32)
    _, spacing = grid.axes[2]
    solution = Solution(Problem(), grid, values, 0.5 / spacing**2, 0.0)
    rng = np.random.default_rng(0)
    states = rng.uniform([[-1.0], [-3.0], [-0.1]], [[1.0], [3.0], [0.1]], (3, 50))
    states = states[:, grid.positions(states)[:, 0] != FAILED]
    x, y, z = grid.positions(states).T.astype(np.float64)
    expected = 2.0 * x - 3.0 * y + 0.5 * z * z
    np.testing.assert_allclose(solution.at(states), expected, rtol=1e-5, atol=1e-4)


def some_transitions():
    """The grid, and its nodes' positions after a step and rewards under five torques."""
    grid = make_grid()
    torques = np.tile(np.linspace(-1.0, 1.0, 5), (np.prod(SHAPE), 1))
    return grid, *transitions(Problem(), grid, torques)


@pytest.fixture
def solved(coarse):
    """The solution, and the operator of value iteration with scipy's interpolation.

    That one omits the parabola along w.
    """
    grid, positions, rewards = some_transitions()
    failed = positions[..., 0] == FAILED
    coordinates = np.moveaxis(positions, 2, 0).reshape(3, -1).clip(0.0)

    def operator(values):
        after = map_coordinates(values, coordinates, order=1).reshape(rewards.shape)
        after = np.where(failed, solver.FAILURE_VALUE, after)
        return (rewards + after).max(axis=1).reshape(SHAPE)

    return solve(Problem(), grid), operator


def test_the_operator_shifts_the_values_of_the_solution_by_the_gain_alone(solved):
    solution, operator = solved
    values = solution.values.astype(np.float64)
    change = operator(values) - values
    alive = values > 0.5 * solver.FAILURE_VALUE
    assert np.ptp(change[alive]) < 0.05 * Problem().control_dt + 1e-4


def test_convergence_is_judged_where_the_policy_does_not_fail():
    _, positions, rewards = some_transitions()
    zeros = np.zeros(SHAPE, np.float32)
    _, change, _ = solver._improve(zeros, positions, rewards, 0.0, 0.0, 2)
    fails = (positions[..., 0] == FAILED).all(axis=1)
    assert 0 < fails.sum() < fails.size
    assert change.shape == ((~fails).sum(),)


def test_value_iteration_converges_to_the_solution(solved):
    solution, operator = solved
    origin = solution.grid.positions(ORIGIN).T
    values = np.zeros(SHAPE)
    for _ in range(600):
        values = operator(values)
        values -= map_coordinates(values, origin, order=1)
    alive = solution.values > 0.5 * solver.FAILURE_VALUE
    np.testing.assert_allclose(values[alive], solution.values[alive], atol=0.5)


def test_gain_and_value_at_the_start(solved):
    solution, _ = solved
    assert 10.0 < solution.gain < 30.0
    assert solution.at(ORIGIN)[0] == pytest.approx(0.0, abs=1e-3)


def test_without_friction_nothing_is_gained(coarse):
    # The centre of mass stays at rest, and the platform stays within an arm's length of it.
    frictionless = solve(Problem(mu=0.0), make_grid(w=(-1.0, 1.0)))
    states, _ = run(frictionless)
    assert abs(states[-1, 2]) < 2.0 * frictionless.grid.q


def test_nothing_counts_after_the_end_of_an_episode(coarse):
    solution = solve(Problem(), make_grid())
    final = final_solutions(solution)
    assert not final[0].values.any()
    # From rest little is gained in a step.
    assert 0.0 <= final[1].at(ORIGIN)[0] < 0.2
    _, steady = run(solution)
    _, ending = run(solution, final)
    # The last swing forwards ends with the episode.
    assert ending > steady + 0.02


def test_the_curvature_of_a_parabola_of_values_is_its_coefficient():
    grid = make_grid()
    first, spacing = grid.axes[2]
    w = first + spacing * np.arange(SHAPE[2])
    # Only the node nearest to the state has this coefficient; two nodes further the values jump.
    state = np.array([0.3, -1.0, 0.7, 0.066])
    position = grid.positions(state[[0, 1, 3], None])[0]
    i, j, k = np.round(position).astype(int)
    assert 0.25 < position[2] - k < 0.5
    coefficients = np.zeros(SHAPE[:2])
    coefficients[i, j] = 1.5
    values = coefficients[..., None] * (w - 1.0) ** 2 + 10.0 * (w > w[k + 1])
    solution = Solution(Problem(), grid, values.astype(np.float32), 0.0, 0.0)
    steps = round(2.0 * solver.SETTLED / Problem().control_dt)
    states = np.tile(state[:, None], (steps, 1, 3))
    assert solver.curvature_of(solution, SimpleNamespace(states=states)) == pytest.approx(1.5)
    fallen = np.full((steps, 4, 3), 2.0)
    assert solver.curvature_of(solution, SimpleNamespace(states=fallen)) == 0.0


def test_torques_are_refined_around_the_best(monkeypatch):
    widths = []

    def recorded(problem, grid, torques):
        assert np.abs(torques).max() == 1.0
        widths.append(np.ptp(torques, axis=1).max())
        return transitions(problem, grid, torques)

    monkeypatch.setattr(solver, "TORQUES", 5)
    monkeypatch.setattr(solver, "transitions", recorded)
    solve(Problem(), make_grid())
    assert widths == [2.0, 1.0, 0.25]


def test_a_grid_extends_beyond_the_trajectories():
    # The cosine of the angle is 0.5: y is 2 x_dot / q, from 2 to 18, and w is half of that minus
    # half of theta_dot, from 2 to 3.
    first = [np.pi / 3.0, -2.0, 0.0, 0.1]
    second = [np.pi / 3.0, 12.0, 0.0, 0.9]
    states = np.array([first, second])[..., None]
    y, w = solver.ranges(SimpleNamespace(states=states), 0.1)
    assert y == (-2.8, 22.8)
    assert w == (1.0, 4.0)


@pytest.mark.parametrize(
    ("y", "along_s", "along_w"), [(100.0, 36, 11), (1.0, 17, 24), (0.1, 10, 40)]
)
def test_nodes_are_divided_by_the_ranges_of_y_and_w(y, along_s, along_w):
    # The 400 nodes along s and w are divided by 0.7 times the ratio of these ranges, between 1 / 4
    # and 3.2.
    shape = solver.divide_nodes((10, 20, 20), (0.0, y), (0.0, 1.0))
    assert shape == (10, along_s, along_w)
