"""Compiles a plain function with numba and LLVM to object files for several kinds of processors.

This module is imported only if something has to be compiled. numba generates LLVM's intermediate code without vectors,
for all processors. A pass for each target then vectorises it without changing a bit of the results.
"""

from __future__ import annotations

import hashlib
import pickle
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from functools import cache
from pathlib import Path
from types import CellType
from typing import Any
from uuid import uuid4

import llvmlite.binding as llvm
import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils, config
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.serialize import dumps
from numba.core.typing.templates import infer, infer_global, make_intrinsic_template
from numba.extending import register_jitable
from numba.np.arrayobj import populate_array

from capsule_gym import compilation, objects
from capsule_gym.checks import first_cause
from capsule_gym.compilation import NO_WRAPPERS, OPTIONS, fingerprint, locked, read_checked, rebound, write_checked
from capsule_gym.objects import Target

# Offsets of an object's type in CPython, and of an array's data, number of dimensions and shape in numpy.
_TYPE, _DATA, _NDIM, _SHAPE = 8, 16, 24, 32

_POINTER, _WORD, _INT, _DOUBLE = ir.IntType(8).as_pointer(), ir.IntType(64), ir.IntType(32), ir.DoubleType()

_registered: set[Callable[..., Any]] = set()


def register() -> None:
    """Registers the functions marked by `capsule_gym.compilation`; numba calls this at its first compilation, too."""
    for function, options in list(compilation.marked.items()):
        if function not in _registered:
            _registered.add(function)
            register_jitable(**options)(function)
    for function, (define, prefer_literal) in list(compilation.generated.items()):
        if function not in _registered:
            _registered.add(function)
            name = function.__name__
            template = make_intrinsic_template(function, define, name, prefer_literal=prefer_literal, kwargs={})
            infer(template)
            infer_global(function, types.Function(template))


compilation.listeners.append(register)


def _inlined(function: Callable[..., Any], options: dict[str, Any], outer: tuple[Any, ...] = ()) -> Any:
    """Compiles a function, plain or compiled, and the compiled helpers that it refers to, with OPTIONS."""

    def renewed(value: Any) -> Any:
        if not isinstance(value, CPUDispatcher) or value in outer:
            return value
        return _inlined(value, value.targetoptions, (*outer, value))

    source = getattr(function, "py_func", function)
    scope = source.__globals__
    names = {name: renewed(scope[name]) for name in source.__code__.co_names if name in scope}
    cells = tuple(CellType(renewed(cell.cell_contents)) for cell in source.__closure__ or ())
    return numba.jit(rebound(source, names, cells or None), **{**options, **OPTIONS, **NO_WRAPPERS})


class _Library(JITCodeLibrary):
    """A library of numba that holds intermediate code only, which saves a quarter of numba's time."""

    def _finalize_final_module(self) -> None:
        self._finalized = True


def _unexecutable(library: Any, fndesc: Any, env: Any) -> Callable[..., Any]:
    """A built-in method in place of the entry for Python; numba distinguishes functions by it."""
    library.finalize()
    return object().__reduce__


@contextmanager
def _scalar() -> Iterator[None]:
    """Makes numba simplify the code for any processor, and leave vectors and machine code to `_emit`.

    Without numba's optimiser LLVM would read ten times the text.
    """
    chosen = {"OPT": type(config.OPT)(min(config.OPT, 1)), "LOOP_VECTORIZE": 0, "SLP_VECTORIZE": 0}
    before = {name: getattr(config, name) for name in chosen}
    context = cpu_target.target_context
    codegen = context.codegen()
    machine = codegen._tm
    try:
        vars(config).update(chosen)
        codegen._tm, codegen._library_class = objects.target_machine(Target("any", "generic", "")), _Library
        context.get_executable = _unexecutable
        yield
    finally:
        vars(config).update(before)
        codegen._tm = machine
        del codegen._library_class, context.get_executable


