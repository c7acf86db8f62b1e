"""Trains an agent and compares it with the paper's controller: `python train.py --help` says all."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_type_hints

from agents.training.stopping import INTERRUPTED, Leaving

LEAVING = Leaving()
if __name__ == "__main__":
    # Before what takes seconds to import.
    LEAVING.install()

from agents.training.errors import RunError  # noqa: E402
from agents.training.presets import PRESETS, Config, read_config  # noqa: E402

RUNS = Path("runs")


def _number(text: str) -> int:
    """An integer, also in the form 8e6 or 8_000_000."""
    value = float(text)
    if value != int(value) or value < 0:
        raise argparse.ArgumentTypeError(f"must be an integer >= 0, got {text!r}")
    return int(value)


def _switch(text: str) -> bool:
    """True or false, in words."""
    if text.lower() not in ("true", "false"):
        raise argparse.ArgumentTypeError(f"must be true or false, got {text!r}")
    return text.lower() == "true"


def _add_fields(parser: argparse._ArgumentGroup, preset: Config) -> None:
    """One option per field of the configuration, with the preset's value as its default."""
    kinds: dict[Any, Any] = {int: _number, float: float, bool: _switch}
    hints = get_type_hints(type(preset))
    for field in dataclasses.fields(preset):
        if field.name == "task":
            continue
        default = getattr(preset, field.name)
        parser.add_argument(
            "--" + field.name.replace("_", "-"),
            type=kinds.get(hints[field.name], str),
            default=default,
            choices=field.metadata["choices"],
            metavar=None if field.metadata["choices"] else "X",
            help=f"{field.metadata['help']} (default: {str(default).lower() if default in (True, False) else default})",
        )


def parse(arguments: Sequence[str] | None = None) -> tuple[Config, argparse.Namespace]:
    """Reads the command line: the configuration of the run, and what is not the run's own."""
    first = argparse.ArgumentParser(add_help=False)
    general = first.add_argument_group("what to train")
    general.add_argument(
        "--task", choices=("residual", "direct"), default="residual", help="residual torque on a law, or direct torque"
    )
    general.add_argument("--algo", choices=("ppo", "sac"), default="ppo", help="algorithm of Stable-Baselines3")
    general.add_argument("--run", type=Path, metavar="DIR", help="folder of the run (default: a new one in runs/)")
    general.add_argument(
        "--resume",
        type=Path,
        metavar="DIR",
        help="go on with the run in this folder, from its last checkpoint; only --total-steps may be changed",
    )
    general.add_argument(
        "--no-comparison", action="store_true", help="skip evaluation, figure and animation at the end"
    )
    known, _ = first.parse_known_args(arguments)
    preset = PRESETS[known.task, known.algo]
    parser = argparse.ArgumentParser(
        prog="train.py",
        parents=[first],
        description="Trains an agent and compares it with the paper's adaptive controller on the set 'paper'. The "
        "options below are those of the chosen --task and --algo, with the preset as their defaults.",
        epilog="Ctrl-C saves and stops; --resume DIR goes on, also after a crash. Model archives contain pickles: load "
        "only what you trust.",
    )
    _add_fields(parser.add_argument_group(f"hyperparameters ({known.task}, {known.algo})"), preset)
    options = parser.parse_args(arguments)
    if options.resume is not None:
        try:
            config = read_config(options.resume)
        except RunError as error:
            parser.error(str(error))
        given = (
            options.total_steps
            if any(a.startswith("--total-steps") for a in arguments or sys.argv[1:])
            else config.total_steps
        )
        return dataclasses.replace(config, total_steps=given), options
    fields = {field.name: getattr(options, field.name) for field in dataclasses.fields(preset)}
    config = dataclasses.replace(preset, **fields)
    return config, options


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config, options = parse(arguments)
    # After the command line is known to be right: importing torch takes seconds.
    from agents import comparison
    from agents.training import loop as training

    try:
        if options.resume is not None:
            run = options.resume
            print(f"Going on with {run} (seed {config.seed}) towards {config.total_steps:,} steps.")
        else:
            stamp = time.strftime("%Y%m%d-%H%M%S")
            run = options.run or RUNS / f"{config.task}-{config.algo}-seed{config.seed}-{stamp}"
            begin(run, config)
            print(f"Training {config.algo.upper()} on the {config.task} task, seed {config.seed}, in {run}.")
        LEAVING.message = f"Stopped. To go on: python train.py --resume {run}"
        finished = training.train(run, config)
    except (RunError, OSError) as error:
        print(f"train.py: error: {error}", file=sys.stderr)
        return 2
    if not finished:
        print(f"\nStopped; saved. To go on: python train.py --resume {run}")
        return INTERRUPTED
    print(f"Trained; the best model on its own draws is {run / 'best' / 'model.zip'}.")
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
