import copy
import json

import pytest

from agents.evaluation import candidates
from agents.evaluation.candidates import all_candidates
from agents.evaluation.sets import parse_set
from agents.leaderboard import __main__ as leaderboard
from agents.leaderboard.board import build, write
from agents.leaderboard.page import END, START, head, rank, render, with_head
from agents.leaderboard.staleness import check
from baselines.gaits.archive import best_known_speed
from tests.agents.evaluation.fakes import Sine, write_run

HORIZON = 0.6


def make_set(name, *plants):
    return parse_set({"name": name, "plants": [{"M": M, "mu": mu, "seed": i} for i, (M, mu) in enumerate(plants)]})


SETS = [make_set("nominal", (0.5, 0.01)), make_set("paper", (0.5, 0.01), (0.55, 0.011), (0.45, 0.009))]
README = f"# Title\n\nBefore.\n\n{START}\n{END}\n\nAfter.\n"


def speed_of(path):
    """A policy for each run, so that training seeds differ."""
    return Sine(0.1 * (4 + int(path.name[-1])), period=0.9, name="learnt")


@pytest.fixture
def world(tmp_path, monkeypatch):
    """Scripted policies, one of which fails everywhere, a checkpoint of two seeds, a README."""
    scripted = {"adaptive": 0.3, "bold": 0.6}
    known = {name: Sine(amplitude, name=name) for name, amplitude in scripted.items()}
    known["wild"] = Sine(1.5, period=10.0, name="wild")
    monkeypatch.setattr(candidates, "SCRIPTED", known)
    monkeypatch.setattr(candidates, "CHECKPOINTS", tmp_path / "checkpoints")
    monkeypatch.setattr("agents.training.runs.load_policy", speed_of)
    for seed in (0, 1):
        write_run(tmp_path / "checkpoints" / "learnt" / f"seed-{seed}", seed)
    (tmp_path / "README.md").write_text(README)
    return tmp_path


def built():
    return build(all_candidates(), SETS, horizon=HORIZON)


def checked(root, sets=SETS):
    return check(root, all_candidates(), sets, horizon=HORIZON)


@pytest.fixture
def written(world):
    write(world, built())
    return world


def edit(root, change, *, pages=True):
    """Changes leaderboard.json, and renders the pages from it unless they should stay behind."""
    board = json.loads((root / "leaderboard.json").read_text())
    change(board)
    if pages:
        write(root, board)
    else:
        (root / "leaderboard.json").write_text(json.dumps(board))


def row_of(board, name):
    return next(row for row in board["rows"] if row["policy"] == name)


def test_what_is_written_passes_the_check(written):
    assert checked(written) == []
    assert not list(written.glob(".*"))
    readme = (written / "README.md").read_text()
    assert readme.startswith(f"# Title\n\nBefore.\n\n{START}\n| policy |")
    assert readme.endswith(f"|\n{END}\n\nAfter.\n")


