"""Compilation of plain functions, and the cache of their machine code.

The functions of the step are ordinary Python; decorators of this module mark them for the compiler. `compile_entry`
looks for machine code that came with the package or that this machine has compiled before. It imports numba and
`capsule_gym.compiler` only if it finds none. The key of the code is a hash of everything that it depends on, so that no
stale code is used after an edit of a law, of the physics or of a gain.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from types import BuiltinFunctionType, CellType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from filelock import FileLock

from capsule_gym import objects
from capsule_gym.files import write_atomically
from capsule_gym.objects import Entry, Target

# A division by zero gives infinity: Python's exception would be a branch in every division and prevent vectorised
# loops. Floating point is strict otherwise, so that all loops give the same bits.
OPTIONS: dict[str, Any] = {"error_model": "numpy"}
# Wrappers that let Python or C call a compiled helper take half of the time to compile it, and are never used.
NO_WRAPPERS: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

# The machine code that comes with the package, for the processors of `objects.LEVELS`.
SHIPPED = Path(__file__).with_name("machine_code")
# Further targets to compile for, into that folder; there are some only while the package is built.
shipping: tuple[Target, ...] = ()
# Packages whose content a fingerprint does not read.
_LIBRARIES = ("builtins", "itertools", "llvmlite", "math", "numba", "numpy", "operator", "typing")
_DIGEST_SIZE = hashlib.sha256().digest_size

# Functions that compiled code may call: `marked` holds their options, `generated` the generators of instructions.
# `capsule_gym.compiler` registers both with numba when it is imported, and adds a listener for later ones.
marked: dict[Callable[..., Any], dict[str, Any]] = {}
generated: dict[Callable[..., Any], tuple[Callable[..., Any], bool]] = {}
listeners: list[Callable[[], None]] = []


def jitable(function: Any, **options: Any) -> Any:
    """Marks a plain function that compiled code may call; if its caller is `inlined`, it is inlined too."""
    marked[function] = {**NO_WRAPPERS, **options}
    for listen in listeners:
        listen()
    return function


def inlined(function: Any) -> Any:
    """Marks a plain function that is inlined into compiled code, so that a loop around it can be vectorised."""
    return jitable(function, forceinline=True)


def intrinsic(define: Callable[..., Any], prefer_literal: bool = False) -> Callable[[Any], Any]:
    """Marks a function whose instructions `define` generates; its body is the equivalent that Python runs.

    The arguments are those of `numba.extending.intrinsic`.
    """

    def mark(function: Any) -> Any:
        generated[function] = define, prefer_literal
        for listen in listeners:
            listen()
        return function

    return mark


def _attribute(text: str) -> Callable[..., Any]:
    """Gives the calling function an LLVM attribute; generates no instructions."""

    def define(typing_context: Any) -> Any:
        from numba import types

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            # llvmlite only adds attributes that it knows by name.
            set.add(builder.function.attributes, text)
            return context.get_dummy_value()

        return types.void(), generate

    return define


@intrinsic(_attribute(objects.WIDEST_VECTORS))
def use_widest_vectors() -> None:
    """Vectorises the loops of the calling function over the whole width of the registers.

    On most processors with AVX-512 the compiler uses half of it, since a few wide instructions lower the clock for all
    others. The kernel's loops are pure arithmetic, and gain a fifth.
    """


@intrinsic(_attribute(objects.INTERLEAVED))
def interleave_loops() -> None:
    """Interleaves two vectors in the loops compiled with the calling function, if vectors hold two or four numbers.

    A Runge-Kutta step is a chain of dependent operations; two interleaved steps use the waiting times of each other.
    """


@intrinsic(_attribute("noinline"))
def stay_apart() -> None:
    """Prevents the inlining of the calling function."""


def fingerprint(function: Callable[..., Any]) -> str | None:
    """A hash of a function, of everything that its compiled code can depend on, and of the options.

    The hash covers its code and that of its callees, with their defaults, closures, globals and attributes of modules.

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

    def add_function(function: Any) -> None:
        names = add_code(function.__code__)
        scope = function.__globals__
        for name in sorted(names & scope.keys()):
            add(name, scope[name], names)
        add("defaults", function.__defaults__, names)
        for name, default in sorted((function.__kwdefaults__ or {}).items()):
            add(name, default, names)
        # numba takes the order of a named tuple's fields from the argument; the code does not contain it.
        for word in re.findall(r"\w+", repr(function.__annotations__)):
            kind = scope.get(word)
            if isinstance(kind, type) and hasattr(kind, "_fields"):
                add(word, kind, names)
        for free, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            add(free, cell.cell_contents, names)

    def add(name: str, value: Any, names: set[str]) -> None:
        # Functions that numba has compiled, and intrinsics.
        if hasattr(value, "py_func") and hasattr(value, "targetoptions"):
            put(sorted(value.targetoptions.items()))
        value = getattr(value, "py_func", getattr(value, "_defn", value))
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
        elif _is_library_type(value) or value is getattr(np, getattr(value, "__name__", ""), None):
            put(str(value))
        elif isinstance(value, ModuleType):
            if (id(value), frozenset(names)) not in seen:
                seen.add((id(value), frozenset(names)))
                for attribute in sorted(names & vars(value).keys()):
                    add(attribute, getattr(value, attribute), names)
        elif isinstance(value, FunctionType):
            put(sorted(marked.get(value, {}).items()) if name else None)
            if id(value) not in seen:
                seen.add(id(value))
                # Compiled code depends on the generator of instructions, not on the body, which Python runs.
                add_function(generated[value][0] if value in generated else value)
        elif isinstance(value, type) and hasattr(value, "_fields"):
            put(value.__qualname__, value._fields, inspect.get_annotations(value))
        else:
            raise TypeError(name, value)

    put(sorted(OPTIONS.items()))
    try:
        put(function.__name__)
        # The empty name leaves out the options of the function itself, which do not matter.
        add("", function, set())
    except TypeError:
        return None
    return digest.hexdigest()[:16]


