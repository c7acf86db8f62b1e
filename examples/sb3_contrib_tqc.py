"""sb3-contrib: TQC, and PPO with an LSTM, by the environment's id, in processes of their own."""

import argparse

from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv

from capsule_gym.sb3 import CapsuleSB3VecEnv

ID = "capsule_gym:CapsuleStickSlip-v0"
ON_THE_GAIT = {"controller": "baselines:gait", "residual_limit": 0.75}


def main() -> None:
    """Trains both."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=100_000)
    steps = parser.parse_args().steps

    # The prefix makes each worker import the package, which registers the environment.
    env = make_vec_env(ID, n_envs=2, seed=0, vec_env_cls=SubprocVecEnv, env_kwargs=ON_THE_GAIT)
    TQC("MlpPolicy", env, learning_starts=100, seed=0, device="cpu", verbose=1).learn(steps, log_interval=1)
    env.close()

    batch = CapsuleSB3VecEnv(8, seed=0, **ON_THE_GAIT)
    RecurrentPPO("MlpLstmPolicy", batch, n_steps=64, seed=0, device="cpu", verbose=1).learn(steps)


if __name__ == "__main__":
    main()
