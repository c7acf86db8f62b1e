"""Optuna: searches hyperparameters of Stable-Baselines3's PPO, and prunes slow trials.

With --storage the same command continues a search, also in several terminals at once.
"""

import argparse
from typing import Any

import optuna  # pip install -e ".[tune,sb3]"
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize, sync_envs_normalization

from capsule_gym.sb3 import CapsuleSB3VecEnv

# Seeds of training and of validation plants, far from those of published runs and evaluation sets.
SEED = 1000
VALIDATION_SEED = 1_000_000

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--trials", type=int, default=40)
parser.add_argument("--steps", type=int, default=1_000_000)
parser.add_argument("--storage", help="for example sqlite:///ppo.db")
args = parser.parse_args()


def objective(trial: optuna.Trial) -> float:
    """The mean return of an episode (cm) on validation plants after a training."""
    gamma = 1.0 - trial.suggest_float("one_minus_gamma", 1e-3, 3e-2, log=True)
    learning_rate = trial.suggest_float("learning_rate", 1e-4, 3e-3, log=True)
    gae_lambda = 1.0 - trial.suggest_float("one_minus_lambda", 5e-3, 1e-1, log=True)
    env = VecNormalize(CapsuleSB3VecEnv(128, SEED, initial_range=(1.047, 8.0)), gamma=gamma)
    validation = VecNormalize(CapsuleSB3VecEnv(64, VALIDATION_SEED), training=False)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=64,
        batch_size=2048,
        gamma=gamma,
        learning_rate=learning_rate,
        gae_lambda=gae_lambda,
        seed=SEED,
        device="cpu",
    )
    for part in range(8):
        model.learn(args.steps // 8, reset_num_timesteps=False)
        sync_envs_normalization(env, validation)
        score: Any = evaluate_policy(model, validation, n_eval_episodes=64)[0]
        trial.report(score, part)
        if trial.should_prune():
            raise optuna.TrialPruned
    return score


study = optuna.create_study(
    storage=args.storage, study_name="ppo", direction="maximize", load_if_exists=True
)
# A training that diverges raises one of these, and its trial fails.
study.optimize(objective, n_trials=args.trials, catch=(ValueError, ArithmeticError))
found = "none was completed"
if study.get_trials(states=[optuna.trial.TrialState.COMPLETE]):
    found = f"a return of {study.best_value:.1f} cm with {study.best_params}"
print(f"best of {len(study.trials)} trials: {found}")
