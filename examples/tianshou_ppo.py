"""Tianshou's high-level interface: PPO by the environment's id."""

import argparse

from tianshou.highlevel.config import OnPolicyTrainingConfig  # pip install -e ".[tianshou]"
from tianshou.highlevel.env import EnvFactoryRegistered, VectorEnvType
from tianshou.highlevel.experiment import ExperimentConfig, PPOExperimentBuilder

ID = "capsule_gym:CapsuleStickSlip-v0"


def main() -> None:
    """Trains."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=30_000, help="of an epoch; there are ten")
    steps = parser.parse_args().steps

    experiment = (
        PPOExperimentBuilder(
            EnvFactoryRegistered(task=ID, venv_type=VectorEnvType.DUMMY),
            ExperimentConfig(seed=0, watch=False, persistence_enabled=False, device="cpu"),
            OnPolicyTrainingConfig(
                max_epochs=10,
                epoch_num_steps=steps,
                collection_step_num_env_steps=min(steps, 2048),
                num_training_envs=8,
                num_test_envs=4,
                batch_size=256,
            ),
        )
        .with_actor_factory_default((64, 64))
        .with_critic_factory_default((64, 64))
        .build()
    )
    print(experiment.run().trainer_result)


if __name__ == "__main__":
    main()
