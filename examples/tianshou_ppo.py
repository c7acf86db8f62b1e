"""Tianshou's high-level interface: PPO by the environment's id."""

import argparse

from tianshou.highlevel.config import OnPolicyTrainingConfig  # pip install -e ".[tianshou]"
from tianshou.highlevel.env import EnvFactoryRegistered, VectorEnvType
from tianshou.highlevel.experiment import ExperimentConfig, PPOExperimentBuilder

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=30_000, help="of an epoch; there are ten")
args = parser.parse_args()

env_id = "capsule_gym:CapsuleStickSlip-v0"
envs = EnvFactoryRegistered(task=env_id, venv_type=VectorEnvType.DUMMY)
options = ExperimentConfig(watch=False, persistence_enabled=False)
training = OnPolicyTrainingConfig(
    max_epochs=10, epoch_num_steps=args.steps, num_training_envs=8, num_test_envs=4
)
experiment = PPOExperimentBuilder(envs, options, training).build()
print(experiment.run().trainer_result)
