"""Whole rollouts in one compiled call: policy, control law, physics and resets, with noise that is drawn before."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numba import types
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from capsule_gym import kernels, layout, resets
from capsule_gym.compilation import compile_now, fingerprint, inlined, inner, kernel
from capsule_gym.elementary import exp
from capsule_gym.identification import CELLS
from capsule_gym.layout import AT, LANES, record
from capsule_gym.network import (
    LAW_TORQUE,
    Header,
    forward,
    input_names,
    make_header,
    to_action,
    workspace,
    write_inputs,
)
from capsule_gym.observation import observation_names
from capsule_gym.resets import Stream, draw_two, plant_at, plant_ranges, random_stream
from capsule_gym.sb3 import CapsuleSB3VecEnv
from capsule_gym.simulation import episode_metrics

# What the critic may be told beside the policy's inputs.
PRIVILEGED = ("M", "log_mu")
# Episodes of a rollout that are told of, where more end than are cut off.
MOST_ENDED = 1024
DISTURBANCES = np.uint64(Stream.disturbances)


class Course(NamedTuple):
    """How episodes of training go.

    Attributes:
        steps: of an episode, agent steps.
        privileged: whether M and log(mu) follow the policy's inputs.
        told: whether the last of those inputs is the logarithm of an energy weight, which every episode draws anew.
        least: of these logarithms, of weights in cm/J; they are drawn uniformly from here ..
        most: .. to here.
        jump: probability of a step that M and mu are drawn anew.
    """

    steps: int
    privileged: bool
    told: bool
    least: float
    most: float
    jump: float


draw_apart, renew_apart = inner(resets.draw), inner(resets.renew)


@inlined
def complete(
    course: Course, block: np.ndarray, j: int, log_weights: np.ndarray, i: int, columns: int, inputs: np.ndarray
) -> None:
    """Writes what the environment's own observation does not hold, at the end of an environment's inputs."""
    if course.told:
        inputs[i, columns - 1] = log_weights[i]
    if course.privileged:
        inputs[i, columns] = block[AT.M + j]
        inputs[i, columns + 1] = math.log(block[AT.mu + j])


def collect(
    advance: Any,
    world: np.ndarray,
    begin: int,
    end: int,
    fixed: np.ndarray,
    observations: np.ndarray,
    course: np.ndarray,
    lines: np.ndarray,
    start_noise: float,
    keys: np.ndarray,
    episodes: np.ndarray,
    law_memory: np.ndarray,
    network: np.ndarray,
    memory: np.ndarray,
    log_weights: np.ndarray,
    inputs: np.ndarray,
    fresh: bool,
    deviation: float,
    noise: np.ndarray,
    chances: np.ndarray,
    returns: np.ndarray,
    lengths: np.ndarray,
    seen: np.ndarray,
    actions: np.ndarray,
    rewards: np.ndarray,
    ends: np.ndarray,
    cut: np.ndarray,
    cut_inputs: np.ndarray,
    ended: np.ndarray,
) -> tuple[int, int, int]:
    """Takes environments through as many agent steps as there is noise for; who ends begins anew at once.

    Args:
        advance: `kernels.advance`, compiled with the law.
        world: as `kernels.advance` takes it; changed.
        begin: first environment, a multiple of LANES.
        end: one past the last environment.
        fixed: as `kernels.advance` takes it, and so the next.
        observations: likewise.
        course: the fields of `Course`.
        lines: with the next three as `resets.draw` takes them.
        start_noise: likewise.
        keys: likewise.
        episodes: likewise; changed.
        law_memory: of the law at the start of an episode.
        network: from `network.pack`.
        memory: as `network.write_inputs` takes it; changed.
        log_weights: logarithms of the energy weights of the running episodes, shape (environments,); changed.
        inputs: shape (environments, inputs and what is privileged), float32: of the present state; changed.
        fresh: whether the episodes have just begun, and the inputs are not there yet.
        deviation: standard deviation of the actions.
        noise: standard normal, shape (steps, environments).
        chances: uniform in [0, 1), shape (steps, environments, 3); an empty first axis where nothing jumps.
        returns: sums of rewards of the running episodes, shape (environments,); changed.
        lengths: steps of these so far, likewise, int64.
        seen: written: the inputs at every step, shape (steps, environments, columns), float32.
        actions: written: what was drawn, before it is clipped, shape (steps, environments), float32.
        rewards: written, likewise.
        ends: written, likewise: 0.0 where the episode goes on after the step, 1.0 where it ends.
        cut: written: step and environment of the episodes that were cut off, not failed; shape (rows, 2), int64.
        cut_inputs: written: their last inputs, shape (rows, columns), float32.
        ended: written: of episodes that ended return, length and the rows of `world`; shape (rows, 2 + layout.ROWS).

    Returns:
        How many rows of `cut` and of `ended` are written; an environment whose law returned no finite torque, or -1.
    """
    header = record(network, 0, Header)
    steps, privileged, told = int(course[0]), course[1] != 0.0, course[2] != 0.0
    way = Course(steps, privileged, told, course[3], course[4], course[5])
    # Of the plant only what no law has a say in is read here.
    plant, settings = layout.unpack(fixed, 0.0)
    lanes = workspace(network)
    row, starts = np.empty(1, np.int64), np.empty((layout.Row.torque, 1))
    cuts = endings = 0
    for b in range(begin // LANES, (end + LANES - 1) // LANES):
        block, first = world[b], b * LANES
        n = min(LANES, end - first)
        if fresh:
            write_inputs(network, observations, first, n, memory, inputs)
            for j in range(n):
                complete(way, block, j, log_weights, first + j, header.inputs, inputs)
        for t in range(len(noise)):
            for j in range(n):
                for k in range(inputs.shape[1]):
                    seen[t, first + j, k] = inputs[first + j, k]
            outputs = forward(network, inputs, first, n, lanes)
            for j in range(n):
                i = first + j
                drawn = np.float32(outputs[j] + deviation * noise[t, i])
                actions[t, i] = drawn
                law_torque = observations[i, LAW_TORQUE] if header.has_law else 0.0
                block[AT.action + j] = np.float32(to_action(header, drawn, law_torque))
                block[AT.active + j] = 1.0
                if len(chances) > 0 and chances[t, i, 0] < way.jump:
                    block[AT.M + j], block[AT.mu + j] = plant_at(lines, chances[t, i, 1], chances[t, i, 2])
            broken = advance(world, first, first + n, False, fixed, observations)
            if broken >= 0:
                return cuts, endings, broken
            for j in range(n):
                i = first + j
                reward = block[AT.reward + j]
                if told:
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
                    write_inputs(network, observations, i, 1, memory, inputs)
                    complete(way, block, j, log_weights, i, header.inputs, inputs)
                    cut[cuts, 0], cut[cuts, 1] = t, i
                    cut_inputs[cuts] = inputs[i]
                    cuts += 1
                if endings < len(ended):
                    ended[endings, 0], ended[endings, 1] = returns[i], lengths[i]
                    for k in range(layout.ROWS):
                        ended[endings, 2 + k] = block[k * LANES + j]
                    endings += 1
                row[0] = i
                if told:
                    share, _ = draw_two(keys[i, 0], keys[i, 1], DISTURBANCES, np.uint64(episodes[i]))
                    log_weights[i] = way.least + share * (way.most - way.least)
                draw_apart(lines, start_noise, row, keys, episodes, starts)
                renew_apart(world[b : b + 1], law_memory, plant.m, plant.g, row - first, starts, episodes[first:])
                # `renew` leaves the others out: who has begun already has taken its zeroth step by then.
                broken = advance(world, first, first + n, True, fixed, observations)
                if broken >= 0:
                    return cuts, endings, broken
                returns[i], lengths[i] = 0.0, 0
                for k in range(CELLS if header.identifies else 0):
                    memory[i * CELLS + k] = 0.0
            write_inputs(network, observations, first, n, memory, inputs)
            for j in range(n):
                complete(way, block, j, log_weights, first + j, header.inputs, inputs)
    return cuts, endings, -1


@lru_cache(maxsize=1)
def _compiled() -> Any:
    """`collect`, which is compiled once for all laws: it is given their steps as functions."""
    compiled = kernel(collect, fingerprint(collect)[:16], {})
    world, begin, end, _, fixed, observations = kernels.SIGNATURE
    step = types.FunctionType(types.int64(*kernels.SIGNATURE))
    numbers, rows, indices = types.float64[::1], types.float64[:, ::1], types.int64[::1]
    many, cube = types.float32[:, ::1], types.float32[:, :, ::1]
    simulation = (step, world, begin, end, fixed, observations)
    episodes = (numbers, numbers, types.float64, types.uint64[:, ::1], indices, numbers)
    policy = (numbers, numbers, numbers, many, types.boolean, types.float64, rows, types.float64[:, :, ::1])
    written = (numbers, indices, cube, many, many, many, types.int64[:, ::1], many, rows)
    compile_now(compiled, (*simulation, *episodes, *policy, *written), "the rollouts of training")
    return next(iter(compiled.overloads.values())).entry_point


class Rollout(NamedTuple):
    """What `RolloutVecEnv.collect` returns; T agent steps of N environments.

    Attributes:
        inputs: of the policy at every step and what is privileged, shape (T, N, columns), float32.
        actions: what was drawn, before it is clipped, shape (T, N), float32.
        rewards: shape (T, N), float32.
        starts: 1.0 at the first step of an episode, shape (T, N), float32.
        cut: step and environment of the episodes that were cut off, not failed; shape (n, 2), int64.
        cut_inputs: the inputs after their last step, shape (n, columns), float32.
        last: inputs of the present state, shape (N, columns), float32.
        over: 1.0 where that begins an episode, shape (N,), float32.
        infos: of the episodes that ended, as SB3 has them: "episode" and "metrics".
    """

    inputs: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    starts: np.ndarray
    cut: np.ndarray
    cut_inputs: np.ndarray
    last: np.ndarray
    over: np.ndarray
    infos: list[dict[str, Any]]


class RolloutVecEnv(CapsuleSB3VecEnv):
    """The native batch as something that collects whole rollouts, for `agents.fast_ppo.FastPPO`.

    An observation is here what the policy and its critic are given: the environment's own, then what the policy adds to
    it (`capsule_gym.network.input_names`), then what the critic alone may know. Where nothing is added it also steps as
    any other `VecEnv`.

    Args:
        num_envs: number of environments.
        seed: environment i gets seed + i.
        episode_steps: of an episode of training, agent steps.
        identifies: whether the policy identifies M and mu.
        privileged: whether the critic is told them.
        energy_weights: lowest and highest energy weight (cm/J) that the policy is told, drawn anew for every episode;
            None for the environment's own, which it is not told.
        jump: probability of a step that M and mu are drawn anew.
        outputs_torque: whether the policy puts out the wanted torque.
        **env_kwargs: what `CapsuleVectorEnv` takes.

    Attributes:
        header: what a packed network begins with, but for what the network itself says.
        names: of the entries of an observation.
        columns: how many they are.

    Raises:
        ValueError: if the critic is told the logarithm of a friction coefficient that may be 0.
    """

    def __init__(
        self,
        num_envs: int,
        seed: int | None = None,
        *,
        episode_steps: int,
        identifies: bool = False,
        privileged: bool = False,
        energy_weights: tuple[float, float] | None = None,
        jump: float = 0.0,
        outputs_torque: bool = False,
        **env_kwargs: Any,
    ) -> None:
        super().__init__(num_envs, seed, max_episode_steps=episode_steps, **env_kwargs)
        simulation = self.batch.simulation
        if privileged and not (simulation.randomization.mu or (simulation.capsule.mu,))[0] > 0.0:
            raise ValueError("privileged must be False where mu may be 0: the critic is told its logarithm, got True")
        low, high = energy_weights or (1.0, 1.0)
        told = energy_weights is not None
        self.course = Course(episode_steps, privileged, told, math.log(low), math.log(high), jump)
        self.header = make_header(
            simulation.options,
            layers=0,
            relu=False,
            tanh_squashing=False,
            clip=0.0,
            identifies=identifies,
            observes_energy_weight=self.course.told,
            outputs_torque=outputs_torque,
        )
        observed = observation_names(simulation.settings.with_reference, simulation.settings.with_parameters)
        self.names = (*input_names(observed, identifies, self.course.told), *(PRIVILEGED if privileged else ()))
        self.columns = len(self.names)
        if self.columns > self.header.observed:
            self.observation_space = spaces.Box(-np.inf, np.inf, (self.columns,), np.float32)
        self.memory = np.zeros(num_envs * CELLS if identifies else 0)
        self.log_weights = np.zeros(num_envs)
        self.inputs = np.zeros((num_envs, self.columns), np.float32)
        self.fresh = True
        self.over = np.ones(num_envs, np.float32)

    def reset(self) -> VecEnvObs:
        """Begins new episodes everywhere; what is added to the observations is there when rollouts are collected."""
        observations = super().reset()
        assert isinstance(observations, np.ndarray)
        self.fresh = True
        self.memory[:] = 0.0
        self.over[:] = 1.0
        simulation = self.batch.simulation
        # Apart from each other in time: a rollout is to hold every part of an episode.
        simulation.write(layout.Row.steps, np.arange(self.num_envs) * self.course.steps // self.num_envs)
        if self.course.told:
            low, high = self.course.least, self.course.most
            # Counted already: the episodes that begin here are the ones before.
            begun = zip(simulation._keys.tolist(), simulation._episodes.tolist(), strict=True)
            streams = (random_stream(key + (rest << 64), n - 1, Stream.disturbances) for (key, rest), n in begun)
            self.log_weights[:] = [low + stream.random() * (high - low) for stream in streams]
        return np.pad(observations, ((0, 0), (0, self.columns - observations.shape[1])))

    def step_wait(self) -> VecEnvStepReturn:
        """One step, for algorithms that collect by themselves.

        Raises:
            RuntimeError: if something is added to the observations, or the policy puts out torques.
        """
        if self.columns > self.header.observed or self.header.outputs_torque:
            raise RuntimeError(
                "step() knows nothing of what is added to the observations, and no torque that is wanted: collect() "
                "rollouts instead"
            )
        return super().step_wait()

    def collect(
        self, network: np.ndarray, deviation: float, noise: np.ndarray, chances: np.ndarray | None = None
    ) -> Rollout:
        """Takes every environment through a rollout, whose length is that of the noise.

        Args:
            network: from `network.pack`.
            deviation: standard deviation of the actions.
            noise: standard normal, shape (T, N), float64.
            chances: uniform in [0, 1), shape (T, N, 3), float64, where M and mu may jump.

        Raises:
            TypeError: if the network or an array is not of that dtype and shape.
            ValueError: if a user's control law returned a torque that is not finite; only a reset goes on from there.
        """
        simulation = self.batch.simulation
        steps, count = len(noise), self.num_envs
        if chances is None:
            chances = np.zeros((0, count, 3))
        blocks = simulation.world.reshape(len(simulation.world), -1)
        fixed = layout.pack(simulation.capsule.plant(), simulation.settings, simulation.reference)
        layout.check_arrays(
            network=(network, np.float64, (None,)),
            noise=(noise, np.float64, (steps, count)),
            chances=(chances, np.float64, (steps if len(chances) else 0, count, 3)),
        )
        seen = np.empty((steps, count, self.columns), np.float32)
        actions, rewards, ends = (np.empty((steps, count), np.float32) for _ in range(3))
        compiled, course = _compiled(), np.array(self.course, np.float64)
        lines, law_memory = plant_ranges(simulation.randomization, simulation.capsule), np.array(simulation.memory)

        def run(first: int, last: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
            # In a rollout an environment's episode is cut off at most so often.
            most = (last - first) * (steps // self.course.steps + 1)
            cut, cut_inputs = np.empty((most, 2), np.int64), np.empty((most, self.columns), np.float32)
            ended = np.empty((max(most, MOST_ENDED), 2 + layout.ROWS))
            cuts, endings, broken = compiled(
                simulation._kernel,
                blocks,
                first,
                last,
                fixed,
                simulation.observations,
                course,
                lines,
                simulation.options.initial_noise,
                simulation._keys,
                simulation._episodes,
                law_memory,
                network,
                self.memory,
                self.log_weights,
                self.inputs,
                self.fresh,
                deviation,
                noise,
                chances,
                self._returns,
                self._lengths,
                seen,
                actions,
                rewards,
                ends,
                cut,
                cut_inputs,
                ended,
            )
            return cut[:cuts], cut_inputs[:cuts], ended[:endings], broken

        parts = simulation.share(run)
        simulation._everyone = False
        broken = max(part[3] for part in parts)
        if broken >= 0:
            simulation._report(broken)
        self.fresh = False
        starts = np.concatenate([self.over[None], ends[:-1]])
        self.over = ends[-1].copy()
        cut, cut_inputs, ended = (np.concatenate([part[n] for part in parts]) for n in range(3))
        # As many as one thread would have told of.
        told = max(count * (steps // self.course.steps + 1), MOST_ENDED)
        return Rollout(
            *(seen, actions, rewards, starts, cut, cut_inputs, self.inputs.copy(), self.over.copy()),
            self._infos(ended[:told]),
        )

    def _infos(self, ended: np.ndarray) -> list[dict[str, Any]]:
        """What SB3 is told of episodes that have ended."""
        world = ended[:, 2:].T
        metrics = episode_metrics(world, self.course.steps * self.batch.simulation.options.control_dt)
        return [
            {
                "episode": {"r": float(ended[n, 0]), "l": int(ended[n, 1])},
                "metrics": {name: float(values[n]) for name, values in metrics.items()},
            }
            for n in range(len(ended))
        ]
