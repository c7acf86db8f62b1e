"""SAC with compiled updates, several times as fast as with autograd."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numba
import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.sac.policies import LOG_STD_MAX, LOG_STD_MIN

# float32, since numba would otherwise promote arrays to float64.
ZERO, HALF, ONE, TWO = (np.float32(value) for value in (0.0, 0.5, 1.0, 2.0))
LOWEST, HIGHEST = np.float32(LOG_STD_MIN), np.float32(LOG_STD_MAX)
HALF_LOG_2_PI = np.float32(0.5 * math.log(2.0 * math.pi))
# As in SB3: keeps a logarithm finite where tanh has saturated.
EPSILON = np.float32(1e-6)

compiled = numba.njit(cache=True, fastmath=True, error_model="numpy")
# A network is the tuple of its weights and biases: two hidden layers with relu, then one or two outputs.
Network = tuple[np.ndarray, ...]


class FastSAC(SAC):
    """SAC whose `train` computes the gradients and the steps of Adam in compiled code.

    The algorithm is that of SB3: with one update per call and the same seed, the parameters agree up to rounding.

    Dictionary observations, a fixed entropy coefficient, gSDE, batch normalisation and networks other than two hidden
    layers are not supported, because this project does not use them.
    """

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Makes `gradient_steps` updates, each with `batch_size` transitions."""
        assert self.replay_buffer is not None and self.ent_coef_optimizer is not None and self.log_ent_coef is not None
        assert isinstance(self.target_entropy, float) and not self.use_sde
        self.policy.set_training_mode(True)
        self._update_learning_rate([self.actor.optimizer, self.critic.optimizer, self.ent_coef_optimizer])
        parameters, averages = list(self.critic.parameters()), list(self.critic_target.parameters())
        actor, actor_gradient = arrays(self.actor.parameters()), gradients(self.actor.parameters())
        half = len(parameters) // 2
        critics = arrays(parameters[:half]), arrays(parameters[half:])
        critic_gradients = gradients(parameters[:half]), gradients(parameters[half:])
        targets = arrays(averages[:half]), arrays(averages[half:])
        (entropy_gradient,) = gradients([self.log_ent_coef])
        adams = [Adam(each) for each in (self.ent_coef_optimizer, self.critic.optimizer, self.actor.optimizer)]

        data = self.replay_buffer.sample(batch_size * gradient_steps, env=self._vec_normalize_env)
        discounts = (1.0 - data.dones) * (self.gamma if data.discounts is None else data.discounts)
        pairs = torch.cat([data.observations, data.actions], dim=1)
        columns = (data.observations, pairs, data.next_observations, data.rewards[:, 0], discounts[:, 0])
        batches = (column.numpy().reshape(gradient_steps, batch_size, *column.shape[1:]) for column in columns)
        flat_averages, flat_parameters = flat(averages), flat(parameters)
        losses = []
        for x, taken, next_x, rewards, discount in zip(*batches, strict=True):
            noise, next_noise = torch.randn(batch_size).numpy(), torch.randn(batch_size).numpy()
            proposal = propose(actor, x, noise)
            coefficient = np.float32(math.exp(self.log_ent_coef.item()))
            entropy_error = -float(proposal[-1].mean() + self.target_entropy)
            entropy_loss = self.log_ent_coef.item() * entropy_error
            entropy_gradient[:] = entropy_error
            adams[0].step()

            wanted = target(actor, targets, next_x, next_noise, coefficient, rewards, discount)
            critic_loss = differentiate_critics(critics, critic_gradients, taken, wanted)
            adams[1].step()
            actor_loss = differentiate_actor(actor, actor_gradient, critics, x, noise, proposal, coefficient)
            adams[2].step()
            average(flat_averages, flat_parameters, np.float32(self.tau))
            losses.append((coefficient, actor_loss, critic_loss, entropy_loss))
        self._n_updates += gradient_steps
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        names = ("ent_coef", "actor_loss", "critic_loss", "ent_coef_loss")
        for name, mean in zip(names, np.mean(losses, axis=0).tolist(), strict=True):
            self.logger.record(f"train/{name}", mean)


