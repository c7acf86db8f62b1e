"""The core as WebAssembly: the fused multiply-add, which WebAssembly lacks, and the bytes of the
module."""

import ctypes.util
import itertools
import json
import math
import os
import shutil
import subprocess

import numpy as np
import pytest

from web import build

SOURCE = """
#define LEVEL web
#include "numbers/number.hpp"
extern "C" __attribute__((export_name("fma"))) double fused(double a, double b, double c) { return web::fma(a, b, c); }
"""
SCRIPT = """
import { readFileSync } from "node:fs";
const [module, triples] = process.argv.slice(1).map((path) => readFileSync(path));
const { instance } = await WebAssembly.instantiate(module);
const given = new Float64Array(triples.buffer.slice(triples.byteOffset, triples.byteOffset + triples.length));
const found = new Float64Array(given.length / 3).map((_, n) => instance.exports.fma(...given.slice(3 * n, 3 * n + 3)));
console.log(JSON.stringify(Buffer.from(found.buffer).toString("hex")));
"""


def fused(folder, triples):
    """The multiply-adds of triples, computed by node."""
    if shutil.which("node") is None and "CI" not in os.environ:
        pytest.skip("needs node")
    (folder / "fma.cpp").write_text(SOURCE, encoding="utf-8")
    (folder / "fma.wasm").write_bytes(build.compile_wasm(folder / "fma.cpp"))
    (folder / "triples").write_bytes(triples.tobytes())
    command = [
        "node",
        "--input-type=module",
        "--eval",
        SCRIPT,
        str(folder / "fma.wasm"),
        str(folder / "triples"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return np.array(np.frombuffer(bytes.fromhex(json.loads(done.stdout))))


def draw_triples():
    """Zeros, infinities; ordinary numbers; sums that cancel, or lie halfway between two numbers;
    any size."""
    rng, count = np.random.default_rng(3), 4000

    def sized(low, high, places=52):
        fraction = 1.0 + np.floor(rng.random(count) * 2.0**places) / 2.0**places
        return rng.choice([-1.0, 1.0], count) * fraction * 2.0 ** rng.integers(low, high, count)

    a, b, near = sized(-3, 4), sized(-3, 4), 1.0 + rng.integers(-3, 4, count) * 2.0**-52
    ordinary, cancel = (a, b, sized(-110, 111)), (a, b, -a * b * near)
    # With few digits a sum often lies halfway between two numbers.
    halves = (sized(-3, 4, 3), np.abs(near), sized(-60, 60, 3))
    any_size = (sized(-1000, 500), sized(-500, 500), sized(-1074, 1000))
    special = itertools.product(
        (0.0, -0.0, 1.5, -1.5, 2.0**-400, 2.0**400, math.inf, -math.inf), repeat=3
    )
    return np.hstack([ordinary, cancel, halves, any_size, np.array([*special]).T]).T.copy()


def test_products_and_sums_are_rounded_once(tmp_path):
    exact, triples = ctypes.CDLL(ctypes.util.find_library("m")).fma, draw_triples()
    exact.restype, exact.argtypes = ctypes.c_double, [ctypes.c_double] * 3
    expected, found = (
        np.array([exact(*triple) for triple in triples.tolist()]),
        fused(tmp_path, triples),
    )
    assert (np.isnan(expected) == np.isnan(found)).all() and np.isnan(found).any()
    expected[np.isnan(expected)] = found[np.isnan(found)] = 0.0
    assert triples[found.view(np.uint64) != expected.view(np.uint64)].tolist() == []


def test_another_folder_and_cache_give_the_same_bytes(tmp_path, monkeypatch):
    first = build.compile_wasm()
    shutil.copytree(build.CORE, tmp_path / "core")
    for name in ("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    monkeypatch.chdir(tmp_path)
    source = tmp_path / "core" / "bindings" / "web.cpp"
    assert build.compile_wasm(source) == first and first.startswith(b"\0asm\1\0\0\0")
