"""Command lines from dataclasses and functions.

A field or an argument is an option, its docstring the help text.

A command is a function with the decorator `command("python -m baselines.tuning")`. One that checks
or shares its options declares them as a frozen dataclass and calls `parse(Args, "python -m
agents.evaluate", arguments)`. An option of type `Positional[str]` is a positional argument; an
option of type `Count` accepts the form 8e6.
"""

import inspect
import io
import math
import os
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar

from capsule_gym.checks import require

try:
    import tyro
    from tyro.conf import Positional, arg
except ImportError as error:
    _EXTRAS = {
        "agents": "train",
        "baselines": "paper",
        "benchmarks": "bench",
        "capsule_gym.export": "export",
        "capsule_gym.identification": "identify",
    }
    _command = getattr(sys.modules["__main__"].__spec__, "name", "")
    _found = [
        extra for package, extra in _EXTRAS.items() if f"{_command}.".startswith(f"{package}.")
    ]
    _extra = _found[0] if _found else "render"
    _message = f'this command needs tyro: pip install "capsule-gym[{_extra}]"'
    if _command.partition(".")[0] in ("agents", "baselines", "benchmarks", "capsule_gym"):
        # Without a traceback, as all errors of a command.
        sys.exit(f"python -m {_command.removesuffix('.__main__')}: error: {_message}")
    raise ImportError(_message) from error

__all__ = [
    "Count",
    "Positional",
    "PositiveCount",
    "arg",
    "check_output",
    "command",
    "parse",
    "refuse",
]

T = TypeVar("T")
# No option --no-fast in addition to --fast.
NO_NEGATIONS = (tyro.conf.FlagCreatePairsOff,)


def _integer(least: int) -> Any:
    """Reads an integer, also in the form 8e6, that is not below the least."""

    def read(words: Sequence[str]) -> int:
        try:
            value = float(words[0].replace("_", ""))
        except ValueError:
            value = math.nan
        if not value.is_integer() or value < least:
            raise ValueError(f"must be an integer >= {least}, got {words[0]!r}")
        return int(value)

    return tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar="N",
        instance_from_str=read,
        is_instance=lambda value: isinstance(value, int),
        str_from_instance=lambda value: [str(value)],
    )


Count = Annotated[int, _integer(0)]
PositiveCount = Annotated[int, _integer(1)]


def parse(
    kind: Callable[..., T],
    prog: str,
    arguments: Sequence[str] | None = None,
    *,
    default: T | None = None,
) -> T:
    """Reads a command line.

    Args:
        kind: a dataclass, or a function that is called; its docstring, up to its arguments, is the
            description.
        prog: the command as the user types it.
        arguments: the words after the command; None takes them from `sys.argv`.
        default: defaults other than the fields' own.

    Raises:
        SystemExit: with 0 after `--help`, with 2 if the command line is invalid.
    """
    if arguments is None and isinstance(sys.stdout, io.TextIOWrapper):
        # Paths may contain characters that the encoding of the output lacks.
        sys.stdout.reconfigure(errors="backslashreplace")
    defaults: dict[str, Any] = {} if default is None else {"default": default}
    description = (inspect.getdoc(kind) or "").partition("\n\nArgs:")[0]
    return tyro.cli(
        kind, prog=prog, args=arguments, description=description, config=NO_NEGATIONS, **defaults
    )


def command(
    prog: str, *errors: type[Exception]
) -> Callable[[Callable[..., int | None]], Callable[..., int]]:
    """Makes a function the `main` of a command, which returns the exit status.

    `main` takes the words after the command. The arguments of the function are the options, its
    docstring is the help. The status is 0 where it returns None. An exception out of `errors` is an
    error of the command line, and an interrupt ends the command without a traceback.
    """

    def decorate(function: Callable[..., int | None]) -> Callable[..., int]:
        def main(arguments: Sequence[str] | None = None) -> int:
            try:
                return parse(function, prog, arguments) or 0
            except errors as error:
                refuse(prog, str(error))
            except KeyboardInterrupt:
                raise SystemExit(128 + signal.SIGINT) from None

        return main

    return decorate


def refuse(prog: str, message: str) -> NoReturn:
    """Ends the command with status 2 and a message that names the option and its value."""
    print(f"{prog}: error: {message}", file=sys.stderr)
    raise SystemExit(2)


def check_output(
    option: str, path: Path | None, suffixes: Sequence[str] = (), *, overwrite: bool = False
) -> None:
    """Raises a ValueError, before the computation, if the output file cannot be written."""
    if path is None:
        return
    # Unlike the methods of Path, these functions accept names that no file can have.
    if os.path.isdir(path) or not os.path.isdir(path.parent):
        raise ValueError(f"{option} must name a file in a folder that exists, got {str(path)!r}")
    accepted = f"the name of a file {' or '.join(suffixes)}"
    require(not suffixes or path.suffix in suffixes, option, accepted, str(path))
    if os.path.exists(path) and not overwrite:
        accepted = "name a new file unless --overwrite is given"
        raise ValueError(f"{option} must {accepted}, got {str(path)!r}")
