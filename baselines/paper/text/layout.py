"""How the report stands on a terminal: headings, tables, paragraphs."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from baselines.paper.published import Number

WIDTH = 118


def title(text: str) -> list[str]:
    """A heading."""
    return ["", text, "=" * len(text)]


def table(rows: Sequence[Sequence[str]], *, left: int = 1) -> list[str]:
    """Aligned columns, the first row as the header; the first `left` columns and the last stand left."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [
            cell.ljust(width) if i < left or i == len(row) - 1 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return [lines[0], "-" * (sum(widths) + 2 * (len(widths) - 1)), *lines[1:]]


def paragraph(text: str, indent: str = "", first: str | None = None) -> list[str]:
    """Text wrapped to the width."""
    return textwrap.wrap(text, WIDTH, initial_indent=indent if first is None else first, subsequent_indent=indent)


def printed(number: Number) -> str:
    """A published number with the digits of print."""
    return f"{number.value:.{number.digits}f}"
