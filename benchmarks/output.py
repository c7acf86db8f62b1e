"""What the commands here have in common: where their numbers and tables go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from capsule_gym.command_line import check_output
from capsule_gym.files import to_json, write_atomically


@dataclass(frozen=True, kw_only=True)
class Output:
    """The options of every command."""

    json: Path | None = None
    """Write the numbers to this new file."""
    markdown: Path | None = None
    """Write the tables to this file."""
    overwrite: bool = False
    """Let --json replace an existing file."""

    def check(self) -> None:
        """Refuses files that cannot be written, before the work.

        Raises:
            ValueError: if one of them cannot.
        """
        check_output("--json", self.json, overwrite=self.overwrite)
        check_output("--markdown", self.markdown, overwrite=True)

    def write(self, command: str, numbers: dict[str, Any], lines: Sequence[str]) -> None:
        """Writes what is asked for.

        Args:
            command: what the page names as its author.
            numbers: for --json.
            lines: of the page, for --markdown.
        """
        if self.json is not None:
            write_atomically(self.json, to_json(numbers))
        if self.markdown is not None:
            write_atomically(self.markdown, "\n".join([written_by(command), "", *lines, ""]))


def written_by(command: str) -> str:
    """The first line of a page that a command writes."""
    return f"<!-- Written by {command}: do not edit. -->"


def check_at_least_one(option: str, count: int) -> None:
    """Refuses a number of turns, trajectories or steps that nothing can be measured in.

    Args:
        option: as the user types it.
        count: its value.

    Raises:
        ValueError: if it is below one.
    """
    if count < 1:
        raise ValueError(f"{option} must be at least 1, got {count}")


def section(name: str, lines: Sequence[str]) -> list[str]:
    """Lines that other pages include by the page's path and this name."""
    return [f"<!-- --8<-- [start:{name}] -->", *lines, f"<!-- --8<-- [end:{name}] -->", ""]
