"""Names of a package that are imported when they are first asked for.

With some of them comes numba, which takes most of a second; a command that only shows its help asks for none.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def later(package: str, places: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """What a package takes for its `__getattr__` and `__dir__`.

    Args:
        package: its `__name__`, while it is imported.
        places: by name the module of the package that has it, as ".env".
    """
    namespace = vars(sys.modules[package])

    def get(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = namespace[name] = getattr(import_module(places[name], package), name)
        return value

    return get, lambda: sorted({*namespace, *places})
