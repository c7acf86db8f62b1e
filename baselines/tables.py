"""Tables of numbers, for the terminal and for Markdown; the first row is the header, cells are finished strings."""

from __future__ import annotations

from collections.abc import Sequence

from tabulate import tabulate

Rows = Sequence[Sequence[str]]


def text_table(rows: Rows, *, left: int | None = None) -> str:
    """Aligned columns for the terminal.

    Args:
        rows: a cell may hold line breaks.
        left: the first so many columns and the last stand left, the others right; None puts all of them left.

    >>> print(text_table([["policy", "cm/s", ""], ["adaptive", "1.39", "reference"], ["epc", "11.62", ""]], left=1))
    policy      cm/s
    --------  ------  ---------
    adaptive    1.39  reference
    epc        11.62
    """
    last = len(rows[0]) - 1
    aligned = ["left" if left is None or column < left or column == last else "right" for column in range(last + 1)]
    return tabulate(rows, headers="firstrow", tablefmt="simple", disable_numparse=True, colalign=aligned)


def markdown_table(rows: Rows) -> str:
    """A Markdown table.

    >>> print(markdown_table([["policy", "cm/s"], ["adaptive", "1.39"]]))
    | policy   | cm/s   |
    |----------|--------|
    | adaptive | 1.39   |
    """
    return tabulate(rows, headers="firstrow", tablefmt="github", disable_numparse=True)
