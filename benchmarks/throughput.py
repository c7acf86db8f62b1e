"""Environment steps per second, compared with other environments: `python -m benchmarks.throughput`.

All actions are drawn beforehand. A single environment plays whole episodes, resets included. A batch of this package
does not truncate, so that batches of every size are measured alike: an environment that fails is reset within the step,
and the reset of all environments is measured separately.
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
from tyro.conf import arg

from baselines import drawing
from baselines.tables import markdown_table, text_table
from benchmarks.measurement import (
    Contender,
    OutputArgs,
    Rate,
    Stepper,
    available_cores,
    describe,
    machine,
    measure,
    save_figure,
    select_available,
)
from benchmarks.mujoco import FRICTIONS, FrictionModel
from capsule_gym import ENV_ID, task
from capsule_gym.command_line import Count, parse
from capsule_gym.parameters import DIRECT_PHYSICS_DT, LAW_PHYSICS_DT

COMMAND = "python -m benchmarks.throughput"
TURNS, QUICK_TURNS = 9, 3
TURN_SECONDS = 0.2
SEED = 0
# Random torques up to the limit would mostly measure resets; the paper's torques are rarely above this share.
ACTION_SCALE = 0.2
LAW: dict[str, Any] = {"controller": "baselines:adaptive", "residual_limit": ACTION_SCALE * task.TORQUE_LIMIT}
# Distinct actions that are repeated.
DRAWS = 16
BATCHES = (1, 64, 1024, 16384, 262144)
LARGE = 262144
PEER_BATCH = 1024
THREADS = (1, 2)
SINGLE_PEER = "CartPole-v1"
DIRECT, WITH_LAW = "capsule", "capsule with law"
INTEGRATOR = "implicitfast"
# The beginning of a label, the colour of its bars, and the legend; the last entry is for all others.
KINDS = (
    (WITH_LAW, "#56B4E9", "ours, the law inside the step"),
    (DIRECT, drawing.BLUE, "ours, direct torque"),
    ("MuJoCo", drawing.VERMILION, "the same capsule in MuJoCo"),
    ("", drawing.MUTED, "other environments"),
)


@dataclass(frozen=True, kw_only=True)
class Args(OutputArgs):
    """Environment steps per second, compared with other environments.

    Peers that need another package come with the extra `bench`. Takes minutes; nothing else should run meanwhile.

    Examples:
      python -m benchmarks.throughput --quick
      python -m benchmarks.throughput --markdown docs/speed_tables.md --figure docs/figures/speed.png
    """

    turns: Annotated[Count, arg(help=f"turns of every contender; --quick takes {QUICK_TURNS} at most")] = TURNS
    quick: Annotated[bool, arg(help=f"fewer turns, no batch of {LARGE:,}")] = False
    figure: Path | None = None
    """Draw the chart into this PNG file."""


def step_single(env_id: str, scale: float = 1.0, unwrapped: bool = False, **kwargs: Any) -> Stepper:
    """One environment: with gymnasium's default wrappers, or without any."""
    made = gym.make(env_id, **kwargs)
    env = made.unwrapped if unwrapped else made
    env.action_space.seed(SEED)
    samples = [env.action_space.sample() for _ in range(256)]
    actions = [sample if isinstance(sample, (int, np.integer)) else np.float32(scale) * sample for sample in samples]
    env.reset(seed=SEED)
    taken = 0

    def step(count: int) -> None:
        nonlocal taken
        for _ in range(count):
            taken += 1
            _, _, terminated, truncated, _ = env.step(actions[taken % len(actions)])
            # Without a wrapper nothing else truncates.
            if terminated or truncated or (unwrapped and taken % task.EPISODE_STEPS == 0):
                env.reset()

    return Stepper(step, made.close)


def step_batch(env_id: str, num_envs: int, scale: float = 1.0, **kwargs: Any) -> Stepper:
    """A native batch through gym.make_vec."""
    env = gym.make_vec(env_id, num_envs=num_envs, vectorization_mode="vector_entry_point", **kwargs)
    env.action_space.seed(SEED)
    samples = [env.action_space.sample() for _ in range(DRAWS)]
    actions = [sample if sample.dtype.kind == "i" else np.float32(scale) * sample for sample in samples]
    if num_envs < LARGE:  # the first reset compiles; before the largest batch smaller ones have done so
        env.reset(seed=SEED)
    start = time.perf_counter()
    env.reset(seed=SEED)
    seconds = time.perf_counter() - start

    def step(count: int) -> None:
        for n in range(count):
            env.step(actions[n % DRAWS])

    return Stepper(step, env.close, seconds)


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

    def step(count: int) -> None:
        for n in range(count):
            env.step(actions[n % DRAWS])

    return Stepper(step, env.close)


