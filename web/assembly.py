"""Compiles functions to a WebAssembly module: numba's intermediate code, LLVM's optimiser and backend, an export list.

The same versions of Python, numba and LLVM give the same bytes on every processor of an architecture: numba's optimiser
works for a generic one (`compiler.lower`), and loops stay scalar.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import llvmlite.binding as llvm
from numba import types

from capsule_gym.compiler import lower
from web.fused import fused

TRIPLE = "wasm32-unknown-unknown"
# Features that every engine supports since 2021.
FEATURES = "+bulk-memory,+mutable-globals,+nontrapping-fptoint,+sign-ext"
LLVM_TYPES = {types.float64: "double", types.int32: "i32", types.int64: "i64", types.uint64: "i64"}

# Replacements of functions in numba's runtime library, for positive, normal numbers.
RUNTIME = f"""
define double @numba_frexp(double %x, ptr %exponent) {{
  %bits = bitcast double %x to i64
  %biased = lshr i64 %bits, 52
  %narrow = trunc i64 %biased to i32
  %power = sub i32 %narrow, 1022
  store i32 %power, ptr %exponent
  %fraction = and i64 %bits, {2**52 - 1}
  %half = or i64 %fraction, {1022 << 52}
  %mantissa = bitcast i64 %half to double
  ret double %mantissa
}}
"""

# Length of a WebAssembly module's preamble in bytes, numbers of its sections, and the kind of an exported function.
PREAMBLE = 8
CUSTOM, EXPORT, DATA = 0, 7, 11
FUNCTION_KIND = 0
# In an object's section "linking": the number of the symbol table, and the flag of an imported symbol.
SYMBOL_TABLE, UNDEFINED = 8, 16


class Entry(NamedTuple):
    """A function that a module exports.

    Attributes:
        name: name of the export.
        function: an uncompiled function; it takes and returns numbers, and takes arrays as pointers.
        result: numba's type of the result.
        arguments: numba's types of the arguments.
    """

    name: str
    function: Callable[..., Any]
    result: Any
    arguments: tuple[Any, ...]


def optimise(entries: Sequence[Entry]) -> Any:
    """Compiles functions to an LLVM module, optimised for WebAssembly; all other functions in it are internal."""
    linked = _lower(Entry("fused", fused.py_func, types.float64, (types.float64,) * 3))
    linked.link_in(llvm.parse_assembly(RUNTIME))
    for entry in entries:
        linked.link_in(_lower(entry))
    machine = _machine()
    # WebAssembly lacks the instruction, so it becomes a call of `fused`, whose definition must not be declared again.
    text = str(linked).replace("declare double @llvm.fma.f64(", "declare double @unused(")
    module = llvm.parse_assembly(text.replace("@llvm.fma.f64(", "@fused("))
    module.triple, module.data_layout = TRIPLE, str(machine.target_data)
    _hide(module, [entry.name for entry in entries])
    # Loops are not vectorised.
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = options.slp_vectorization = False
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    return module


def assemble(module: Any, names: Sequence[str]) -> bytes:
    """The WebAssembly module that exports these functions; it imports memory, the stack pointer and undefined symbols.

    Raises:
        RuntimeError: if the functions need data.
    """
    _hide(module, names)
    built = _machine().emit_object(module)
    # Sections for linkers are removed. Without data, all indices in an object are final.
    sections = dict(pair for pair in _sections(built) if pair[0] != CUSTOM)
    if DATA in sections:
        raise RuntimeError("the functions must need no data")
    functions = _functions(built)
    listed = [_number(len(name)) + name.encode() + bytes([FUNCTION_KIND]) + _number(functions[name]) for name in names]
    sections[EXPORT] = _number(len(listed)) + b"".join(listed)
    parts = (bytes([number]) + _number(len(content)) + content for number, content in sorted(sections.items()))
    return built[:PREAMBLE] + b"".join(parts)


def _machine() -> Any:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    return llvm.Target.from_triple(TRIPLE).create_target_machine(features=FEATURES, opt=3)


def _hide(module: Any, names: Sequence[str]) -> None:
    """Makes all but these functions internal."""
    for symbol in (*module.functions, *module.global_variables):
        if not symbol.is_declaration:
            symbol.linkage = "external" if symbol.name in names else "internal"


def _lower(entry: Entry) -> Any:
    """The LLVM module of a function, with the entry's name and with plain arguments and result."""
    module, result = lower(entry.function, entry.result(*entry.arguments), {})
    kinds = [LLVM_TYPES.get(kind, "ptr") for kind in entry.arguments]
    given = ", ".join(f"{kind} %{n}" for n, kind in enumerate(kinds))
    kind, inner = LLVM_TYPES[entry.result], result.fndesc.llvm_func_name
    # numba's functions return a status (none of these raises an exception), and the result through a pointer. They are
    # not inlined, since inlining the multiply-add at each call would make the step many times as long.
    wrapper = (
        f'declare i32 @"{inner}"(ptr, ptr, {", ".join(kinds)})\n'
        f"define {kind} @{entry.name}({given}) noinline {{\n"
        f"  %room = alloca {kind}\n"
        f'  %status = call i32 @"{inner}"(ptr %room, ptr null, {given})\n'
        f"  %value = load {kind}, ptr %room\n"
        f"  ret {kind} %value\n}}\n"
    )
    module.link_in(llvm.parse_assembly(wrapper))
    return module


def _number(value: int) -> bytes:
    """Encodes an unsigned number for WebAssembly, with seven bits per byte."""
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def _read_number(content: bytes, at: int) -> tuple[int, int]:
    """Reads the number at a position; returns it and the position after it."""
    value = shift = 0
    while True:
        byte = content[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at


def _sections(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yields the numbers and contents of a module's sections."""
    at = PREAMBLE
    while at < len(content):
        size, start = _read_number(content, at + 1)
        yield content[at], content[start : start + size]
        at = start + size


def _functions(built: bytes) -> dict[str, int]:
    """The indices of an object's functions, from its symbol table (WebAssembly/tool-conventions, Linking.md)."""
    (content,) = (
        content for number, content in _sections(built) if number == CUSTOM and content.startswith(b"\x07linking")
    )
    _, at = _read_number(content, len(b"\x07linking"))
    while content[at] != SYMBOL_TABLE:
        size, start = _read_number(content, at + 1)
        at = start + size
    _, start = _read_number(content, at + 1)
    count, at = _read_number(content, start)
    functions = {}
    for _ in range(count):
        kind = content[at]
        flags, at = _read_number(content, at + 1)
        index, at = _read_number(content, at)
        # An import has no name.
        if flags & UNDEFINED:
            continue
        size, at = _read_number(content, at)
        name, at = content[at : at + size].decode(), at + size
        if kind == FUNCTION_KIND:
            functions[name] = index
    return functions
