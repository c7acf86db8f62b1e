"""skrl: PPO on the native batch."""

import argparse

import gymnasium as gym
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.trainers.torch import SequentialTrainer
from skrl.utils.model_instantiators.torch import deterministic_model, gaussian_model

ID = "capsule_gym:CapsuleStickSlip-v0"
LAYERS = [{"name": "net", "input": "OBSERVATIONS", "layers": [64, 64], "activations": "tanh"}]


def main() -> None:
    """Trains."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000, help="of each environment")
    steps = parser.parse_args().steps

    # skrl takes the returned observation for the next one. With SAME_STEP, it is the first of the new episode.
    env = wrap_env(gym.make_vec(ID, num_envs=64, autoreset_mode="SAME_STEP"))
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space, "device": env.device}
    models = {
        "policy": gaussian_model(**spaces, network=LAYERS, output="ACTIONS"),
        "value": deterministic_model(**spaces, network=LAYERS, output="ONE"),
    }
    memory = RandomMemory(memory_size=128, num_envs=env.num_envs, device=env.device)
    cfg = PPO_CFG(rollouts=128, mini_batches=8, time_limit_bootstrap=True)
    agent = PPO(models=models, memory=memory, cfg=cfg, **spaces)
    SequentialTrainer(env=env, agents=agent, cfg={"timesteps": steps, "headless": True}).train()


if __name__ == "__main__":
    main()
