"""What other processes may do to a batch and to the disk cache: fork, and leave files half written."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numba
import numpy as np
import pytest

from capsule_gym import CapsuleVectorEnv
from capsule_gym.compilation import compile_cached, compile_now

HANG_SECONDS = 60.0
ACTIONS = np.full((130, 1), 0.5, np.float32)


def rollout(env: CapsuleVectorEnv) -> str:
    digest = hashlib.sha256()
    for _ in range(20):
        observations, rewards, *_ = env.step(ACTIONS)
        digest.update(observations.tobytes() + rewards.tobytes())
    return digest.hexdigest()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_steps_on():
    env = CapsuleVectorEnv(130, threads=2)
    env.reset(seed=0)
    env.step(ACTIONS)
    read, write = os.pipe()
    with warnings.catch_warnings():
        # Python 3.12 on: other threads may hold locks; ours are idle.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        os.write(write, rollout(env).encode())
        env.close()
        os.write(write, b" closed")
        os._exit(0)
    deadline = time.monotonic() + HANG_SECONDS
    while os.waitpid(child, os.WNOHANG) == (0, 0):
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            pytest.fail("the forked process hangs")
        time.sleep(0.01)
    assert os.read(read, 100).decode() == f"{rollout(env)} closed"
    os.close(read)
    os.close(write)
    env.close()


def shifted(x: float) -> float:
    return x + 0.125


SIGNATURE = (numba.float64,)


def compiled() -> tuple[float, bool]:
    """The function's value at 1, and whether it came from the disk."""
    function = compile_cached(shifted)
    compile_now(function, SIGNATURE, "a function")
    return function(1.0), bool(function.stats.cache_hits)


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[-100] ^= 1
    path.write_bytes(content)


def occupy(path: Path) -> None:
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize("damage", [truncate, flip, occupy])
def test_a_damaged_cache_is_compiled_again(tmp_path, monkeypatch, capsys, damage):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert compiled() == (1.125, False)
    assert compiled() == (1.125, True)
    (entry,) = tmp_path.rglob("*.nbc")
    damage(entry)
    assert compiled() == (1.125, False)
    # Mended, where it could be.
    assert compiled() == (1.125, damage is not occupy)
    assert capsys.readouterr().err.count("compiling") == (3 if damage is occupy else 2)


def test_where_no_cache_can_be_written_to_everything_is_compiled(tmp_path):
    nowhere = tmp_path / "file"
    nowhere.write_text("")
    code = (
        "from numba.core import caching\n"
        "caching.InTreeCacheLocator.from_function = classmethod(lambda *_: None)\n"
        "from tests.capsule_gym.test_processes import compiled\n"
        "print(compiled())"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(nowhere), "HOME": str(nowhere), "XDG_CACHE_HOME": str(nowhere)}
    result = subprocess.run(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parents[2],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.stdout == "(1.125, False)\n", result.stderr
