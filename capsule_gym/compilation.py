"""How plain functions become compiled ones that numba's disk cache may keep.

numba's own cache looks at the date of one file. A function here is compiled under a name that holds a hash of
everything it refers to, so that an edit of a law, of the physics or of a gain never meets a stale entry, and an
unchanged one is found again by any process.
"""

from __future__ import annotations

import hashlib
import inspect
import pickle
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import BuiltinFunctionType, CellType, CodeType, FunctionType, ModuleType
from typing import Any
from uuid import uuid4

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core.caching import FunctionCache
from numba.core.registry import CPUDispatcher
from numba.core.serialize import dumps
from numba.extending import _Intrinsic, intrinsic, register_jitable

from capsule_gym.files import write_atomically

# A division by zero gives infinity. Python's exception would be a branch in every division, which no loop over
# environments survives; strict floating point otherwise, so that all loops give the same bits.
OPTIONS: dict[str, Any] = {"error_model": "numpy"}
# Wrappers that let Python or C call a compiled helper take half of the time to compile it, and are never used.
_NO_WRAPPERS: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

DIGEST_SIZE = hashlib.sha256().digest_size
# Packages whose content a fingerprint does not read.
_LIBRARIES = ("builtins", "itertools", "llvmlite", "math", "numba", "numpy", "operator", "typing")

# Decorators of plain functions that compiled code may call. Compiled code contains no call of an `inlined` one but its
# body: no loop over environments is vectorised otherwise.
jitable = register_jitable(**_NO_WRAPPERS)
inlined = register_jitable(forceinline=True, **_NO_WRAPPERS)


@intrinsic
def use_widest_vectors(typing_context: Any) -> Any:
    """Has the calling function's loops vectorised over the whole width of the registers.

    On most processors with AVX-512 the compiler takes half of it, since a few wide instructions lower the clock for all
    others. The kernel's loops are nothing but arithmetic, and gain a fifth.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        # llvmlite only adds attributes that it knows by name.
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.void(), generate


def fingerprint(function: Callable[..., Any]) -> str | None:
    """A hash of a function, of everything that its compiled code can depend on, and of the options.

    That is its code and that of its callees, with their defaults, closures, globals and attributes of modules.

    Returns:
        16 digits of a sha256; None if something among these is of a type whose content this function cannot read.
    """
    digest = hashlib.sha256()
    seen: set[Any] = set()

    def put(*parts: Any) -> None:
        digest.update(repr(parts).encode() + b"\0")

    def add_code(code: CodeType) -> set[str]:
        """Adds a code object and those in it; returns the names of globals and attributes that they read."""
        put(code.co_code, code.co_varnames, code.co_names, code.co_freevars)
        put(getattr(code, "co_exceptiontable", None))
        names = set(code.co_names)
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                names |= add_code(constant)
            else:
                put(constant)
        return names

    def add_function(function: FunctionType) -> None:
        names = add_code(function.__code__)
        scope = function.__globals__
        for name in sorted(names & scope.keys()):
            add(name, scope[name], names)
        add("defaults", function.__defaults__, names)
        for name, default in sorted((function.__kwdefaults__ or {}).items()):
            add(name, default, names)
        # numba learns from the argument where a named tuple holds which field: the code does not say it.
        for word in re.findall(r"\w+", repr(function.__annotations__)):
            kind = scope.get(word)
            if isinstance(kind, type) and hasattr(kind, "_fields"):
                add(word, kind, names)
        for free, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            add(free, cell.cell_contents, names)

    def add(name: str, value: Any, names: set[str]) -> None:
        if isinstance(value, CPUDispatcher):
            put(sorted(value.targetoptions.items()))
        value = value._defn if isinstance(value, _Intrinsic) else getattr(value, "py_func", value)
        home = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None) or ""
        named = isinstance(value, (ModuleType, FunctionType, BuiltinFunctionType, type))
        put(name, type(value).__qualname__)
        if value is None or isinstance(value, (bool, int, float, complex, str, bytes, np.generic)):
            put(value)
        elif isinstance(value, (tuple, list)):
            put(len(value), getattr(value, "_fields", None))
            for entry in value:
                add("", entry, names)
        elif isinstance(value, np.ndarray) and not value.dtype.hasobject:
            put(value.dtype, value.shape, np.ascontiguousarray(value).tobytes())
        elif named and home.partition(".")[0] in _LIBRARIES:
            put(home, value.__name__)
        elif isinstance(value, (types.Type, ir.Type)) or value is getattr(np, getattr(value, "__name__", ""), None):
            put(str(value))
        elif isinstance(value, ModuleType):
            if (id(value), frozenset(names)) not in seen:
                seen.add((id(value), frozenset(names)))
                for attribute in sorted(names & vars(value).keys()):
                    add(attribute, getattr(value, attribute), names)
        elif isinstance(value, FunctionType):
            if id(value) not in seen:
                seen.add(id(value))
                add_function(value)
        elif isinstance(value, type) and hasattr(value, "_fields"):
            put(value.__qualname__, value._fields, inspect.get_annotations(value))
        else:
            raise TypeError(name, value)

    put(sorted(OPTIONS.items()))
    try:
        add(function.__name__, function, set())
    except TypeError:
        return None
    return digest.hexdigest()[:16]


def rebound(function: Any, name: str, bindings: dict[str, Any], cells: tuple[CellType, ...] | None = None) -> Any:
    """A copy of a function under another name, with some globals bound to other values, and with that closure."""
    scope = {**function.__globals__, **bindings}
    copy = FunctionType(function.__code__, scope, name, function.__defaults__, cells)
    copy.__qualname__ = name
    copy.__module__ = function.__module__
    return copy


def distinct(function: Any, digest: str, outer: tuple[Any, ...] = ()) -> Any:
    """A copy of a law, and of the compiled helpers it refers to, under names that hold the hash.

    numba's symbols hold a function's name and a counter of the process. Two laws out of one factory, compiled in two
    processes and loaded from the disk cache into a third, would have the same symbol, and the linker would give both
    the first one's code.
    """

    def renewed(value: Any) -> Any:
        if not isinstance(value, CPUDispatcher) or value in outer:
            return value
        options = {**value.targetoptions, **OPTIONS}
        return numba.jit(distinct(value.py_func, digest, (*outer, value)), **options)

    names = {
        name: renewed(function.__globals__[name]) for name in function.__code__.co_names if name in function.__globals__
    }
    cells = tuple(CellType(renewed(cell.cell_contents)) for cell in function.__closure__ or ())
    return rebound(function, f"{function.__name__}_{digest}", names, cells or None)


def inner(function: Any, **options: Any) -> Any:
    """Compiles a function that kernels call, with more of numba's options."""
    return numba.njit(function, **OPTIONS, **_NO_WRAPPERS, **options)


