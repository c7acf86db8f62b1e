"""TorchRL: one environment, its pixels, and the native batch, each as a rollout in a TensorDict."""

import argparse

import gymnasium as gym
from torchrl.envs import GymEnv, GymWrapper  # pip install -e ".[torchrl]"

ID = "capsule_gym:CapsuleStickSlip-v0"


def main() -> None:
    """Shows the three rollouts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=200)
    steps = parser.parse_args().steps

    single = GymEnv(ID, controller="baselines:adaptive", residual_limit=0.1)
    single.set_seed(0)
    print(single.rollout(steps)["next", "reward"].sum().item(), "cm in", steps, "steps")

    pixels = GymEnv(ID, from_pixels=True, pixels_only=True)
    print(pixels.rollout(3)["pixels"].shape)

    # TorchRL supports two autoreset modes; gymnasium's default is the third.
    batch = GymWrapper(gym.make_vec(ID, num_envs=64, autoreset_mode="SAME_STEP"))
    batch.set_seed(0)
    data = batch.rollout(steps, break_when_any_done=False)
    print(data.shape, "steps,", data["next", "terminated"].sum().item(), "failures")


if __name__ == "__main__":
    main()
