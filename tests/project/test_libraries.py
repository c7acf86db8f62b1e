"""Other libraries' ways with an environment, each as its documentation shows it; skipped where one is not installed.

pip install torchrl minari h5py          # or, in an environment of its own:
pip install "tianshou[eval]>=2" docstring_parser jsonargparse
"""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import capsule_gym
from tests.capsule_gym.fakes import layout

# Theirs, not ours.
pytestmark = pytest.mark.filterwarnings("ignore")

VARIANTS = pytest.mark.parametrize("kwargs", [{}, {"controller": "baselines:adaptive"}], ids=["direct", "adaptive"])
HORIZON = 30


@VARIANTS
def test_tianshous_experiments_train(kwargs, tmp_path, monkeypatch):
    experiments = pytest.importorskip("tianshou.highlevel.experiment", exc_type=ImportError)
    from tianshou.highlevel.config import OnPolicyTrainingConfig
    from tianshou.highlevel.env import EnvFactoryRegistered, VectorEnvType

    monkeypatch.chdir(tmp_path)  # where it writes its log
    name = f"capsule_gym:{capsule_gym.ENV_ID}"
    environments = EnvFactoryRegistered(task=name, venv_type=VectorEnvType.DUMMY, max_episode_steps=HORIZON, **kwargs)
    config = experiments.ExperimentConfig(persistence_enabled=False, watch=False)
    # Two test episodes before the epoch and after it, and five ends of each environment on the way.
    training = OnPolicyTrainingConfig(
        max_epochs=1,
        epoch_num_steps=600,
        num_training_envs=4,
        num_test_envs=2,
        test_step_num_episodes=2,
        collection_step_num_env_steps=200,
        buffer_size=1000,
    )
    result = experiments.PPOExperimentBuilder(environments, config, training).build().run().trainer_result
    assert result.train_step == 600
    assert result.train_episode >= 4
    assert np.isfinite(result.best_reward)


@VARIANTS
@pytest.mark.parametrize("n", [None, 3], ids=["single", "batch"])
def test_torchrl_registers_the_infos_and_rolls_out(n, kwargs):
    envs = pytest.importorskip("torchrl.envs")
    if n is None:
        # A batch's infos are registered by themselves.
        made = gym.make(capsule_gym.ENV_ID, max_episode_steps=HORIZON, **kwargs)
        env = envs.GymWrapper(made).auto_register_info_dict()
    else:
        kwargs = {"autoreset_mode": "SAME_STEP", "max_episode_steps": HORIZON, **kwargs}
        env = envs.GymWrapper(gym.make_vec(capsule_gym.ENV_ID, num_envs=n, **kwargs))
    rollout = env.rollout(4 * HORIZON, break_when_any_done=False)
    assert int(rollout["next", "done"].sum()) >= 4
    expected = layout(gym.make(capsule_gym.ENV_ID).reset(seed=0)[1])
    for name, (_, dtype, shape) in expected.items():
        values = rollout["next", name].numpy()
        assert values.dtype == dtype, name
        assert values.reshape(*rollout.batch_size, *shape).shape[-1 - len(shape)] == 4 * HORIZON, name
    env.close()


@VARIANTS
def test_minari_records_the_infos(kwargs, tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    pytest.importorskip("h5py")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = minari.DataCollector(gym.make(capsule_gym.ENV_ID, max_episode_steps=HORIZON, **kwargs), record_infos=True)
    _, info = env.reset(seed=0)
    expected = layout(info)
    episodes = 0
    while episodes < 3:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            episodes += 1
            env.reset()
    data = env.create_dataset("capsule/test-v0", algorithm_name="random")
    assert data.total_episodes == 3
    for episode in data:
        assert set(episode.infos) == set(expected)
        for name, (_, dtype, shape) in expected.items():
            assert episode.infos[name].dtype == dtype, name
            # The reset's is the first.
            assert episode.infos[name].shape == (len(episode.actions) + 1, *shape), name
    again = data.recover_environment()
    assert again.spec.max_episode_steps == HORIZON
    assert np.array_equal(again.reset(seed=0)[1]["state"], info["state"])
    env.close()
