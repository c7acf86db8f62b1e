"""What is measured: this package's environments and their peers, all with actions drawn beforehand.

A single environment plays whole episodes, resets included. A batch of ours does not truncate, so that batches of every
size are measured alike: an environment that fails is reset within the steps, and the reset of all is timed apart.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.frictions import FRICTIONLOSS, FRICTIONS, Friction, series_name
from benchmarks.timing import Contender, Stepper
from capsule_gym import ENV_ID, task
from capsule_gym.parameters import DIRECT_PHYSICS_DT, LAW_PHYSICS_DT, Capsule

SEED = 0
# Mostly resets would be measured under random torques up to the limit, and the paper's are rarely above this share.
ACTION_SCALE = 0.2
LAW: dict[str, Any] = {"controller": "baselines:adaptive", "residual_limit": ACTION_SCALE * task.TORQUE_LIMIT}
DRAWS = 16
BATCHES = (1, 64, 1024, 16384, 262144)
LARGE = 262144
PEER_BATCH = 1024
THREADS = (1, 2)
SMALLEST_SHARED = 1024
START = (task.START_THETA, 0.0, 0.0, 0.0)
SINGLE_PEER = "CartPole-v1"
DIRECT, WITH_LAW = "capsule", "capsule with law"
DIRECT_BATCH = f"{DIRECT}, gym.make_vec"
STEPPED_INTEGRATOR = "implicitfast"


def substeps(physics_dt: float) -> int:
    """Steps of the integrator in one step of the environment."""
    return round(task.CONTROL_DT / physics_dt)


def step_single(env_id: str, scale: float = 1.0, unwrapped: bool = False, **kwargs: Any) -> Stepper:
    """One environment: through gymnasium's default wrappers, or without any."""
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
            # Without a wrapper nobody else truncates.
            if terminated or truncated or (unwrapped and taken % task.EPISODE_STEPS == 0):
                env.reset()

    return Stepper(step, made.close)


def _step_vector(env: Any, scale: float) -> Stepper:
    """A batch with gymnasium's interface."""
    env.action_space.seed(SEED)
    samples = [env.action_space.sample() for _ in range(DRAWS)]
    actions = [sample if sample.dtype.kind == "i" else np.float32(scale) * sample for sample in samples]
    if env.num_envs < LARGE:  # the first one compiles; smaller batches have done it for the largest
        env.reset(seed=SEED)
    start = time.perf_counter()
    env.reset(seed=SEED)
    seconds = time.perf_counter() - start

    def step(count: int) -> None:
        for n in range(count):
            env.step(actions[n % len(actions)])

    return Stepper(step, env.close, seconds)


def step_batch(env_id: str, num_envs: int, scale: float = 1.0, **kwargs: Any) -> Stepper:
    """A native batch through gym.make_vec."""
    made = gym.make_vec(env_id, num_envs=num_envs, vectorization_mode="vector_entry_point", **kwargs)
    return _step_vector(made, scale)


def step_envpool(env_id: str, num_envs: int, threads: int) -> Stepper:
    """A batch of EnvPool's, stepped synchronously."""
    import envpool

    with warnings.catch_warnings():
        # Its spaces lose the precision of their bounds, which gymnasium tells.
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


def step_mujoco(friction: Friction, integrator: str, physics_dt: float, num_envs: int, threads: int) -> Stepper:
    """The capsule in MuJoCo, under the same random torques as ours; nothing but the physics is computed."""
    from benchmarks import mujoco_capsule

    model = mujoco_capsule.build_model(Capsule(), friction, integrator, physics_dt)
    batch = mujoco_capsule.Batch(model, num_envs, threads, START, substeps(physics_dt))
    limit = ACTION_SCALE * task.TORQUE_LIMIT
    torques = np.random.default_rng(SEED).uniform(-limit, limit, (DRAWS, num_envs, 1))

    def step(count: int) -> None:
        for n in range(count):
            batch.step(torques[n % DRAWS])

    return Stepper(step, batch.close)


def mujoco_contender(friction: Friction, integrator: str, physics_dt: float, threads: int = 1) -> Contender:
    """A batch of the capsule in MuJoCo."""
    return Contender(
        f"{series_name(friction, integrator)}, {1e3 * physics_dt:g} ms",
        partial(step_mujoco, friction, integrator, physics_dt, PEER_BATCH, threads),
        PEER_BATCH,
        substeps(physics_dt),
        threads,
        packages=("mujoco",),
    )


def our_batch(label: str, num_envs: int, physics_dt: float, threads: int = 1, **kwargs: Any) -> Contender:
    """A batch of ours; its ratio is to MuJoCo's at the same step and threads, that of a batch of one to CartPole."""
    make: Callable[[], Stepper] = partial(
        step_batch, ENV_ID, num_envs, physics_dt=physics_dt, threads=threads, max_episode_steps=sys.maxsize, **kwargs
    )
    peer = mujoco_contender(FRICTIONLOSS, STEPPED_INTEGRATOR, physics_dt, threads)
    return Contender(label, make, num_envs, substeps(physics_dt), threads, peer.name if num_envs > 1 else SINGLE_PEER)


def ours(large: bool) -> list[Contender]:
    """This package's, without and with a law inside the step.

    Args:
        large: whether the largest batch takes part.
    """
    found = []
    kinds: tuple[tuple[str, float, dict[str, Any]], ...] = (
        (DIRECT, DIRECT_PHYSICS_DT, {"scale": ACTION_SCALE}),
        (WITH_LAW, LAW_PHYSICS_DT, LAW),
    )
    for label, physics_dt, kwargs in kinds:
        for suffix, unwrapped in (("step alone", True), ("gym.make", False)):
            make = partial(step_single, ENV_ID, unwrapped=unwrapped, **kwargs)
            found.append(Contender(f"{label}, {suffix}", make, 1, substeps(physics_dt), peer=SINGLE_PEER))
        for num_envs in BATCHES if large else BATCHES[: BATCHES.index(LARGE)]:
            for threads in THREADS if num_envs >= SMALLEST_SHARED else THREADS[:1]:
                found.append(our_batch(f"{label}, gym.make_vec", num_envs, physics_dt, threads, **kwargs))
    return found


def peers() -> list[Contender]:
    """Others': gymnasium's and EnvPool's tasks of about this size, and the same capsule in MuJoCo."""
    found = [
        Contender(SINGLE_PEER, partial(step_single, SINGLE_PEER)),
        Contender("Pendulum-v1", partial(step_single, "Pendulum-v1")),
        Contender(
            "InvertedPendulum-v5",
            partial(step_single, "InvertedPendulum-v5"),
            substeps=2,  # its frame_skip
            packages=("mujoco", "imageio"),
        ),
        Contender(f"{SINGLE_PEER}, gym.make_vec", partial(step_batch, SINGLE_PEER, PEER_BATCH), PEER_BATCH),
    ]
    for threads in THREADS:
        make = partial(step_envpool, "Pendulum-v1", PEER_BATCH, threads)
        found.append(Contender("EnvPool Pendulum-v1", make, PEER_BATCH, threads=threads, packages=("envpool",)))
    for friction in FRICTIONS:
        for physics_dt in (DIRECT_PHYSICS_DT, LAW_PHYSICS_DT):
            found += [mujoco_contender(friction, STEPPED_INTEGRATOR, physics_dt, threads) for threads in THREADS]
    return found
