"""Tables of numbers, for the terminal and for Markdown; the first row is the header, cells are finished strings."""

from collections.abc import Sequence
from decimal import ROUND_FLOOR, Decimal

try:
    from tabulate import tabulate
except ImportError as error:
    raise ImportError('tables need tabulate: pip install "capsule-gym[paper]"') from error

Rows = Sequence[Sequence[str]]


def text_table(rows: Rows, *, left: int | None = None) -> str:
    """Aligned columns for the terminal: the first `left` and the last, for remarks, to the left; None aligns all so.

    >>> print(text_table([["policy", "cm/s", ""], ["adaptive", "1.39", "reference"], ["epc", "11.62", ""]], left=1))
    policy      cm/s
    --------  ------  ---------
    adaptive    1.39  reference
    epc        11.62
    """
    last = len(rows[0]) - 1
    aligned = ["left" if left is None or n < left or n == last else "right" for n in range(last + 1)]
    table = tabulate(rows, headers="firstrow", tablefmt="simple", disable_numparse=True, colalign=aligned)
    return "\n".join(line.rstrip() for line in table.splitlines())


def markdown_table(rows: Rows) -> str:
    """A Markdown table.

    >>> print(markdown_table([["policy", "cm/s"], ["adaptive", "1.390"]]))
    |policy|cm/s|
    |---|---|
    |adaptive|1.390|
    """
    head, *lines = (f"|{'|'.join(row)}|" for row in rows)
    return "\n".join([head, "|" + "---|" * len(rows[0]), *lines])


def printed_below(value: float, digits: int) -> str:
    """A lower bound with `digits` decimals, rounded down, so that the printed number is a bound as well.

    >>> printed_below(0.8477, 2)
    '0.84'
    """
    return str(Decimal(value).quantize(Decimal(1).scaleb(-digits), ROUND_FLOOR))
