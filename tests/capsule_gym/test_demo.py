"""The demo and the game: names of agents, episodes equal to the environment's, files, keys and error messages."""

from __future__ import annotations

import re
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from capsule_gym import Capsule, demo, play
from capsule_gym.demo import NAMES, Episode, find_policy
from capsule_gym.evaluation_sets import load_set
from capsule_gym.play import STRENGTH, Game
from capsule_gym.task import HORIZON, Termination

Image = pytest.importorskip("PIL.Image")
pygame = pytest.importorskip("pygame")

PLANT, PLANTS = load_set("paper").plants[0], load_set("wide").plants[:3]


@pytest.fixture(autouse=True)
def display(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


def test_every_policy_has_one_name_and_acts():
    assert {"zero", "adaptive", "gait-guarded", "direct-ppo"} <= set(NAMES)
    assert len(NAMES) == len(set(NAMES))
    for name in ("random", "gait-oracle", "dp-oracle", "direct-ppo/seed-2"):
        episode = Episode(find_policy(name), PLANT)
        episode.advance(0.2)
        assert episode.policy.name in name and episode.state()["torque"] != 0.0


def test_an_episode_is_the_environments_and_stands_still_at_its_end():
    episode = Episode(find_policy("direct-ppo"), load_set("nominal").plants[0])
    assert episode.speed == "direct-ppo 0.00 cm/s" and episode.end is None
    episode.advance(2.0 * HORIZON)
    assert episode.end is Termination.none and episode.time == pytest.approx(HORIZON)
    assert episode.speed == f"direct-ppo {episode.env.episode_metrics(1650)['mean_speed']:.2f} cm/s"
    last, time = episode.state(), episode.time
    episode.advance(3.0 * HORIZON)
    assert (episode.state(), episode.time) == (last, time)
    assert episode.ghost() == ("direct-ppo", last["theta"], last["x"])
    episode.begin(PLANT)
    assert (episode.end, episode.time, episode.state()["x"]) == (None, 0.0, 0.0)


def test_the_set_decides_which_capsule_is_shown(monkeypatch, tmp_path):
    shown = []
    own = SimpleNamespace(name="own", env_kwargs={"capsule": Capsule(l=0.4)}, start=find_policy("zero").start)
    monkeypatch.setattr(demo, "find_policy", lambda name: own)
    monkeypatch.setattr(demo, "draw_episode", lambda renderer, seconds, episode, rival: shown.append(episode) or [])
    monkeypatch.setattr(demo, "write_gif", lambda pictures, path: None)
    for name in ("paper", "sticky"):
        demo.main(["own", "--set", name, "-o", str(tmp_path / "out.gif")])
    assert [episode.env.simulation.capsule for episode in shown] == [Capsule(), Capsule(static_ratio=1.3)]


def test_a_policys_own_control_interval_keeps_the_time():
    episode = Episode(find_policy("residual-ppo"), PLANT)
    assert episode.policy.env_kwargs["control_dt"] == 0.005
    episode.advance(0.1)
    assert episode.time == pytest.approx(0.1)


def test_a_file_has_the_pictures_that_were_asked_for(tmp_path, capsys):
    path = tmp_path / "out.gif"
    assert demo.main(["direct-ppo", "--rival", "zero", "--seconds", "0.4", "-o", str(path)]) == 0
    out = capsys.readouterr().out
    assert "direct-ppo" in out and "zero" in out and "over 0.4 s" in out
    with Image.open(path) as picture:
        assert (picture.n_frames, picture.info["duration"]) == (11, 40)
        first = np.asarray(picture.convert("RGB"))
        picture.seek(10)
        assert (first != np.asarray(picture.convert("RGB"))).any()
    with pytest.raises(SystemExit):
        demo.main(["zero", "--seconds", "0.1", "-o", str(path)])
    with Image.open(path) as picture:
        assert picture.n_frames == 11
    assert demo.main(["random", "--seconds", "0.2", "-o", str(path), "--overwrite"]) == 0
    with Image.open(path) as picture:
        assert picture.n_frames == 6


def test_a_failure_ends_the_picture_and_the_rival_waits():
    pusher = SimpleNamespace(name="pusher", env_kwargs={}, start=lambda seeds: lambda observations: np.ones((1, 1)))
    episode, rival = Episode(pusher, PLANT), Episode(find_policy("zero"), PLANT)
    renderer = episode.renderer("rgb_array", "pusher")
    count = sum(1 for _ in demo.draw_episode(renderer, 30.0, episode, rival))
    assert 1 < count < 300 and episode.end in (Termination.pendulum, Termination.contact)
    assert rival.time == pytest.approx(episode.time)


def test_the_plants_are_those_of_the_set_from_the_seed_on(tmp_path):
    path, drift = tmp_path / "own.json", load_set("drift").plants
    path.write_text(load_set("drift").to_json(), encoding="utf-8")
    assert demo.PlantArgs().plants() == load_set("paper").plants
    assert demo.PlantArgs(set=str(path), seed=42).plants() == drift[42:] + drift[:42]
    changed = demo.PlantArgs(set="drift", seed=3, mu=0.25).plants()
    assert {(plant.mu, len(plant.changes)) for plant in changed} == {(0.25, 0)}
    assert [plant.M for plant in changed] == [plant.M for plant in drift[3:] + drift[:3]]
    assert {plant.M for plant in demo.PlantArgs(M=0.6).plants()} == {0.6}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["direct-po"], "did you mean 'direct-ppo'?"),
        (["zero", "--set", "papr"], "got 'papr'; did you mean 'paper'?"),
        (["zero", "--seed", "400"], "--seed must be one of the set's, 0 to 399, got 400"),
        (["zero", "--seed", "-1"], "must be an integer >= 0, got '-1'"),
        (["zero", "--M", "0"], "M must be a finite number"),
        (["zero", "--seconds", "0"], "--seconds"),
        (["zero", "-o", "out.mp4"], "--output must name a GIF"),
    ],
)
def test_bad_arguments_are_refused_in_a_line(words, said, capsys):
    with pytest.raises(SystemExit) as ended:
        demo.main(words)
    error = capsys.readouterr().err
    assert ended.value.code == 2 and said in error and "Traceback" not in error