def flat(tensors: Iterable[torch.Tensor]) -> Network:
    """Flat views of the tensors' memory."""
    return tuple(tensor.detach().view(-1).numpy() for tensor in tensors)


def arrays(parameters: Iterable[torch.Tensor]) -> Network:
    """Views of the parameters' memory."""
    return tuple(parameter.detach().numpy() for parameter in parameters)


def gradients(parameters: Iterable[torch.Tensor]) -> Network:
    """Sets the parameters' gradients to zero and returns views of their memory."""
    for parameter in (parameters := list(parameters)):
        parameter.grad = torch.zeros_like(parameter)
    return arrays(parameter.grad for parameter in parameters)


class Adam:
    """Compiled steps of a torch optimizer; they change its parameters and its state in place."""

    def __init__(self, optimizer: torch.optim.Optimizer) -> None:
        (group,) = optimizer.param_groups
        parameters, self.rate = group["params"], np.float32(group["lr"])
        self.decay, self.eps = tuple(map(np.float32, group["betas"])), np.float32(group["eps"])
        for parameter in parameters:
            if not (state := optimizer.state[parameter]):
                moments = {name: torch.zeros_like(parameter) for name in ("exp_avg", "exp_avg_sq")}
                state.update(step=torch.zeros(()), **moments)
        states = [optimizer.state[parameter] for parameter in parameters]
        columns = (
            parameters,
            [parameter.grad for parameter in parameters],
            *([state[name] for state in states] for name in ("exp_avg", "exp_avg_sq", "step")),
        )
        self.columns = tuple(map(flat, columns))

    def step(self) -> None:
        """Makes one step with the current gradients."""
        adam(*self.columns, self.rate, self.decay, self.eps)


@compiled
def adam(parameters: Any, slopes: Any, means: Any, squares: Any, steps: Any, rate: Any, decay: Any, eps: Any) -> None:
    """Makes one step of Adam."""
    for parameter, slope, mean, square, step in zip(parameters, slopes, means, squares, steps):  # noqa: B905 (numba knows no strict)
        step[0] += ONE
        size = rate / np.float32(1.0 - np.float64(decay[0]) ** np.float64(step[0]))
        scale = ONE / np.float32(1.0 - np.float64(decay[1]) ** np.float64(step[0]))
        for i in range(len(parameter)):
            mean[i] += (ONE - decay[0]) * (slope[i] - mean[i])
            square[i] += (ONE - decay[1]) * (slope[i] * slope[i] - square[i])
            parameter[i] -= size * mean[i] / (np.sqrt(square[i] * scale) + eps)


@compiled
def average(averages: Any, parameters: Any, tau: Any) -> None:
    """Updates the moving averages of the parameters with the rate `tau`."""
    for mean, parameter in zip(averages, parameters):  # noqa: B905 (numba knows no strict)
        for i in range(len(mean)):
            mean[i] += tau * (parameter[i] - mean[i])


@compiled
def rectify(y: Any, bias: Any) -> Any:
    """Adds the biases to the rows and applies relu, in place."""
    for i in range(y.shape[0]):
        for j in range(y.shape[1]):
            y[i, j] = max(y[i, j] + bias[j], ZERO)
    return y


@compiled
def gate(slope: Any, outputs: Any) -> Any:
    """Sets the slopes of units with output 0 to 0, in place."""
    for i in range(slope.shape[0]):
        for j in range(slope.shape[1]):
            slope[i, j] = slope[i, j] if outputs[i, j] > ZERO else ZERO
    return slope


@compiled
def hidden(network: Any, x: Any) -> Any:
    """The outputs of both hidden layers."""
    first = rectify(np.dot(x, network[0].T), network[1])
    return first, rectify(np.dot(first, network[2].T), network[3])


@compiled
def differentiate(network: Any, gradient: Any, x: Any, first: Any, second: Any, slope: Any) -> None:
    """Writes the gradients of the hidden layers, given the slope over the second layer's output."""
    ones = np.ones(len(x), np.float32)
    slope = gate(slope, second)
    gradient[2][:], gradient[3][:] = np.dot(slope.T, first), np.dot(ones, slope)
    slope = gate(np.dot(slope, network[2]), first)
    gradient[0][:], gradient[1][:] = np.dot(slope.T, x), np.dot(ones, slope)


