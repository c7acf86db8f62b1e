"""Where the time of a training goes: `python -m benchmarks.training_profile`.

The contenders take turns, so that whatever else the machine does meets them all; times are the processor's.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from baselines.tables import markdown_table, text_table
from benchmarks.machine import machine
from benchmarks.output import section
from benchmarks.trainers import FORMER, PACKAGES, Trainer, TurnOptions, ppo, sac
from capsule_gym.command_line import parse

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize

COMMAND = "python -m benchmarks.training_profile"
PROFILED = (
    ppo("PPO, preset"),
    ppo("SB3's PPO, tuned", own=False, **FORMER),
    sac("SB3's SAC", own=False, fused=False),
    sac("LeanSAC, fused Adam (preset)"),
)

ROLLOUT, STEPS = "collect: whole rollouts, compiled", "update: all steps, compiled"
ENVIRONMENT, NORMALISE, COLLECT = "collect: environment", "collect: normalisation", "collect: policy and bookkeeping"
STORE, SAMPLE = "collect: store in replay buffer", "update: draw from replay buffer"
FORWARD, BACKWARD, ADAM = "update: networks", "update: backward", "update: Adam"
TARGETS, REST = "update: target networks", "update: losses and the rest"
# In the order of the table.
PARTS = (ROLLOUT, ENVIRONMENT, NORMALISE, COLLECT, STORE, STEPS, SAMPLE, FORWARD, BACKWARD, ADAM, TARGETS, REST)


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
            start = time.process_time()
            try:
                return function(*args, **kwargs)
            finally:
                whole = time.process_time() - start
                self.seconds[label] += whole - self._inner.pop()
                if self._inner:
                    self._inner[-1] += whole

        setattr(owner, name, clocked)
        self._undo.append(lambda: setattr(owner, name, function) if own else delattr(owner, name))

    def stop(self) -> None:
        """Takes all clocks off."""
        while self._undo:
            self._undo.pop()()


def watch(model: BaseAlgorithm, clocks: Clocks) -> None:
    """Puts clocks on the parts of a training."""
    # torch takes seconds to import, which --help need not wait for.
    import stable_baselines3.sac.sac as sb3_sac
    import torch
    from stable_baselines3 import PPO, SAC

    from agents.training import ppo as own_ppo

    env = cast("VecNormalize", model.get_vec_normalize_env())
    clocks.watch(model, "collect_rollouts", COLLECT)
    clocks.watch(model, "train", REST)
    if isinstance(model, own_ppo.CapsulePPO):
        clocks.watch(env.venv, "collect", ROLLOUT)
        clocks.watch(env, "normalize_obs", NORMALISE)
        clocks.watch(own_ppo, "make_steps", STEPS)
        return
    clocks.watch(env, "step_wait", NORMALISE)
    clocks.watch(env.venv, "step_wait", ENVIRONMENT)
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


@dataclass(frozen=True, kw_only=True)
class Options(TurnOptions):
    """What the time of a training goes to: microseconds per environment step of each of its parts.

    Little else should run meanwhile. Ctrl-C ends it early and keeps what there is.

    Examples:
      python -m benchmarks.training_profile --markdown docs/train_fast_profile.md
    """


def profile(trainers: Sequence[Trainer], turns: int, seconds: float) -> dict[str, dict[str, float]]:
    """Microseconds per environment step that each part of a training takes; arguments as for `take_turns`."""
    from benchmarks.training_turns import learn, take_turns, unit

    totals: dict[str, Clocks] = defaultdict(Clocks)
    steps: dict[str, int] = defaultdict(int)

    def turn(trainer: Trainer, model: BaseAlgorithm, count: int) -> str:
        clocks = totals[trainer.name]
        watch(model, clocks)
        try:
            learn(model, count)
        finally:
            clocks.stop()
        steps[trainer.name] += count * unit(model)
        return trainer.name

    take_turns(trainers, turns, seconds, "profile", turn)
    return {
        name: {part: 1e6 * value / steps[name] for part, value in clocks.seconds.items()}
        for name, clocks in totals.items()
        if steps[name]
    }


def rows(results: Mapping[str, Mapping[str, float]]) -> list[list[str]]:
    """The profile as a table."""
    sums = {name: sum(parts.values()) for name, parts in results.items()}
    table = [["us per environment step", *results]]
    for part in PARTS:
        if any(part in parts for parts in results.values()):
            cells = [
                f"{parts[part]:.1f} ({100.0 * parts[part] / sums[name]:.0f} %)" if part in parts else ""
                for name, parts in results.items()
            ]
            table.append([part, *cells])
    return [*table, ["sum", *(f"{value:.1f}" for value in sums.values())]]


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    found = machine(*PACKAGES)
    parts = profile(PROFILED, options.turns, options.seconds)
    table = rows(parts)
    print(f"\n{text_table(table)}")
    numbers = {
        "machine": found,
        "turns": options.turns,
        "seconds": options.seconds,
        "microseconds_per_env_step": parts,
    }
    options.write(COMMAND, numbers, section("profile", [markdown_table(table), "", options.note(found)]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