@pytest.mark.parametrize("words", [["play"], ["demo", "zero"]])
def test_without_pygame_one_line_names_what_to_install(words):
    code = f"""
import sys
sys.modules["pygame"] = None
from capsule_gym.{words[0]} import main
main({words[1:]!r})
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert 'pip install "capsule-gym[render]"' in done.stderr.splitlines()[-1]


# The game


@pytest.fixture
def game() -> Game:
    return Game(PLANTS, find_policy("zero"))


def test_the_last_key_wins_and_the_one_before_comes_back(game):
    def after(name: str, pressed: bool) -> float:
        game.on_key(name, pressed)
        return game.action / STRENGTH

    assert [after("a", True), after("d", True), after("d", False), after("a", False)] == [1.0, -1.0, 1.0, 0.0]
    assert [after("left", True), after("right", True)] == [1.0, -1.0]
    game.tick(0.2)
    assert game.episode.state()["theta"] < game.rival.state()["theta"] - 0.01


def test_both_are_on_the_same_plant_at_the_same_time(game):
    for number in (0, 1, 2, 0):
        for episode in (game.episode, game.rival):
            assert (episode.state()["M"], episode.state()["mu"]) == (PLANTS[number].M, PLANTS[number].mu)
        game.tick(0.5)
        assert game.episode.time == pytest.approx(0.5) and game.rival.time == pytest.approx(0.5)
        game.on_key("n", True)
        assert game.episode.time == game.rival.time == 0.0
    # Slow motion loses no time between frames.
    game.speed = 0.1
    for _ in range(100):
        game.tick(0.02)
    assert game.episode.time == pytest.approx(0.2)


def test_a_failure_is_named_and_stops_both(game):
    game.action = 1.0
    game.tick(20.0)
    assert game.episode.end in (Termination.pendulum, Termination.contact)
    assert game.rival.time == pytest.approx(game.episode.time)
    assert re.match(r"The (ball|capsule) .* after \d\.\d s: you -?\d+\.\d\d cm/s, zero -?\d", game.note())


def test_a_whole_episode_ends_with_the_time(game):
    keys = game.note()
    game.tick(100.0)
    assert game.episode.end is Termination.none and game.episode.time == pytest.approx(HORIZON)
    game.on_key("r", True)
    assert game.note() == keys and game.episode.time == 0.0


def test_the_command_ends_with_its_window_and_by_an_interrupt(monkeypatch):
    events = iter([[], [pygame.event.Event(pygame.QUIT)]])
    monkeypatch.setattr(pygame.event, "get", lambda: next(events))
    assert play.main(["--rival", "zero", "--set", "nominal"]) == 0
    assert not pygame.display.get_init()

    def interrupt() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(pygame.event, "get", interrupt)
    with pytest.raises(SystemExit) as ended:
        play.main(["--rival", "zero"])
    assert ended.value.code == 130 and not pygame.display.get_init()
