"""Environment steps per second, compared with other environments: `python -m benchmarks.throughput`.

All actions are drawn beforehand. A single environment runs whole episodes, including resets. A batch of this package
does not truncate episodes, so that all batch sizes are comparable; an environment that fails is reset within the step.
"""

from __future__ import annotations

import statistics
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from itertools import cycle
from typing import Any

import gymnasium as gym
import numpy as np
from tqdm import tqdm

from benchmarks.measurement import OutputArgs, available_cores, machine, spread, take_turns
from benchmarks.mujoco import FRICTIONS, FrictionModel
from capsule_gym import ENV_ID, task
from capsule_gym.command_line import Count, parse
from capsule_gym.config import DIRECT_PHYSICS_DT, LAW_PHYSICS_DT

COMMAND = "python -m benchmarks.throughput"
TURN_SECONDS, CALIBRATION_SECONDS = 0.2, 0.05
SEED = 0
# With random torques up to the limit, resets would dominate. The paper's torques rarely exceed this fraction.
ACTION_SCALE = 0.2
LAW: dict[str, Any] = {"controller": "baselines:adaptive", "residual_limit": ACTION_SCALE * task.TORQUE_LIMIT}
# Number of distinct actions, which are repeated.
DRAWS = 16
BATCHES = (64, 1024, 16384)
PEER_BATCH = 1024
THREADS = (1, 2)
SINGLE_PEER = "CartPole-v1"
DRAWN_PEER = "Pendulum-v1, drawn"
DIRECT, WITH_LAW = "capsule", "capsule with law"
DISTURBED: dict[str, Any] = {"disturbances": "real", "randomization": "real"}
INTEGRATOR = "implicitfast"
CONDITIONS = (
    f"A step of ours and of MuJoCo's capsule is {1e3 * task.CONTROL_DT:g} ms; direct torque is uniform within "
    f"±{ACTION_SCALE * task.TORQUE_LIMIT:g} N m, the law is baselines:adaptive. Ours computes observation, reward and "
    "info too, MuJoCo's batch (mujoco.rollout) the physics alone. Ratios of batches are to its batch at the same step "
    'and number of threads. Batches of ours never truncate here. Disturbed: the plants and disturbances of "real". '
    'Drawn: render() after each step, in "rgb_array".'
)


@dataclass(frozen=True, kw_only=True)
class Args(OutputArgs):
    """Environment steps per second, compared with other environments.

    Peers that need another package come with the extra `bench`. Takes minutes; nothing else should run meanwhile.

    Examples:
      python -m benchmarks.throughput --turns 3
      python -m benchmarks.throughput --markdown docs/speed_tables.md
    """

    turns: Count = 9
    """Turns of every contender."""


# Functions that make a number of steps in all environments, and that free the environments.
Stepper = tuple[Callable[[int], None], Callable[[], None]]


@dataclass(frozen=True)
class Contender:
    """A way to step environments whose rate is measured.

    Attributes:
        label: label in tables.
        make: function that creates the environments.
        environments: number of environments.
        substeps: integration steps in one step of the environment.
        threads: number of threads that share the environments.
        peer: name of the contender in the denominator of the ratio.
        package: package that must be installed in addition to this package.
    """

    label: str
    make: Callable[[], Stepper]
    environments: int = 1
    substeps: int = 1
    threads: int = 1
    peer: str | None = None
    package: str = "numpy"

    @property
    def name(self) -> str:
        """The label with batch size and threads, unique among the contenders."""
        batch = f", {self.environments} environments" if self.environments > 1 else ""
        return f"{self.label}{batch}{f', {self.threads} threads' if self.threads > 1 else ''}"


def step_single(env_id: str, scale: float = 1.0, **kwargs: Any) -> Stepper:
    """One environment with gymnasium's default wrappers; with a render mode, each step also renders a frame."""
    env = gym.make(env_id, **kwargs)
    env.action_space.seed(SEED)
    samples = [env.action_space.sample() for _ in range(256)]
    actions = cycle(s if isinstance(s, (int, np.integer)) else np.float32(scale) * s for s in samples)
    env.reset(seed=SEED)

    def step(count: int) -> None:
        for _ in range(count):
            _, _, terminated, truncated, _ = env.step(next(actions))
            if "render_mode" in kwargs:
                env.render()
            if terminated or truncated:
                env.reset()

    return (step, env.close)


