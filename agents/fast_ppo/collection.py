"""Rollouts in one compiled call: policy, control law, physics and resets, with random numbers drawn beforehand."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from agents.training.config import PPOConfig
from capsule_gym import kernels, layout, resets
from capsule_gym.compilation import inlined
from capsule_gym.compiler import compile_allocating
from capsule_gym.elementary import exp
from capsule_gym.layout import AT, LANES, Row, record
from capsule_gym.network import LAW_TORQUE, Header, forward, make_header, make_workspace, to_action, write_inputs
from capsule_gym.observation import CELLS
from capsule_gym.resets import Stream, draw_two, plant_at, plant_ranges
from capsule_gym.sb3 import CapsuleSB3VecEnv
from capsule_gym.simulation import episode_metrics

DISTURBANCES = np.uint64(Stream.disturbances)
# Further inputs of a privileged critic, after M and log(mu), for varied plants.
PRIVILEGED = (
    *(Row.theta, Row.theta_dot, Row.x_dot, Row.motor, Row.latency),
    *(Row.theta_bias, Row.theta_dot_bias, Row.x_dot_bias),
    *(Row.drift_of_theta, Row.drift_of_theta_dot, Row.drift_of_x_dot),
    *(Row.m, Row.l, Row.k, Row.c),
)


@inlined
def observe(
    network: np.ndarray,
    observations: np.ndarray,
    first: int,
    n: int,
    memory: np.ndarray,
    block: np.ndarray,
    log_weights: np.ndarray,
    inputs: np.ndarray,
) -> None:
    """Writes the inputs of policy and critic for environments first..first + n - 1; arrays as in `collect`."""
    write_inputs(network, observations, first, n, memory, inputs)
    header = record(network, 0, Header)
    columns = header.inputs
    for i in range(first, first + n):
        if header.observes_energy_weight:
            inputs[i, columns - 1] = log_weights[i]
        # Further inputs of a privileged critic.
        if columns < inputs.shape[1]:
            inputs[i, columns] = block[AT.M + i % LANES]
            inputs[i, columns + 1] = math.log(block[AT.mu + i % LANES])
            if columns + 2 < inputs.shape[1]:
                for k in range(len(PRIVILEGED)):
                    inputs[i, columns + 2 + k] = block[PRIVILEGED[k] * LANES + i % LANES]


def collect(
    advance: int,  # address of the compiled `kernels.advance`, which documents the next four
    world: np.ndarray,  # changed
    count: int,  # number of environments
    fixed: np.ndarray,
    observations: np.ndarray,  # changed
    steps: int,  # agent steps of an episode
    jump: float,  # probability that M and mu are drawn anew in a step
    least: float,  # smallest logarithm of an energy weight (cm/J), which are drawn uniformly
    most: float,  # largest such logarithm
    lines: np.ndarray,  # `resets.draw` documents this and the next three
    start: np.ndarray,
    keys: np.ndarray,
    episodes: np.ndarray,  # changed
    draw_table: np.ndarray,  # as `resets.draw_rows` takes it
    law_memory: np.ndarray,  # memory of the law at the start of an episode
    network: np.ndarray,  # from `network.pack`
    memory: np.ndarray,  # of the filter, as `network.write_inputs` documents; changed
    log_weights: np.ndarray,  # of the running episodes' energy weights, shape (environments,); changed
    inputs: np.ndarray,  # network inputs of the present state, shape (environments, columns); changed
    fresh: bool,  # whether the episodes have just begun, and `inputs` are not written yet
    deviation: float,  # standard deviation of the actions
    noise: np.ndarray,  # standard normal, shape (steps, environments)
    chances: np.ndarray,  # uniform in [0, 1), shape (steps, environments, 3); an empty first axis without jumps
    returns: np.ndarray,  # sums of rewards of the running episodes, shape (environments,); changed
    lengths: np.ndarray,  # agent steps of the running episodes, shape (environments,); changed
    seen: np.ndarray,  # written: `inputs` at every step, shape (steps, environments, columns)
    actions: np.ndarray,  # written: actions before clipping, shape (steps, environments)
    rewards: np.ndarray,  # written, shape (steps, environments)
    ends: np.ndarray,  # written: 1.0 where the episode ends with the step, else 0.0
    cut: np.ndarray,  # written: step and environment of the truncated episodes, shape (rows, 2)
    cut_inputs: np.ndarray,  # written: their last inputs, shape (rows, columns)
    lanes: np.ndarray,  # from `network.make_workspace`; written
    ended: np.ndarray,  # written: of ended episodes return, length and rows of `world` down to the task's memory
) -> tuple[int, int, int]:
    """Makes `len(noise)` steps of the environments; an environment whose episode ends begins the next episode.

    Returns:
        The numbers of rows written to `cut` and `ended`, and an environment whose law returned a torque that is not
        finite, or -1.
    """
    header = record(network, 0, Header)
    weighted = header.observes_energy_weight
    # Only fields of the plant that do not depend on the law are read here.
    plant, settings = layout.unpack(fixed, 0.0, 0.0)
    row, starts = np.empty(1, np.int64), np.empty((Row.torque, 1))
    drawn_rows = np.empty((len(draw_table), 1))
    cuts = endings = 0
    for b in range(len(world)):
        block, first = world[b], b * LANES
        n = min(LANES, count - first)
        if fresh:
            for i in range(first, first + n):
                # `episodes` already counts the episodes that begin here.
                share, _ = draw_two(keys[i, 0], keys[i, 1], DISTURBANCES, np.uint64(episodes[i] - 1))
                log_weights[i] = least + share * (most - least)
            observe(network, observations, first, n, memory, block, log_weights, inputs)
        for t in range(len(noise)):
            for j in range(n):
                for k in range(inputs.shape[1]):
                    seen[t, first + j, k] = inputs[first + j, k]
            outputs = lanes[forward(network, inputs, first, n, lanes)]
            for j in range(n):
                i = first + j
                drawn = np.float32(outputs[j] + deviation * noise[t, i])
                actions[t, i] = drawn
                law_torque = observations[i, LAW_TORQUE] if header.has_law else 0.0
                block[AT.action + j] = np.float32(to_action(header, drawn, law_torque))
                block[AT.active + j] = 1.0
                if len(chances) > 0 and chances[t, i, 0] < jump:
                    block[AT.M + j], block[AT.mu + j] = plant_at(lines, chances[t, i, 1], chances[t, i, 2])
            broken = kernels.call_advance(advance, world, first, first + n, False, fixed, observations)
            if broken >= 0:
                return cuts, endings, broken
            for j in range(n):
                i = first + j
                reward = block[AT.reward + j]
                if weighted:
                    reward -= (exp(log_weights[i]) - settings.energy_weight) * block[AT.energy + j]
                rewards[t, i] = reward
                returns[i] += reward
                lengths[i] += 1
                failed = block[AT.termination + j] != 0.0
                over = failed or block[AT.steps + j] >= steps
                ends[t, i] = 1.0 if over else 0.0
                if not over:
                    continue
                if not failed:
                    observe(network, observations, i, 1, memory, block, log_weights, inputs)
                    cut[cuts, 0], cut[cuts, 1] = t, i
                    cut_inputs[cuts] = inputs[i]
                    cuts += 1
                ended[endings, 0], ended[endings, 1] = returns[i], lengths[i]
                for k in range(ended.shape[1] - 2):
                    ended[endings, 2 + k] = block[k * LANES + j]
                endings += 1
                row[0] = i
                share, _ = draw_two(keys[i, 0], keys[i, 1], DISTURBANCES, np.uint64(episodes[i]))
                log_weights[i] = least + share * (most - least)
                resets.draw(lines, start, row, keys, episodes, starts)
                resets.draw_rows(draw_table, row, keys, episodes, drawn_rows)
                resets.renew(world[b : b + 1], law_memory, plant.m, plant.g, row - first, starts, episodes[first:])
                for k in range(len(draw_table)):
                    block[int(draw_table[k, 0]) * LANES + j] = drawn_rows[k, 0]
                # Begins the new episode; `renew` has set `active` to 0 for the other environments.
                broken = kernels.call_advance(advance, world, first, first + n, True, fixed, observations)
                if broken >= 0:
                    return cuts, endings, broken
                returns[i], lengths[i] = 0.0, 0
                for k in range(CELLS if header.identifies else 0):
                    memory[i * CELLS + k] = 0.0
            observe(network, observations, first, n, memory, block, log_weights, inputs)
    return cuts, endings, -1


@lru_cache(maxsize=1)
def _compiled() -> Any:
    """Compiles `collect` once for all laws, since the compiled step of a law is an argument."""
    number, numbers, rows, indices = "float64", "float64[::1]", "float64[:, ::1]", "int64[::1]"
    many, cube = "float32[:, ::1]", "float32[:, :, ::1]"
    simulation = ("int64", rows, "int64", numbers, many)
    episodes = ("int64", number, number, number, numbers, numbers, "uint64[:, ::1]", indices, rows, numbers)
    policy = (numbers, numbers, numbers, many, "boolean", number, rows, "float64[:, :, ::1]")
    written = (numbers, indices, cube, many, many, many, "int64[:, ::1]", many, rows, rows)
    signature = f"({', '.join((*simulation, *episodes, *policy, *written))})"
    return compile_allocating(collect, signature, "the rollouts of training")


class Rollout(NamedTuple):
    """A rollout of T agent steps of N environments."""

    inputs: np.ndarray  # network inputs at every step, shape (T, N, columns), float32
    actions: np.ndarray  # before clipping, shape (T, N), float32
    rewards: np.ndarray  # shape (T, N), float32
    starts: np.ndarray  # 1.0 at the first step of an episode, shape (T, N), float32
    cut: np.ndarray  # step and environment of the truncated episodes; shape (n, 2), int64
    cut_inputs: np.ndarray  # the inputs after their last step, shape (n, columns), float32
    last: np.ndarray  # inputs of the present state, shape (N, columns), float32
    over: np.ndarray  # 1.0 where the present state begins an episode, shape (N,), float32
    infos: list[dict[str, Any]]  # of the ended episodes, with SB3's "episode" and "metrics"


class RolloutVecEnv(CapsuleSB3VecEnv):
    """Environments that collect rollouts for `agents.fast_ppo.FastPPO`; `step` is not supported.

    An observation holds the inputs of policy and critic: the environment's own observation, the policy's further inputs
    (`capsule_gym.network.input_names`), and the inputs of the critic alone.

    Args:
        config: configuration of the run.
        seed: environment i gets seed + i.
        episode_steps: agent steps of an episode.
        **env_kwargs: arguments of `CapsuleVectorEnv`.

    Attributes:
        header: header of a packed network, without its layers, activation and clip.
        columns: number of entries of an observation.
        jump: probability that M and mu are drawn anew in a step.

    Raises:
        ValueError: if the critic is privileged and mu may be 0, whose logarithm is not finite.
    """

    def __init__(self, config: PPOConfig, seed: int, episode_steps: int, **env_kwargs: Any) -> None:
        super().__init__(config.num_envs, seed, max_episode_steps=episode_steps, **env_kwargs)
        simulation = self.batch.simulation
        if config.privileged_critic and not (simulation.randomization.mu or (simulation.capsule.mu,))[0] > 0.0:
            raise ValueError("privileged_critic must be False where mu may be 0, whose logarithm it observes, got True")
        self.steps, self.jump = episode_steps, config.jump_rate * simulation.options.control_dt
        self.least, self.most = map(math.log, config.energy_weights or (1.0, 1.0))
        self.header = make_header(
            simulation.options,
            layers=0,
            relu=False,
            tanh_squashing=False,
            clip=0.0,
            identifies=config.identifies,
            observes_energy_weight=config.energy_weights is not None,
            outputs_torque=config.output == "torque",
        )
        privileged = 2 + len(PRIVILEGED) * (simulation.settings.history > 0)
        self.columns = self.header.inputs + privileged * config.privileged_critic
        if self.columns > self.header.observed:
            self.observation_space = spaces.Box(-np.inf, np.inf, (self.columns,), np.float32)
        self.memory = np.zeros(self.num_envs * CELLS if config.identifies else 0)
        self.log_weights = np.zeros(self.num_envs)
        self.inputs = np.zeros((self.num_envs, self.columns), np.float32)
        self.fresh = True
        self.over = np.ones(self.num_envs, np.float32)

    def reset(self) -> VecEnvObs:
        """Begins new episodes; inputs beyond the environment's observation are 0 until rollouts are collected."""
        observations = super().reset()
        assert isinstance(observations, np.ndarray)
        self.fresh = True
        self.memory[:] = 0.0
        self.over[:] = 1.0
        simulation = self.batch.simulation
        # Staggered in time, so that a rollout contains every part of an episode.
        simulation.write(Row.steps, np.arange(self.num_envs) * self.steps // self.num_envs)
        return np.pad(observations, ((0, 0), (0, self.columns - observations.shape[1])))

    def step_wait(self) -> VecEnvStepReturn:
        """Raises a RuntimeError: these environments only collect rollouts."""
        raise RuntimeError("RolloutVecEnv does not step: collect() rollouts, or use CapsuleSB3VecEnv")

    def collect(self, network: np.ndarray, deviation: float, noise: np.ndarray, chances: np.ndarray) -> Rollout:
        """Collects a rollout of T = len(noise) steps.

        Args:
            network: from `network.pack`.
            deviation: standard deviation of the actions.
            noise: standard normal, shape (T, N), float64.
            chances: uniform in [0, 1), shape (T, N, 3), float64, for jumps of M and mu; (0, N, 3) without jumps.

        Raises:
            ValueError: if a user's control law returned a torque that is not finite; a reset must follow.
        """
        simulation = self.batch.simulation
        steps, count = len(noise), self.num_envs
        blocks = simulation.world.reshape(len(simulation.world), -1)
        seen = np.empty((steps, count, self.columns), np.float32)
        actions, rewards, ends = (np.empty((steps, count), np.float32) for _ in range(3))
        # Sized for the worst case: the system allocates only the pages that are written.
        cut, cut_inputs = np.empty((steps * count, 2), np.int64), np.empty((steps * count, self.columns), np.float32)
        ended = np.empty((steps * count, 2 + simulation.task_end))
        lines, law_memory = plant_ranges(simulation.randomization, simulation.capsule), np.array(simulation.memory)
        # In the groups of the signature in `_compiled`.
        cuts, endings, broken = _compiled()(
            *(simulation._kernel.address, blocks, count, simulation.fixed, simulation.observations),
            *(self.steps, self.jump, self.least, self.most, lines, simulation.start),
            *(simulation._keys, simulation._episodes, simulation.draw_table, law_memory),
            *(network, self.memory, self.log_weights, self.inputs, self.fresh, deviation, noise, chances),
            *(self._returns, self._lengths, seen, actions, rewards, ends, cut, cut_inputs),
            *(make_workspace(network), ended),
        )
        simulation._everyone = False
        if broken >= 0:
            simulation._report(broken)
        self.fresh = False
        starts = np.concatenate([self.over[None], ends[:-1]])
        self.over = ends[-1].copy()
        ended = ended[:endings]
        metrics = episode_metrics(ended[:, 2:].T, self.steps * simulation.options.control_dt, simulation.task)
        infos: list[dict[str, Any]] = [
            {
                "episode": {"r": float(ended[n, 0]), "l": int(ended[n, 1])},
                "metrics": {name: float(values[n]) for name, values in metrics.items()},
            }
            for n in range(endings)
        ]
        last, over = self.inputs.copy(), self.over.copy()
        return Rollout(seen, actions, rewards, starts, cut[:cuts], cut_inputs[:cuts], last, over, infos)
