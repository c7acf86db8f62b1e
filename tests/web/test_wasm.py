"""The core as WebAssembly: the fused multiply-add, which it lacks, and the module's bytes."""

import ctypes.util
import itertools
import math
import shutil

import numpy as np
import pytest

from web import build

SOURCE = """
#define LEVEL web
#include "numbers/number.hpp"
extern "C" __attribute__((export_name("fma"))) double fused(double a, double b, double c) {
  return web::fma(a, b, c);
}
"""
SCRIPT = """
import { readFileSync } from "node:fs";
const [module, file] = process.argv.slice(1).map((path) => readFileSync(path));
const { instance } = await WebAssembly.instantiate(module);
const triples = new Float64Array(Uint8Array.from(file).buffer);
const found = new Float64Array(triples.length / 3);
for (let n = 0; n < found.length; n++)
  found[n] = instance.exports.fma(...triples.subarray(3 * n, 3 * n + 3));
console.log(JSON.stringify(Buffer.from(found.buffer).toString("hex")));
"""
COUNT = 4000
SPECIAL = (0.0, -0.0, 1.5, -1.5, 2.0**-400, 2.0**400, math.inf, -math.inf)


def draw_sized(rng, low, high, places=52):
    """Numbers of any sign from 2^low to 2^high with this many binary places."""
    steps = 2.0**places
    fraction = 1.0 + np.floor(rng.random(COUNT) * steps) / steps
    sign = rng.choice([-1.0, 1.0], COUNT)
    return sign * fraction * 2.0 ** rng.integers(low, high, COUNT)


def draw_triples():
    """Factors and summands, shape (count, 3)."""
    rng = np.random.default_rng(3)
    a = draw_sized(rng, -3, 4)
    b = draw_sized(rng, -3, 4)
    near_one = 1.0 + rng.integers(-3, 4, COUNT) * 2.0**-52
    ordinary = (a, b, draw_sized(rng, -110, 111))
    cancelling = (a, b, -a * b * near_one)
    # With few digits a sum often lies halfway between two numbers.
    halfway = (draw_sized(rng, -3, 4, 3), near_one, draw_sized(rng, -60, 60, 3))
    any_size = [draw_sized(rng, *size) for size in ((-1000, 500), (-500, 500), (-1074, 1000))]
    special = list(itertools.product(SPECIAL, repeat=3))
    return np.vstack([np.hstack([ordinary, cancelling, halfway, any_size]).T, special])


@pytest.fixture(scope="module")
def triples():
    return draw_triples()


@pytest.fixture(scope="module")
def found(run_node, tmp_path_factory, triples):
    """The multiply-adds of the triples, computed by node."""
    folder = tmp_path_factory.mktemp("fma")
    (folder / "fma.cpp").write_text(SOURCE, "utf-8")
    (folder / "fma.wasm").write_bytes(build.compile_wasm(folder / "fma.cpp"))
    (folder / "triples").write_bytes(triples.tobytes())
    bits = run_node(SCRIPT, folder / "fma.wasm", folder / "triples")
    return np.frombuffer(bytes.fromhex(bits))


@pytest.fixture(scope="module")
def expected(triples):
    """Those of the C library."""
    exact = ctypes.CDLL(ctypes.util.find_library("m")).fma
    exact.restype = ctypes.c_double
    exact.argtypes = [ctypes.c_double] * 3
    return np.array([exact(*triple) for triple in triples.tolist()])


def test_products_and_sums_are_rounded_once(triples, found, expected):
    # The bits of NaN are not defined.
    differing = (found.view(np.uint64) != expected.view(np.uint64)) & ~np.isnan(expected)
    assert triples[differing].tolist() == []


def test_infinities_give_the_same_nan(found, expected):
    assert np.isnan(found).any()
    assert (np.isnan(found) == np.isnan(expected)).all()


@pytest.fixture(scope="module")
def wasm():
    return build.compile_wasm()


def test_the_core_compiles_to_webassembly(wasm):
    assert wasm.startswith(b"\0asm\1\0\0\0")


def test_another_folder_and_cache_give_the_same_bytes(wasm, tmp_path, monkeypatch):
    for name in ("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    shutil.copytree(build.CORE, tmp_path / "core")
    monkeypatch.chdir(tmp_path)
    source = tmp_path / "core" / "bindings" / "web.cpp"
    assert build.compile_wasm(source) == wasm


def test_an_error_of_the_compiler_is_shown(tmp_path):
    source = tmp_path / "broken.cpp"
    source.write_text("int broken = nothing;")
    with pytest.raises(RuntimeError, match="undeclared identifier 'nothing'"):
        build.compile_wasm(source)
