"""Tables of numbers, for the terminal and for Markdown.

The first row is the header, and cells are finished strings.
"""

from collections.abc import Mapping, Sequence
from decimal import ROUND_FLOOR, Decimal
from typing import Any

try:
    from tabulate import tabulate
except ImportError as error:
    raise ImportError('tables need tabulate: pip install "capsule-gym[paper]"') from error

Rows = Sequence[Sequence[str]]


def text_table(rows: Rows, *, left: int | None = None) -> str:
    """Aligned columns for the terminal.

    The first `left` columns and the last one, for remarks, are aligned to the left; None aligns all
    columns so.

    >>> rows = [["policy", "cm/s", ""], ["adaptive", "1.390", "reference"], ["epc", "11.62", "new"]]
    >>> print(text_table(rows, left=1))
    policy      cm/s
    --------  ------  ---------
    adaptive   1.390  reference
    epc        11.62  new
    """
    count = len(rows[0])
    if left is None:
        left = count
    aligned = ["left"] * left + ["right"] * (count - left)
    aligned[-1] = "left"
    table = tabulate(
        rows, headers="firstrow", tablefmt="simple", disable_numparse=True, colalign=aligned
    )
    return "\n".join(line.rstrip() for line in table.splitlines())


def fields_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """A table for the terminal of mappings with the same keys, numbers with four digits.

    >>> print(fields_table([{"mean_speed": 1.384, "failed": False}]))
    mean speed    failed
    ------------  --------
    1.384         no
    """

    def cell(value: Any) -> str:
        if isinstance(value, (list, tuple)):
            return ", ".join(map(cell, value))
        if isinstance(value, bool):
            return "yes" if value else "no"
        return f"{value:.4g}" if isinstance(value, float) else str(value)

    head = [name.replace("_", " ") for name in rows[0]]
    cells = [[cell(value) for value in row.values()] for row in rows]
    return text_table([head, *cells])


def markdown_table(rows: Rows) -> str:
    """A Markdown table.

    >>> print(markdown_table([["policy", "cm/s"], ["adaptive", "1.390"]]))
    |policy|cm/s|
    |---|---|
    |adaptive|1.390|
    """
    head, *lines = (f"|{'|'.join(row)}|" for row in rows)
    rule = "|" + "---|" * len(rows[0])
    return "\n".join([head, rule, *lines])


def printed_below(value: float, digits: int) -> str:
    """A lower bound rounded down to `digits` decimals, so that the printed number is a bound, too.

    >>> printed_below(0.8477, 2)
    '0.84'
    """
    last = Decimal(1).scaleb(-digits)
    return str(Decimal(value).quantize(last, ROUND_FLOOR))
