"""Tuned hyperparameters: of each algorithm and action mode, and of the trained rows."""

from dataclasses import replace
from typing import Any

from agents.training.config import (
    ActionMode,
    Algorithm,
    Config,
    Environment,
    PPOConfig,
    RecurrentPPOConfig,
    SACConfig,
    TD3Config,
    TQCConfig,
)
from capsule_gym.checks import nearest

# Largest angle, rad, and angular velocity, rad/s, at the start of an episode.
WIDE_STARTS = (1.047, 8.0)
ON_POLICY: dict[str, Any] = dict(
    total_steps=4_000_000,
    evaluate_every=400_000,
    num_envs=128,
    n_steps=128,
    learning_rate=1e-3,
    final_learning_rate=0.0,
    gae_lambda=0.95,
    ent_coef=0.003,
)
# Wide starts and, on a law, the total torque as action lead out of slow gaits; a critic that knows
# the plant makes the seeds alike (docs/algorithms.md).
RESIDUAL_PPO = PPOConfig(
    **ON_POLICY,
    total_torque=True,
    initial_range=WIDE_STARTS,
    termination_penalty=10.0,
    batch_size=1024,
    privileged=True,
)
# From the default start, with a larger penalty, both tried seeds learnt wide swings; with wide
# starts, two of four.
DIRECT_PPO = replace(
    RESIDUAL_PPO,
    action_mode="direct",
    controller=None,
    total_torque=False,
    initial_range=None,
    termination_penalty=30.0,
)
# With half the epochs of PPO a step takes half the time, and learns as much.
DIRECT_RECURRENT_PPO = RecurrentPPOConfig(
    action_mode="direct", controller=None, n_epochs=3, **ON_POLICY
)
OFF_POLICY: dict[str, Any] = dict(
    total_steps=400_000,
    evaluate_every=50_000,
    num_envs=32,
    batch_size=512,
    learning_rate=7e-4,
)
# With only the default start, training converges to a one-sided gait; without correlated noise or
# without `observation_scale`, it mostly converges to a narrow gait (docs/algorithms.md).
DIRECT_OFF_POLICY: dict[str, Any] = dict(
    action_mode="direct",
    controller=None,
    initial_range=WIDE_STARTS,
    episode_seconds=4.0,
    termination_penalty=10.0,
    total_steps=500_000,
    evaluate_every=25_000,
    num_envs=32,
    batch_size=256,
    learning_starts=2000,
    learning_rate=1e-3,
    n_steps=3,
    tau=0.005,
    action_noise=0.25,
    noise_time=0.25,
    observation_scale=(2.0, 0.25, 6.0),
)
TARGET_ENTROPY = -3.0
DIRECT_SAC = SACConfig(**DIRECT_OFF_POLICY, target_entropy=TARGET_ENTROPY)
DIRECT_TQC = TQCConfig(
    **DIRECT_OFF_POLICY, target_entropy=TARGET_ENTROPY, quantiles=10, dropped_quantiles=0
)
PRESETS: dict[tuple[ActionMode, Algorithm], Config] = {
    ("residual", "ppo"): RESIDUAL_PPO,
    ("direct", "ppo"): DIRECT_PPO,
    ("residual", "recurrentppo"): RecurrentPPOConfig(total_torque=True, **ON_POLICY),
    ("direct", "recurrentppo"): DIRECT_RECURRENT_PPO,
    ("residual", "sac"): SACConfig(**OFF_POLICY),
    ("direct", "sac"): DIRECT_SAC,
    ("residual", "td3"): TD3Config(**OFF_POLICY, action_noise=0.2),
    ("direct", "td3"): TD3Config(**DIRECT_OFF_POLICY),
    ("residual", "tqc"): TQCConfig(**OFF_POLICY),
    ("direct", "tqc"): DIRECT_TQC,
}