def lower(function: Callable[..., Any], signature: Any, bindings: dict[str, Any]) -> tuple[Any, Any]:
    """LLVM's intermediate code of a function: the module, and numba's result, which names the function in it.

    The arguments are those of `compilation.compile_entry`.

    Raises:
        TypeError: if numba cannot compile the function, or the function creates arrays or lists.
    """
    register()
    own = {name: _inlined(v, {"forceinline": True}) if callable(v) else v for name, v in bindings.items()}
    source = rebound(function, own)
    # numba's exceptions contain the path of the source, which differs between builds.
    source.__code__ = source.__code__.replace(co_filename=Path(source.__code__.co_filename).name)
    # The functions compiled here own no memory: reference counts are left out.
    dispatcher = numba.njit(source, _nrt=False, **OPTIONS, **NO_WRAPPERS)
    try:
        with _scalar():
            dispatcher.compile(signature)
    except Exception as error:
        # numba also raises exceptions of other classes than its own.
        raise TypeError(f"numba cannot compile it: {first_cause(error)}") from error
    result = next(iter(dispatcher.overloads.values()))
    # Removes the attributes of this processor.
    text = re.sub(r' "target-(cpu|features)"="[^"]*"', "", result.library.get_llvm_str())
    return llvm.parse_assembly(text), result


def compile_objects(
    function: Callable[..., Any], signature: str, bindings: dict[str, Any], targets: Sequence[Target]
) -> list[bytes]:
    """Object files of a function, one for each target, as `objects.load` takes them.

    The arguments are those of `compilation.compile_entry`.

    Raises:
        TypeError: if numba cannot compile it.
    """
    module, result = lower(function, signature, bindings)
    module.link_in(llvm.parse_assembly(str(_python_function(result))))
    module.get_function(result.fndesc.llvm_func_name).name = objects.FUNCTION
    exported = (objects.FUNCTION, objects.PYTHON_FUNCTION)
    # Names of numba contain counters of the process.
    for kind, values in (("f", module.functions), ("g", module.global_variables)):
        for n, value in enumerate(values):
            if not value.is_declaration and value.name not in exported:
                value.linkage = "internal"
                value.name = f"{kind}{n}"
    # A function that requests the attribute loses it if it is inlined, so all functions get it.
    text = re.sub(r"^(define .*) \{$", rf"\1 {objects.WIDEST_VECTORS} {{", str(module), flags=re.MULTILINE)
    return [_emit(text, target) for target in targets]


def _emit(text: str, target: Target) -> bytes:
    if objects.INTERLEAVED in text and not target.wide:
        # LLVM reads this on branches that close a loop; it has no effect on other branches.
        text = re.sub(r"^(  br i1 .*)$", r"\1, !llvm.loop !9998", text, flags=re.MULTILINE)
        text += '\n!9998 = distinct !{!9998, !9999}\n!9999 = !{!"llvm.loop.interleave.count", i32 2}\n'
    machine = objects.target_machine(target)
    module = llvm.parse_assembly(text)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization, options.slp_vectorization = True, False
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    content: bytes = machine.emit_object(module)
    return content


def _python_function(result: Any) -> ir.Module:
    """A module with the function that Python calls (METH_FASTCALL), a wrapper of numba's compiled function."""
    context, kinds, returned = cpu_target.target_context, result.signature.args, result.signature.return_type
    module = ir.Module()
    convention = context.call_conv
    compiled = ir.Function(module, convention.get_function_type(returned, kinds), result.fndesc.llvm_func_name)
    function = ir.Function(
        module, ir.FunctionType(_POINTER, [_POINTER, _POINTER.as_pointer(), _WORD]), objects.PYTHON_FUNCTION
    )
    itself, given, count = function.args
    builder = ir.IRBuilder(function.append_basic_block())

    def call(name: str, kind: Any, *arguments: Any) -> Any:
        signature = ir.FunctionType(kind, [value.type for value in arguments])
        return builder.call(cgutils.get_or_insert_function(module, signature, name), arguments)

    def field(value: Any, offset: int, kind: Any) -> Any:
        return builder.load(builder.bitcast(builder.gep(value, [_WORD(offset)]), kind.as_pointer()))

    def constant(n: int) -> Any:
        """The entry n of the table that `objects.load` fills."""
        return call("PyTuple_GetItem", _POINTER, itself, _WORD(n))

    def fail(condition: Any, n: int) -> None:
        with cgutils.if_unlikely(builder, condition):
            call("PyErr_SetObject", ir.VoidType(), constant(n), constant(n + 1))
            builder.ret(_POINTER(None))

    array_type, arguments = constant(0), []
    fail(builder.icmp_unsigned("!=", count, _WORD(len(kinds))), 1)
    for n, kind in enumerate(kinds):
        value = builder.load(builder.gep(given, [_WORD(n)]))
        if isinstance(kind, types.Array):
            fail(builder.icmp_unsigned("!=", field(value, _TYPE, _POINTER), array_type), 1)
            fail(builder.icmp_unsigned("!=", field(value, _NDIM, _INT), _INT(kind.ndim)), 1)
            sizes = field(value, _SHAPE, _WORD.as_pointer())
            shape = [builder.load(builder.gep(sizes, [_WORD(axis)])) for axis in range(kind.ndim)]
            itemsize = kind.dtype.bitwidth // 8
            strides = [_WORD(itemsize)]
            for size in shape[:0:-1]:
                strides.insert(0, builder.mul(strides[0], size))
            array = context.make_array(kind)(context, builder)
            data = field(value, _DATA, array.data.type)
            populate_array(array, data, shape, strides, itemsize, None)
            arguments.append(array._getvalue())
        elif isinstance(kind, types.Float):
            arguments.append(call("PyFloat_AsDouble", _DOUBLE, value))
        else:
            number = call("PyLong_AsLongLong", _WORD, value)
            arguments.append(number if kind == types.int64 else builder.icmp_unsigned("!=", number, _WORD(0)))
    fail(builder.icmp_unsigned("!=", call("PyErr_Occurred", _POINTER), _POINTER(None)), 1)
    thread = call("PyEval_SaveThread", _POINTER)
    status, value = convention.call_function(builder, compiled, returned, kinds, arguments)
    call("PyEval_RestoreThread", ir.VoidType(), thread)
    fail(status.is_error, 3)
    builder.ret(call("PyLong_FromLongLong", _POINTER, _WORD(0) if returned == types.none else value))
    return module


