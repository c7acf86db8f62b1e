"""The native batch as a `VecEnv` of Stable-Baselines3, the only module that needs that library (extra `sb3`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from capsule_gym.checks import written
from capsule_gym.vector_env import CapsuleVectorEnv


class CapsuleSB3VecEnv(VecEnv):
    """The native batch as a `VecEnv` of Stable-Baselines3, without a Python loop over environments.

    It replaces `make_vec_env("capsule_gym:CapsuleStickSlip-v0", n_envs=num_envs)`. The info of an environment is empty
    except at the end of an episode. There it contains "terminal_observation", "TimeLimit.truncated", "episode" with the
    return "r" and the length "l" as in SB3's `Monitor`, and "metrics" (`capsule_gym.task.Metrics`, and the task's).
    With `goal_env=True` every info contains the terms that `HerReplayBuffer(copy_info_dict=True)` adds to a reward.

    Args:
        num_envs: number of environments.
        seed: environment i gets seed + i.
        **env_kwargs: arguments of `CapsuleVectorEnv` except `autoreset_mode`.

    Raises:
        TypeError: if an argument is of the wrong type, or `autoreset_mode` is given.
        ValueError: if an argument is out of range.

    Attributes:
        batch: the `CapsuleVectorEnv`, stepped with SAME_STEP.
    """

    def __init__(self, num_envs: int, seed: int | None = None, **env_kwargs: Any) -> None:
        self.batch = CapsuleVectorEnv(num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **env_kwargs)
        self._actions: np.ndarray | None = None
        self._returns = np.zeros(num_envs)
        self._lengths = np.zeros(num_envs, np.int64)
        super().__init__(num_envs, self.batch.single_observation_space, self.batch.single_action_space)
        if seed is not None:
            self.seed(seed)

    def reset(self) -> VecEnvObs:
        """Begins a new episode in every environment, with the options of `set_options`; returns the observations.

        Raises:
            ValueError: if the options of the environments have different keys, or an option is unknown or out of range.
        """
        # SB3's options are one dict per environment; under each key the batch takes a value per environment.
        names = self._options[0].keys()
        if any(options.keys() != names for options in self._options):
            raise ValueError(f"options must have the same keys for every environment, got {written(self._options)}")
        gathered = {name: [options[name] for options in self._options] for name in names}
        observations, _ = self.batch.reset(seed=self._seeds, options=gathered or None)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the actions of the next step, shape (num_envs, 1)."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Steps; returns observations, rewards (float32), dones and infos."""
        assert self._actions is not None, "step_async() comes before step_wait()"
        observations, rewards, terminated, truncated, info = self.batch.step(self._actions)
        dones = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if self.batch.simulation.options.goal_env:
            last = info["final_info"] if dones.any() else info
            for name in ("reward_energy", "reward_termination"):
                for own, value in zip(infos, np.where(dones, last[name], info[name]), strict=True):
                    own[name] = float(value)
        if dones.any():
            metrics = info["final_info"]["metrics"]
            for i in np.flatnonzero(dones):
                infos[i] |= {
                    "terminal_observation": info["final_obs"][i],
                    "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                    "episode": {"r": float(self._returns[i]), "l": int(self._lengths[i])},
                    "metrics": {name: float(values[i]) for name, values in metrics.items() if name[0] != "_"},
                }
            self._returns[dones] = 0.0
            self._lengths[dones] = 0
        return observations, rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        """Ends the threads of the batch."""
        self.batch.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """One frame per environment."""
        return self.batch.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of the batch, once per requested environment."""
        return [getattr(self.batch, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raises an AttributeError, since the environments of a batch share their settings."""
        raise AttributeError(f"cannot set {attr_name!r}: the environments of a batch share their settings")

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Calls `compute_reward`; other methods raise an AttributeError, since a batch has no separate environments."""
        if method_name == "compute_reward":
            return [self.batch.compute_reward(*args, **kwargs)] * len(list(self._get_indices(indices)))
        raise AttributeError(f"cannot call {method_name!r} of one environment: call it of the attribute `batch`")

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """False except for `Monitor`, whose infos a batch contains: with True, SB3 evaluates whole episodes."""
        return [wrapper_class is Monitor] * len(list(self._get_indices(indices)))
