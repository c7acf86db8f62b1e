"""The modules come out the same bytes whatever the processor, and need nothing."""

from __future__ import annotations

import hashlib

import pytest

from web import assembly, modules


def test_a_module_is_the_same_bytes_again_and_for_another_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    first = modules.build([modules.COMMON])[modules.COMMON]
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    monkeypatch.setenv("NUMBA_CPU_FEATURES", "")
    again = modules.build([modules.COMMON], cache=None)[modules.COMMON]
    assert hashlib.sha256(again).hexdigest() == hashlib.sha256(first).hexdigest()
    assert again.startswith(b"\0asm\1\0\0\0")


def test_numbas_optimiser_must_be_off() -> None:
    with pytest.raises(RuntimeError, match="NUMBA_OPT must be 0, got"):
        assembly.assemble([])


def test_what_needs_a_library_is_refused() -> None:
    # A memory and one function; nothing else.
    def field(name: str) -> bytes:
        return bytes([len(name)]) + name.encode()

    imports = b"\2" + field("env") + field("memory") + b"\2\0\1" + field("env") + field("sin") + b"\0\0"
    built = b"\0asm\1\0\0\0" + bytes([assembly.IMPORT, len(imports)]) + imports
    with pytest.raises(RuntimeError, match=r"it lacks \['sin'\]"):
        assembly._module(built, {})
