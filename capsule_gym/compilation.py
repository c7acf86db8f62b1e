"""How plain functions become compiled ones that numba's disk cache may keep.

numba's own cache looks at the date of one file. A function here is compiled under a name that holds a hash of
everything it refers to, so that an edit of a law, of the physics or of a gain never meets a stale entry, and an
unchanged one is found again by any process.
"""

from __future__ import annotations

import gc
import hashlib
import inspect
import pickle
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from numba import types
from numba.core import event
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
# What a fingerprint does not look into.
_LIBRARIES = ("math", "numpy", "numba", "typing", "builtins")

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


def fingerprint(function: Callable[..., Any]) -> str:
    """A sha256 of a function, of all that it refers to (constants, closures, globals, callees), and of the options."""
    digest = hashlib.sha256(repr(sorted(OPTIONS.items())).encode())
    seen: set[int] = set()

    def add_code(code: CodeType, scope: dict[str, Any]) -> None:
        digest.update(code.co_code)
        digest.update(repr((code.co_names, code.co_varnames, code.co_freevars)).encode())
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                add_code(constant, scope)
            else:
                digest.update(repr(constant).encode())
        for name in code.co_names:
            if name in scope:
                add(name, scope[name], code.co_names)

    def add(name: str, value: Any, names: tuple[str, ...]) -> None:
        digest.update(name.encode())
        if isinstance(value, CPUDispatcher):
            digest.update(repr(sorted(value.targetoptions.items())).encode())
        value = value._defn if isinstance(value, _Intrinsic) else getattr(value, "py_func", value)
        if isinstance(value, FunctionType):
            if id(value) in seen or value.__module__.startswith(_LIBRARIES):
                return
            seen.add(id(value))
            add_code(value.__code__, value.__globals__)
            digest.update(repr(value.__defaults__).encode())
            # numba learns from the argument where a named tuple holds which field: the code does not say it.
            for word in re.findall(r"\w+", repr(value.__annotations__)):
                kind = value.__globals__.get(word)
                if isinstance(kind, type) and hasattr(kind, "_fields"):
                    add(word, kind, ())
            for free, cell in zip(value.__code__.co_freevars, value.__closure__ or (), strict=True):
                add(free, cell.cell_contents, ())
        elif isinstance(value, ModuleType):
            if not value.__name__.startswith(_LIBRARIES):
                for attribute in names:
                    if hasattr(value, attribute):
                        add(attribute, getattr(value, attribute), ())
        elif isinstance(value, (tuple, list)):
            digest.update(f"{type(value).__qualname__} of {len(value)}".encode())
            digest.update(repr(getattr(value, "_fields", ())).encode())
            for entry in value:
                add("", entry, ())
        elif isinstance(value, np.ndarray):
            digest.update(repr((value.dtype, value.shape)).encode() + np.ascontiguousarray(value).tobytes())
        elif isinstance(value, type):
            fields = inspect.get_annotations(value) if hasattr(value, "_fields") else None
            digest.update(repr((value.__qualname__, fields)).encode())
        else:
            digest.update(repr(value).encode())

    add(function.__name__, function, ())
    return digest.hexdigest()


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


def kernel(function: Callable[..., Any], digest: str, bindings: dict[str, Any]) -> Any:
    """The function with those globals, compiled at its first call or loaded from the disk cache of its sources."""
    dispatcher = numba.njit(rebound(function, f"{function.__name__}_{digest}", bindings), nogil=True, **OPTIONS)
    # numba finds no folder where neither NUMBA_CACHE_DIR, nor the package, nor the user's cache can be written to.
    with suppress(RuntimeError):
        dispatcher._cache = Cache(dispatcher.py_func)
    return dispatcher


class Cache(FunctionCache):
    """numba's disk cache, for files that other processes may damage.

    numba believes what it finds: an index that was cut off ends the program with an unpickling error, and machine code
    in which a bit has changed is run. It also names the file of the code in the index only, so that two processes for
    different processors can give theirs the same name. Here each entry is a file of its own, whose name holds the hash
    of all that the code depends on, and which begins with the hash of its content. What does not fit is compiled again;
    where nothing can be written nothing is kept.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function of a signature, or None."""
        target_context.refresh()
        # Code that was kept by another version may refer to a module that has another name now.
        with suppress(OSError, ImportError, AttributeError):
            content = self._file(sig, target_context.codegen()).read_bytes()
            digest, payload = content[:DIGEST_SIZE], content[DIGEST_SIZE:]
            if hashlib.sha256(payload).digest() == digest:
                return self._impl.rebuild(target_context, pickle.loads(payload))
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
    return kernel(function, fingerprint(function)[:16], {})


def compile_now(function: Any, signature: tuple[Any, ...], what: str) -> None:
    """Compiles a function for a signature, or loads it from the disk cache; says so on stderr where it has to compile.

    Args:
        function: what `kernel` has made.
        signature: numba's types of its arguments.
        what: for the message; empty where it takes too short a time to say so.
    """
    # A compilation makes millions of objects that live until its end: looking for garbage is a tenth of the time.
    collecting = gc.isenabled()
    gc.disable()
    try:
        with event.install_listener("numba:compile", _Announcement(what)):
            function.compile(signature)
    finally:
        if collecting:
            gc.enable()


class _Announcement(event.Listener):
    """Says once that a compilation has begun."""

    def __init__(self, what: str) -> None:
        self.what = what

    def on_start(self, event: Any) -> None:
        if self.what:
            # Above a progress bar, not behind it: who draws one has imported tqdm.
            bars = sys.modules.get("tqdm") if sys.stderr.isatty() else None
            (print if bars is None else bars.tqdm.write)(
                f"capsule_gym: compiling {self.what}; this takes some seconds, once: numba keeps the result on disk",
                file=sys.stderr,
            )
            sys.stderr.flush()
        self.what = ""

    def on_end(self, event: Any) -> None:
        pass
