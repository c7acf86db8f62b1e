"""Trains an agent and compares it with the paper's controller: `python train.py --help`."""

import secrets
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from shlex import quote
from typing import Annotated

from agents.training.signals import INTERRUPTED, QuietExit

QUIET_EXIT = QuietExit()
if __name__ == "__main__":
    # Installed before the imports, which take seconds.
    QUIET_EXIT.install()

import tyro  # noqa: E402

from agents.training.config import (  # noqa: E402
    BEST,
    CONFIG,
    MODEL,
    ActionMode,
    Algorithm,
    Config,
    Environment,
    PPOConfig,
    RunError,
    read_config,
)
from agents.training.presets import TRAINED_ROWS, preset, row_settings  # noqa: E402
from baselines.drawing import new_figure, style  # noqa: E402
from capsule_gym.checks import first_cause  # noqa: E402
from capsule_gym.command_line import parse, refuse  # noqa: E402
from capsule_gym.control.lookup import is_own  # noqa: E402
from capsule_gym.policies.policy import POLICY  # noqa: E402
from capsule_gym.tasks.task import ENV_ID  # noqa: E402

PROG = "train.py"
RUNS = Path("runs")
Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR")]
RowName = Annotated[
    str | None,
    tyro.conf.arg(metavar="NAME", help=f"Row of the leaderboard: {', '.join(TRAINED_ROWS)}."),
]


@dataclass(frozen=True)
class Choice:
    """The options that decide the defaults of all others."""

    env: Environment = "CapsuleStickSlip-v0"
    """The environment: maximum speed, a goal, or a commanded velocity."""
    action_mode: Annotated[
        ActionMode | None, tyro.conf.arg(name="task", metavar="{residual,direct}")
    ] = None
    """Residual torque on a control law, or direct torque; residual by default, and direct in the
    other environments."""
    algo: Algorithm = "ppo"
    """Algorithm of Stable-Baselines3."""
    row: RowName = None
    resume: Folder = None
    """Resume the run in this folder from its last checkpoint; only --total-steps may change."""


@dataclass(frozen=True)
class Args(Choice):
    """Trains an agent and compares it with the paper's adaptive controller on the set 'paper'.

    The hyperparameters below are those of the chosen --env, --task and --algo, with the preset as
    their defaults; --row starts from the settings of a row of the leaderboard. Ctrl-C saves and
    stops; --resume DIR continues, also after a crash. Checkpoints contain pickles: resume only runs
    of your own.

    Examples:
      python train.py --task direct --randomization wide --seed 1
      python train.py --row direct-ppo-wide --seed 1
      python train.py --env CapsuleGoal-v0 --seed 1
      python train.py --task direct --stack-size 4 --rig fit.json
      python train.py --algo sac --total-steps 8e5 --run runs/mine
      python train.py --resume runs/mine --total-steps 2e6
      python train.py --task direct --wrapper my_module:MyReward
    """

    run: Folder = None
    """Folder of the run; by default a new one in runs/."""
    no_comparison: bool = False
    """Skip evaluation, figure and animation at the end."""
    wandb: bool = False
    """Also log to Weights & Biases: pip install "capsule-gym[wandb]"."""
    trust_controller: bool = False
    """Resume a run whose config.json names a control law or wrapper of your own: importing it runs
    its code."""
    hyperparameters: tyro.conf.OmitArgPrefixes[Config] = field(default_factory=PPOConfig)


def read_args(arguments: Sequence[str] | None = None) -> Args:
    """Reads the command line.

    Returns:
        The arguments, with the hyperparameters of the new or, with --resume, of the resumed run.
    """
    # These options decide which other options exist.
    choice, _ = tyro.cli(
        Choice,
        args=arguments,
        return_unknown_args=True,
        add_help=False,
    )
    if choice.resume is not None:
        return _read_resumed(choice.resume, arguments)
    if choice.row is None:
        action_mode = choice.action_mode or ("residual" if choice.env == ENV_ID else "direct")
        settings = preset(choice.env, action_mode, choice.algo)
        args = parse(Args, PROG, arguments, default=_default(settings))
        _check_rig(settings, args)
        return args
    try:
        settings = row_settings(choice.row)
    except ValueError as error:
        refuse(PROG, f"--row: {error}")
    args = parse(Args, PROG, arguments, default=_default(settings))
    _check_same_kind(settings, args, f"--row {choice.row}")
    _check_rig(settings, args)
    return args


def _read_resumed(run: Path, arguments: Sequence[str] | None) -> Args:
    """Reads the arguments of a resumed run."""
    try:
        before = read_config(run)
    except RunError as error:
        refuse(PROG, str(error))
    args = parse(Args, PROG, arguments, default=_default(before))
    rig = args.hyperparameters.rig
    other_rig = None if rig == before.rig else rig
    for option, given in (("--run", args.run), ("--row", args.row), ("--rig", other_rig)):
        if given is not None:
            refuse(PROG, f"{option} must not be given with --resume, got {str(given)!r}")
    _check_same_kind(before, args, "--resume")
    changed = args.hyperparameters.to_dict()
    for name, value in before.to_dict().items():
        if name != "total_steps" and value != changed[name]:
            must = f"--{name.replace('_', '-')} must stay {value} with --resume"
            refuse(PROG, f"{must}, got {changed[name]}; only --total-steps may be changed")
    code = _foreign_code(before)
    if code and not args.trust_controller:
        names = f"names code to import, {code!r}"
        refuse(PROG, f"{run / CONFIG} {names}: --trust-controller if it may run")
    return args