def _is_library_type(value: Any) -> bool:
    """Whether this is one of numba's types, or of LLVM's."""
    return type(value).__module__.startswith(("numba.core.types", "llvmlite.ir.types"))


def rebound(function: Any, bindings: dict[str, Any], cells: tuple[CellType, ...] | None = None) -> Any:
    """A copy of a function with some globals bound to other values, and with the closure `cells` or its own."""
    scope = {**function.__globals__, **bindings}
    closure = cells or function.__closure__
    copy = FunctionType(function.__code__, scope, function.__name__, function.__defaults__, closure)
    copy.__module__, copy.__annotations__ = function.__module__, function.__annotations__
    return copy


def compile_entry(
    function: Callable[..., Any], signature: str, what: str = "", bindings: dict[str, Any] | None = None
) -> Entry:
    """Compiles a function to machine code, which checks neither dtype nor contiguity of its arrays.

    Args:
        function: a plain function that allocates no memory, and returns None or an integer.
        signature: its types in numba's notation; arrays are C-contiguous.
        what: description in the message on stderr if the function has to be compiled; empty for no message.
        bindings: globals with other values. A function among these is plain or compiled; it and its compiled helpers
            are compiled anew with OPTIONS.

    Raises:
        TypeError: if numba cannot compile it.
    """
    name, own = function.__name__, bindings or {}
    digest, target = fingerprint(rebound(function, own)), objects.host_target()
    if digest is None:
        return objects.load(_compile(function, signature, own, [target])[0], name)
    # NUMBA_BOUNDSCHECK is part of the key, so that code without bounds checks is not used if they are switched on.
    parts = (digest, signature, _compiler_digest(), os.environ.get("NUMBA_BOUNDSCHECK"))
    key = f"{name}-{hashlib.sha256(repr(parts).encode()).hexdigest()[:16]}"
    if key not in _loaded:
        kept = _cache_folder() / f"{key}.{target.name}.o"
        content = read_checked(SHIPPED / kept.name) or read_checked(kept)
        if content is None:
            with locked(kept.with_suffix(".lock")):
                # Another process may have compiled it in the meantime.
                content = read_checked(kept)
                if content is None:
                    if what:
                        text = f"compiling {what}; this takes some seconds, once: the result is kept on disk"
                        print(f"capsule_gym: {text}", file=sys.stderr)
                    content, *others = _compile(function, signature, own, [target, *shipping])
                    write_checked(kept, content)
                    for kind, other in zip(shipping, others, strict=True):
                        write_checked(SHIPPED / f"{key}.{kind.name}.o", other)
        _loaded[key] = objects.load(content, name)
    return _loaded[key]


_loaded: dict[str, Entry] = {}


@cache
def cached_entry(function: Callable[..., Any], signature: str, what: str = "") -> Entry:
    """`compile_entry` of a module-level function, cached in the process."""
    return compile_entry(function, signature, what)


def _compile(
    function: Callable[..., Any], signature: str, bindings: dict[str, Any], targets: list[Target]
) -> list[bytes]:
    # numba takes most of a second to import.
    from capsule_gym.compiler import compile_objects

    return compile_objects(function, signature, bindings, targets)


def read_checked(file: Path) -> bytes | None:
    """The content of a file from `write_checked`, or None if it is missing or damaged: damaged code must not run."""
    try:
        content = file.read_bytes()
    except OSError:
        return None
    digest, payload = content[:_DIGEST_SIZE], content[_DIGEST_SIZE:]
    return payload if hashlib.sha256(payload).digest() == digest else None


def write_checked(file: Path, content: bytes) -> None:
    """Writes a file for `read_checked`; errors of the system are ignored."""
    with suppress(OSError):
        write_atomically(file, hashlib.sha256(content).digest() + content)


@cache
def _compiler_digest() -> str:
    """A hash of the modules that turn a function into machine code."""
    texts = [Path(__file__).with_name(name).read_bytes() for name in ("compiler.py", "objects.py")]
    return hashlib.sha256(b"".join(texts)).hexdigest()


def _cache_folder() -> Path:
    """The folder of cached machine code: NUMBA_CACHE_DIR, `__pycache__` of the package, or the user's cache."""
    beside = Path(__file__).with_name("__pycache__")
    if folder := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(folder) / "capsule_gym"
    with suppress(OSError):
        beside.mkdir(exist_ok=True)
        if os.access(beside, os.W_OK):
            return beside
    home = os.environ.get("LOCALAPPDATA") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "capsule_gym"


@contextmanager
def locked(file: Path) -> Iterator[None]:
    """Holds a lock, so that only one of several processes compiles; there is no lock if no file can be written."""
    lock = FileLock(file)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except OSError:
        pass
    try:
        yield
    finally:
        lock.release()