def test_board(written):
    board = json.loads((written / "leaderboard.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    speeds = [row["results"]["paper"]["mean_speed"]["iqm"] for row in board["rows"]]
    assert speeds == sorted(speeds, reverse=True)
    assert board["sets"] == {s.name: s.hash for s in SETS}
    learnt = row_of(board, "learnt")
    assert learnt["training_seeds"] == [0, 1]
    assert learnt["revision"] == "0123456789ab"
    assert sorted(learnt["files"]) == [f"seed-{i}/{name}" for i in (0, 1) for name in ("config.json", "model.zip")]
    assert learnt["results"]["paper"]["resampled"] == "seeds"
    assert learnt["results"]["paper"]["episodes"] == 6
    bold = row_of(board, "bold")
    assert (bold["training_seeds"], bold["revision"], bold["files"]) == ([], None, {})
    assert bold["results"]["nominal"]["mean_speed"]["low"] is None
    assert row_of(board, "wild")["results"]["paper"]["failures"] == 3


def test_page(written):
    page = (written / "LEADERBOARD.md").read_text()
    board = json.loads((written / "leaderboard.json").read_text())
    assert page == render(board)
    assert "| 1 |" in page
    assert "`python -m agents.evaluate learnt --set paper`" in page
    assert "3/3 failed" in page
    for s in SETS:
        assert s.hash[:12] in page


def test_shares_of_the_best_known_speed(written):
    board = json.loads((written / "leaderboard.json").read_text())
    results = row_of(board, "bold")["results"]["nominal"]
    speed = results["mean_speed"]["iqm"]
    assert results["share_of_best_known"]["iqm"] == pytest.approx(speed / best_known_speed(0.5, 0.01), rel=1e-5)
    page = (written / "LEADERBOARD.md").read_text()
    cell = f"{results['share_of_best_known']['iqm']:.2f}"
    assert "| share of best-known |" in page
    assert f"| bold | {cell} | " in page
    edit(written, nudge("bold", 1.01, "share_of_best_known"))
    (stale,) = checked(written)
    assert stale.startswith("bold on paper: share_of_best_known (iqm) is ")


def test_no_share_outside_the_table_of_gaits(world):
    jump = {"t": 0.3, "M": 0.5, "mu": 0.02}
    drift = parse_set({"name": "drift", "plants": [{"M": 0.5, "mu": 0.01, "seed": 0, "changes": [jump]}]})
    board = build(all_candidates(), [SETS[1], make_set("far", (0.5, 0.01), (0.5, 0.6)), drift], horizon=HORIZON)
    for row in board["rows"]:
        assert ["share_of_best_known" in summary for summary in row["results"].values()] == [True, False, False]
    assert "| policy | paper |\n" in render(board)


def test_head_always_shows_the_reference(written):
    board = json.loads((written / "leaderboard.json").read_text())
    rows = [copy.deepcopy(row_of(board, "bold")) | {"policy": f"better-{i}"} for i in range(9)]
    for row in rows:
        row["results"]["paper"]["mean_speed"]["iqm"] = 1e3
    board["rows"] = rank([*board["rows"], *rows])
    names = [line.split(" | ")[0].removeprefix("| ") for line in head(board)[2:]]
    assert names == [f"better-{i}" for i in range(5)] + ["adaptive"]


def test_check_says_when_there_is_none(world):
    assert checked(world) == ["leaderboard.json is missing"]
    for text in ("{", "[]", '{"sets": {}, "versions": {}, "rows": [{}]}'):
        (world / "leaderboard.json").write_text(text)
        (stale,) = checked(world)
        assert stale.startswith("leaderboard.json is malformed: ")


def test_check_names_changed_sets_before_any_work(written, monkeypatch):
    monkeypatch.setattr(leaderboard, "build", lambda *args, **kwargs: pytest.fail("evaluated"))
    other = [SETS[0], make_set("paper", (0.5, 0.02)), make_set("new", (0.5, 0.01))]
    stale = checked(written, other)
    assert stale[0] == f"set paper: hash is {SETS[1].hash} in leaderboard.json and {other[1].hash} now"
    assert stale[1].startswith("set new: hash is None")
    assert stale[-1] == "the numbers were not evaluated again"


def test_check_names_changed_rows(written):
    write_run(written / "checkpoints" / "learnt" / "seed-1", 1, model=b"another")
    write_run(written / "checkpoints" / "fresh" / "seed-0", 0)
    candidates.SCRIPTED["newcomer"] = candidates.SCRIPTED.pop("bold")
    assert checked(written)[:-1] == [
        "bold: is in leaderboard.json and does not exist",
        "newcomer: exists and is not in leaderboard.json",
        "fresh: exists and is not in leaderboard.json",
        "learnt: files have changed: seed-1/model.zip",
    ]


def test_check_names_changed_revisions_and_seeds(written):
    (written / "checkpoints" / "learnt" / "seed-0").rename(written / "gone")
    edit(written, lambda board: row_of(board, "learnt").update(revision="feed"))
    stale = checked(written)
    assert "learnt: training_seeds is [0, 1] in leaderboard.json and [1] now" in stale
    assert "learnt: revision is 'feed' in leaderboard.json and '0123456789ab' now" in stale


def test_check_names_stale_pages(written):
    with (written / "LEADERBOARD.md").open("a") as file:
        file.write("mine is better\n")
    readme = written / "README.md"
    readme.write_text(readme.read_text().replace("| policy |", "| polity |"))
    assert checked(written)[:-1] == [
        "LEADERBOARD.md is not what leaderboard.json renders to",
        "README.md: the leaderboard's head is not what leaderboard.json renders to",
    ]


def nudge(name, factor, metric="mean_speed"):
    def change(board):
        row_of(board, name)["results"]["paper"][metric]["iqm"] *= factor

    return change


@pytest.mark.parametrize(
    ("name", "factor", "stale"), [("bold", 1.0005, 0), ("bold", 1.01, 1), ("learnt", 1.01, 0), ("learnt", 2.0, 1)]
)
def test_check_compares_numbers_to_the_tolerance_of_the_row(written, name, factor, stale):
    edit(written, nudge(name, factor))
    found = checked(written)
    assert len(found) == stale
    for line in found:
        assert line.startswith(f"{name} on paper: mean_speed (iqm) is ")


def test_check_compares_counts_and_undefined_numbers(written):
    def change(board):
        row_of(board, "bold")["results"]["paper"]["failures"] = 1
        row_of(board, "adaptive")["results"]["paper"]["mean_speed"]["low"] = None

    edit(written, change)
    found = checked(written)
    assert found[0].startswith("adaptive on paper: mean_speed (low) is None in leaderboard.json and ")
    assert found[1:] == []
    # A row with failures is taken to be chaotic: one more of three is within 5 %, rounded up; two are not.
    edit(written, lambda board: row_of(board, "bold")["results"]["paper"].update(failures=2))
    assert "bold on paper: failures is 2 in leaderboard.json and 0 now" in checked(written)
    edit(written, lambda board: row_of(board, "bold")["results"]["paper"].pop("rms_torque"))
    assert "bold on paper: leaderboard.json is malformed: KeyError: 'rms_torque'" in checked(written)


def test_readme_markers(written):
    board = json.loads((written / "leaderboard.json").read_text())
    assert with_head("# No markers\n", board) == "# No markers\n"
    for text in (START, END, END + START, START + END + END, START + START + END):
        with pytest.raises(ValueError, match=r"README\.md must hold <!-- leaderboard:start -->"):
            with_head(text, board)
    # Broken markers stop the writing before anything is written, and are named by the check.
    (written / "README.md").write_text(START)
    (written / "leaderboard.json").write_text(json.dumps(board))
    with pytest.raises(ValueError, match="once each, or neither"):
        write(written, {**board, "rows": []})
    assert json.loads((written / "leaderboard.json").read_text()) == board
    assert "once each, or neither" in checked(written)[0]
    (written / "README.md").unlink()
    assert checked(written) == []


def test_command_line(world, monkeypatch, capsys):
    monkeypatch.setattr(leaderboard, "SET_NAMES", ("paper",))
    monkeypatch.setattr(leaderboard, "load_set", lambda name: SETS[1])
    monkeypatch.setattr(candidates, "CHECKPOINTS", world / "none")
    assert leaderboard.main(["--check", "--jobs", "1"], root=world) == 1
    assert "The leaderboard is stale:\n- leaderboard.json is missing\nRun " in capsys.readouterr().out
    assert leaderboard.main(["--jobs", "1"], root=world) == 0
    assert leaderboard.main(["--check", "--jobs", "1"], root=world) == 0
    assert "up to date: 3 policies on 1 sets" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        leaderboard.main(["--jobs", "0"])


def test_processes_give_the_same():
    # Spawned workers see the real policies, not the fakes.
    real = [c for c in all_candidates() if c.name == "zero"]
    assert build(real, SETS, jobs=2, horizon=0.1) == build(real, SETS, horizon=0.1)
