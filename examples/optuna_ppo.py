"""Optuna: searches hyperparameters of Stable-Baselines3's PPO on the native batch, and prunes slow trials."""

import argparse
from typing import Any

import optuna  # pip install -e ".[tune,sb3]"
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize, sync_envs_normalization

from capsule_gym.sb3 import CapsuleSB3VecEnv

# Seeds of training and of validation plants, far from those of published runs and evaluation sets.
SEED, VALIDATION_SEED = 1000, 1_000_000
EVALUATIONS = 8


def main() -> None:
    """Searches; with --storage the same command continues a search, also in several terminals at once."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--storage", help="for example sqlite:///ppo.db")
    args = parser.parse_args()

    def objective(trial: optuna.Trial) -> float:
        gamma = 1.0 - trial.suggest_float("one_minus_gamma", 1e-3, 3e-2, log=True)
        settings: dict[str, Any] = {
            "learning_rate": trial.suggest_float("learning_rate", 1e-4, 3e-3, log=True),
            "gae_lambda": 1.0 - trial.suggest_float("one_minus_lambda", 5e-3, 1e-1, log=True),
            "batch_size": trial.suggest_categorical("batch_size", [1024, 2048, 4096]),
            "n_epochs": trial.suggest_int("n_epochs", 3, 10),
            "policy_kwargs": {"log_std_init": trial.suggest_float("log_std_init", -1.5, 0.0)},
        }
        env = VecNormalize(CapsuleSB3VecEnv(num_envs=128, seed=SEED, initial_range=(1.047, 8.0)), gamma=gamma)
        model = PPO("MlpPolicy", env, n_steps=64, gamma=gamma, seed=SEED, device="cpu", **settings)
        best = -float("inf")
        for n in range(EVALUATIONS):
            model.learn(args.steps // EVALUATIONS, reset_num_timesteps=False)
            validation = VecNormalize(CapsuleSB3VecEnv(64, VALIDATION_SEED), training=False, norm_reward=False)
            sync_envs_normalization(env, validation)
            score: Any = evaluate_policy(model, validation, n_eval_episodes=64)[0]
            best = max(best, score)
            trial.report(best, n)
            if trial.should_prune():
                raise optuna.TrialPruned
        return best

    pruner = optuna.pruners.MedianPruner(n_warmup_steps=EVALUATIONS // 2)
    options: dict[str, Any] = {"storage": args.storage, "study_name": "ppo", "load_if_exists": True}
    study = optuna.create_study(direction="maximize", pruner=pruner, **options)
    study.optimize(objective, n_trials=args.trials)
    print(f"best of {len(study.trials)} trials: a return of {study.best_value:.1f} cm with {study.best_params}")


if __name__ == "__main__":
    main()
