"""Grid, transitions and solver, compared with the environment, closed forms and value iteration in
numpy."""

from dataclasses import replace
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


def make_grid(shape=SHAPE, w=(-2.0, 5.0)):
    return Grid(shape, (-6.0, 20.0), w, 0.5)


@pytest.fixture
def coarse(monkeypatch):
    """Five torques at every node, without refinement."""
    monkeypatch.setattr(solver, "TORQUES", 5)
    monkeypatch.setattr(solver, "REFINEMENTS", 0)


def test_a_transition_is_a_step_of_the_environment_bit_for_bit():
    rng = np.random.default_rng(1)
    starts = rng.uniform([-1.2, -6.0, 0.0, -0.3], [1.2, 6.0, 0.0, 0.6], (40, 4))
    starts[::3, 3] = 0.0
    actions = rng.uniform(-1.0, 1.0, 40).astype(np.float32)
    model = Transitions(Problem(mu=0.2, energy_weight=0.3), 40)
    # A batch can be used again, and every state may have its own plant.
    model.step(rng.uniform(-1.0, 1.0, (3, 40)), np.ones(40))
    M = rng.uniform(0.4, 0.6, 40)
    model.set_plants(M, np.full(40, 0.2))
    ends, rewards, failed = model.step(starts[:, [0, 1, 3]].T, actions.astype(np.float64))
    env = CapsuleEnv(randomization="none", energy_weight=0.3, termination_penalty=0.0)
    for i, (start, action) in enumerate(zip(starts, actions, strict=True)):
        env.reset(seed=0, options={"M": M[i], "mu": 0.2, "state": start})
        _, reward, terminated, _, info = env.step(action[None])
        assert (ends[:, i] == info["state"][[0, 1, 3]]).all() and (rewards[i], failed[i]) == (
            reward,
            terminated,
        )


def test_lost_contact_the_end_of_the_swing_and_the_edge_of_the_grid_fail():
    grid = make_grid()
    nodes = grid.nodes()
    # Stick states lie on nodes.
    position = grid.positions(np.array([[0.3], [2.0], [0.0]]))[0, 1]
    assert position == pytest.approx(round(position), abs=1e-5)
    torques = np.tile([-1.0, 1.0], (nodes.shape[1], 1))
    failed = transitions(Problem(), grid, torques)[0][..., 0] == FAILED
    falling = (nodes[0] > 1.5) & (nodes[1] > 5.0)
    assert falling.any() and failed[falling].all()
    # (M + m) g = m l theta_dot^2 at the upright.
    thrown = (np.abs(nodes[0]) < 0.1) & (nodes[1] > 13.0)
    assert thrown.any() and failed[thrown].all() and 0.2 < failed.mean() < 0.8
    with_margin = transitions(Problem(margin=3.0), grid, torques)[0][..., 0] == FAILED
    assert (with_margin >= failed).all() and with_margin.sum() > failed.sum()


