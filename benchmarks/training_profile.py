"""Where the time of a training goes."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any, cast

import stable_baselines3.sac.sac as sb3_sac
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from benchmarks.training_cost import BROAD, Contender, learn, ppo, sac, take_turns, vector_step


class Clocks:
    """Adds up the time inside functions, without what other clocked functions inside them take."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._inner: list[float] = []
        self._undo: list[Callable[[], None]] = []

    def watch(self, owner: Any, name: str, label: str) -> None:
        """Puts a clock on a function of a module, class or object."""
        function = getattr(owner, name)
        own = name in vars(owner)

        def clocked(*args: Any, **kwargs: Any) -> Any:
            self._inner.append(0.0)
            start = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                whole = time.perf_counter() - start
                self.seconds[label] += whole - self._inner.pop()
                if self._inner:
                    self._inner[-1] += whole

        setattr(owner, name, clocked)
        self._undo.append(lambda: setattr(owner, name, function) if own else delattr(owner, name))

    def stop(self) -> None:
        """Takes all clocks off."""
        while self._undo:
            self._undo.pop()()


COLLECT, ENVIRONMENT, NORMALISE = "collect: policy and bookkeeping", "collect: environment", "collect: normalisation"
FORWARD, BACKWARD, ADAM, REST = "update: networks", "update: backward", "update: Adam", "update: losses and the rest"
STORE, SAMPLE, TARGETS = "collect: store in replay buffer", "update: draw from replay buffer", "update: target networks"


def watch(model: BaseAlgorithm, clocks: Clocks) -> None:
    """Puts clocks on the parts of a training."""
    env = cast(VecNormalize, model.get_vec_normalize_env())
    clocks.watch(model, "collect_rollouts", COLLECT)
    clocks.watch(env, "step_wait", NORMALISE)
    clocks.watch(env.venv, "step_wait", ENVIRONMENT)
    clocks.watch(model, "train", REST)
    clocks.watch(torch.Tensor, "backward", BACKWARD)
    clocks.watch(torch.autograd, "grad", BACKWARD)
    if isinstance(model, PPO):
        optimizers: list[torch.optim.Optimizer] = [model.policy.optimizer]
        clocks.watch(model.policy, "evaluate_actions", FORWARD)
    else:
        assert isinstance(model, SAC) and model.ent_coef_optimizer is not None and model.replay_buffer is not None
        optimizers = [model.actor.optimizer, model.critic.optimizer, model.ent_coef_optimizer]
        clocks.watch(model.replay_buffer, "add", STORE)
        clocks.watch(model.replay_buffer, "sample", SAMPLE)
        for network in (*model.critic.q_networks, *model.critic_target.q_networks, model.actor.latent_pi):
            clocks.watch(network, "forward", FORWARD)
        clocks.watch(model.actor.mu, "forward", FORWARD)
        clocks.watch(model.actor.log_std, "forward", FORWARD)
        clocks.watch(sb3_sac, "polyak_update", TARGETS)
        clocks.watch(torch, "_foreach_lerp_", TARGETS)
    for optimizer in optimizers:
        clocks.watch(optimizer, "step", ADAM)
        clocks.watch(optimizer, "zero_grad", ADAM)


def profile(rivals: Sequence[Contender], turns: int, seconds: float) -> dict[str, dict[str, float]]:
    """Microseconds per environment step that each part of a training takes."""
    totals: dict[str, Clocks] = defaultdict(Clocks)
    steps: dict[str, int] = defaultdict(int)

    def turn(rival: Contender, model: BaseAlgorithm, count: int) -> str:
        clocks = totals[rival.name]
        watch(model, clocks)
        try:
            learn(model, count)
        finally:
            clocks.stop()
        steps[rival.name] += count * vector_step(model)
        return rival.name

    take_turns(rivals, turns, seconds, "profile", turn)
    return {
        name: {part: 1e6 * value / steps[name] for part, value in clocks.seconds.items()}
        for name, clocks in totals.items()
        if steps[name]
    }


def profile_rows(results: dict[str, dict[str, float]]) -> list[list[str]]:
    """The profile as a table."""
    order = (ENVIRONMENT, NORMALISE, COLLECT, STORE, SAMPLE, FORWARD, BACKWARD, ADAM, TARGETS, REST)
    sums = {name: sum(parts.values()) for name, parts in results.items()}
    rows = [["us per environment step", *results]]
    for part in order:
        if any(part in parts for parts in results.values()):
            cells = [
                f"{parts[part]:.1f} ({100.0 * parts[part] / sums[name]:.0f} %)" if part in parts else ""
                for name, parts in results.items()
            ]
            rows.append([part, *cells])
    return [*rows, ["sum", *(f"{value:.1f}" for value in sums.values())]]


def profiled() -> list[Contender]:
    """What --profile measures."""
    return [
        ppo("PPO, preset"),
        ppo("PPO, broad", **BROAD),
        sac("SB3's SAC", SAC, fused=False),
        sac("LeanSAC, fused Adam (preset)"),
    ]
