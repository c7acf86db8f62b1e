"""Rollouts in one compiled call: the same bits as a Python loop over the batch, also with failures and jumps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", exc_type=ImportError)

import torch
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.logger import configure

from agents.fast_ppo.collection import Rollout, RolloutVecEnv
from agents.training import algorithms as loop
from agents.training.config import PPOConfig
from capsule_gym import Capsule, CapsuleVectorEnv, Controller, Policy, Randomization
from capsule_gym.elementary import exp
from capsule_gym.layout import LANES, Row
from capsule_gym.network import LAW_TORQUE, pack, to_action
from capsule_gym.observation import CELLS, estimates, identify
from capsule_gym.resets import Stream, plant_at, plant_ranges, random_stream
from capsule_gym.task import METRICS, Termination
from tests.agents.training.small import small
from tests.capsule_gym.test_network import make_layers

SEED = 5
OWN = ("episode_steps", "identifies", "privileged_critic", "energy_weights", "jump_rate", "output")
LAW = {"controller": "baselines:adaptive", "residual_limit": 3.0}
EVERYTHING = {"identifies": True, "privileged_critic": True, "energy_weights": (0.1, 20.0), "jump_rate": 2.5}
WIDE = {"randomization": "wide", "termination_penalty": 30.0}
CASES: dict[str, dict[str, Any]] = {
    "plain": {},
    "starts and plants differ": {**WIDE, "initial_range": (1.0, 8.0), "observe_parameters": True},
    "everything": {**WIDE, **EVERYTHING},
    "everything on a law": {**WIDE, **EVERYTHING, **LAW, "output": "torque"},
    "a law without more": LAW,
    "weights alone": {"energy_weights": (0.5, 0.5)},
    "a torque without a law": {"output": "torque", "privileged_critic": True, "jump_rate": 50.0},
    "friction of either direction": {**WIDE, **EVERYTHING, "capsule": Capsule(static_ratio=1.4, backward_ratio=1.3)},
    "episodes of one step": {**WIDE, **EVERYTHING, "episode_steps": 1},
    "diverging": {"torque_limit": 1e6, "identifies": True},
}


def make_env(count: int, **changes: Any) -> RolloutVecEnv:
    options = {"episode_steps": 40, **changes}
    steps = options.pop("episode_steps")
    config = PPOConfig(num_envs=count, **{name: options.pop(name) for name in OWN if name in options})
    env = RolloutVecEnv(config, SEED, steps, **options)
    env.reset()
    return env


def make_layers_for(env: RolloutVecEnv) -> list:
    return make_layers((env.header.inputs, 8, 1), seed=1)


def make_network(env: RolloutVecEnv, tanh_squashing: bool = False, layers: Any = None) -> np.ndarray:
    layers = layers or make_layers_for(env)
    header = env.header._replace(layers=len(layers), clip=10.0, tanh_squashing=tanh_squashing)
    return pack(layers, np.zeros(header.inputs), np.ones(header.inputs), header)


def draws(env: RolloutVecEnv, steps: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(steps, env.num_envs))
    return noise, rng.random((steps if env.jump else 0, env.num_envs, 3))


class Loop:
    """Steps the same environments in Python with the drawn actions."""

    def __init__(self, count: int, **changes: Any) -> None:
        settings: dict[str, Any] = {"episode_steps": 40, **changes}
        self.own = {name: settings.pop(name) for name in OWN if name in settings}
        steps = self.own["episode_steps"]
        self.batch = CapsuleVectorEnv(count, autoreset_mode="SAME_STEP", max_episode_steps=steps, **settings)
        self.simulation = self.batch.simulation
        self.observations, _ = self.batch.reset(seed=SEED)
        self.simulation.write(Row.steps, np.arange(count) * steps // count)
        self.count, self.episodes = count, [0] * count
        self.chance = self.own.get("jump_rate", 0.0) * self.simulation.options.control_dt
        self.memory: list[Any] = [(0.0,) * CELLS] * count
        self.log_weights = [self.weight(i) for i in range(count)]
        self.returns, self.lengths = [0.0] * count, [0] * count
        self.inputs = self.perceive(range(count))
        self.over = np.ones(count, np.float32)

    def weight(self, i: int) -> float:
        low, high = map(math.log, self.own.get("energy_weights", (1.0, 1.0)))
        return low + random_stream(SEED + i, self.episodes[i], Stream.disturbances).random() * (high - low)

    def perceive(self, rows: Any) -> np.ndarray:
        """Returns the inputs of some environments, computed from `observations`, and updates `memory`."""
        capsule, found = self.simulation.capsule, []
        for i in rows:
            row = self.observations[i].tolist()
            if self.own.get("identifies"):
                plant = (capsule.m, capsule.l, capsule.g, self.simulation.options.control_dt)
                self.memory[i] = identify(self.memory[i], *row[:3], *plant)
                row += estimates(self.memory[i])
            if "energy_weights" in self.own:
                row.append(self.log_weights[i])
            if self.own.get("privileged_critic"):
                block = self.simulation.world[i // LANES, :, i % LANES]
                row += [block[Row.M], math.log(block[Row.mu])]
            found.append(row)
        return np.array(found, np.float32)

    def jump(self, chances: np.ndarray) -> None:
        lines = plant_ranges(self.simulation.randomization, self.simulation.capsule)
        for i, (chance, share_M, share_mu) in enumerate(chances):
            if chance < self.chance:
                lane = self.simulation.world[i // LANES, :, i % LANES]
                lane[Row.M], lane[Row.mu] = plant_at(lines, share_M, share_mu)

    def follow(self, env: RolloutVecEnv, rollout: Rollout, chances: np.ndarray) -> dict[str, int]:
        """Compares a rollout with the batch under the same actions; returns the number of events of each kind."""
        happened = dict.fromkeys(("failed", "cut", "diverged", "jumped"), 0)
        cut, cut_inputs, infos = {}, {}, {}
        for t, drawn in enumerate(rollout.actions):
            assert rollout.inputs[t].tobytes() == self.inputs.tobytes(), t
            assert rollout.starts[t].tobytes() == self.over.tobytes(), t
            if len(chances):
                self.jump(chances[t])
                happened["jumped"] += int((chances[t, :, 0] < self.chance).sum())
            has_law = self.simulation.controller is not None and self.own.get("output") == "torque"
            laws = self.observations[:, LAW_TORQUE] if has_law else np.zeros(self.count)
            actions = [to_action(env.header, float(a), float(law)) for a, law in zip(drawn, laws, strict=True)]
            observations, rewards, terminated, truncated, info = self.batch.step(np.array(actions, np.float32)[:, None])
            self.over = (terminated | truncated).astype(np.float32)
            ended = np.flatnonzero(self.over).tolist()
            final = info.get("final_info", info)
            energy = np.where(self.over, final["energy"], info["energy"])
            after = observations.copy()
            for i in range(self.count):
                reward = float(rewards[i])
                if "energy_weights" in self.own:
                    reward -= (exp(self.log_weights[i]) - self.simulation.settings.energy_weight) * float(energy[i])
                assert rollout.rewards[t, i] == np.float32(reward)
                self.returns[i] += reward
                self.lengths[i] += 1
            for i in ended:
                place = (i // LANES, t, i)
                if not terminated[i]:
                    self.observations[i] = info["final_obs"][i]
                    # Uses the plant of the ended episode; the batch has already begun the next episode.
                    lane = self.simulation.world[i // LANES, :, i % LANES]
                    present = lane[[Row.M, Row.mu]].copy()
                    lane[[Row.M, Row.mu]] = final["M"][i], final["mu"][i]
                    cut[place], cut_inputs[place] = (t, i), self.perceive([i])[0]
                    lane[[Row.M, Row.mu]] = present
                metrics = {name: float(final["metrics"][name][i]) for name in METRICS}
                infos[place] = {"episode": {"r": self.returns[i], "l": self.lengths[i]}, "metrics": metrics}
                happened["failed"] += int(terminated[i])
                happened["cut"] += int(not terminated[i])
                happened["diverged"] += int(final["termination"][i] == Termination.diverged)
                self.returns[i], self.lengths[i], self.memory[i] = 0.0, 0, (0.0,) * CELLS
                self.episodes[i] += 1
                self.log_weights[i] = self.weight(i)
            self.observations = after
            self.inputs = self.perceive(range(self.count))
        assert rollout.last.tobytes() == self.inputs.tobytes()
        assert rollout.over.tobytes() == self.over.tobytes()
        in_order = sorted(infos)
        assert rollout.infos == [infos[place] for place in in_order]
        in_order = sorted(cut)
        assert rollout.cut.tolist() == [list(cut[place]) for place in in_order]
        assert rollout.cut_inputs.tobytes() == b"".join(cut_inputs[place].tobytes() for place in in_order)
        return happened


@pytest.mark.parametrize("count", [3, LANES + 6])
@pytest.mark.parametrize("changes", CASES.values(), ids=CASES)
def test_a_rollout_gives_the_bits_of_a_loop_in_python(changes, count):
    env, loop = make_env(count, **changes), Loop(count, **changes)
    network, happened = make_network(env), {"failed": 0, "cut": 0, "diverged": 0, "jumped": 0}
    for n, steps in enumerate((70, 1, 30)):
        noise, chances = draws(env, steps, n)
        # Each action is held for several steps; otherwise nothing would move.
        noise = np.repeat(noise[:: 1 + steps // 10], 1 + steps // 10, axis=0)[:steps]
        rollout = env.collect(network, 2.0, np.ascontiguousarray(noise), chances)
        for name, number in loop.follow(env, rollout, chances).items():
            happened[name] += number
    assert happened["cut"] > 0 or "torque_limit" in changes
    assert (happened["jumped"] > 0) == ("jump_rate" in changes)
    assert (happened["diverged"] > 0) == ("torque_limit" in changes)
    if count > LANES and changes.get("episode_steps") != 1:
        assert happened["failed"] > 0


def test_what_is_drawn_is_the_networks_output_and_the_noise():
    env = make_env(9, **WIDE, **EVERYTHING)
    noise, chances = draws(env, 50)
    for tanh_squashing in (False, True):
        rollout = env.collect(make_network(env, tanh_squashing), 0.7, noise, chances)
        (weights, bias), (weights_2, bias_2) = make_layers_for(env)
        given = rollout.inputs[..., : env.header.inputs].astype(np.float64).clip(-10.0, 10.0)
        outputs = (np.tanh(given @ weights.T + bias) @ weights_2.T + bias_2)[..., 0]
        outputs = np.tanh(outputs) if tanh_squashing else outputs
        np.testing.assert_allclose(rollout.actions, outputs + 0.7 * noise, rtol=1e-6, atol=1e-7)
        assert (np.abs(rollout.actions) > 1.0).any()


@pytest.mark.parametrize("changes", [{}, {"identifies": True}, {**LAW, "identifies": True}], ids=str)
def test_without_noise_it_acts_as_the_policy_does(changes):
    count, steps = LANES + 2, 35
    env = make_env(count, episode_steps=10_000, **changes)
    own = {name: changes[name] for name in changes if name not in OWN}
    # The policy pumps energy into the pendulum with all of its inputs.
    weights = np.full((1, env.header.inputs), 0.01, np.float32)
    weights[0, :2] = -1.0, 0.05
    layers = [(weights, np.full(1, 0.1, np.float32))]
    policy = Policy(
        name="made",
        algorithm="ppo",
        layers=tuple(layers),
        activation="tanh",
        squashing="clip",
        identifies=changes.get("identifies", False),
        mean=np.zeros(env.header.inputs),
        variance=np.ones(env.header.inputs),
        clip=10.0,
        epsilon=0.0,
        env_kwargs=own,
        training_seed=0,
        revision="abc",
    )
    rollout = env.collect(make_network(env, layers=layers), 0.0, *draws(env, steps))
    batch = CapsuleVectorEnv(count, max_episode_steps=10_000, **own)
    observations, _ = batch.reset(seed=SEED)
    act = policy.start(range(count))
    for t in range(steps):
        assert rollout.inputs[t, :, : policy.entries].tobytes() == observations.tobytes(), t
        actions = act(observations)
        assert actions[:, 0].tobytes() == rollout.actions[t].clip(-1.0, 1.0).tobytes()
        observations, _, terminated, _, _ = batch.step(actions)
        assert not terminated.any()
    assert np.abs(rollout.inputs[..., 2]).max() > 0.02


def test_a_law_that_returns_no_number_is_reported_and_a_reset_goes_on():
    def law(theta, theta_dot, x, x_dot, memory, reference):
        return (memory[0] * 1e10 if x > 1e-4 else 0.1), memory

    controller = Controller("breaking", law, np.zeros((1, 2)), memory=(1e308,))
    env = make_env(LANES + 1, controller=controller)
    network = make_network(env)
    with pytest.raises(ValueError, match="the control law 'breaking' returned a torque that is not finite"):
        env.collect(network, 1.0, *draws(env, 200))
    observations = env.reset()
    assert np.isfinite(observations).all()
    rollout = env.collect(network, 0.0, *draws(env, 1))
    assert np.isfinite(rollout.rewards).all()


@pytest.mark.parametrize("changes", [{}, {**EVERYTHING, "randomization": "wide"}], ids=["plain", "everything"])
def test_returns_and_advantages_are_those_of_stable_baselines(changes):
    config = small("direct", "ppo", n_steps=48, episode_seconds=0.6, gae_lambda=0.9, log_std_init=0.5, **changes)
    env = loop.make_env(config, 0)
    model: Any = loop.make_model(config, env)
    model.set_logger(configure(None, []))
    model.learn(512)
    rollout = model._collect(env, config.n_steps)
    rewards = rollout.rewards.copy()
    assert len(rollout.cut) > 0 and rewards.min() < -0.9 * config.termination_penalty
    model._fill(env, rollout, model.rollout_buffer)

    def values(inputs: np.ndarray) -> torch.Tensor:
        return model.policy.predict_values(torch.from_numpy(env.normalize_obs(inputs)))

    spaces = (env.observation_space, env.action_space)
    buffer = RolloutBuffer(config.n_steps, *spaces, gae_lambda=0.9, gamma=config.gamma, n_envs=config.num_envs)
    with torch.no_grad():
        # As in SB3's collection, a step that a time limit ends also gets the value of the last inputs.
        for (t, i), inputs in zip(rollout.cut.tolist(), rollout.cut_inputs, strict=True):
            rewards[t, i] += config.gamma * values(inputs[None]).item()
        for t, inputs in enumerate(rollout.inputs):
            normal = torch.from_numpy(env.normalize_obs(inputs))
            actions = torch.from_numpy(rollout.actions[t][:, None])
            expected, log_probs, _ = model.policy.evaluate_actions(normal, actions)
            buffer.add(normal.numpy(), actions.numpy(), rewards[t], rollout.starts[t], expected[:, 0], log_probs)
        buffer.compute_returns_and_advantage(values(rollout.last), rollout.over)
    for name in ("observations", "actions", "log_probs", "advantages", "returns"):
        found, expected = getattr(model.rollout_buffer, name), getattr(buffer, name)
        np.testing.assert_allclose(found.ravel(), expected.ravel(), rtol=1e-4, atol=1e-4)
    assert np.ptp(buffer.returns) > config.termination_penalty


def test_these_environments_do_not_step():
    with pytest.raises(RuntimeError, match=r"collect\(\) rollouts"):
        make_env(2).step(np.zeros((2, 1), np.float32))


def test_a_privileged_critic_needs_positive_friction():
    for changes in (
        {"capsule": Capsule(mu=0.0), "randomization": "none"},
        {"randomization": Randomization(mu=(0.0, 0.1))},
    ):
        with pytest.raises(ValueError, match="privileged_critic must be False where mu may be 0"):
            make_env(1, privileged_critic=True, **changes)