def test_the_solution_is_that_of_value_iteration(coarse):
    """Compares with relative value iteration in numpy on the same transitions, with scipy's
    interpolation."""
    solution = solve(Problem(), make_grid())
    grid, torques = solution.grid, np.tile(np.linspace(-1.0, 1.0, 5), (np.prod(SHAPE), 1))
    positions, rewards = transitions(Problem(), grid, torques)
    failed = positions[..., 0] == FAILED
    coordinates = np.moveaxis(positions, 2, 0).reshape(3, -1).clip(0.0)

    def operator(values):
        after = map_coordinates(values, coordinates, order=1).reshape(rewards.shape)
        return (rewards + np.where(failed, solver.FAILURE_VALUE, after)).max(axis=1).reshape(SHAPE)

    values = solution.values.astype(np.float64)
    alive = values > 0.5 * solver.FAILURE_VALUE
    # scipy's interpolation omits the parabola along w. `at` interpolates this parabola and linear
    # functions exactly.
    a, b, c = np.meshgrid(*(np.arange(n) for n in SHAPE), indexing="ij")
    states = np.random.default_rng(0).uniform(
        [[-1.0], [-3.0], [-0.1]], [[1.0], [3.0], [0.1]], (3, 50)
    )
    states = states[:, grid.positions(states)[:, 0] != FAILED]
    x, y, z = grid.positions(states).T.astype(np.float64)
    bent = (2.0 * a - 3.0 * b + 0.5 * c * c).astype(np.float32)
    found = replace(solution, values=bent, curvature=0.5 / grid.axes[2, 1] ** 2).at(states)
    np.testing.assert_allclose(found, 2.0 * x - 3.0 * y + 0.5 * z * z, rtol=1e-5, atol=1e-4)
    # The operator shifts the solution's values by the gain alone, and other initial values converge
    # to them.
    assert np.ptp((operator(values) - values)[alive]) < 0.05 * Problem().control_dt + 1e-4
    origin = grid.positions(np.array([[-np.pi / 3.0], [0.0], [0.0]])).T
    other = np.zeros(SHAPE)
    for _ in range(600):
        other = operator(other)
        other -= map_coordinates(other, origin, order=1)
    np.testing.assert_allclose(other[alive], values[alive], atol=0.5)
    start = solution.at(np.array([[-np.pi / 3.0], [0.0], [0.0]]))[0]
    assert 10.0 < solution.gain < 30.0 and start == pytest.approx(0.0, abs=1e-3)


def test_without_friction_nothing_is_gained(coarse):
    # The centre of mass stays at rest, and the platform stays within an arm's length of it.
    frictionless = solve(Problem(mu=0.0), make_grid(w=(-1.0, 1.0)))
    trajectory = run_policy(frictionless, np.array([START_THETA]), horizon=4.0)
    assert abs(trajectory.states[-1, 2, 0]) < 2.0 * frictionless.grid.q


def test_nothing_counts_after_the_end_of_an_episode(coarse):
    solution, start = solve(Problem(), make_grid()), np.array([START_THETA])
    final = final_solutions(solution)
    assert not final[0].values.any()
    steady, ending = (run_policy(solution, start, final=each, horizon=4.0) for each in ((), final))
    # The last swing forwards ends with the episode.
    assert ending.metrics["distance"][0] > steady.metrics["distance"][0] + 0.02


def test_the_curvature_of_a_parabola_of_values_is_its_coefficient():
    problem, grid = Problem(), make_grid()
    parabola = 1.5 * (grid.axes[2, 0] + grid.axes[2, 1] * np.arange(SHAPE[2]) - 1.0) ** 2
    solution = Solution(
        problem, grid, np.broadcast_to(parabola, SHAPE).astype(np.float32), 0.0, 0.0
    )
    states = np.zeros((round(2.0 * solver.SETTLED / problem.control_dt), 4, 3))
    assert solver.curvature_of(solution, SimpleNamespace(states=states)) == pytest.approx(
        1.5, abs=1e-3
    )


def test_torques_are_refined_around_the_best(monkeypatch):
    widths = []
    monkeypatch.setattr(solver, "TORQUES", 5)
    monkeypatch.setattr(
        solver, "transitions", lambda *a: widths.append(np.ptp(a[2], 1).max()) or transitions(*a)
    )
    solve(Problem(), make_grid())
    assert widths == [2.0, 1.0, 0.25]


def test_a_grid_extends_beyond_the_trajectories():
    # At theta = 0 y is x_dot / q, and w is that minus theta_dot: from 1 to 9, and from 2 to 3.
    states = np.array([[[0.0, -1.0, 0.0, 0.1]], [[0.0, 6.0, 0.0, 0.9]]]).transpose(0, 2, 1)
    assert solver.ranges(SimpleNamespace(states=states), 0.1) == ((-1.4, 11.4), (1.0, 4.0))
    # The 400 nodes along s and w are divided by 0.7 times the ratio of these ranges, between 1 / 4
    # and 3.2.
    for y, shape in ((100.0, (10, 36, 11)), (1.0, (10, 17, 24)), (0.1, (10, 10, 40))):
        assert solver.divide_nodes((10, 20, 20), (0.0, y), (0.0, 1.0)) == shape
