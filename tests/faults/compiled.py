"""Compiled code whose cache is shared, damaged or read-only, and processes that fork."""

from __future__ import annotations

import random
import shutil
from collections.abc import Sequence
from pathlib import Path

from tests.faults.bench import Bench, Outcome
from tests.faults.processes import Child, fork, rollout


def same_bits(children: Sequence[Child], expected: str, outcome: Outcome) -> None:
    """Expects that processes print the hash of a batch."""
    for child in children:
        status, printed = child.end(), child.printed()
        outcome.expect(status == 0 and printed.splitlines()[-1:] == [expected], f"exit status {status}: {printed}")
        outcome.tried += 1


def at_once(bench: Bench, outcome: Outcome, tries: int) -> None:
    """Compiles for one empty cache in many processes at once, then reads what they have left."""
    _, expected = bench.compiled()
    cache = str(bench.new("cache"))
    same_bits([Child(bench.new("log"), rollout, cache) for _ in range(tries)], expected, outcome)
    reader = Child(bench.new("log"), rollout, cache)
    reader.end()
    outcome.expect(reader.printed() == f"{expected}\n", f"what they left cannot be read: {reader.printed()}")
    bench.tick(tries)


def damage(path: Path, how: str, rng: random.Random) -> None:
    """Damages a file."""
    content = bytearray(path.read_bytes())
    if how == "truncated":
        del content[rng.randrange(len(content)) :]
    elif how == "garbled":
        content[:] = rng.randbytes(len(content))
    else:
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path.write_bytes(content)


def damaged_cache(bench: Bench, outcome: Outcome, tries: int, how: str) -> None:
    """Runs a batch from a damaged cache, which is mended by that, and damaged again."""
    cache, expected = bench.compiled()
    for _ in range(tries):
        for path in cache.rglob("*.nb?"):
            damage(path, how, bench.rng)
        same_bits([Child(bench.new("log"), rollout, str(cache))], expected, outcome)
        bench.tick()


def emptied_cache(bench: Bench, outcome: Outcome, tries: int) -> None:
    """Removes the cache while a process compiles for it."""
    _, expected = bench.compiled()
    for _ in range(tries):
        cache = bench.new("cache")
        child = Child(bench.new("log"), rollout, str(cache))
        child.wait(cache.exists)
        child.wait(seconds=bench.rng.uniform(0.0, 5.0))
        shutil.rmtree(cache, ignore_errors=True)
        same_bits([child], expected, outcome)
        bench.tick()


def read_only_cache(bench: Bench, outcome: Outcome, tries: int) -> None:
    """Runs a batch where the cache may not be written to."""
    _, expected = bench.compiled()
    for _ in range(tries):
        cache = bench.new("cache")
        cache.mkdir()
        with bench.read_only(cache):
            same_bits([Child(bench.new("log"), rollout, str(cache))], expected, outcome)
        bench.tick()


def forks(bench: Bench, outcome: Outcome, tries: int) -> None:
    """Forks processes whose threads have run."""
    for _ in range(tries):
        child = Child(bench.new("log"), fork)
        status, printed = child.end(), child.printed().split()
        right = status == 0 and len(printed) == 2 and len(set(printed)) == 1
        outcome.expect(right, f"exit status {status}: {child.printed()}")
        outcome.tried += 1
        bench.tick()