def step_mujoco(friction: FrictionModel, physics_dt: float, num_envs: int, threads: int) -> Stepper:
    """The capsule in MuJoCo under the same random torques; only the physics is computed."""
    from benchmarks import mujoco

    model = mujoco.build_model(friction, INTEGRATOR, physics_dt)
    batch = mujoco.Batch(model, num_envs, threads, round(task.CONTROL_DT / physics_dt))
    limit = ACTION_SCALE * task.TORQUE_LIMIT
    torques = np.random.default_rng(SEED).uniform(-limit, limit, (DRAWS, num_envs))

    def step(count: int) -> None:
        for n in range(count):
            batch.step(torques[n % DRAWS])

    return Stepper(step, batch.close)


def mujoco_contender(friction: FrictionModel, physics_dt: float, threads: int = 1) -> Contender:
    """A batch of the capsule in MuJoCo."""
    return Contender(
        f"MuJoCo {friction.name}, {INTEGRATOR}, {1e3 * physics_dt:g} ms",
        partial(step_mujoco, friction, physics_dt, PEER_BATCH, threads),
        PEER_BATCH,
        round(task.CONTROL_DT / physics_dt),
        threads,
        packages=("mujoco",),
    )


def ours(large: bool) -> list[Contender]:
    """The environments of this package, without and with a law inside the step.

    Args:
        large: whether the largest batch is included.
    """
    found = []
    kinds: tuple[tuple[str, float, dict[str, Any]], ...] = (
        (DIRECT, DIRECT_PHYSICS_DT, {"scale": ACTION_SCALE}),
        (WITH_LAW, LAW_PHYSICS_DT, LAW),
    )
    for label, physics_dt, kwargs in kinds:
        substeps = round(task.CONTROL_DT / physics_dt)
        for suffix, unwrapped in (("step alone", True), ("gym.make", False)):
            single = partial(step_single, ENV_ID, unwrapped=unwrapped, **kwargs)
            found.append(Contender(f"{label}, {suffix}", single, 1, substeps, peer=SINGLE_PEER))
        for num_envs in BATCHES if large else BATCHES[: BATCHES.index(LARGE)]:
            for threads in THREADS if num_envs >= PEER_BATCH else THREADS[:1]:
                endless = {"physics_dt": physics_dt, "threads": threads, "max_episode_steps": sys.maxsize}
                batch = partial(step_batch, ENV_ID, num_envs, **endless, **kwargs)
                peer = mujoco_contender(FRICTIONS[0], physics_dt, threads).name if num_envs > 1 else SINGLE_PEER
                found.append(Contender(f"{label}, gym.make_vec", batch, num_envs, substeps, threads, peer))
    return found


def peers() -> list[Contender]:
    """Tasks of gymnasium and EnvPool of about this size, and the same capsule in MuJoCo."""
    inverted, packages = "InvertedPendulum-v5", ("mujoco", "imageio")
    found = [
        Contender(SINGLE_PEER, partial(step_single, SINGLE_PEER)),
        Contender("Pendulum-v1", partial(step_single, "Pendulum-v1")),
        # Its frame_skip is 2.
        Contender(inverted, partial(step_single, inverted), substeps=2, packages=packages),
        Contender(f"{SINGLE_PEER}, gym.make_vec", partial(step_batch, SINGLE_PEER, PEER_BATCH), PEER_BATCH),
    ]
    for threads in THREADS:
        make = partial(step_envpool, "Pendulum-v1", PEER_BATCH, threads)
        found.append(Contender("EnvPool Pendulum-v1", make, PEER_BATCH, threads=threads, packages=("envpool",)))
    for friction in FRICTIONS:
        for physics_dt in (DIRECT_PHYSICS_DT, LAW_PHYSICS_DT):
            found += [mujoco_contender(friction, physics_dt, threads) for threads in THREADS]
    return found


def table(measured: Sequence[Contender], rates: Mapping[str, Rate]) -> list[list[str]]:
    """The table of rates; a ratio only where its peer was measured."""
    rows = [["", "envs", "threads", "substeps", "env-steps/s", "IQR", "substeps/s", "us per env-step", "ratio", "to"]]
    labels = {contender.name: contender.label for contender in measured}
    for contender in measured:
        rate, peer = rates[contender.name], rates.get(contender.peer or "")
        rows.append(
            [
                contender.label,
                f"{contender.environments:,}",
                str(contender.threads),
                str(contender.substeps),
                f"{rate.median:,.0f}",
                f"{rate.spread:.0%}",
                f"{rate.median * contender.substeps:,.0f}",
                f"{1e6 / rate.median:.3g}",
                f"{rate.median / peer.median:.3g}" if peer else "",
                labels[contender.peer or ""] if peer else "",
            ]
        )
    return rows


