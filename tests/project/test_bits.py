"""The bits of whole episodes at each level of instructions, and with other libraries of elementary functions.

`make bits-check` compares one training seed of each policy; `make bits` compares all seeds at every level.
"""

from __future__ import annotations

import pytest

from tests import bits

# The physics, a law, the network and the rollout.
SUBJECTS = ("plant", "plant anisotropic", "law adaptive", "policy direct-ppo/seed-0", "policy residual-ppo/seed-0")


def test_bits_are_the_committed_ones(capsys) -> None:
    assert bits.main(["--only", *SUBJECTS]) == 0, capsys.readouterr().out


LIBRARIES = {name: value for variables in bits.libraries().values() for name, value in variables.items()}


# Without fused instructions, a law takes a minute.
@pytest.mark.parametrize(
    ("variables", "subject"),
    [*((level, SUBJECTS[-2]) for level in bits.levels().values()), (LIBRARIES, SUBJECTS[-1])],
    ids=str,
)
def test_bits_do_not_depend_on_the_processor_or_on_libraries(variables: dict[str, str], subject: str) -> None:
    done = bits.run(variables, "plant", subject)
    assert done.returncode == 0, done.stdout + done.stderr


def test_wrong_and_missing_hashes_are_found(capsys, monkeypatch, tmp_path) -> None:
    (tmp_path / "bits.json").write_text('{"plant": "0", "law lost": "1"}', encoding="utf-8")
    monkeypatch.setattr(bits, "FILE", tmp_path / "bits.json")
    some = [subject for subject in bits.subjects() if subject.name in ("plant", "law adaptive")]
    monkeypatch.setattr(bits, "subjects", lambda: some)
    monkeypatch.setattr(bits, "compute", lambda subject: ("here", []))
    assert bits.main([]) == 1
    out = capsys.readouterr().out
    assert "law lost: unknown subject" in out
    assert "plant: here here, 0 committed" in out and "law adaptive: here here, None committed" in out