def _step_repeatedly(
    step: Callable[[np.ndarray], Any], actions: Sequence[np.ndarray] | np.ndarray
) -> Callable[[int], None]:
    """Returns a function that makes a number of steps and repeats the actions."""

    def repeat(count: int) -> None:
        for n in range(count):
            step(actions[n % len(actions)])

    return repeat


def step_batch(env_id: str, num_envs: int, scale: float = 1.0, **kwargs: Any) -> Stepper:
    """A native batch through gym.make_vec."""
    env = gym.make_vec(env_id, num_envs=num_envs, vectorization_mode="vector_entry_point", **kwargs)
    env.action_space.seed(SEED)
    samples = [env.action_space.sample() for _ in range(DRAWS)]
    actions = [sample if sample.dtype.kind == "i" else np.float32(scale) * sample for sample in samples]
    env.reset(seed=SEED)
    return (_step_repeatedly(env.step, actions), env.close)


def step_envpool(env_id: str, num_envs: int, threads: int) -> Stepper:
    """A batch of EnvPool, stepped synchronously."""
    import envpool

    with warnings.catch_warnings():
        # gymnasium warns that the bounds of EnvPool's spaces lose precision.
        warnings.simplefilter("ignore", UserWarning)
        env = envpool.make(env_id, env_type="gymnasium", num_envs=num_envs, num_threads=threads, seed=SEED)
        env.reset()
        box = env.action_space
    shape = (DRAWS, num_envs, *box.shape)
    actions = np.random.default_rng(SEED).uniform(box.low, box.high, shape).astype(np.float32)
    return (_step_repeatedly(env.step, actions), env.close)


def step_mujoco(friction: FrictionModel, physics_dt: float, num_envs: int, threads: int) -> Stepper:
    """The capsule in MuJoCo under the same random torques; only the physics is computed."""
    from benchmarks import mujoco

    model = mujoco.build_model(friction, INTEGRATOR, physics_dt)
    batch = mujoco.Batch(model, num_envs, threads, round(task.CONTROL_DT / physics_dt))
    limit = ACTION_SCALE * task.TORQUE_LIMIT
    torques = np.random.default_rng(SEED).uniform(-limit, limit, (DRAWS, num_envs))
    return (_step_repeatedly(batch.step, torques), batch.close)


def mujoco_contender(friction: FrictionModel, physics_dt: float, threads: int = 1) -> Contender:
    """A batch of the capsule in MuJoCo."""
    return Contender(
        f"MuJoCo {friction.name}, {INTEGRATOR}, {1e3 * physics_dt:g} ms",
        partial(step_mujoco, friction, physics_dt, PEER_BATCH, threads),
        PEER_BATCH,
        round(task.CONTROL_DT / physics_dt),
        threads,
        package="mujoco",
    )


def ours() -> list[Contender]:
    """The contenders of this package, without and with a law inside the step."""
    found = []
    kinds: tuple[tuple[str, float, dict[str, Any]], ...] = (
        (DIRECT, DIRECT_PHYSICS_DT, {"scale": ACTION_SCALE}),
        (WITH_LAW, LAW_PHYSICS_DT, LAW),
    )
    for label, physics_dt, kwargs in kinds:
        substeps = round(task.CONTROL_DT / physics_dt)
        single = partial(step_single, ENV_ID, **kwargs)
        found.append(Contender(f"{label}, gym.make", single, 1, substeps, peer=SINGLE_PEER))
        for num_envs in BATCHES:
            for threads in THREADS if num_envs >= PEER_BATCH else THREADS[:1]:
                endless = {"physics_dt": physics_dt, "threads": threads, "max_episode_steps": sys.maxsize}
                batch = partial(step_batch, ENV_ID, num_envs, **endless, **kwargs)
                peer = mujoco_contender(FRICTIONS[0], physics_dt, threads).name
                found.append(Contender(f"{label}, gym.make_vec", batch, num_envs, substeps, threads, peer))
    for exact in [each for each in found if each.environments in (1, PEER_BATCH) and each.threads == 1]:
        label = exact.label.replace(", ", ", disturbed, ")
        found.append(replace(exact, label=label, make=partial(exact.make, **DISTURBED), peer=exact.name))
    drawn = partial(step_single, ENV_ID, ACTION_SCALE, render_mode="rgb_array")
    found.append(Contender(f"{DIRECT}, drawn", drawn, peer=DRAWN_PEER))
    return found