def kernel(function: Callable[..., Any], digest: str | None, bindings: dict[str, Any], what: str = "") -> Any:
    """The function with other globals, compiled at its first call or loaded from the disk cache.

    Args:
        function: a plain function.
        digest: a hash of all that the code depends on; None keeps the code in this process alone.
        bindings: the globals that are to have other values.
        what: for a message on stderr where it is not in the cache; empty where it takes too short a time to say so.
    """
    bound = rebound(function, f"{function.__name__}_{digest or uuid4().hex}", bindings)
    dispatcher = numba.njit(bound, nogil=True, **OPTIONS)
    # numba finds no folder where neither NUMBA_CACHE_DIR, nor the package, nor the user's cache can be written to.
    with suppress(RuntimeError):
        if digest:
            dispatcher._cache = Cache(dispatcher.py_func)
            dispatcher._cache.what = what
    return dispatcher


class Cache(FunctionCache):
    """numba's disk cache, for files that other processes may damage.

    numba believes what it finds: an index that was cut off ends the program with an unpickling error, and machine code
    in which a bit has changed is run. It also names the file of the code in the index only, so that two processes for
    different processors can give theirs the same name. Here each entry is a file of its own, whose name holds the hash
    of all that the code depends on, and which begins with the hash of its content. What does not fit is compiled again;
    where nothing can be written nothing is kept.
    """

    what = ""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function of a signature, or None."""
        target_context.refresh()
        # Code that was kept by another version may refer to a module that has another name now.
        with suppress(OSError, ImportError, AttributeError):
            content = self._file(sig, target_context.codegen()).read_bytes()
            digest, payload = content[:DIGEST_SIZE], content[DIGEST_SIZE:]
            if hashlib.sha256(payload).digest() == digest:
                return self._impl.rebuild(target_context, pickle.loads(payload))
        if self.what:
            text = f"compiling {self.what}; this takes some seconds, once: numba keeps the result on disk"
            print(f"capsule_gym: {text}", file=sys.stderr)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keeps a compiled function."""
        if self._impl.check_cachable(data):
            payload = dumps(self._impl.reduce(data))
            with suppress(OSError):
                write_atomically(self._file(sig, data.codegen), hashlib.sha256(payload).digest() + payload)

    def _file(self, sig: Any, codegen: Any) -> Path:
        """Where the code of a signature lies for this processor and this version of numba and of the sources."""
        # Without BOUNDSCHECK, code compiled without bounds checks would be used where they are switched on.
        stamp = self._impl.locator.get_source_stamp()
        key = (self._index_key(sig, codegen), stamp, numba.__version__, numba.config.BOUNDSCHECK)
        digest = hashlib.sha256(repr(key).encode()).hexdigest()[:16]
        return Path(self.cache_path) / f"{self._impl.filename_base}.{digest}.nbc"


@cache
def compile_cached(function: Callable[..., Any]) -> Any:
    """Compiles a module-level function with numba; unlike numba's own, the disk cache notices edits of its callees.

    The same function gives the same dispatcher.
    """
    return kernel(function, fingerprint(function), {})


def compile_entry(function: Callable[..., Any], signature: tuple[Any, ...], what: str = "") -> Any:
    """A module-level function as compiled code alone: it checks neither dtype nor shape nor contiguity of its arrays.

    numba's search for the right compiled form takes time, and finds none for read-only arrays or another law's step.

    Args:
        function: plain.
        signature: numba's types of its arguments.
        what: as for `kernel`.
    """
    compiled = kernel(function, fingerprint(function), {}, what)
    compiled.compile(signature)
    return next(iter(compiled.overloads.values())).entry_point
