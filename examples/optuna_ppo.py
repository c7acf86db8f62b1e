"""Optuna: searches PPO's hyperparameters of a row of train.py, by the score of its runs on validation plants."""

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import optuna

from agents.training.loop import begin, train
from agents.training.presets import row_settings


def suggest(trial: optuna.Trial) -> dict[str, Any]:
    """The settings of a trial; gamma and lambda are sampled by their distance from 1."""
    learning_rate = trial.suggest_float("learning_rate", 1e-4, 3e-3, log=True)
    return {
        "learning_rate": learning_rate,
        "final_learning_rate": learning_rate * trial.suggest_float("final_over_first", 0.03, 1.0, log=True),
        "gamma": 1.0 - trial.suggest_float("one_minus_gamma", 1e-3, 3e-2, log=True),
        "gae_lambda": 1.0 - trial.suggest_float("one_minus_lambda", 5e-3, 1e-1, log=True),
        "batch_size": trial.suggest_categorical("batch_size", [1024, 2048, 4096]),
        "n_epochs": trial.suggest_int("n_epochs", 3, 10),
        "log_std_init": trial.suggest_float("log_std_init", -1.5, 0.0),
    }


def main() -> None:
    """Searches; the same command continues a search, also in several terminals at once."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("row", help="a row of the leaderboard that PPO trains")
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--folder", type=Path, default=Path("runs/optuna"))
    args = parser.parse_args()
    # A training seed of its own, so that the settings do not overfit those of published runs.
    base = dataclasses.replace(
        row_settings(args.row), seed=1000, total_steps=args.steps, evaluate_every=args.steps // 8
    )

    def objective(trial: optuna.Trial) -> float:
        scores: list[float] = []

        def report(lines: list[dict[str, float]]) -> None:
            scores.append(next(value for name, value in lines[-1].items() if name.startswith("score_")))
            trial.report(scores[-1], len(scores))
            if trial.should_prune():
                raise optuna.TrialPruned

        config = dataclasses.replace(base, **suggest(trial))
        begin(run := args.folder / args.row / f"trial-{trial.number}", config)
        if not train(run, report=report):
            raise KeyboardInterrupt
        return max(scores)

    (args.folder / args.row).mkdir(parents=True, exist_ok=True)
    storage, pruner = f"sqlite:///{args.folder / args.row / 'study.db'}", optuna.pruners.MedianPruner(n_warmup_steps=4)
    study = optuna.create_study(
        storage=storage, study_name="ppo", direction="maximize", load_if_exists=True, pruner=pruner
    )
    study.optimize(objective, n_trials=args.trials, catch=(ValueError,))
    print(f"best of {len(study.trials)} trials: {study.best_value:.2f} with {study.best_params}")


if __name__ == "__main__":
    main()
