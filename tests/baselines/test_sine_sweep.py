import numpy as np

from baselines import sine_sweep


def test_a_sine_moves_the_robot_to_the_side_of_its_well(monkeypatch):
    monkeypatch.setattr(sine_sweep, "TRANSIENT", 20.0)
    # 1 Hz and 1.6 Hz.
    found = sine_sweep.sweep(np.array([31, 49]), np.array([0.02, 0.3, 1.3]))
    assert (found.theta[:2] < -0.6).all() and (found.speed[1] < -0.3).all()
    assert abs(found.speed[0]).max() < 0.02
    assert found.theta[2, 0] > 0.3 and 1.0 < found.speed[2, 0] < 2.0
    # A slow, strong torque drops the pendulum.
    assert np.isnan(found.speed[2, 1])
    left, right = sine_sweep.describe(found)
    assert left.startswith("left well: 80% of the completed runs") and right.startswith("right well: 20%")
