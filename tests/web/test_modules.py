"""Parts of the live page's build: WebAssembly modules, the fused multiply-add out of integers, one HTML file."""

from __future__ import annotations

import itertools
import math
import re
import sys
from fractions import Fraction

import numpy as np
import pytest

from web import assembly, build, modules
from web.fused import fused

# --- WebAssembly -----------------------------------------------------------------------------------------------------


def test_a_module_is_the_same_bytes_again_and_for_another_processor(monkeypatch) -> None:
    first = modules.build([modules.COMMON])[modules.COMMON]
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    monkeypatch.setenv("NUMBA_CPU_FEATURES", "")
    again = modules.build([modules.COMMON], cache=None)[modules.COMMON]
    assert again == first and first.startswith(b"\0asm\1\0\0\0")


def test_numbas_optimiser_must_be_off() -> None:
    with pytest.raises(RuntimeError, match="NUMBA_OPT must be 0, got"):
        assembly.optimise([])


# --- fused multiply-add ----------------------------------------------------------------------------------------------

SPECIAL = (
    *(0.0, 1.0, 0.5, 1.5, 3.0, 1.0 + 2.0**-52, 1.0 - 2.0**-53, 5e-324, 3e-320, 2.0**-537, 2.0**-538, math.inf),
    *(sys.float_info.min, sys.float_info.min * (1.0 - 2.0**-52), 2.0**511, 2.0**512, sys.float_info.max),
)


def exact(a: float, b: float, c: float) -> float:
    """a b + c rounded once, by fractions."""
    if not (math.isfinite(a) and math.isfinite(b)):
        return a * b + c
    if not math.isfinite(c):
        return c
    value = Fraction(a) * Fraction(b) + Fraction(c)
    if value == 0:
        # IEEE defines the sign of a sum of zeros; where numbers cancel it is plus.
        return a * b + c if 0.0 in (a, b) else 0.0
    try:
        rounded = float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf
    return rounded if rounded else math.copysign(0.0, value)


def triples(case: str) -> np.ndarray:
    """Triples of a kind, one per column."""
    rng, count = np.random.default_rng(3), 4000

    def sized(low: int, high: int) -> np.ndarray:
        return rng.choice([-1.0, 1.0], count) * (1.0 + rng.random(count)) * 2.0 ** rng.integers(low, high, count)

    if case == "special":
        values = [sign * value for value in SPECIAL for sign in (1.0, -1.0)] + [math.nan]
        return np.array(list(itertools.product(values, repeat=3))).T
    if case == "any bits":
        return rng.integers(0, 2**64, (3, count), dtype=np.uint64).view(np.float64)
    if case == "subnormal":
        return np.array((sized(-545, -500), sized(-545, -500), sized(-1074, -1010)))
    if case == "huge":
        return np.array((sized(500, 520), sized(500, 520), sized(1000, 1023)))
    a, b = sized(-3, 4), sized(-3, 4)
    return np.array(
        (a, b, -a * b * (1.0 + rng.integers(-3, 4, count) * 2.0**-52) if case == "cancel" else sized(-110, 111))
    )


@pytest.mark.parametrize("case", ["any bits", "ordinary", "cancel", "subnormal", "huge", "special"])
def test_products_and_sums_are_rounded_once(case: str) -> None:
    found = np.array([(fused(*triple), exact(*triple)) for triple in triples(case).T.tolist()])
    same = (found[:, 0].view(np.uint64) == found[:, 1].view(np.uint64)) | np.isnan(found).all(axis=1)
    assert same.all()


# --- one HTML file ---------------------------------------------------------------------------------------------------


def test_modules_follow_what_they_import(tmp_path, monkeypatch) -> None:
    page = tmp_path
    monkeypatch.setattr(build, "PAGE", page)
    (page / "index.html").write_text("<style>/* style */</style><script>/* script */</script>", encoding="utf-8")
    (page / "page.css").write_text("body { color: var(--ink); }", encoding="utf-8")
    (page / "page.js").write_text('import { a } from "./a.js";\nimport { b as c } from "./b.js";\n', "utf-8")
    (page / "a.js").write_text('import { b } from "./b.js";\nexport const a = b;\n', "utf-8")
    (page / "b.js").write_text(
        'import { figure } from "./figure.js";\nimport { drive } from "./capsule.mjs";\nexport async function b() {}\n',
        "utf-8",
    )
    built = build.build_page("export function drive() {}\n")
    order = re.findall(r'^modules\["(.*?)"\] =', built, re.MULTILINE)
    assert order == ["figure.js", "capsule.mjs", "b.js", "a.js", "page.js"]
    assert 'const { b: c } = modules["b.js"];' in built and "return { b };" in built
    assert "import" not in built and "export" not in built
    assert "--ink: #1e293b;" in built and '"ROD": 168.0' in built
