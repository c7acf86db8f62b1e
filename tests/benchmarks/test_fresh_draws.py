from dataclasses import replace

from benchmarks import fresh_draws


def test_means_on_new_plants_agree_with_the_table_and_not_with_another(monkeypatch, capsys):
    monkeypatch.setattr(fresh_draws, "PLANTS", 20)
    monkeypatch.setattr(fresh_draws, "MAIN_SETS", ("paper",))
    assert fresh_draws.main(["open-loop"]) == 0
    assert "0 of 1 means differ" in capsys.readouterr().out
    load_row = fresh_draws.load_row

    def slower(path):
        row = load_row(path)
        return replace(row, scores={name: scores - 1.0 for name, scores in row.scores.items()})

    monkeypatch.setattr(fresh_draws, "load_row", slower)
    assert fresh_draws.main(["open-loop"]) == 1
    assert "0/20  differs" in capsys.readouterr().out
