import gymnasium as gym
import numpy as np


class Swing(gym.ObservationWrapper):
    """Rewards the speed of the pendulum, observes only its angle and speed, and ends episodes at 4
    rad/s."""

    def __init__(self, env):
        super().__init__(env)
        space = env.observation_space
        self.observation_space = gym.spaces.Box(space.low[:2], space.high[:2], dtype=np.float32)

    def observation(self, observation):
        return observation[:2]

    def step(self, action):
        observation, _, terminated, truncated, info = super().step(action)
        speed = abs(float(info["state"][1]))
        return observation, speed, terminated or speed > 4.0, truncated, info


class Unpicklable(gym.Wrapper):
    def __init__(self, env):
        super().__init__(env)
        self.scale = lambda reward: reward


class TwoArguments(gym.Wrapper):
    def __init__(self, env, weight):
        super().__init__(env)


class Discrete(gym.ActionWrapper):
    """Offers the smallest and the largest torque."""

    def __init__(self, env):
        super().__init__(env)
        self.action_space = gym.spaces.Discrete(2)


class Longer(gym.ObservationWrapper):
    """Adds a constant to the observation."""

    def __init__(self, env):
        super().__init__(env)
        space = env.observation_space
        low = np.append(space.low, np.float32(0.0))
        high = np.append(space.high, np.float32(1.0))
        self.observation_space = gym.spaces.Box(low, high, dtype=np.float32)

    def observation(self, observation):
        return np.append(observation, np.float32(1.0))