def peers() -> list[Contender]:
    """Tasks of similar size from gymnasium and EnvPool, and the same capsule in MuJoCo."""
    inverted = "InvertedPendulum-v5"
    found = [
        Contender(SINGLE_PEER, partial(step_single, SINGLE_PEER)),
        Contender("Pendulum-v1", partial(step_single, "Pendulum-v1")),
        Contender(DRAWN_PEER, partial(step_single, "Pendulum-v1", render_mode="rgb_array")),
        # Its frame_skip is 2.
        Contender(inverted, partial(step_single, inverted), substeps=2, package="mujoco"),
        Contender(f"{SINGLE_PEER}, gym.make_vec", partial(step_batch, SINGLE_PEER, PEER_BATCH), PEER_BATCH),
    ]
    for threads in THREADS:
        make = partial(step_envpool, "Pendulum-v1", PEER_BATCH, threads)
        found.append(Contender("EnvPool Pendulum-v1", make, PEER_BATCH, threads=threads, package="envpool"))
    for friction in FRICTIONS:
        for physics_dt in (DIRECT_PHYSICS_DT, LAW_PHYSICS_DT):
            found += [mujoco_contender(friction, physics_dt, threads) for threads in THREADS]
    return found


def select_available(contenders: Sequence[Contender]) -> tuple[list[Contender], list[str]]:
    """The contenders that this machine can measure, and a line with the reason for each omitted contender."""
    found, left_out = [], []
    for contender in contenders:
        if find_spec(contender.package) is None:
            reason = f'{contender.package} is not installed: pip install "capsule-gym[bench]"'
            left_out.append(f"{contender.name} is left out: {reason}")
        elif contender.threads > available_cores():
            left_out.append(f"{contender.name} is left out: this machine has fewer cores")
        else:
            found.append(contender)
    return found, left_out


def measure(contenders: Sequence[Contender], turns: int) -> dict[str, list[float]]:
    """Measures the environment steps per second of all contenders; returns them by name, one number per turn."""
    with ExitStack() as stack:
        ready: dict[str, Callable[[], float]] = {}
        for contender in tqdm(contenders, desc="preparing"):
            step, close = contender.make()
            stack.callback(close)
            step(1)  # compiles
            count = 1
            while count / (rate := _rate(step, count)) < CALIBRATION_SECONDS:
                count *= 2
            ready[contender.name] = partial(_rate, step, max(1, round(rate * TURN_SECONDS)))
        rates = take_turns(ready, turns)
    return {each.name: [each.environments * rate for rate in rates[each.name]] for each in contenders}


def _rate(step: Callable[[int], None], count: int) -> float:
    """Makes `count` steps; returns the steps per second."""
    start = time.perf_counter()
    step(count)
    return count / (time.perf_counter() - start)


def table(measured: Sequence[Contender], rates: Mapping[str, Sequence[float]]) -> list[list[str]]:
    """The table of rates; a ratio is shown only if its peer was measured."""
    rows = [["", "envs", "threads", "substeps", "env-steps/s", "IQR", "ratio", "to"]]
    labels = {contender.name: contender.label for contender in measured}
    for contender in measured:
        numbers = [f"{n:,}" for n in (contender.environments, contender.threads, contender.substeps)]
        rate, peer = statistics.median(rates[contender.name]), rates.get(contender.peer or "")
        ratio = [f"{rate / statistics.median(peer):.3g}", labels[contender.peer or ""]] if peer else ["", ""]
        rows.append([contender.label, *numbers, f"{rate:,.0f}", f"{spread(rates[contender.name]):.0%}", *ratio])
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    contenders, left_out = select_available([*ours(), *peers()])
    rates = measure(contenders, args.turns)
    rows = table(contenders, rates)
    note = f"{machine('mujoco', 'envpool')}; medians of {args.turns} turns, IQR: interquartile range over it."
    args.report(COMMAND, rows, CONDITIONS, note, *left_out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
