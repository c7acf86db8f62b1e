"""Searches the hyperparameters of a preset or row with Optuna: `python -m agents.study.tune --help` says all.

A trial is a run with other hyperparameters. Its score is that of its best evaluation on the run's own draws, what every
run chooses its best policy by: mean speed and failures. No frozen set is looked at. A trial whose evaluations are below
the median of those before it is pruned.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from agents.evaluation.episodes import versions
from agents.study.jobs import Evaluation, best, evaluations
from agents.study.process import POLL, Training
from agents.study.study import check_jobs, leave
from agents.training.errors import RunError
from agents.training.presets import Algorithm, Config, OffPolicyConfig, PPOConfig, named_settings, read_config
from agents.training.stopping import INTERRUPTED, Stop
from baselines.tables import text_table
from capsule_gym.command_line import Count, Positional, parse, refuse
from capsule_gym.files import canonical_hash, to_json, write_atomically

if TYPE_CHECKING:
    from optuna import Study, Trial
    from optuna.trial import FrozenTrial

PROG = "python -m agents.study.tune"
RUNS = Path("runs/tune")
DATA = Path(__file__).with_name("data")
# Far from the seeds of published runs: their settings are not chosen by their luck.
FIRST_SEED = 1000
# Of a run; a trial is pruned or not where it evaluates, from the fourth on: the first tell little of what comes.
EVALUATIONS_PER_TRIAL = 8
FIRST_PRUNING = 4
# Trials that none is pruned before: a third of all, at most so many.
UNPRUNED = 8

Space = Callable[["Trial"], dict[str, Any]]


def _shared(trial: Trial) -> dict[str, Any]:
    """What every algorithm has."""
    rate = trial.suggest_float("learning_rate", 1e-4, 3e-3, log=True)
    return {
        "learning_rate": rate,
        "final_learning_rate": rate * trial.suggest_float("final_over_first", 0.03, 1.0, log=True),
        # By its distance from 1, the inverse of the horizon in steps.
        "gamma": 1.0 - trial.suggest_float("one_minus_gamma", 1e-3, 3e-2, log=True),
        "hidden": trial.suggest_categorical("hidden", [32, 64, 128]),
    }


def _on_policy(trial: Trial) -> dict[str, Any]:
    num_envs = trial.suggest_categorical("num_envs", [64, 128, 256])
    return {
        **_shared(trial),
        "num_envs": num_envs,
        # As many samples in an update, whatever the number of environments.
        "n_steps": trial.suggest_categorical("rollout", [8192, 16384, 32768]) // num_envs,
        "batch_size": trial.suggest_categorical("batch_size", [1024, 2048, 4096]),
        "n_epochs": trial.suggest_int("n_epochs", 3, 10),
        "gae_lambda": 1.0 - trial.suggest_float("one_minus_lambda", 5e-3, 1e-1, log=True),
        "log_std_init": trial.suggest_float("log_std_init", -1.5, 0.0),
        "least_log_std": trial.suggest_float("least_log_std", -4.0, -1.5),
        "termination_penalty": trial.suggest_float("termination_penalty", 10.0, 300.0, log=True),
    }


def _few(trial: Trial) -> dict[str, Any]:
    """What matters most, for the few trials that an algorithm with dear updates gets."""
    rate = trial.suggest_float("learning_rate", 3e-4, 3e-3, log=True)
    return {
        "learning_rate": rate,
        "final_learning_rate": 0.1 * rate,
        "gamma": 1.0 - trial.suggest_float("one_minus_gamma", 5e-3, 1e-2, log=True),
    }


def _off_policy(trial: Trial) -> dict[str, Any]:
    return {
        **_few(trial),
        "num_envs": trial.suggest_categorical("num_envs", [32, 64, 128]),
        "gradient_steps": trial.suggest_categorical("gradient_steps", [4, 8, 16]),
        "tau": trial.suggest_float("tau", 5e-3, 2e-2, log=True),
    }


def _recurrent(trial: Trial) -> dict[str, Any]:
    return {
        **_few(trial),
        "n_epochs": trial.suggest_int("n_epochs", 3, 8),
        "gae_lambda": 1.0 - trial.suggest_float("one_minus_lambda", 5e-3, 1e-1, log=True),
    }


def _deterministic(trial: Trial) -> dict[str, Any]:
    rate = trial.suggest_float("learning_rate", 2e-4, 1e-3, log=True)
    return {
        "learning_rate": rate,
        "final_learning_rate": 0.1 * rate,
        "gamma": 1.0 - trial.suggest_float("one_minus_gamma", 5e-3, 2e-2, log=True),
        "tau": trial.suggest_float("tau", 3e-3, 1e-2, log=True),
        "action_noise": trial.suggest_float("action_noise", 0.3, 1.0, log=True),
        "noise_time": trial.suggest_float("noise_time", 0.1, 0.5, log=True),
    }


def _distributional(trial: Trial) -> dict[str, Any]:
    return {
        **_off_policy(trial),
        # The time of an update grows with the square of their number.
        "quantiles": trial.suggest_categorical("quantiles", [5, 10]),
        "dropped_quantiles": trial.suggest_int("dropped_quantiles", 0, 3),
    }


SPACES: dict[Algorithm, Space] = {
    "ppo": _on_policy,
    "sac": _off_policy,
    "td3": _deterministic,
    "tqc": _distributional,
    "recurrent-ppo": _recurrent,
}


@dataclass(frozen=True)
class Options:
    """Searches the hyperparameters of a preset or row on its runs' own draws; called again, it goes on.

    Prints the best trials as fields of the row's settings, and writes all of them to runs/tune/NAME/trials.json.

    Examples:
      python -m agents.study.tune direct-ppo --trials 40 --total-steps 1e6
      python -m agents.study.tune direct-ppo --trials 60 --total-steps 1e6 --keep
    """

    row: Annotated[Positional[str], arg(metavar="NAME", help="A preset as TASK-ALGO, or a row of the leaderboard.")]
    trials: Count = 40
    """Trials in all, those of earlier calls and pruned ones included."""
    total_steps: Count | None = None
    """Environment steps of a trial; those of the row where none are given."""
    seed: Count = FIRST_SEED
    """Training seed of the trials, and seed of the search."""
    jobs: int = 1
    """Trials at a time."""
    runs: Path = RUNS
    """Folder of the searches, each in NAME."""
    keep: bool = False
    """Also copy the trials to agents/study/data/NAME.json, to be committed."""

    def check(self) -> None:
        """Refuses what cannot be searched."""
        named_settings(self.row)
        if self.trials < 1:
            raise ValueError(f"--trials must be an integer >= 1, got {self.trials}")
        check_jobs(self.jobs)
        self.settings().check()
        if find_spec("optuna") is None:
            raise ValueError("the search needs Optuna: pip install 'capsule-gym[tune]'")

    def settings(self) -> Config:
        """What every trial has, but for what is searched."""
        row = named_settings(self.row)
        steps = self.total_steps or row.total_steps
        changes: dict[str, Any] = {"total_steps": steps, "evaluate_every": max(1, steps // EVALUATIONS_PER_TRIAL)}
        if isinstance(row, PPOConfig):
            changes["direct_steps"] = row.direct_steps * steps // row.total_steps
        return dataclasses.replace(row, seed=self.seed, **changes)


class Search:
    """The trials of one row.

    Args:
        options: of the command.
        stop: what Ctrl-C sets.
    """

    def __init__(self, options: Options, stop: Stop) -> None:
        self.options = options
        self.stop = stop
        self.folder = options.runs / options.row
        self.settings = options.settings()
        self.space = SPACES[self.settings.algo]

    def run(self) -> Study:
        """Goes on until there are enough trials, or the user stops it.

        Raises:
            RunError: if the folder holds a search that was begun with other settings.
        """
        import optuna
        from optuna.storages import JournalStorage
        from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self.folder.mkdir(parents=True, exist_ok=True)
        journal = str(self.folder / "journal.log")
        study = optuna.create_study(
            storage=JournalStorage(JournalFileBackend(journal, lock_obj=JournalFileOpenLock(journal))),
            study_name=self.options.row,
            direction="maximize",
            load_if_exists=True,
            pruner=optuna.pruners.MedianPruner(min(UNPRUNED, self.options.trials // 3), n_warmup_steps=FIRST_PRUNING),
        )
        fixed = {"settings": {"algo": self.settings.algo, **self.settings.to_dict()}}
        if study.user_attrs and study.user_attrs != fixed:
            raise RunError(f"{journal} holds a search that was begun with other settings: move {self.folder} elsewhere")
        for name, value in fixed.items():
            study.set_user_attr(name, value)
        # Seeded by where it stands too: a search that goes on would else draw again what it has drawn.
        study.sampler = optuna.samplers.TPESampler(seed=self.options.seed + len(study.trials), constant_liar=True)
        for trial in study.trials:
            if trial.state == optuna.trial.TrialState.RUNNING:
                # Its process is gone; the same parameters find the same run.
                study.tell(trial.number, state=optuna.trial.TrialState.FAIL)
                study.enqueue_trial(trial.params)
        missing = self.options.trials - len(ended(study))
        if missing > 0:
            study.optimize(
                self.objective, n_trials=missing, n_jobs=self.options.jobs, catch=(RunError,), callbacks=[self._tell]
            )
        return study

    def config_of(self, trial: Trial) -> Config:
        """What a trial is trained with; of what learns from a replay buffer, as long as it makes as many updates."""
        base, config = self.settings, dataclasses.replace(self.settings, **self.space(trial))
        if not isinstance(base, OffPolicyConfig) or not isinstance(config, OffPolicyConfig):
            return config
        more, fewer = config.num_envs * base.gradient_steps, config.gradient_steps * base.num_envs
        lengths = {name: getattr(base, name) * more // fewer for name in ("total_steps", "evaluate_every")}
        return dataclasses.replace(config, **lengths)

    def objective(self, trial: Trial) -> float:
        """Trains one trial, or goes on with it, and scores it.

        Raises:
            RunError: if it cannot be trained.
            TrialPruned: if it is below the others.
        """
        import optuna

        config = self.config_of(trial)
        trial.set_user_attr("config", config.to_dict())
        # Named by its settings: the same ones are the same run.
        run = self.folder / canonical_hash(config.to_dict())[:12]
        if run.exists() and read_config(run).to_dict() != config.to_dict():
            raise RunError(f"{run} holds another run")
        lines: list[Evaluation] = []
        reported = 0
        training = Training(run, config)
        try:
            while True:
                # Before the evaluations, of which none must be missed.
                status = training.status()
                lines = evaluations(run)
                for line in lines[reported:]:
                    reported += 1
                    if line.stage < len(config.stages()) - 1:
                        continue
                    trial.report(line.score, reported)
                    if status is None and trial.should_prune():
                        raise optuna.TrialPruned
                if status is not None:
                    break
                if self.stop.requested:
                    training.stop()
                time.sleep(POLL)
        finally:
            training.stop()
            training.wait()
            trial.set_user_attr("evaluations", [dataclasses.astuple(line) for line in lines])
        if self.stop.requested:
            trial.study.stop()
            trial.study.enqueue_trial(trial.params)
            raise RunError("stopped")
        if status != 0:
            print(f"trial {trial.number}: {training.last_line()} (see {training.log})", file=sys.stderr)
            raise RunError(f"{run} ended with status {status}")
        chosen = best(lines, config)
        assert chosen is not None
        return chosen.score

    def _tell(self, study: Study, trial: FrozenTrial) -> None:
        """A line per trial."""
        value = "" if trial.value is None else f" {trial.value:.2f}"
        first = max((each.value for each in ended(study) if each.state.name == "COMPLETE"), default=None)
        shown = "" if first is None else f"; best {first:.2f}"
        print(f"trial {trial.number}: {trial.state.name.lower()}{value}{shown}", file=sys.stderr)


def ended(study: Study) -> list[FrozenTrial]:
    """The trials that say something: whole ones and pruned ones."""
    return [trial for trial in study.trials if trial.state.name in ("COMPLETE", "PRUNED")]


def content_of(study: Study) -> dict[str, Any]:
    """A search as data: settings, versions, and every trial with its parameters, score and evaluations."""
    trials = [
        {
            "number": trial.number,
            "state": trial.state.name.lower(),
            "score": trial.value if trial.state.name == "COMPLETE" else None,
            "parameters": trial.params,
            "evaluations": trial.user_attrs.get("evaluations"),
        }
        for trial in ended(study)
    ]
    return {
        "row": study.study_name,
        "settings": study.user_attrs["settings"],
        "evaluations": [field.name for field in dataclasses.fields(Evaluation)],
        "versions": versions(),
        "trials": trials,
    }


def as_text(content: dict[str, Any]) -> str:
    """A search as JSON with a line per trial."""
    trials = ",\n".join(f"  {json.dumps(trial)}" for trial in content["trials"])
    head = to_json({name: value for name, value in content.items() if name != "trials"})
    return head.removesuffix("\n}\n") + f',\n "trials": [\n{trials}\n ]\n}}\n'


def best_table(study: Study, settings: Config, count: int = 5) -> str:
    """The best trials, with the fields in which they differ from the row."""
    whole = [trial for trial in ended(study) if trial.state.name == "COMPLETE"]
    first = sorted(whole, key=lambda trial: -float(trial.value or 0.0))[:count]
    now = settings.to_dict()
    rows = [["trial", "score", "settings"]]
    for trial in first:
        config = trial.user_attrs["config"]
        changed = [f"{name}={value:.3g}" for name, value in config.items() if value != now[name]]
        rows.append([str(trial.number), f"{trial.value:.2f}", ", ".join(changed)])
    return text_table(rows, left=1)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, PROG, arguments)
    with Stop() as stop:
        search = Search(options, stop)
        try:
            study = search.run()
        except (RunError, OSError) as error:
            refuse(PROG, str(error))
    text = as_text(content_of(study))
    write_atomically(search.folder / "trials.json", text)
    print(best_table(study, search.settings))
    if stop.requested:
        print("Stopped; saved. The same command goes on.")
        return INTERRUPTED
    if options.keep:
        DATA.mkdir(exist_ok=True)
        write_atomically(DATA / f"{options.row}.json", text)
        print(f"Written: {DATA / options.row}.json")
    return 0 if len(ended(study)) >= options.trials else 1


if __name__ == "__main__":
    leave(main)
