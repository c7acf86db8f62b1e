"""The fingerprint of a law: any edit that affects its compiled code changes the fingerprint.

A grammar generates each law as a package of modules: helpers, nested modules, modules named like libraries, defaults,
constants, arrays, closures, nested factories, named tuples and ufuncs.
"""

from __future__ import annotations

import sys
from types import ModuleType

import numba
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from capsule_gym.compilation import fingerprint

IMPORTS = """
from enum import IntEnum
from typing import NamedTuple
import numpy as np
from numba import njit
"""
# By name: the code before the law, and a term of its torque. An edit changes the number A; K distinguishes the parts.
PARTS = {
    "literal": ("", "A * x"),
    "global": ("gK = A", "gK * x"),
    "tuple": ("gK = (1.0, (A, 2.0))", "gK[1][0] * x"),
    "table": ("gK = np.zeros(1200)\ngK[600] = A", "gK[600] * x"),
    "named tuple": ("class T(NamedTuple):\n    g: float\ngK = T(A)", "gK.g * x"),
    "enumeration": ("class EK(IntEnum):\n    g = A", "EK.g * x"),
    "helper": ("@njit\ndef fK(v):\n    return A * v", "fK(x)"),
    "option": ("fK = njit(error_model=('numpy', 'python')[A % 2])(lambda v: 1.0 / v)", "fK(x)"),
    "default": ("@njit\ndef fK(v, g=A):\n    return g * v", "fK(x)"),
    "keyword": ("@njit\ndef fK(v, *, g=A):\n    return g * v", "fK(x)"),
    "table as default": ("t = np.zeros(1200)\nt[600] = A\n@njit\ndef fK(v, g=t):\n    return g[600] * v", "fK(x)"),
    "closure": ("def m(g):\n    return njit(lambda v: g * v)\nfK = m(A)", "fK(x)"),
    "nested factory": (
        "def m(g):\n    def n(h):\n        inner = njit(lambda v: g * h * v)\n        return njit(lambda v: inner(v))\n"
        "    return n\nfK = m(A)(2.0)",
        "fK(x)",
    ),
    "function inside": ("def fK(v):\n    def h(w):\n        return A * w\n    return h(v)\nfK = njit(fK)", "fK(x)"),
    "ufunc": ("fK = np.frompyfunc(lambda v: A * v, 1, 1)", "fK(x)"),
    "closure over a ufunc": (
        "def m(g):\n    u = np.frompyfunc(lambda v: g * v, 1, 1)\n    return njit(lambda v: u(v))\nfK = m(A)",
        "fK(x)",
    ),
    "dictionary": ("gK = {'g': A}", "gK['g'] * x"),
    "object of a library": ("gK = np.poly1d([A])", "gK(x)"),
    "module": ("import math_laws.gains as jK", "jK.g * x"),
    "nested module": ("import math_laws.sub.gains", "math_laws.sub.gains.g * x"),
    "function of a module": ("from math_laws import numba_tools as jK", "jK.scale(x)"),
}
MODULES = {
    "math_laws": "",
    "math_laws.gains": "g = A",
    "math_laws.sub": "",
    "math_laws.sub.gains": "g = A",
    "math_laws.numba_tools": "from numba import njit\n@njit\ndef scale(v):\n    return A * v",
}


def make_fingerprint(parts: list[tuple[str, int]]) -> str | None:
    """The fingerprint of a law that is written anew from these parts and their numbers."""
    numbers = dict(parts)
    of_module = {
        "math_laws.gains": numbers.get("module", 1),
        "math_laws.sub.gains": numbers.get("nested module", 1),
        "math_laws.numba_tools": numbers.get("function of a module", 1),
    }
    for name, text in MODULES.items():
        module = sys.modules[name] = ModuleType(name)
        module.__path__ = []
        exec(text.replace("A", str(of_module.get(name, 1))), vars(module))
        if "." in name:
            parent, _, last = name.rpartition(".")
            setattr(sys.modules[parent], last, module)
    filled = [
        [text.replace("K", str(k)).replace("A", str(number)) for text in PARTS[part]]
        for k, (part, number) in enumerate(parts)
    ]
    before = "\n".join(text for text, _ in filled)
    scope = {"__name__": "math_laws.law"}
    exec(f"{IMPORTS}{before}\ndef law(x):\n    return {' + '.join(term for _, term in filled)}", scope)
    return fingerprint(scope["law"])


@settings(max_examples=12 * settings.default.max_examples)
@given(
    st.lists(
        st.tuples(st.sampled_from(sorted(PARTS)), st.integers(1, 9)), min_size=1, max_size=5, unique_by=lambda x: x[0]
    ),
    st.integers(1, 9),
)
def test_an_edit_anywhere_changes_the_fingerprint(parts, change):
    try:
        before = make_fingerprint(parts)
        assert make_fingerprint(parts) == before
        for k, (part, number) in enumerate(parts):
            edited = [*parts[:k], (part, number + change + (part == "option") * (change % 2 == 0)), *parts[k + 1 :]]
            after = make_fingerprint(edited)
            assert after is None or after != before, part
    finally:
        for name in MODULES:
            sys.modules.pop(name, None)


def test_only_what_cannot_be_read_has_no_fingerprint():
    without = {part for part in PARTS if make_fingerprint([(part, 2)]) is None}
    assert without == {"enumeration", "ufunc", "closure over a ufunc", "dictionary", "object of a library"}
    # A ufunc of numba's own; a process can make only a few thousand.
    ufunc = numba.vectorize(lambda v: 2.0 * v)
    assert fingerprint(lambda x: ufunc(x)) is None
    assert fingerprint(lambda x: np.sqrt(x)) is not None
