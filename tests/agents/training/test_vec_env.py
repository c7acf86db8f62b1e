import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from agents.training.vec_env import CapsuleSB3VecEnv
from capsule_gym import CapsuleVectorEnv


def test_sb3_batch_is_the_native_batch_with_terminal_observations():
    kwargs = {"controller": "baselines:adaptive", "residual_limit": 3.0, "max_episode_steps": 30}
    ours = CapsuleSB3VecEnv(6, seed=4, **kwargs)
    native = CapsuleVectorEnv(6, autoreset_mode=AutoresetMode.SAME_STEP, **kwargs)
    assert ours.reset().tobytes() == native.reset(seed=4)[0].tobytes()
    rng = np.random.default_rng(0)
    seen = set()
    returns = np.zeros(6)
    for _ in range(100):
        actions = rng.uniform(-1, 1, (6, 1)).astype(np.float32)
        observations, rewards, dones, infos = ours.step(actions)
        expected = native.step(actions)
        assert observations.tobytes() == expected[0].tobytes()
        assert np.array_equal(rewards, expected[1].astype(np.float32))
        assert np.array_equal(dones, expected[2] | expected[3])
        returns += expected[1]
        for i, info in enumerate(infos):
            assert bool(info) == bool(dones[i])
            if dones[i]:
                assert info["terminal_observation"].tobytes() == expected[4]["final_obs"][i].tobytes()
                assert not np.array_equal(info["terminal_observation"], observations[i])
                assert info["TimeLimit.truncated"] == bool(expected[3][i] and not expected[2][i])
                assert info["episode"]["r"] == pytest.approx(returns[i])
                assert info["metrics"]["failed"] == float(expected[2][i])
                returns[i] = 0.0
                seen.add((bool(expected[2][i]), bool(expected[3][i])))
    # Both kinds of end were met: failures and time limits.
    assert {(True, False), (False, True)} <= seen


def test_interface_of_the_vec_env():
    env = CapsuleSB3VecEnv(3, controller="baselines:adaptive", render_mode="rgb_array")
    env.seed(3)
    env.reset()
    assert env.get_attr("max_episode_steps") == [1650] * 3
    assert env.get_attr("render_mode", [0]) == ["rgb_array"]
    assert [set(m) >= {"mean_speed"} for m in env.env_method("episode_metrics")] == [True] * 3
    assert env.env_is_wrapped(type(None)) == [False] * 3
    with pytest.raises(AttributeError, match="share their settings"):
        env.set_attr("render_mode", None)
    assert len(env.get_images()) == 3
    env.close()