def _default(settings: Config) -> Args:
    """The arguments of which the command line may change some."""
    kind = (settings.env, settings.action_mode, settings.algo)
    return Args(*kind, hyperparameters=settings)


def _foreign_code(config: Config) -> tuple[str, ...] | str | None:
    """The wrappers or the control law outside this package that a run imports, if any."""
    return config.wrapper or (None if is_own(config.controller) else config.controller)


def _check_same_kind(settings: Config, args: Args, chosen_by: str) -> None:
    """Ends the command if an option differs from the kind of the resumed run or the row."""
    for option, name in (("--env", "env"), ("--task", "action_mode"), ("--algo", "algo")):
        was, given = getattr(settings, name), getattr(args, name)
        if was != given:
            refuse(PROG, f"{option} must stay {was} with {chosen_by}, got {given}")


def _check_rig(settings: Config, args: Args) -> None:
    """Ends the command if options are given that an identified rig determines."""
    config = args.hyperparameters
    for name in ("randomization", "disturbances"):
        given = getattr(config, name)
        if config.rig is not None and given != getattr(settings, name):
            refuse(PROG, f"--{name} must not be given with --rig, got {given!r}")


def _report(failure: threading.ExceptHookArgs) -> None:
    """Hides the traceback of an OSError in TensorBoard's thread.

    TensorBoard raises the error again at the next write.
    """
    if not isinstance(failure.exc_value, OSError):
        threading.__excepthook__(failure)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = read_args(arguments)
    if args.wandb and find_spec("wandb") is None:
        refuse(PROG, '--wandb needs wandb: pip install "capsule-gym[wandb]"')
    before = threading.excepthook
    threading.excepthook = _report
    try:
        return _train(args)
    except (RunError, OSError) as error:
        print(f"{PROG}: error: {error}", file=sys.stderr)
        return 2
    finally:
        threading.excepthook = before


def _can_draw() -> bool:
    """Whether figures can be drawn; the reason why not is printed."""
    try:
        with style():
            new_figure(1.0)
    except (ImportError, OSError, ValueError) as error:
        reason = f"since figures cannot be drawn: {first_cause(error)}"
        print(f"Without a comparison at the end, {reason}", file=sys.stderr)
        return False
    return True


def _train(args: Args) -> int:
    """Trains and compares; returns the exit status."""
    # Imported after the command line is checked, since torch takes seconds to import.
    from agents.report import compare
    from agents.training.loop import train

    config = args.hyperparameters
    compared = not (args.no_comparison or config.wrapper) and _can_draw()
    if args.resume is None:
        run = _begin(args)
    else:
        run = args.resume
        print(f"Resuming {run} (seed {config.seed}) until {config.total_steps:,} steps.")
    hint = f"To resume: python train.py --resume {quote(str(run))}"
    if _foreign_code(config):
        hint += " --trust-controller"
    QUIET_EXIT.message = f"Stopped. {hint}"
    if not train(run, config.total_steps, wandb=args.wandb):
        print(f"\nStopped; saved. {hint}")
        return INTERRUPTED
    best = run / BEST / (MODEL if config.wrapper else POLICY)
    print(f"Trained; the best policy on validation plants is {best}.")
    if compared:
        QUIET_EXIT.message = "Stopped. The run is complete; its comparison is not."
        compare(run)
    if not config.wrapper:
        export = f"python -m capsule_gym.export {quote(str(run))} --c policy.h"
        print(f"For a microcontroller: {export}{' --law' if config.controller else ''}")
    return 0


def _begin(args: Args) -> Path:
    """Creates the folder of a new run, which it returns."""
    from agents.training.loop import begin

    config = args.hyperparameters
    run = args.run or RUNS / _new_name(args)
    try:
        begin(run, config)
    except FileExistsError:
        found = f"{str(run)!r}; --resume {quote(str(run))} resumes it"
        raise RunError(f"--run must name a new folder, got {found}") from None
    except (TypeError, ValueError) as error:
        raise RunError(str(error)) from error
    what = f"{config.algo.upper()} on {config.env}, {config.action_mode} torque"
    print(f"Training {what}, seed {config.seed}, in {run}.")
    return run


def _new_name(args: Args) -> str:
    """The name of a new run's folder: its kind, its seed, the time, and a random number."""
    config = args.hyperparameters
    names: list[str] = [config.action_mode, config.algo]
    if config.env != ENV_ID:
        names.insert(0, config.task)
    kind = args.row or "-".join(names)
    now = time.strftime("%Y%m%d-%H%M%S")
    return f"{kind}-seed{config.seed}-{now}-{secrets.token_hex(2)}"


if __name__ == "__main__":
    # Python looks for wrappers and laws beside this file alone.
    sys.path.append("")
    sys.exit(main())
