"""What the analysis writes for one page of the documentation."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Document:
    """The output of the analysis for one page of the documentation.

    Attributes:
        sections: Markdown by the name under which the page includes it.
        figures: functions that draw a figure of matplotlib, by the name of its files.
    """

    sections: Mapping[str, str]
    figures: Mapping[str, Callable[[], Any]]