class Cache(FunctionCache):
    """numba's disk cache, for files that other processes may damage.

    numba does not check its files: a truncated index ends the program with an unpickling error, and machine code in
    which a bit has changed is run. numba also names the file of the code in the index only, so that two processes for
    different processors can choose the same name. Here each entry is a separate file. Its name contains the hash of
    everything that the code depends on, and it begins with the hash of its content. Code without a valid file is
    compiled again; if no file can be written, nothing is kept.
    """

    what = ""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function of a signature, or None."""
        target_context.refresh()
        # Code from another version may refer to a module that has been renamed.
        payload = read_checked(self._file(sig, target_context.codegen()))
        with suppress(ImportError, AttributeError):
            if payload is not None:
                return self._impl.rebuild(target_context, pickle.loads(payload))
        if self.what:
            text = f"compiling {self.what}; this takes some seconds, once: numba keeps the result on disk"
            print(f"capsule_gym: {text}", file=sys.stderr)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keeps a compiled function."""
        if self._impl.check_cachable(data):
            write_checked(self._file(sig, data.codegen), dumps(self._impl.reduce(data)))

    def _file(self, sig: Any, codegen: Any) -> Path:
        """The file of a signature's code for this processor and this version of numba and of the sources."""
        # BOUNDSCHECK is part of the key, so that code without bounds checks is not used if they are switched on.
        stamp = self._impl.locator.get_source_stamp()
        key = (self._index_key(sig, codegen), stamp, numba.__version__, numba.config.BOUNDSCHECK)
        digest = hashlib.sha256(repr(key).encode()).hexdigest()[:16]
        return Path(self.cache_path) / f"{self._impl.filename_base}.{digest}.nbc"


@cache
def compile_cached(function: Callable[..., Any]) -> Any:
    """Compiles a module-level function with numba; unlike numba's own disk cache, this one notices edits of callees.

    For functions that allocate memory or return arrays, which `compilation.compile_entry` does not take. The same
    function gives the same dispatcher.
    """
    return _dispatcher(function, "")


def compile_allocating(function: Callable[..., Any], signature: str, what: str) -> Any:
    """The Python entry of a function that allocates memory or returns several numbers; see `compile_entry`."""
    compiled = _dispatcher(function, what)
    folder = compiled.stats.cache_path
    with locked(Path(folder, f"{compiled.py_func.__name__}.lock")) if folder else nullcontext():
        compiled.compile(signature)
    return next(iter(compiled.overloads.values())).entry_point


def _dispatcher(function: Callable[..., Any], what: str) -> Any:
    register()
    digest = fingerprint(function)
    # The name distinguishes numba's files of different contents.
    bound = rebound(function, {})
    bound.__name__ = bound.__qualname__ = f"{function.__name__}_{digest or uuid4().hex}"
    dispatcher = numba.njit(bound, nogil=True, **OPTIONS)
    # numba finds no folder where neither NUMBA_CACHE_DIR, nor the package, nor the user's cache can be written to.
    with suppress(RuntimeError):
        if digest:
            dispatcher._cache = Cache(dispatcher.py_func)
            dispatcher._cache.what = what
    return dispatcher
