"""Stable-Baselines3's PPO with a compiled rollout and a compiled update."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.distributions import Distribution
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.torch_layers import MlpExtractor
from stable_baselines3.common.utils import explained_variance
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from agents.fast_ppo.collection import Rollout, RolloutVecEnv
from agents.fast_ppo.update import LOSSES, pack, unpack, update
from agents.training.algorithms import HALF_LOG_2_PI, FastTanh
from capsule_gym import network
from capsule_gym.network import Layer


class FastPolicy(ActorCriticPolicy):
    """A policy and a critic with separate networks; the critic may have more inputs.

    Args:
        observation_space: space of the inputs of policy and critic.
        action_space: space of a single action.
        lr_schedule: as in SB3.
        policy_inputs: number of entries, from the first on, that the policy observes; the critic observes all entries.
        tanh_mean: whether tanh maps the mean to [-1, 1].
        least_log_std: lower bound of the logarithm of the standard deviation.
        **kwargs: as in SB3.
    """

    def __init__(
        self,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        lr_schedule: Callable[[float], float],
        *,
        policy_inputs: int,
        tanh_mean: bool = False,
        least_log_std: float = -20.0,
        **kwargs: Any,
    ) -> None:
        self.policy_inputs, self.tanh_mean, self.least_log_std = policy_inputs, tanh_mean, least_log_std
        super().__init__(observation_space, action_space, lr_schedule, **kwargs)

    def _build_mlp_extractor(self) -> None:
        """Builds the hidden layers; those of the policy get only the policy's inputs."""
        super()._build_mlp_extractor()
        layers = MlpExtractor(self.policy_inputs, self.net_arch, self.activation_fn, self.device).policy_net
        layers.register_forward_pre_hook(lambda _, given: (given[0][..., : self.policy_inputs],))
        self.mlp_extractor.policy_net = layers

    def mean_and_log_std(self, latent: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean and logarithmic standard deviation of the action, shapes (n, 1) and (1,), from the last hidden layer."""
        mean = self.action_net(latent)
        return FastTanh()(mean) if self.tanh_mean else mean, self.log_std.clamp_min(self.least_log_std)

    def _get_action_dist_from_latent(self, latent_pi: torch.Tensor) -> Distribution:
        return self.action_dist.proba_distribution(*self.mean_and_log_std(latent_pi))


class FastPPO(PPO):
    """Stable-Baselines3's PPO with the rollout and the update each in one compiled call.

    The loss, its gradients, Adam, the advantages, bootstrapping at time limits and the random minibatches are those of
    SB3, up to float32 rounding. The differences are:

    Always:
        - Observations are normalised with the statistics of the previous rollouts, which are constant during a rollout
          and its update. `VecNormalize` updates them at every step.
        - The first rollout only measures these statistics and is not used for learning.
        - Training episodes begin staggered in time, so that a rollout contains every part of an episode.
        - Torch's generator draws one permutation per epoch for the minibatches; SB3 uses numpy's generator.
        - tanh is computed as 2 / (1 + exp(-2 x)) - 1, in float32.
        - Only one action, `RolloutVecEnv` in a `VecNormalize`, and `FastPolicy` with tanh are supported. gSDE, clipping
          of the value function, a target divergence, squashed actions, other constants of Adam than SB3's, and
          advantages that are not normalised are not supported.

    With options:
        - `least_log_std`: lower bound on the log standard deviation of the actions; below it the gradient is 0.
        - `tanh_mean`: tanh maps the mean of the action to [-1, 1].
        - `critic_steps`: in the first steps only the critic learns (the advantages are 0).
        - `privileged_critic`: the critic observes M and log(mu) in addition to the policy's inputs; in disturbed
          environments also the state, the motor's torque, the latency, the errors of the sensors and m, l, k and c.
        - `output="torque"`: the network's output is the total torque; the action is this torque minus the law's torque.
        - `identifies`: online estimates of M and mu are inputs of the policy.
        - `energy_weights`: every episode draws an energy weight, whose logarithm is an input of the policy.
        - `jump_rate`: M and mu are drawn anew within episodes.

    The networks of actor and critic are updated in two threads.
    """

    policy: FastPolicy
    critic_steps = 0
    """Environment steps at the start in which only the critic learns."""

    def collect_rollouts(
        self, env: VecEnv, callback: BaseCallback, rollout_buffer: RolloutBuffer, n_rollout_steps: int
    ) -> bool:
        """Fills the rollout buffer; returns whether to continue."""
        assert isinstance(env, VecNormalize) and isinstance(env.venv, RolloutVecEnv)
        self.policy.set_training_mode(False)
        callback.on_rollout_start()
        rms: Any = env.obs_rms
        if self._n_updates == 0:
            rollout = self._collect(env, n_rollout_steps)
            # Replaces the statistics, which contain the observations of the reset.
            rms = RunningMeanStd(shape=(env.venv.columns,))
            rms.update(rollout.inputs.reshape(-1, env.venv.columns))
            env.obs_rms = rms
            if not self._count(rollout, callback):
                return False
        rollout = self._collect(env, n_rollout_steps)
        going_on = self._count(rollout, callback)
        self._fill(env, rollout, rollout_buffer)
        rms.update(rollout.inputs.reshape(-1, env.venv.columns))
        callback.on_rollout_end()
        return going_on

    def _collect(self, env: VecNormalize, steps: int) -> Rollout:
        """Collects a rollout with the current policy."""
        venv: Any = env.venv
        rms: Any = env.obs_rms
        policy = self.policy
        layers, _, _ = self._arrays(torch.Tensor.detach)
        header = venv.header._replace(layers=len(layers), tanh_squashing=policy.tanh_mean, clip=env.clip_obs)
        mean, variance = rms.mean[: header.inputs], rms.var[: header.inputs]
        acting = network.pack(layers, mean, 1.0 / np.sqrt(variance + env.epsilon), header)
        deviation = float(policy.log_std.detach().clamp_min(policy.least_log_std).exp())
        noise = torch.randn(steps, self.n_envs).double().numpy()
        chances = torch.rand(steps if venv.jump > 0.0 else 0, self.n_envs, 3).double().numpy()
        return venv.collect(acting, deviation, noise, chances)

    def _count(self, rollout: Rollout, callback: BaseCallback) -> bool:
        """Counts a rollout's steps and reports its episodes; returns whether to continue."""
        self.num_timesteps += rollout.rewards.size
        infos = rollout.infos
        self._update_info_buffer(infos)
        callback.update_locals(locals())
        return callback.on_step()

    @torch.no_grad()
    def _fill(self, env: VecNormalize, rollout: Rollout, buffer: RolloutBuffer) -> None:
        """Fills the buffer with a rollout and its values, log probabilities, returns and advantages."""
        steps, count, columns = rollout.inputs.shape
        inputs = torch.from_numpy(env.normalize_obs(rollout.inputs.reshape(-1, columns)))
        values = self.policy.predict_values(inputs).numpy().reshape(steps, count)
        rewards = rollout.rewards
        beyond = self.policy.predict_values(torch.from_numpy(env.normalize_obs(rollout.cut_inputs))).numpy().ravel()
        rewards[rollout.cut[:, 0], rollout.cut[:, 1]] += self.gamma * beyond
        buffer.observations, buffer.actions = inputs.numpy().reshape(rollout.inputs.shape), rollout.actions
        buffer.values, buffer.rewards, buffer.episode_starts = values, rewards, rollout.starts
        buffer.advantages = np.empty_like(values)
        last = self.policy.predict_values(torch.from_numpy(env.normalize_obs(rollout.last)))
        buffer.compute_returns_and_advantage(last, rollout.over)
        if self.num_timesteps <= self.critic_steps:
            # Zero advantages give a zero gradient of the policy loss.
            buffer.advantages = np.zeros_like(values)
        actions = torch.from_numpy(rollout.actions.reshape(-1, 1))
        mean, log_std = self.policy.mean_and_log_std(self.policy.mlp_extractor.forward_actor(inputs))
        # The logarithm of a normal density.
        log_probs = -0.5 * ((actions - mean) * (-log_std).exp()).square() - log_std - HALF_LOG_2_PI
        buffer.log_probs = log_probs.numpy()

    def train(self) -> None:
        """Makes `n_epochs` passes over the rollout."""
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        clip_range: Any = self.clip_range
        buffer = self.rollout_buffer
        inputs = buffer.observations.reshape(-1, buffer.observations.shape[-1])
        orders = torch.stack([torch.randperm(len(inputs)) for _ in range(self.n_epochs)]).numpy()
        states = self._states()
        changed = [
            self._arrays(torch.Tensor.detach),
            self._arrays(lambda parameter: states[parameter]["exp_avg"]),
            self._arrays(lambda parameter: states[parameter]["exp_avg_sq"]),
        ]
        packed = [pack([*actor, *critic], log_std) for actor, critic, log_std in changed]
        actor, critic = (
            np.array([layers[0][0].shape[1], *(len(bias) for _, bias in layers)]) for layers in changed[0][:2]
        )
        losses = update(
            self.batch_size,
            clip_range(self._current_progress_remaining),
            self.ent_coef,
            self.vf_coef,
            self.max_grad_norm,
            self.policy.optimizer.param_groups[0]["lr"],
            int(states[self.policy.log_std]["step"]),
            self.policy.tanh_mean,
            self.policy.least_log_std,
            *(actor, critic, orders, inputs, buffer.actions.ravel(), buffer.log_probs.ravel()),
            *(buffer.advantages.ravel(), buffer.returns.ravel(), *packed),
        )
        for array, (of_actor, of_critic, log_std) in zip(packed, changed, strict=True):
            unpack(array, [*of_actor, *of_critic], log_std)
        for state in states.values():
            state["step"] += self.n_epochs * -(-len(inputs) // self.batch_size)
        self._n_updates += self.n_epochs
        for name, value in zip(LOSSES, losses.tolist(), strict=True):
            self.logger.record(f"train/{name}", value)
        explained = explained_variance(buffer.values.ravel(), buffer.returns.ravel())
        self.logger.record("train/explained_variance", explained)
        self.logger.record("train/std", self.policy.log_std.exp().item())
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")

    def _states(self) -> dict[torch.Tensor, dict[str, torch.Tensor]]:
        """Adam's state of every parameter; zeros before the first step."""
        states: Any = self.policy.optimizer.state
        for parameter in self.policy.parameters():
            if not states[parameter]:
                moments = {name: torch.zeros_like(parameter.detach()) for name in ("exp_avg", "exp_avg_sq")}
                states[parameter] = {"step": torch.zeros(()), **moments}
        return states

    def _arrays(self, of: Callable[[torch.Tensor], torch.Tensor]) -> tuple[list[Layer], list[Layer], np.ndarray]:
        """Arrays of actor, critic and log_std that share the memory of the tensors `of(parameter)`."""
        policy: Any = self.policy
        hidden = policy.mlp_extractor
        networks = [*hidden.policy_net[::2], policy.action_net], [*hidden.value_net[::2], policy.value_net]
        actor, critic = (
            [(of(layer.weight).numpy(), of(layer.bias).numpy()) for layer in layers] for layers in networks
        )
        return actor, critic, of(policy.log_std).numpy()
