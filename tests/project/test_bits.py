"""The bits of whole episodes on this processor, on a lesser one, and with other libraries of elementary functions."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

from tests import bits

# Two kernels, the network and the compiled rollout, which is what there is time for: `python -m tests.bits --variants`
# takes everything to all processors.
SUBJECTS = ("plant", "law adaptive", "policy residual-ppo/seed-0")
SAMPLE = """
import hashlib, math, numpy as np
x = np.linspace(0.1, 9.0, 10_000)
for values in (np.exp(x), np.array([math.sin(value) for value in x])):
    print(hashlib.sha256(values.tobytes()).hexdigest())
"""


def test_bits_are_the_committed_ones(capsys):
    assert bits.main([]) == 0, capsys.readouterr().out


def test_bits_do_not_depend_on_the_processor():
    if "generic" not in bits.processors():
        pytest.skip("the names of processors are those of x86")
    done = bits.run(bits.processors()["generic"], *SUBJECTS)
    assert done.returncode == 0, done.stdout + done.stderr


def both_libraries() -> dict[str, str]:
    """The environment variables of all of them together."""
    return {name: value for variables in bits.libraries().values() for name, value in variables.items()}


def test_bits_do_not_depend_on_the_libraries_of_elementary_functions():
    done = bits.run(both_libraries())
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc" or not {"fma", "avx2"} <= bits.own_features(),
    reason="elsewhere the C library has nothing to choose from",
)
def test_those_libraries_do_compute_something_else():
    own, other = (
        subprocess.run(
            [sys.executable, "-c", SAMPLE], env={**os.environ, **variables}, capture_output=True, text=True, check=True
        ).stdout.split()
        for variables in ({}, both_libraries())
    )
    assert len(own) == 2
    assert own[0] != other[0], "numpy's exponential"
    assert own[1] != other[1], "the C library's sine"


def test_a_subject_that_has_no_hash_and_a_hash_without_subject_count(capsys, monkeypatch, tmp_path):
    (tmp_path / "bits.json").write_text('{"plant": "0", "law lost": "1"}', encoding="utf-8")
    monkeypatch.setattr(bits, "FILE", tmp_path / "bits.json")
    some = [subject for subject in bits.subjects() if subject.name in ("plant", "law epc")]
    monkeypatch.setattr(bits, "subjects", lambda: some)
    assert bits.main([]) == 1
    out = capsys.readouterr().out
    assert "law lost: is no subject" in out
    assert "plant: " in out and "here, 0 committed" in out
    assert "law epc: " in out and "here, None committed" in out