@compiled
def propose(actor: Any, x: Any, noise: Any) -> Any:
    """Outputs of both hidden layers, logarithms of the standard deviation, actions, and their log probabilities."""
    first, second = hidden(actor, x)
    mean = np.dot(second, actor[4][0]) + actor[5][0]
    log_std = np.minimum(np.maximum(np.dot(second, actor[6][0]) + actor[7][0], LOWEST), HIGHEST)
    action = np.tanh(mean + np.exp(log_std) * noise)
    density = -HALF * noise * noise - log_std - HALF_LOG_2_PI
    return first, second, log_std, action, density - np.log(ONE - action * action + EPSILON)


@compiled
def value(critic: Any, pairs: Any) -> Any:
    """Values of pairs of observation and action, and the outputs of both hidden layers."""
    first, second = hidden(critic, pairs)
    return np.dot(second, critic[4][0]) + critic[5][0], first, second


@compiled
def value_slope(critic: Any, first: Any, second: Any) -> Any:
    """The derivatives of the values with respect to the action."""
    slope = gate(np.outer(np.ones(len(second), np.float32), critic[4][0]), second)
    slope = gate(np.dot(slope, critic[2]), first)
    return np.dot(slope, np.ascontiguousarray(critic[0][:, -1]))


@compiled
def target(actor: Any, critics: Any, x: Any, noise: Any, coefficient: Any, rewards: Any, discounts: Any) -> Any:
    """The target values of the critics."""
    _, _, _, action, log_prob = propose(actor, x, noise)
    pairs = np.concatenate((x, action.reshape(-1, 1)), axis=1)
    lowest = np.minimum(value(critics[0], pairs)[0], value(critics[1], pairs)[0])
    return rewards + discounts * (lowest - coefficient * log_prob)


@compiled
def differentiate_critics(critics: Any, gradients: Any, pairs: Any, wanted: Any) -> float:
    """Writes the critics' gradients; returns their loss."""
    loss = 0.0
    for critic, gradient in zip(critics, gradients):  # noqa: B905 (numba knows no strict)
        values, first, second = value(critic, pairs)
        error = values - wanted
        loss += 0.5 * (error * error).mean()
        slope = error / np.float32(len(error))
        gradient[4][0], gradient[5][0] = np.dot(slope, second), slope.sum()
        differentiate(critic, gradient, pairs, first, second, np.outer(slope, critic[4][0]))
    return loss


@compiled
def differentiate_actor(
    actor: Any, gradient: Any, critics: Any, x: Any, noise: Any, proposal: Any, coefficient: Any
) -> float:
    """Writes the actor's gradient; returns its loss."""
    first, second, log_std, action, log_prob = proposal
    pairs = np.concatenate((x, action.reshape(-1, 1)), axis=1)
    value_1, first_1, second_1 = value(critics[0], pairs)
    value_2, first_2, second_2 = value(critics[1], pairs)
    slope_1, slope_2 = value_slope(critics[0], first_1, second_1), value_slope(critics[1], first_2, second_2)
    squash, share = ONE - action * action, ONE / np.float32(len(x))
    entropy_slope = coefficient * TWO * action / (squash + EPSILON)
    slope = share * squash * (entropy_slope - np.where(value_1 < value_2, slope_1, slope_2))
    inside = (log_std > LOWEST) & (log_std < HIGHEST)
    std_slope = np.where(inside, slope * np.exp(log_std) * noise - share * coefficient, ZERO)
    gradient[4][0], gradient[5][0] = np.dot(slope, second), slope.sum()
    gradient[6][0], gradient[7][0] = np.dot(std_slope, second), std_slope.sum()
    outputs = np.outer(slope, actor[4][0]) + np.outer(std_slope, actor[6][0])
    differentiate(actor, gradient, x, first, second, outputs)
    return (coefficient * log_prob - np.minimum(value_1, value_2)).mean()
