"""Trains an agent and compares it with the paper's controller: `python train.py --help` says all."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from agents.training.stopping import INTERRUPTED, Leaving

LEAVING = Leaving()
if __name__ == "__main__":
    # Before what takes seconds to import.
    LEAVING.install()

import tyro  # noqa: E402

from agents.training.errors import RunError  # noqa: E402
from agents.training.presets import (  # noqa: E402
    BEST,
    CONFIG,
    MODEL,
    PRESETS,
    ROWS,
    Algorithm,
    Config,
    PPOConfig,
    RecurrentPPOConfig,
    Task,
    read_config,
    row_settings,
)
from capsule_gym.command_line import parse, parse_some, refuse  # noqa: E402
from capsule_gym.controller import is_own  # noqa: E402
from capsule_gym.policy import POLICY  # noqa: E402

PROG = "train.py"
RUNS = Path("runs")
Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR")]


@dataclass(frozen=True)
class Choice:
    """What decides the defaults of all other options."""

    task: Task = "residual"
    """Residual torque on a control law, or direct torque."""
    algo: Algorithm = "ppo"
    """Algorithm of Stable-Baselines3."""
    row: Annotated[str | None, tyro.conf.arg(metavar="NAME", help=f"Row of the leaderboard: {', '.join(ROWS)}.")] = None
    resume: Folder = None
    """Go on with the run in this folder, from its last checkpoint; only --total-steps may be changed."""


@dataclass(frozen=True)
class Options(Choice):
    """Trains an agent and compares it with the paper's adaptive controller on the set 'paper'.

    The hyperparameters below are those of the chosen --task and --algo, with the preset as their defaults; --row begins
    from what a row of the leaderboard is trained with. Ctrl-C saves and stops; --resume DIR goes on, also after a
    crash. Checkpoints contain pickles: resume only runs of your own.

    Examples:
      python train.py --task direct --randomization wide --seed 1
      python train.py --row direct-ppo-wide --seed 1
      python train.py --algo sac --total-steps 8e5 --run runs/mine
      python train.py --resume runs/mine --total-steps 2e6
    """

    run: Folder = None
    """Folder of the run; a new one in runs/ where none is given."""
    no_comparison: bool = False
    """Skip evaluation, figure and animation at the end."""
    wandb: bool = False
    """Also log to Weights & Biases: pip install "capsule-gym[wandb]"."""
    trust_controller: bool = False
    """Go on with a run whose config.json names a control law from elsewhere: importing it runs its code."""
    hyperparameters: tyro.conf.OmitArgPrefixes[Config] = field(default_factory=PPOConfig)


def read_options(arguments: Sequence[str] | None = None) -> Options:
    """Reads the command line.

    Returns:
        The options; `hyperparameters` are the new run's or, with --resume, those of the run that goes on.
    """
    choice = parse_some(Choice, PROG, arguments)
    if choice.resume is not None:
        return _read_resumed(choice.resume, arguments)
    if choice.row is None:
        preset = PRESETS[choice.task, choice.algo]
        return parse(Options, PROG, arguments, default=Options(choice.task, choice.algo, hyperparameters=preset))
    try:
        settings = row_settings(choice.row)
    except ValueError as error:
        refuse(PROG, f"--row: {error}")
    default = Options(settings.task, settings.algo, choice.row, hyperparameters=settings)
    options = parse(Options, PROG, arguments, default=default)
    _refuse_another_kind(default, options, f"--row {choice.row}")
    return options


def _read_resumed(run: Path, arguments: Sequence[str] | None) -> Options:
    """The options of a run that goes on."""
    try:
        before = read_config(run)
    except RunError as error:
        refuse(PROG, str(error))
    default = Options(before.task, before.algo, None, run, hyperparameters=before)
    options = parse(Options, PROG, arguments, default=default)
    for option, given in (("--run", options.run), ("--row", options.row)):
        if given is not None:
            refuse(PROG, f"{option} must not be given with --resume, got {str(given)!r}")
    _refuse_another_kind(default, options, "--resume")
    old, new = before.to_dict(), options.hyperparameters.to_dict()
    for name in (name for name in old if name != "total_steps" and old[name] != new[name]):
        option = "--" + name.replace("_", "-")
        must = f"{option} must stay {old[name]} with --resume"
        refuse(PROG, f"{must}, got {new[name]}; only --total-steps may be changed")
    if not (options.trust_controller or is_own(before.controller)):
        path = run / CONFIG
        refuse(PROG, f"{path} names the control law {before.controller!r}: --trust-controller if its code may run")
    return options


def _refuse_another_kind(before: Options, options: Options, chosen_by: str) -> None:
    """Ends the command where it names another task or algorithm than the run or the row that decides them."""
    for name in ("task", "algo"):
        was, given = getattr(before, name), getattr(options, name)
        if was != given:
            refuse(PROG, f"--{name} must stay {was} with {chosen_by}, got {given}")


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = read_options(arguments)
    config = options.hyperparameters
    # After the command line is known to be right: importing torch takes seconds.
    from agents import comparison
    from agents.training import loop as training

    try:
        if options.resume is not None:
            run = options.resume
            print(f"Going on with {run} (seed {config.seed}) towards {config.total_steps:,} steps.")
        else:
            stamp = time.strftime("%Y%m%d-%H%M%S")
            kind = options.row or f"{config.task}-{config.algo}"
            run = options.run or RUNS / f"{kind}-seed{config.seed}-{stamp}"
            begin(run, config)
            print(f"Training {config.algo.upper()} on the {config.task} task, seed {config.seed}, in {run}.")
        LEAVING.message = f"Stopped. To go on: python train.py --resume {run}"
        finished = training.train(run, config, wandb=options.wandb)
    except (RunError, OSError) as error:
        print(f"{PROG}: error: {error}", file=sys.stderr)
        return 2
    if not finished:
        print(f"\nStopped; saved. To go on: python train.py --resume {run}")
        return INTERRUPTED
    if isinstance(config, RecurrentPPOConfig):
        best, why = MODEL, ", which Stable-Baselines3 loads: a policy with a memory has no policy file"
    else:
        best, why = POLICY, ""
    print(f"Trained; what was best on plants of the run's own is {run / BEST / best}{why}.")
    if not options.no_comparison:
        LEAVING.message = "Stopped. The run is complete; its comparison is not."
        comparison.compare(run)
    return 0


def begin(run: Path, config: Config) -> None:
    """Makes the folder of a new run; whatever it refuses is an error of the command line."""
    from agents.training import loop as training

    try:
        training.begin(run, config)
    except FileExistsError:
        raise RunError(f"--run must name a new folder, got {str(run)!r}; --resume {run} goes on with it") from None
    except (TypeError, ValueError) as error:
        raise RunError(str(error)) from error


if __name__ == "__main__":
    sys.exit(main())