def notes(measured: Sequence[Contender], rates: Mapping[str, Rate]) -> list[str]:
    """The conditions of the measurement, and the duration of a reset of the largest batch."""
    own = [contender for contender in measured if contender.label.startswith(DIRECT) and contender.threads == 1]
    largest = max(own, key=lambda contender: contender.environments)
    rate = rates[largest.name]
    seconds = rate.reset_seconds or 0.0
    share = seconds / largest.environments / (task.EPISODE_STEPS / rate.median)
    return [
        f"A step of ours and of MuJoCo's capsule is {1e3 * task.CONTROL_DT:g} ms; direct torque is uniform within "
        f"±{ACTION_SCALE * task.TORQUE_LIMIT:g} N m, the law is baselines:adaptive. Ours computes observation, reward "
        "and info too, MuJoCo's batch (mujoco.rollout) the physics alone. Ratios of batches are to its batch at the "
        "same step and number of threads.",
        f"Batches of ours never truncate here: resetting all of {largest.environments:,} environments takes "
        f"{seconds:.2g} s, which adds {share:.1%} to the time of an episode of {task.EPISODE_STEPS} steps.",
    ]


def draw(measured: Sequence[Contender], rates: Mapping[str, Rate], note: str) -> Any:
    """The chart, to be called in `drawing.style`: a bar per contender on one thread, a mark for two threads."""
    figure = drawing.new_figure(5.2)
    axes = figure.subplots()
    bars = [contender for contender in measured if contender.threads == 1]
    shared = {(c.label, c.environments): rates[c.name].median for c in measured if c.threads > 1}
    mark: dict[str, Any] = {"marker": "D", "markersize": 3.2, "color": drawing.INK, "linestyle": "none"}
    labelled: set[str] = set()
    for row, contender in enumerate(bars):
        colour, words = next(entry[1:] for entry in KINDS if contender.label.startswith(entry[0]))
        label = None if words in labelled else words
        labelled.add(words)
        rate, two = rates[contender.name].median, shared.get((contender.label, contender.environments))
        axes.barh(row, rate, height=0.72, color=colour, log=True, label=label)
        text = f"{rate:,.0f}"
        if two is not None:
            axes.plot(two, row, **mark)
            text += f" ({two:,.0f})"
        axes.annotate(text, (1.01, row), xycoords=axes.get_yaxis_transform(), va="center", fontsize=6.5)
    axes.plot([], [], label="two threads (bars: one)", **mark)
    names = [f"{c.label}{f' x {c.environments:,}' if c.environments > 1 else ''}" for c in bars]
    axes.set_yticks(range(len(bars)), names, fontsize=6.8)
    axes.set_ylim(len(bars) - 0.4, -0.6)
    axes.set_xlim(left=10.0 ** math.floor(math.log10(min(rate.median for rate in rates.values()))))
    axes.set_xlabel("environment steps per second; x 1,024: a batch of that size")
    axes.legend(loc="lower right", fontsize=6.8)
    drawing.add_note(figure, note)
    return figure


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    found = machine("mujoco", "envpool")
    turns = min(args.turns, QUICK_TURNS) if args.quick else args.turns
    contenders, left_out = select_available([*ours(large=not args.quick), *peers()], available_cores())
    rates = measure(contenders, turns, TURN_SECONDS)
    rows = table(contenders, rates)
    note = f"{describe(found)}; medians of {turns} turns, IQR: interquartile range over it."
    below = [*notes(contenders, rates), note, *left_out]
    print(text_table(rows), *below, sep="\n\n")
    entries = [
        {
            "name": contender.name,
            "label": contender.label,
            "environments": contender.environments,
            "threads": contender.threads,
            "substeps": contender.substeps,
            "peer": contender.peer,
            **asdict(rates[contender.name]),
        }
        for contender in contenders
    ]
    numbers = {"machine": found, "turns": turns, "turn_seconds": TURN_SECONDS, "left_out": left_out, "rates": entries}
    args.write(COMMAND, numbers, "\n\n".join([markdown_table(rows), *below]).split("\n"))
    if args.figure is not None:
        with drawing.style():
            save_figure(draw(contenders, rates, note), args.figure)
    return 0


if __name__ == "__main__":
    sys.exit(main())
