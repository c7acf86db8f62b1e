"""The native batch as a `VecEnv` of Stable-Baselines3.

This is the only module that needs that library (extra `sb3`). A model saved with `AsymmetricPolicy`
loads wherever this package and Stable-Baselines3 are installed.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from capsule_gym.checks import check_flag, require
from capsule_gym.envs.simulation import check_seed
from capsule_gym.envs.vector_env import CapsuleVectorEnv
from capsule_gym.parameters import DISTURBANCES, Disturbances

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.policies import MultiInputActorCriticPolicy
    from stable_baselines3.common.running_mean_std import RunningMeanStd
    from stable_baselines3.common.torch_layers import MlpExtractor
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import (
        VecEnvIndices,
        VecEnvObs,
        VecEnvStepReturn,
    )
    from torch import Tensor, nn
except ImportError as error:
    message = 'capsule_gym.sb3 needs Stable-Baselines3: pip install "capsule-gym[sb3]"'
    raise ImportError(message) from error

# A critic observes the logarithm of mu, which may be 0.
LEAST_MU = 1e-3


class CapsuleSB3VecEnv(VecEnv):
    """The native batch as a `VecEnv` of Stable-Baselines3, without a Python loop over environments.

    It replaces `make_vec_env("capsule_gym:CapsuleStickSlip-v0", n_envs=num_envs)`. The info of an
    environment contains the "cost" of the step, and is the same dict at every step without one. At
    the end of an episode it also contains "terminal_observation", "TimeLimit.truncated", "episode"
    with the return "r" and the length "l" as in SB3's `Monitor`, and "metrics"
    (`capsule_gym.tasks.task.METRICS`, and the task's). With `goal_env=True` every info contains the
    terms that `HerReplayBuffer(copy_info_dict=True)` adds to a reward.

    Args:
        num_envs: number of environments.
        seed: environment i gets seed + i.
        privileged: give observations {"policy": .., "critic": ..}. "policy" is the environment's
            observation; "critic" is what only a critic may see in training: M in kg, log(mu), and
            all other constants of the plant and disturbances that an episode draws, and where the
            agent observes sensors, the true theta, theta_dot and x_dot. `AsymmetricPolicy` is for
            these observations.
        **env_kwargs: arguments of `CapsuleVectorEnv` except `autoreset_mode`.

    Raises:
        TypeError: if an argument is of the wrong type, or `autoreset_mode` is given.
        ValueError: if an argument is out of range.

    Attributes:
        batch: the `CapsuleVectorEnv`, stepped with SAME_STEP.
    """

    def __init__(
        self, num_envs: int, seed: int | None = None, *, privileged: bool = False, **env_kwargs: Any
    ) -> None:
        self.privileged = check_flag("privileged", privileged)
        self.batch = CapsuleVectorEnv(
            num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **env_kwargs
        )
        simulation = self.batch.simulation
        self._goals = simulation.options.goal_env
        fits = not (self.privileged and self._goals)
        require(fits, "privileged", "False with goal_env=True", privileged)
        self._actions: np.ndarray | None = None
        # Creating infos at every step takes longer than what SB3 does with them.
        self._free_infos: list[dict[str, Any]] = [{"cost": 0.0} for _ in range(num_envs)]
        self._returns = np.zeros(num_envs)
        self._lengths = np.zeros(num_envs, np.int64)
        space: gym.spaces.Space[Any] = self.batch.single_observation_space
        if self.privileged:
            disturbed = Disturbances.named(simulation.options.disturbances) or Disturbances()
            self._drawn_constants = simulation.randomization.drawn
            ranges = {name: getattr(disturbed, name) for name in DISTURBANCES}
            self._drawn_disturbances = [
                name for name, value in ranges.items() if isinstance(value, tuple)
            ]
            self._reads = simulation.settings.agent_reads
            entries = 2 + len(self._drawn_constants) + len(self._drawn_disturbances)
            if self._reads:
                entries += 3
            critic = gym.spaces.Box(-np.inf, np.inf, (entries,), np.float32)
            space = gym.spaces.Dict({"policy": space, "critic": critic})
        super().__init__(num_envs, space, self.batch.single_action_space)
        # `VecVideoRecorder` reads the frames per second here.
        self.metadata = self.batch.metadata
        if seed is not None:
            self.seed(check_seed(seed, count=num_envs))

    def reset(self) -> VecEnvObs:
        """Begins new episodes with the options of `set_options`; returns the observations.

        Raises:
            ValueError: if the options of the environments have different keys, or an option is
                unknown or out of range.
        """
        # SB3's options are one dict per environment; under each key the batch takes a value per
        # environment.
        names = self._options[0].keys()
        same = all(options.keys() == names for options in self._options)
        require(same, "options", "dicts with the same keys for every environment", self._options)
        gathered = {name: [options[name] for options in self._options] for name in names}
        observations, info = self.batch.reset(seed=self._seeds, options=gathered or None)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return self._with_critic(observations, info)

    def _with_critic(self, observations: Any, info: dict[str, Any]) -> VecEnvObs:
        """The observations, with those of the critic from an info of the batch if privileged."""
        if not self.privileged:
            return observations
        columns = [info["M"], np.log(np.maximum(info["mu"], LEAST_MU))]
        columns += [info["capsule"][name] for name in self._drawn_constants]
        columns += [info["disturbances"][name] for name in self._drawn_disturbances]
        if self._reads:
            theta, theta_dot, _, x_dot = info["state"].T
            columns += [theta, theta_dot, x_dot]
        return {"policy": observations, "critic": np.array(columns, np.float32).T}

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
        infos = self._goal_infos(info, dones) if self._goals else self._free_infos.copy()
        costs = info["cost"]
        if dones.any():
            costs = np.where(dones, info["final_info"]["cost"], costs)
        for i in np.flatnonzero(costs).tolist():
            infos[i] = {**infos[i], "cost": float(costs[i])}
        if dones.any():
            last = self._with_critic(info["final_obs"], info["final_info"])
            metrics = info["final_info"]["metrics"]
            names = [name for name in metrics if not name.startswith("_")]
            for i in np.flatnonzero(dones).tolist():
                infos[i] = {
                    **infos[i],
                    "terminal_observation": _row(last, i),
                    "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                    "episode": {"r": float(self._returns[i]), "l": int(self._lengths[i])},
                    "metrics": {name: float(metrics[name][i]) for name in names},
                }
            self._returns[dones] = 0.0
            self._lengths[dones] = 0
        return self._with_critic(observations, info), rewards.astype(np.float32), dones, infos

    def _goal_infos(self, info: dict[str, Any], dones: np.ndarray) -> list[dict[str, Any]]:
        """The terms of the rewards that do not depend on the goal, for each environment."""
        last = info["final_info"] if dones.any() else info
        names = ("reward_energy", "reward_termination")
        terms = [np.where(dones, last[name], info[name]).tolist() for name in names]
        rows = zip(*terms, strict=True)
        return [{"cost": 0.0, **dict(zip(names, values, strict=True))} for values in rows]

    def close(self) -> None:
        """Ends the threads of the batch."""
        self.batch.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """One frame per environment."""
        return self.batch.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of the batch, once per requested environment."""
        return [getattr(self.batch, attr_name)] * self._count(indices)

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raises an AttributeError, since the environments of a batch share their settings."""
        raise AttributeError(
            f"cannot set {attr_name!r}: the environments of a batch share their settings"
        )

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Calls `compute_reward`; other methods raise an AttributeError.

        A batch has no separate environments.
        """
        if method_name == "compute_reward":
            return [self.batch.compute_reward(*args, **kwargs)] * self._count(indices)
        raise AttributeError(
            f"cannot call {method_name!r} of one environment: call it of the attribute `batch`"
        )

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper], indices: VecEnvIndices = None
    ) -> list[bool]:
        """False except for `Monitor`: then SB3 evaluates whole episodes, which infos contain."""
        return [wrapper_class is Monitor] * self._count(indices)

    def _count(self, indices: VecEnvIndices) -> int:
        """The number of requested environments."""
        return len(list(self._get_indices(indices)))


