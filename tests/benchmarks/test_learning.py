"""What settings learn: the comparison, its table and its going on."""

from __future__ import annotations

import json

import pytest

from benchmarks import learning

SMALL = {
    "num_envs": 8,
    "n_steps": 32,
    "batch_size": 64,
    "hidden": 8,
    "evaluation_episodes": 2,
    "evaluate_every": 10_000,
}


def test_settings_are_compared_and_a_comparison_goes_on(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(learning, "SETTINGS", {"tuned": SMALL})
    plants = [{"M": 0.5, "mu": 0.01, "seed": seed, "changes": []} for seed in range(2)]
    (tmp_path / "two.json").write_text(json.dumps({"name": "two", "plants": plants}))
    options = ["--settings", "adaptive", "tuned", "--steps", "512", "--set", str(tmp_path / "two.json")]
    options += ["--runs", str(tmp_path / "runs")]
    assert learning.main([*options, "--seeds", "0", "--json", str(tmp_path / "a.json")]) == 0
    first = (tmp_path / "runs" / "tuned-512-seed0" / "model.zip").stat().st_mtime_ns
    written = ["--json", str(tmp_path / "b.json"), "--markdown", str(tmp_path / "b.md")]
    assert learning.main([*options, "--seeds", "0", "1", *written]) == 0
    assert (tmp_path / "runs" / "tuned-512-seed0" / "model.zip").stat().st_mtime_ns == first
    content = json.loads((tmp_path / "b.json").read_text())
    assert content["settings"]["tuned"]["summary"]["training_seeds"] == [0, 1]
    assert [run["steps"] for run in content["settings"]["tuned"]["runs"]] == [512, 512]
    assert content["settings"]["tuned"]["runs"][0]["processor_seconds"] > 0.0
    line = next(line for line in (tmp_path / "b.md").read_text().splitlines() if line.startswith("| tuned "))
    assert line.split("|")[2].strip() == "2"
    assert "mean speed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--json", __file__], "--json"),
        (["--settings", "nobody"], "nobody"),
        (["--steps", "0.5"], "--steps"),
        (["--steps", "0"], "--steps"),
        (["--set", "nowhere"], "nowhere"),
    ],
)
def test_bad_options_are_named(arguments, message, capsys):
    with pytest.raises(SystemExit) as stop:
        learning.main(arguments)
    assert stop.value.code == 2
    assert message in capsys.readouterr().err
