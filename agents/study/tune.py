"""Tunes the hyperparameters of a preset or row with Optuna: `python -m agents.study.tune --help`.

A trial is a run with other hyperparameters. Its score is that of its best policy on the run's validation plants (mean
speed less penalties for power and failures), never on a frozen set. Optuna prunes trials below the median.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from agents.evaluation.episodes import versions
from agents.study.jobs import RESUME, evaluations, score
from agents.training.config import Algorithm, Config, OffPolicyConfig, RunError
from agents.training.presets import PRESETS, ROWS, row_settings
from agents.training.signals import INTERRUPTED
from capsule_gym.checks import check_count
from capsule_gym.command_line import Count, Positional, parse, refuse
from capsule_gym.files import canonical_hash, to_json, write_atomically

if TYPE_CHECKING:
    from optuna import Study, Trial

PROG = "python -m agents.study.tune"
# Far from the seeds of published runs, so that the settings do not overfit these.
FIRST_SEED = 1000
EVALUATIONS_PER_TRIAL = 8
# Trials are pruned only after WARMUP_EVALUATIONS, and after a third of all trials, at most STARTUP_TRIALS, is complete.
WARMUP_EVALUATIONS, STARTUP_TRIALS = 4, 8

# Lists are choices, ranges of integers uniform, positive ranges of floats log-uniform, other ranges of floats uniform.
# gamma and lambda are sampled by their distance from 1; `rollout` is n_steps * num_envs. Algorithms with slow updates
# have few trials and therefore few parameters.
Space = dict[str, list[int] | tuple[float, float]]
FEW: Space = {"learning_rate": (3e-4, 3e-3), "one_minus_gamma": (5e-3, 1e-2)}
OFF_POLICY: Space = {**FEW, "num_envs": [32, 64, 128], "gradient_steps": [4, 8, 16], "tau": (5e-3, 2e-2)}
SPACES: dict[Algorithm, Space] = {
    "ppo": {
        "learning_rate": (1e-4, 3e-3),
        "final_over_first": (0.03, 1.0),
        "one_minus_gamma": (1e-3, 3e-2),
        "hidden": [32, 64, 128],
        "num_envs": [64, 128, 256],
        "rollout": [8192, 16384, 32768],
        "batch_size": [1024, 2048, 4096],
        "n_epochs": (3, 10),
        "one_minus_lambda": (5e-3, 1e-1),
        "log_std_init": (-1.5, 0.0),
        "termination_penalty": (10.0, 300.0),
    },
    "sac": OFF_POLICY,
    "td3": {
        "learning_rate": (2e-4, 1e-3),
        "one_minus_gamma": (5e-3, 2e-2),
        "tau": (3e-3, 1e-2),
        "action_noise": (0.3, 1.0),
        "noise_time": (0.1, 0.5),
    },
    "tqc": {**OFF_POLICY, "quantiles": [5, 10], "dropped_quantiles": (0, 3)},
    "recurrent-ppo": {**FEW, "n_epochs": (3, 8), "one_minus_lambda": (5e-3, 1e-1)},
}


def suggest(trial: Trial, algo: Algorithm) -> dict[str, Any]:
    """Samples the parameters of a trial; returns the fields of its configuration."""
    found: dict[str, Any] = {}
    for name, span in SPACES[algo].items():
        if isinstance(span, list):
            found[name] = trial.suggest_categorical(name, span)
        elif isinstance(span[0], int):
            found[name] = trial.suggest_int(name, span[0], int(span[1]))
        else:
            found[name] = trial.suggest_float(name, *span, log=span[0] > 0.0)
    found["final_learning_rate"] = found["learning_rate"] * found.pop("final_over_first", 0.1)
    found["gamma"] = 1.0 - found.pop("one_minus_gamma")
    if "one_minus_lambda" in found:
        found["gae_lambda"] = 1.0 - found.pop("one_minus_lambda")
    if "rollout" in found:
        found["n_steps"] = found.pop("rollout") // found["num_envs"]
    return found


@dataclass(frozen=True)
class Args:
    """Tunes the hyperparameters of a preset or row on the validation plants of its runs.

    Prints the best trial, and writes all of them to runs/tune/NAME/trials.json. The trials are in Optuna's storage
    runs/tune/NAME/study.db: --resume continues the search, also in several terminals at once.

    Examples:
      python -m agents.study.tune efficient --trials 60 --runs runs/mine
    """

    row: Annotated[Positional[str], arg(metavar="NAME", help="A preset as TASK-ALGO, or a row of the leaderboard.")]
    trials: Count = 40
    """Number of trials, with pruned ones and those of earlier calls."""
    total_steps: Count | None = None
    """Environment steps of a trial; those of the row by default."""
    seed: Count = FIRST_SEED
    """Training seed of the trials, and seed of the sampler."""
    runs: Path = Path("runs/tune")
    """Folder of the searches, each in NAME."""

    resume: bool = False
    """Continue a search of your own: checkpoints contain pickles, which can run any code."""

    def check(self) -> None:
        """Checks names and ranges."""
        self.settings().check()
        if (self.runs / self.row).exists() and not self.resume:
            raise ValueError(f"{self.runs / self.row} contains a search: {RESUME}")
        check_count("--trials", self.trials)
        if find_spec("optuna") is None:
            raise ValueError("tuning needs Optuna: pip install 'capsule-gym[tune]'")

    def settings(self) -> Config:
        """The configuration of all trials, without the tuned parameters."""
        row = row_settings(self.row, ROWS | {f"{task}-{algo}": preset for (task, algo), preset in PRESETS.items()})
        steps = self.total_steps or row.total_steps
        evaluate_every = max(1, steps // EVALUATIONS_PER_TRIAL)
        return dataclasses.replace(row, seed=self.seed, total_steps=steps, evaluate_every=evaluate_every)


def config_of(trial: Trial, base: Config) -> Config:
    """The configuration of a trial; off-policy trials have equal numbers of updates instead of steps."""
    config = dataclasses.replace(base, **suggest(trial, base.algo))
    if not isinstance(base, OffPolicyConfig) or not isinstance(config, OffPolicyConfig):
        return config
    more, fewer = config.num_envs * base.gradient_steps, config.gradient_steps * base.num_envs
    lengths = {name: getattr(base, name) * more // fewer for name in ("total_steps", "evaluate_every")}
    return dataclasses.replace(config, **lengths)


def objective(trial: Trial, base: Config, folder: Path) -> float:
    """Trains a trial, or resumes it, and returns its score in cm/s.

    Raises:
        KeyboardInterrupt: if the user stops the trial; the search tries its parameters again.
        RunError: if the trial cannot be trained.
        TrialPruned: if the trial is below the median of the other trials.
    """
    import optuna

    # Imported here, since torch takes seconds to import and --help does not need it.
    from agents.training.loop import begin, train

    config = config_of(trial, base)
    # The name depends only on the settings, so that a repeated trial resumes its run.
    run = folder / canonical_hash(config.to_dict())[:12]
    if not run.exists():
        begin(run, config)

    def report(lines: list[dict[str, float]]) -> None:
        trial.report(score(lines[-1]), len(lines))
        if lines[-1]["steps"] < config.total_steps and trial.should_prune():
            raise optuna.TrialPruned

    try:
        if not train(run, report=report):
            raise KeyboardInterrupt
    except KeyboardInterrupt:
        trial.study.enqueue_trial(trial.params)
        raise
    finally:
        trial.set_user_attr("evaluations", evaluations(run))
    return max(map(score, evaluations(run)))


def tune(args: Args) -> Study:
    """Trains trials until `args.trials` have ended, and writes them to trials.json.

    Raises:
        RunError: if the storage contains a search with other settings.
    """
    import optuna
    from optuna.trial import TrialState

    folder, base = args.runs / args.row, args.settings()
    folder.mkdir(parents=True, exist_ok=True)
    storage = f"sqlite:///{folder / 'study.db'}"
    pruner = optuna.pruners.MedianPruner(min(STARTUP_TRIALS, args.trials // 3), n_warmup_steps=WARMUP_EVALUATIONS)
    study = optuna.create_study(
        storage=storage, study_name=args.row, direction="maximize", load_if_exists=True, pruner=pruner
    )
    settings = {"algo": base.algo, **json.loads(to_json(base.to_dict()))}
    if study.user_attrs.get("settings", settings) != settings:
        raise RunError(f"{folder} contains a search with other settings: move it")
    study.set_user_attr("settings", settings)
    # The seed includes the number of trials, so that a resumed search does not sample the same parameters again.
    study.sampler = optuna.samplers.TPESampler(seed=args.seed + len(study.trials), constant_liar=True)
    ended = (TrialState.COMPLETE, TrialState.PRUNED)
    missing = args.trials - len(study.get_trials(states=ended))
    if missing > 0:
        enough = optuna.study.MaxTrialsCallback(args.trials, states=ended)
        study.optimize(
            lambda trial: objective(trial, base, folder), n_trials=missing, catch=(ValueError,), callbacks=[enough]
        )
    trials = [
        {
            "number": trial.number,
            "state": trial.state.name.lower(),
            "score": trial.value if trial.state == TrialState.COMPLETE else None,
            "parameters": trial.params,
            "evaluations": trial.user_attrs["evaluations"],
        }
        for trial in study.get_trials(states=ended)
    ]
    head = {"row": args.row, "settings": settings, "versions": versions()}
    write_atomically(folder / "trials.json", to_json({**head, "trials": trials}))
    return study


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    try:
        study = tune(args)
    except (RunError, OSError) as error:
        refuse(PROG, str(error))
    except KeyboardInterrupt:
        print("\nStopped; --resume continues.")
        return INTERRUPTED
    complete = [trial for trial in study.trials if trial.state.name == "COMPLETE"]
    if not complete:
        print("No trial is complete.", file=sys.stderr)
        return 1
    print(f"Best of {len(complete)} complete trials: {study.best_value:.2f} cm/s with {study.best_params}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