def _row(observations: Any, i: int) -> Any:
    """The observation of environment i from an array or a dict of arrays."""
    if isinstance(observations, dict):
        return {name: part[i] for name, part in observations.items()}
    return observations[i]


class FixedScale(RunningMeanStd):
    """Statistics with which SB3's `VecNormalize` multiplies an observation by fixed factors.

    Assign it to `env.obs_rms`, or to its entry "policy" where observations are dicts.

    Running statistics would magnify `stick`, which is almost constant. `VecNormalize.training =
    False` would also stop the normalisation of rewards.

    Args:
        factors: the factor of each entry of the observation, shape (entries,), > 0.
    """

    def __init__(self, factors: np.ndarray) -> None:
        super().__init__(shape=factors.shape)
        self.var = factors**-2.0

    def update(self, arr: np.ndarray) -> None:
        """Changes nothing."""


class _Last(nn.Module):
    """The last entries of the features."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self.count = count

    def forward(self, features: Tensor) -> Tensor:
        """Features of shape (.., all) to (.., count)."""
        return features[..., -self.count :]


class AsymmetricPolicy(MultiInputActorCriticPolicy):
    """A policy of SB3's `PPO` whose critic sees more: for `CapsuleSB3VecEnv(privileged=True)`.

    The actor takes the observation "policy", the critic that and the observation "critic" (Pinto et
    al., "Asymmetric actor critic for image-based robot learning", 2018). `predict` also takes both,
    but its actions depend only on "policy". Arguments are those of SB3's
    `MultiInputActorCriticPolicy`.
    """

    def _build_mlp_extractor(self) -> None:
        # The features are both observations, in the order of their names: the critic's, then the
        # policy's.
        super()._build_mlp_extractor()
        assert isinstance(self.observation_space, gym.spaces.Dict)
        (observed,) = self.observation_space["policy"].shape or ()
        actor = MlpExtractor(observed, self.net_arch, self.activation_fn, self.device)
        self.mlp_extractor.policy_net = nn.Sequential(_Last(observed), *actor.policy_net)
