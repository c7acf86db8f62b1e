"""Writes `_core.pyi`, the types of the compiled core; the build runs it.

Rows, settings and all other names of the core are lists in C++. The stub shows them to type
checkers and editors.
"""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

HEAD = """# Written by capsule_gym/core/stub.py from the compiled module.
# Arrays are passed by their addresses.
from typing import Any, Final

"""
# The types of what named tuples and functions contain, which the module does not know.
TAIL = """
def select_level(place: int, /) -> None: ...  # in LEVELS
def describe(options: dict[str, float | None], /) -> Description: ...

# Both call a function of capsule_gym/core/bindings/level.cpp: the result is the index of an
# environment whose law has failed, or -1; of functions over arrays it is the number of their
# results. `call` releases the lock.
def call(name: str, /, *arguments: float) -> int: ...
def call_locked(name: str, /, *arguments: float) -> int: ...

# A function of capsule_gym/core/bindings/recorded_functions.hpp, with the address of the constants;
# returns the rows.
def trace(function: str, number: int, constants: int, /) -> list[tuple[Any, ...]]: ...
"""
FIELD_TYPES = {
    "Settings": {},
    "Layout": {},
    "Description": {
        "settings": "Settings",
        "layout": "Layout",
        "entries": "list[tuple[str, float, float]]",
        "draws": "list[tuple[float, float, float, float, float, float]]",
    },
    "TaskDescription": {
        "fields": "list[str]",
        "shown": "list[str]",
        "term": "str",
        "steps": "int",
        "draws": "list[tuple[str, float, float, float]]",
        "metrics": "dict[str, str]",
    },
}
NUMBER_TYPES = {"Settings": "float", "Layout": "int"}
DICT_TYPES = {
    "LAWS": "dict[str, tuple[str, int, int]]",
    "TASKS": "dict[str, TaskDescription]",
    "METRICS": "dict[str, str]",
}


def write_types(core: ModuleType) -> str:
    """The text of the stub."""
    lines = [HEAD]
    for name, types in FIELD_TYPES.items():
        fields = getattr(core, name).__match_args__
        lines.append(f"class {name}(tuple[Any, ...]):")
        for field in fields:
            field_type = types.get(field) or NUMBER_TYPES[name]
            lines += ["    @property", f"    def {field}(self) -> {field_type}: ..."]
        lines.append("")
    lines.append("class Row:")
    for name in core.ROW_NAMES:
        lines.append(f"    {name}: Final = {getattr(core.Row, name)}")
    lines.append("")
    for name, value in sorted(vars(core).items()):
        if name.isupper():
            lines.append(f"{name}: Final[{type_of(name, value)}]")
    return "\n".join(lines) + "\n" + TAIL


def type_of(name: str, value: Any) -> str:
    """The type of a constant."""
    if isinstance(value, list):
        return "list[str]"
    return DICT_TYPES.get(name) or type(value).__name__


def main(module: str, stub: str) -> None:
    """Writes the stub of a compiled module to a file."""
    spec = importlib.util.spec_from_file_location("_core", module)
    assert spec is not None and spec.loader is not None, f"{module} is not a module"
    core = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(core)
    Path(stub).write_text(write_types(core), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
