"""TorchRL: one environment, its pixels, and the native batch, each as a rollout in a TensorDict."""

import gymnasium as gym
from torchrl.envs import GymEnv, GymWrapper  # pip install -e ".[torchrl]"

ID = "capsule_gym:CapsuleStickSlip-v0"

single = GymEnv(ID, controller="baselines:adaptive", residual_limit=0.1)
print(single.rollout(50)["next", "reward"].sum().item(), "cm in 50 steps")

pixels = GymEnv(ID, from_pixels=True, pixels_only=True)
print(pixels.rollout(3)["pixels"].shape)

# TorchRL supports two autoreset modes; gymnasium's default is the third.
batch = GymWrapper(gym.make_vec(ID, num_envs=64, autoreset_mode="SAME_STEP"))
data = batch.rollout(50, break_when_any_done=False)
print(data.shape, "steps,", data["next", "terminated"].sum().item(), "failures")
