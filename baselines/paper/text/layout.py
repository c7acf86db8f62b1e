"""How the report stands on a terminal: headings, tables, paragraphs."""

from __future__ import annotations

import textwrap

from baselines.paper.published import Number
from baselines.tables import Rows, text_table

WIDTH = 118


def title(text: str) -> list[str]:
    """A heading."""
    return ["", text, "=" * len(text)]


def table(rows: Rows, *, left: int = 1, last_left: bool = True) -> list[str]:
    """The lines of `text_table`."""
    return text_table(rows, left=left, last_left=last_left).splitlines()


def paragraph(text: str, indent: str = "", first: str | None = None) -> list[str]:
    """Text wrapped to the width."""
    return textwrap.wrap(text, WIDTH, initial_indent=indent if first is None else first, subsequent_indent=indent)


def printed(number: Number) -> str:
    """A published number with the digits of print."""
    return f"{number.value:.{number.digits}f}"
