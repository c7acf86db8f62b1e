"""Machine code in object files: its target processors, and its loading without numba."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import sys
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np

# Marks functions for which the compiler uses the whole width of the registers.
WIDEST_VECTORS = '"prefer-vector-width"="512"'
# Marks functions whose loops take two vectors at a time.
INTERLEAVED = '"interleaved"'
# The symbols that an object file exports: the function in numba's calling convention, and its entry for Python.
FUNCTION, PYTHON_FUNCTION = "function", "python_function"

_V3 = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
_V4 = (*_V3, "avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl")


class Target(NamedTuple):
    """A kind of processor.

    Attributes:
        name: name in file names.
        cpu: LLVM's name.
        features: in LLVM's notation.
    """

    name: str
    cpu: str
    features: str

    @property
    def wide(self) -> bool:
        """Whether registers hold eight numbers."""
        return "avx512" in self.cpu or "+avx512f" in self.features


def _levels() -> dict[Target, tuple[str, ...]]:
    """The targets of the shipped machine code, the best one first, and the processor features that they need."""
    system = sys.platform
    if platform.machine().lower() in ("arm64", "aarch64"):
        return {Target(f"{system}-arm64", "generic", "+neon"): ("neon",)}
    return {
        # The first processors of these levels: LLVM generates worse loops for the level alone.
        Target(f"{system}-x86-64-v4", "skylake-avx512", ""): _V4,
        Target(f"{system}-x86-64-v3", "haswell", ""): _V3,
    }


LEVELS = _levels()


@cache
def host_target() -> Target:
    """The target of this processor: one of `LEVELS`, or a specific one.

    NUMBA_CPU_NAME and NUMBA_CPU_FEATURES choose another target, as they do for numba.
    """
    given = os.environ.get("NUMBA_CPU_NAME"), os.environ.get("NUMBA_CPU_FEATURES")
    found = llvm.get_host_cpu_features()
    if given == (None, None):
        for target, needed in LEVELS.items():
            if all(found.get(feature) for feature in needed):
                return target
    cpu = given[0] or llvm.get_host_cpu_name()
    features = (given[1] or "") if given != (None, None) else found.flatten()
    digest = hashlib.sha256(features.encode()).hexdigest()[:8]
    return Target(f"{sys.platform}-{cpu}-{digest}", cpu, features)


def target_machine(target: Target) -> Any:
    """LLVM's compiler for a kind of processors."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    triple = llvm.Target.from_triple(llvm.get_process_triple())
    return triple.create_target_machine(cpu=target.cpu, features=target.features, opt=3)


class Entry(NamedTuple):
    """A compiled function.

    Attributes:
        call: the entry for Python, with arrays and numbers as positional arguments. It checks that arrays are numpy's,
            and their number of dimensions; it releases the interpreter's lock.
        address: address of the function in numba's calling convention, for compiled code; valid while `call` exists.
    """

    call: Callable[..., int]
    address: int


class _MethodDefinition(ctypes.Structure):
    """CPython's PyMethodDef."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("function", ctypes.c_void_p),
        ("flags", ctypes.c_int),
        ("documentation", ctypes.c_char_p),
    )


# Arguments come as an array of objects and their number.
_METH_FASTCALL = 0x80
# Functions of the interpreter that an object file calls.
_PYTHON_API = (
    "PyErr_Occurred",
    "PyErr_SetObject",
    "PyEval_RestoreThread",
    "PyEval_SaveThread",
    "PyFloat_AsDouble",
    "PyLong_AsLongLong",
    "PyLong_FromLongLong",
    "PyTuple_GetItem",
)


@cache
def _initialize() -> Any:
    """Gives the linker the interpreter's functions; returns the one that creates a function from a definition."""
    for name in _PYTHON_API:
        llvm.add_symbol(name, ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value)
    new = ctypes.pythonapi.PyCFunction_NewEx
    new.restype, new.argtypes = ctypes.py_object, [ctypes.POINTER(_MethodDefinition), ctypes.py_object, ctypes.c_void_p]
    return new


def load(content: bytes, name: str) -> Entry:
    """Loads the function of an object file; `name` is its name in messages."""
    new = _initialize()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), target_machine(host_target()))
    engine.add_object_file(llvm.ObjectFileRef.from_data(content))
    engine.finalize_object()
    address = engine.get_function_address(PYTHON_FUNCTION)
    definition = _MethodDefinition(name.encode(), address, _METH_FASTCALL, None)
    # The function reads the first of these from its `self` (see `capsule_gym.compiler`), and keeps the rest alive.
    itself = (
        np.ndarray,
        TypeError,
        f"{name}: arguments must be the numbers and arrays of its signature",
        IndexError,
        f"{name}: an index is out of range",
        engine,
        definition,
    )
    return Entry(new(ctypes.byref(definition), itself, None), engine.get_function_address(FUNCTION))
