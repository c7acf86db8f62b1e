import numpy as np
import pytest

from baselines.optimum.grid import DEAD, Grid
from baselines.optimum.holds import Holds
from baselines.optimum.motion import follow, repeat
from baselines.optimum.solver import DEATH, Problem, _compiled, _improve, solve, transitions
from capsule_gym import CapsuleEnv

TINY = (13, 18, 7)


def tiny(M=0.5, w=(-2.0, 5.0)):
    return Grid(TINY, (-6.0, 20.0), w, M)


def test_a_hold_is_a_step_of_the_environment_bit_for_bit():
    rng = np.random.default_rng(1)
    problem = Problem(M=0.47, mu=0.2, energy_weight=0.3)
    starts = rng.uniform([-1.2, -6.0, 0.0, -0.3], [1.2, 6.0, 0.0, 0.6], (40, 4))
    starts[::3, 3] = 0.0
    actions = rng.uniform(-1.0, 1.0, 40).astype(np.float32)
    holds = problem.holds(40)
    # A batch that has been used is as good as a new one.
    holds.put(rng.uniform(-1.0, 1.0, (3, 40)))
    holds.take(np.ones(40))
    holds.put(starts[:, [0, 1, 3]].T)
    ends, rewards, dead = holds.take(actions.astype(np.float64))
    env = CapsuleEnv(randomization="none", energy_weight=0.3, termination_penalty=0.0)
    for i, (start, action) in enumerate(zip(starts, actions, strict=True)):
        env.reset(seed=0, options={"M": 0.47, "mu": 0.2, "state": start})
        _, reward, terminated, _, info = env.step(action[None])
        assert (ends[:, i] == info["state"][[0, 1, 3]]).all()
        assert (rewards[i], dead[i]) == (reward, terminated)
    env.close()


def test_lost_contact_the_end_of_the_swing_and_the_edge_of_the_grid_are_dead():
    problem, grid = Problem(), tiny()
    nodes = grid.nodes()
    positions, _ = transitions(problem, grid, np.tile([-1.0, 1.0], (nodes.shape[1], 1)))
    dead = positions[..., 0] == DEAD
    falling = (nodes[0] > 1.5) & (nodes[1] > 5.0)
    assert falling.any() and dead[falling].all()
    # (M + m) g = m l theta_dot^2 at the upright.
    thrown = (np.abs(nodes[0]) < 0.1) & (nodes[1] > 13.0)
    assert thrown.any() and dead[thrown].all()
    slow = (np.abs(nodes[0]) < 0.9) & (np.abs(nodes[1]) < 2.0) & (np.abs(nodes[2]) < 0.2)
    inner = (grid.positions(nodes)[:, 2] > 1.5) & (grid.positions(nodes)[:, 2] < 4.5)
    assert (slow & inner).any() and not dead[slow & inner].any()
    spared = transitions(Problem(margin=3.0), grid, np.ones((nodes.shape[1], 1)))[0][..., 0] == DEAD
    assert (spared[:, 0] >= dead[:, 1]).all() and spared.sum() > dead[:, 1].sum()


def test_the_operator_is_monotone_and_does_not_expand():
    problem, grid = Problem(), tiny()
    torques = np.tile(np.linspace(-1.0, 1.0, 3), (np.prod(TINY), 1))
    positions, rewards = transitions(problem, grid, torques)
    rng = np.random.default_rng(2)
    chosen = np.zeros(np.prod(TINY), np.int32)

    def operator(values):
        out = np.empty_like(values)
        _compiled(_improve)(values, out, chosen, positions, rewards, 0.3, 0.01, DEATH)
        return out

    below = rng.uniform(DEATH, 50.0, TINY).astype(np.float32)
    above = below + rng.uniform(0.0, 5.0, TINY).astype(np.float32)
    moved = operator(above) - operator(below)
    assert (moved >= -1e-4).all()
    assert moved.max() <= (above - below).max() + 1e-4
    assert np.unique(chosen).size > 1


def test_a_solution_solves_its_equation():
    solution = solve(Problem(), tiny(), torques=5, refinements=0, tolerance=0.05)
    assert solution.drift < 0.05
    assert 10.0 < solution.gain < 30.0
    start = np.array([[-np.pi / 3.0], [0.0], [0.0]])
    assert solution.at(start)[0] == pytest.approx(0.0, abs=1e-3)


def test_no_torque_gains_nothing():
    # The pendulum falls into its rest, which moves the platform once.
    solution = solve(Problem(torque_limit=1e-6), tiny(), torques=1, refinements=2, tolerance=0.2)
    motion = follow(solution)
    assert abs(motion.metrics["mean_speed"][0]) < 0.05
    assert (motion.states[-500:, 2] == motion.states[-1, 2]).all()


def test_without_friction_no_policy_gains_anything():
    # The centre of mass stays where it is, and the platform within an arm's length of that.
    problem = Problem(mu=0.0)
    solution = solve(problem, tiny(w=(-1.0, 1.0)), torques=5, refinements=0, tolerance=0.2)
    motion = follow(solution, horizon=4.0)
    arm = 200.0 * solution.grid.q
    assert abs(100.0 * motion.states[-1, 2, 0]) < arm


def test_more_torques_and_less_price_gain_more():
    coarse = solve(Problem(), tiny(), torques=3, refinements=0)
    fine = solve(Problem(), tiny(), torques=5, refinements=0)
    dear = solve(Problem(energy_weight=3.0), tiny(), torques=5, refinements=0)
    assert coarse.gain < fine.gain + 0.05
    assert dear.gain < fine.gain


def test_a_motion_repeats_bit_for_bit():
    solution = solve(Problem(), tiny(), torques=5, refinements=0, tolerance=0.1)
    motion = follow(solution, horizon=3.0)
    again = repeat(solution.problem, motion.choices[:, 0])
    assert (again.states == motion.states).all()
    assert again.metrics["mean_speed"] == motion.metrics["mean_speed"]


@pytest.mark.parametrize("wrong", [{"M": -1.0}, {"mu": np.nan}, {"margin": -1.0}, {"hold": 0.0}, {"torque_limit": 0.0}])
def test_what_is_no_problem_is_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Problem(**wrong)


def test_holds_of_many_plants():
    problem = Problem()
    holds = Holds(2, problem.options)
    holds.set_plants(np.array([0.5, 1.0]), np.array([0.01, 0.01]))
    holds.put(np.array([[0.1, 0.1], [0.0, 0.0], [0.2, 0.2]]))
    ends, _, _ = holds.take(np.ones(2))
    alone = problem.holds(1)
    alone.put(np.array([[0.1], [0.0], [0.2]]))
    assert (ends[:, 0] == alone.take(np.ones(1))[0][:, 0]).all()
    assert ends[2, 1] != ends[2, 0]