# Shared by the presets of the other tasks. Failures are rare, so a score needs many validation
# episodes.
OTHER_TASK = PPOConfig(
    action_mode="direct",
    controller=None,
    randomization="default",
    energy_weight=0.0,
    gamma=0.99,
    num_envs=256,
    hidden=128,
    final_learning_rate=2e-5,
    ent_coef=0.006,
    privileged=True,
)
# A training episode is hardly longer than the time to the goal. A rest within 2 mm requires little
# noise: without an entropy bonus, exploration would end early. How far a stroke carries depends on
# the plant.
GOAL = replace(
    OTHER_TASK,
    env="CapsuleGoal-v0",
    observe_estimates=True,
    episode_seconds=3.0,
    termination_penalty=3.0,
    total_steps=14_000_000,
    n_steps=64,
    evaluation_episodes=512,
)
# The platform lifts at the ends of the ranges of M, mu and the commands, and at a start with full
# torque. Training exceeds all of these limits, so that failures are more frequent in training than
# in evaluations. Without an entropy bonus, or with rewards clipped at 10, a third of the penalty,
# failures became more frequent after 4 to 8 million steps.
VELOCITY = replace(
    OTHER_TASK,
    env="CapsuleVelocity-v0",
    mass_range=(0.42, 0.55),
    friction_range=(0.042, 0.57),
    command_range=(-0.115, 0.115),
    residual_limit=1.3,
    training_limit=1.4,
    episode_seconds=20.0,
    termination_penalty=20.0,
    clip_reward=100.0,
    total_steps=16_000_000,
    num_envs=128,
    n_steps=128,
    evaluation_episodes=4096,
)
ENV_PRESETS: dict[Environment, Config] = {GOAL.env: GOAL, VELOCITY.env: VELOCITY}

# Residuals on a fast law: little noise.
RESIDUAL_REAL = PPOConfig(
    controller="baselines:gait_predictive",
    residual_limit=1.0,
    disturbances="real",
    randomization="real",
    # Without latencies from 0 on, one of five seeds failed where the sensors have none.
    latency_range=(0.0, 0.015),
    episode_seconds=10.0,
    termination_penalty=100.0,
    gamma=0.9975,
    total_steps=2_000_000,
    evaluate_every=250_000,
    evaluation_episodes=512,
    num_envs=256,
    n_steps=128,
    batch_size=4096,
    learning_rate=1e-3,
    final_learning_rate=3e-5,
    log_std_init=-1.2,
    privileged=True,
)
DIRECT_PPO_WIDE = replace(DIRECT_PPO, randomization="wide", observe_estimates=True)
DIRECT_RECURRENT_PPO_WIDE = replace(
    DIRECT_RECURRENT_PPO, randomization="wide", total_steps=3_000_000
)
# With more steps the cost of transport rises again.
EFFICIENT = replace(
    DIRECT_PPO,
    energy_weight=5.25,
    initial_range=WIDE_STARTS,
    total_steps=2_000_000,
    evaluate_every=200_000,
)
# Keys are the names of the folders in capsule_gym/data/policies; each run sets its own seed.
TRAINED_ROWS: dict[str, Config] = {
    "residual-ppo": RESIDUAL_PPO,
    "direct-ppo": DIRECT_PPO,
    "direct-ppo-wide": DIRECT_PPO_WIDE,
    "direct-recurrent-ppo": DIRECT_RECURRENT_PPO_WIDE,
    "direct-sac": DIRECT_SAC,
    "residual-real": RESIDUAL_REAL,
    "efficient": EFFICIENT,
    "goal": GOAL,
    "velocity": VELOCITY,
}


def preset(env: Environment, action_mode: ActionMode, algo: Algorithm) -> Config:
    """The default settings of a run.

    In the other environments, only direct torque with PPO is tuned.
    """
    tuned = ENV_PRESETS.get(env)
    if tuned is None:
        return PRESETS[action_mode, algo]
    if (action_mode, algo) == (tuned.action_mode, tuned.algo):
        return tuned
    settings = replace(
        PRESETS[action_mode, algo],
        env=env,
        randomization=tuned.randomization,
        energy_weight=tuned.energy_weight,
        termination_penalty=tuned.termination_penalty,
    )
    if action_mode == "residual":
        return replace(settings, controller=f"baselines:{tuned.task}_pulses")
    return settings


def row_settings(name: str) -> Config:
    """The settings of a row of the leaderboard, with seed 0.

    Raises:
        ValueError: if the name is unknown.
    """
    if name not in TRAINED_ROWS:
        accepted = f"one of {', '.join(TRAINED_ROWS)}"
        raise ValueError(f"a row must be {accepted}, got {name!r}{nearest(name, TRAINED_ROWS)}")
    return TRAINED_ROWS[name]
