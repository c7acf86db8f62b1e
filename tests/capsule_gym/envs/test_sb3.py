import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecNormalize

from capsule_gym import CapsuleVectorEnv
from capsule_gym.core.layout import Row
from capsule_gym.sb3 import AsymmetricPolicy, CapsuleSB3VecEnv, FixedScale


@pytest.mark.parametrize(
    "kwargs", [{"controller": "baselines:adaptive", "residual_limit": 3.0}, {"task": "goal"}]
)
def test_sb3_batch_is_the_native_batch_with_terminal_observations(kwargs):
    kwargs = {**kwargs, "max_episode_steps": 11}
    ours = CapsuleSB3VecEnv(6, seed=4, **kwargs)
    native = CapsuleVectorEnv(6, autoreset_mode=AutoresetMode.SAME_STEP, **kwargs)
    assert (
        len(
            {
                (ours.reset(), ours.step(np.ones((6, 1))), ours.batch.simulation.row(Row.M)[0])[2]
                for _ in "ab"
            }
        )
        == 2
    )
    ours.seed(4)
    assert ours.reset().tobytes() == native.reset(seed=4)[0].tobytes()
    with pytest.warns(UserWarning, match="draws nothing without a render_mode"):
        assert ours.get_images() == [None] * 6
    rng, seen = np.random.default_rng(0), set()
    returns, lengths = np.zeros(6), np.zeros(6, int)
    for _ in range(300):
        actions = rng.uniform(-1, 1, (6, 1)).astype(np.float32)
        observations, rewards, dones, infos = ours.step(actions)
        expected = native.step(actions)
        assert observations.tobytes() == expected[0].tobytes()
        assert np.array_equal(rewards, expected[1].astype(np.float32))
        assert np.array_equal(dones, expected[2] | expected[3])
        returns += expected[1]
        lengths += 1
        for i, info in enumerate(infos):
            assert bool(info) == bool(dones[i])
            if dones[i]:
                assert (
                    info["terminal_observation"].tobytes() == expected[4]["final_obs"][i].tobytes()
                )
                assert not np.array_equal(info["terminal_observation"], observations[i])
                assert info["TimeLimit.truncated"] == bool(expected[3][i] and not expected[2][i])
                assert info["episode"] == {"r": pytest.approx(returns[i]), "l": lengths[i]}
                metrics = expected[4]["final_info"]["metrics"]
                assert info["metrics"] == {
                    name: metrics[name][i] for name in metrics if name[0] != "_"
                }
                returns[i], lengths[i] = 0.0, 0
                seen.add((bool(expected[2][i]), bool(expected[3][i])))
    # Both kinds of end occurred, failures and time limits, also in one step.
    assert seen == {(True, False), (False, True), (True, True)}


def test_interface_of_the_vec_env():
    env = CapsuleSB3VecEnv(3, controller="baselines:adaptive", render_mode="rgb_array")
    env.seed(3)
    env.reset()
    assert (env.get_attr("max_episode_steps"), env.get_attr("render_mode", [0])) == (
        [1650] * 3,
        ["rgb_array"],
    )
    assert (env.env_is_wrapped(gym.Wrapper), env.env_is_wrapped(Monitor, [0, 2])) == (
        [False] * 3,
        [True] * 2,
    )
    with pytest.raises(AttributeError, match="share their settings"):
        env.set_attr("render_mode", None)
    with pytest.raises(AttributeError, match="attribute `batch`"):
        env.env_method("episode_metrics")
    assert [image.shape[2] for image in env.get_images()] == [3, 3, 3]
    assert (env.close(), env.batch.closed)[1]


def test_options_of_the_next_reset_reach_each_environment_and_only_that_reset():
    env = CapsuleSB3VecEnv(2, seed=0)
    env.set_options(
        [{"M": 0.6, "state": [0.1, 0.0, 0.0, 0.0]}, {"M": 0.7, "state": [0.2, 0.0, 0.0, 0.0]}]
    )
    observations = env.reset()
    assert env.batch.simulation.row(Row.M).tolist() == [0.6, 0.7]
    assert observations[:, 0].tolist() == pytest.approx([0.1, 0.2])
    env.reset()
    assert (env.batch.simulation.row(Row.M) <= 0.55).all()
    env.set_options([{"M": 0.6}, {}])
    with pytest.raises(ValueError, match="same keys"):
        env.reset()


@pytest.mark.parametrize(
    ("kwargs", "entries"),
    [
        ({"randomization": "wide"}, 2),
        ({"disturbances": "real", "randomization": "real-wide"}, 2 + 4 + 4 + 3),
    ],
)
def test_a_privileged_critic_observes_the_plant_and_the_true_state(kwargs, entries):
    ours = CapsuleSB3VecEnv(70, seed=4, privileged=True, max_episode_steps=10, **kwargs)
    native = CapsuleVectorEnv(70, autoreset_mode="SAME_STEP", max_episode_steps=10, **kwargs)
    assert ours.observation_space["critic"] == gym.spaces.Box(
        -np.inf, np.inf, (entries,), np.float32
    )

    def check(found, observations, info, rows):
        assert found["policy"].tobytes() == observations.tobytes()
        assert found["critic"].dtype == np.float32
        expected = [info["M"], np.log(info["mu"])]
        if "disturbances" in kwargs:
            expected += [info["capsule"][name] for name in ("m", "l", "k", "c")]
            expected += [
                info["disturbances"][f"{name}_bias"] for name in ("theta", "theta_dot", "x_dot")
            ]
            expected += [info["disturbances"]["latency"], *info["state"].T[[0, 1, 3]]]
        np.testing.assert_array_equal(found["critic"], np.array(expected, np.float32).T[rows])

    every = np.arange(70)
    check(ours.reset(), *native.reset(seed=4), every)
    rng = np.random.default_rng(0)
    for _ in range(25):
        actions = rng.uniform(-1, 1, (70, 1)).astype(np.float32)
        found, _, dones, infos = ours.step(actions)
        observations, _, _, _, info = native.step(actions)
        check(found, observations, info, every)
        for i in np.flatnonzero(dones):
            check(infos[i]["terminal_observation"], info["final_obs"][i], info["final_info"], i)


def test_fixed_scales_multiply_observations():
    factors = np.array([0.5, 1.0, 2.0, 3.0, 4.0])
    env = VecNormalize(CapsuleSB3VecEnv(2, seed=0), clip_obs=100.0)
    env.obs_rms = FixedScale(factors)
    env.reset()
    assert env.normalize_obs(np.array([1.0, -1.0, 0.5, 1.0, 10.0])) == pytest.approx(
        factors * [1, -1, 0.5, 1, 10]
    )


def test_the_actor_ignores_what_only_the_critic_observes(tmp_path):
    env = CapsuleSB3VecEnv(4, seed=0, privileged=True, max_episode_steps=20, randomization="wide")
    model = PPO(AsymmetricPolicy, env, n_steps=16, batch_size=32, seed=0, device="cpu")
    before = [parameter.clone() for parameter in model.policy.parameters()]
    model.learn(128)
    assert all(
        not torch.equal(*each) for each in zip(before, model.policy.parameters(), strict=True)
    )
    model.save(tmp_path / "model.zip")
    model = PPO.load(tmp_path / "model.zip", device="cpu")
    observations = env.reset()
    changed = {**observations, "critic": observations["critic"] + 1.0}
    np.testing.assert_array_equal(
        *(model.predict(each, deterministic=True)[0] for each in (observations, changed))
    )
    values = [
        model.policy.predict_values(model.policy.obs_to_tensor(each)[0])
        for each in (observations, changed)
    ]
    assert (values[0] != values[1]).all()
