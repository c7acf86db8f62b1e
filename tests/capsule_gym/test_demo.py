"""The demo: what its command line refuses, what it writes, and gymnasium's own `play`."""

from __future__ import annotations

import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

import capsule_gym
from capsule_gym import demo

Image = pytest.importorskip("PIL.Image")
pygame = pytest.importorskip("pygame")


@pytest.fixture(autouse=True)
def dummy(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def test_a_demo_in_a_file_has_the_pictures_that_were_asked_for(tmp_path, capsys):
    path = tmp_path / "out.gif"
    assert demo.main(["direct-ppo", "--rival", "adaptive", "--start", "1", "--seconds", "0.4", "-o", str(path)]) == 0
    said = capsys.readouterr().out
    assert "direct-ppo" in said and "adaptive" in said and str(path) in said
    with Image.open(path) as picture:
        assert picture.n_frames == 11
        assert picture.info["duration"] == 40
        first = np.asarray(picture.convert("RGB"))
        picture.seek(10)
        assert (first != np.asarray(picture.convert("RGB"))).any()


def test_slow_motion_has_more_pictures_of_the_same_time(tmp_path):
    path = tmp_path / "slow.gif"
    assert demo.main(["adaptive", "--seconds", "0.2", "--speed", "0.5", "-o", str(path)]) == 0
    with Image.open(path) as picture:
        assert picture.n_frames == 11


def test_a_demo_in_a_window_ends_with_its_time(monkeypatch, capsys):
    monkeypatch.setattr(demo, "FPS", 100)
    assert demo.main(["adaptive", "--seconds", "0.1", "--M", "0.6", "--mu", "0.05"]) == 0
    assert "M = 0.6 kg, mu = 0.05" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["direct-po"], "did you mean 'direct-ppo'?"),
        (["gait-nominal"], "NAME_OR_PATH must be one of"),
        (["adaptive", "--rival", "nobody-at-all"], "--rival must be one of"),
        (["adaptive", "--set", "papr"], "did you mean 'paper'?"),
        (["adaptive", "--seed", "100"], "0 to 99"),
        (["adaptive", "--mu", "9"], "mu=9"),
        (["adaptive", "--M", "-1"], "M"),
        (["adaptive", "--speed", "0"], "--speed"),
        (["adaptive", "--start", "34"], "--start"),
        (["adaptive", "--seconds", "0"], "--seconds"),
        (["adaptive", "-o", "out.mp4"], "--output must name a GIF"),
        (["adaptive", "-o", "nowhere/out.gif"], "--output"),
        (["adaptive", "-o", "out.gif", "--seconds", "33", "--speed", "0.1"], "at most 1000 pictures"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_a_line(words, said, capsys):
    with pytest.raises(SystemExit) as ended:
        demo.main(words)
    error = capsys.readouterr().err
    assert ended.value.code == 2 and said in error and error.count("\n") == 1


def test_a_file_is_replaced_only_if_that_is_asked_for(tmp_path, capsys):
    path = tmp_path / "kept.gif"
    path.write_bytes(b"mine")
    with pytest.raises(SystemExit):
        demo.main(["adaptive", "--seconds", "0.1", "-o", str(path)])
    assert path.read_bytes() == b"mine"
    assert demo.main(["adaptive", "--seconds", "0.1", "-o", str(path), "--overwrite"]) == 0
    assert path.read_bytes().startswith(b"GIF")


@pytest.mark.parametrize("module", ["play", "demo"])
def test_without_pygame_one_line_names_what_to_install(module):
    code = f"""
import sys
sys.modules["pygame"] = None
from capsule_gym.{module} import main
main({["adaptive"] if module == "demo" else []!r})
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    *_, last = done.stderr.splitlines()
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert 'pip install "capsule-gym[render]"' in last


@pytest.mark.filterwarnings("ignore")
def test_gymnasiums_own_play_plays(monkeypatch):
    from gymnasium.utils.play import play as gymnasium_play

    down = [pygame.event.Event(pygame.KEYDOWN, key=pygame.K_a)]
    events = iter([[], down, [], [], [pygame.event.Event(pygame.QUIT)]])
    monkeypatch.setattr(pygame.event, "get", lambda: next(events))
    actions = []
    env = gym.make(capsule_gym.ENV_ID, render_mode="rgb_array")
    gymnasium_play(
        env, callback=lambda *step: actions.append(float(step[2][0])), noop=np.zeros(1, np.float32), fps=10_000
    )
    assert actions[0] == 0.0 and actions[-1] == 1.0
