import json

from agents.comparison import compare
from agents.training.loop import begin, train
from tests.agents.training.small import small


def test_comparison_is_printed_and_drawn(tmp_path, capsys, monkeypatch):
    run = tmp_path / "run"
    config = small("residual", "ppo", total_steps=256)
    begin(run, config)
    train(run, config)
    set_file = tmp_path / "two.json"
    plants = [{"M": 0.5, "mu": 0.01, "seed": 0, "changes": []}, {"M": 0.52, "mu": 0.01, "seed": 1, "changes": []}]
    set_file.write_text(json.dumps({"name": "two", "plants": plants}))
    monkeypatch.setattr("agents.comparison.ANIMATION_SECONDS", 0.08)
    monkeypatch.setattr("agents.comparison.ANIMATION_START", 0.04)
    monkeypatch.setattr("agents.report.page.LIVE", tmp_path / "live.html")
    (tmp_path / "live.html").write_text("<head></head>")
    compare(run, str(set_file))
    out = capsys.readouterr().out
    for word in ("mean speed", "cost of transport", "peak torque", "backward", "failures", "difference", "adaptive"):
        assert word in out
    for name in ("comparison.png", "animation.gif", "comparison.json", "report.html"):
        assert (run / name).stat().st_size > 1000
    assert not list(run.glob("*.tmp*"))
