"""The demo: agents are found by name, an episode is the environment's, and the command writes and refuses."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import baselines
from capsule_gym import demo
from capsule_gym.demo import Agent, Episode, agent_names, control_laws, find_agent
from capsule_gym.evaluation_sets import load_set
from capsule_gym.task import HORIZON, Termination

Image = pytest.importorskip("PIL.Image")
pytest.importorskip("pygame")

PLANT = load_set("paper").plants[0]


@pytest.fixture(autouse=True)
def dummy(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def agent(name: str) -> Agent:
    return find_agent("NAME_OR_PATH", name)


def test_every_agent_and_every_law_has_one_name():
    assert {"zero", "adaptive", "gait-guarded", "direct-ppo"} <= set(agent_names())
    assert len(agent_names()) == len(set(agent_names()))
    for name, law in (("zero", None), ("gait-guarded", "baselines:gait"), ("epc", "baselines:epc")):
        assert agent(name)[:2] == (name, {"controller": law})
    assert sorted(control_laws().values()) == sorted(f"baselines:{name}" for name in baselines.__all__)


def test_an_episode_is_the_environments_and_stands_still_at_its_end():
    episode = Episode(agent("direct-ppo"), load_set("nominal").plants[0])
    assert episode.mean_speed == 0.0 and episode.end is None
    episode.advance(2.0 * HORIZON)
    assert episode.end is Termination.none and episode.time == pytest.approx(HORIZON)
    assert episode.mean_speed == pytest.approx(episode.env.episode_metrics()["mean_speed"], rel=1e-12) != 0.0
    last, time = episode.state(), episode.time
    episode.advance(3.0 * HORIZON)
    assert (episode.state(), episode.time) == (last, time)
    assert episode.ghost() == ("direct-ppo", last["theta"], last["x"])
    episode.begin(PLANT)
    assert (episode.end, episode.time, episode.state()["x"]) == (None, 0.0, 0.0)


def test_a_policys_own_control_interval_keeps_the_time_and_its_reference_is_shown():
    episode = Episode(agent("residual-ppo"), PLANT)
    assert episode.agent.env_kwargs["control_dt"] == 0.005
    episode.advance(0.1)
    assert episode.time == pytest.approx(0.1)
    simulation = episode.env.simulation
    tick = round(0.1 / simulation.controller.dt)
    assert episode.state()["theta_reference"] == simulation.reference[tick % len(simulation.reference), 0] != 0.0


def test_a_file_has_the_pictures_that_were_asked_for(tmp_path, capsys):
    path = tmp_path / "out.gif"
    assert demo.main(["direct-ppo", "--rival", "zero", "--start", "1", "--seconds", "0.4", "-o", str(path)]) == 0
    out = capsys.readouterr().out
    assert "direct-ppo" in out and "zero" in out and "over 1.4 s" in out and str(path) in out
    with Image.open(path) as picture:
        assert (picture.n_frames, picture.info["duration"]) == (11, 40)
        first = np.asarray(picture.convert("RGB"))
        picture.seek(10)
        assert (first != np.asarray(picture.convert("RGB"))).any()
    with pytest.raises(SystemExit):
        demo.main(["zero", "--seconds", "0.1", "-o", str(path)])
    with Image.open(path) as picture:
        assert picture.n_frames == 11
    # In slow motion there are more pictures of the same time.
    assert demo.main(["zero", "--seconds", "0.1", "--speed", "0.5", "-o", str(path), "--overwrite"]) == 0
    with Image.open(path) as picture:
        assert picture.n_frames == 6


def test_a_failure_ends_the_picture_and_is_named(tmp_path, capsys):
    def push() -> demo.Callable[[np.ndarray], np.ndarray]:
        return lambda observation: np.ones(1, np.float32)

    episode = Episode(Agent("pusher", {}, push), PLANT)
    with demo.renderer_of("demo", episode, "rgb_array", "pusher") as renderer:
        count = sum(1 for _ in demo.draw_episode(renderer, [0.1 * n for n in range(300)], episode, None))
    assert count < 300 and episode.end in (Termination.pendulum, Termination.contact)


def test_the_plants_are_those_of_the_set_from_the_seed_on(tmp_path):
    path, drift = tmp_path / "own.json", load_set("drift").plants
    path.write_text(load_set("drift").to_json(), encoding="utf-8")
    assert demo.PlantArgs().plants() == load_set("paper").plants
    assert demo.PlantArgs(set=str(path), seed=42).plants() == drift[42:] + drift[:42]
    changed = demo.PlantArgs(set="drift", seed=3, mu=0.25).plants()
    assert {(plant.mu, plant.changes) for plant in changed} == {(0.25, ())}
    assert [plant.M for plant in changed[:97]] == [plant.M for plant in drift[3:]]
    assert {plant.M for plant in demo.PlantArgs(M=0.6).plants()} == {0.6}
    for speed in (0.1, 20.0):
        demo.PlantArgs(speed=speed).check()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["direct-po"], "did you mean 'direct-ppo'?"),
        (["zero", "--set", "papr"], "got 'papr'; did you mean 'paper'?"),
        (["zero", "--seed", "100"], "--seed must be one of the set's, 0 to 99, got 100"),
        (["zero", "--seed", "-1"], "must be an integer >= 0, got '-1'"),
        (["zero", "--M", "0"], "M must be a finite number"),
        (["zero", "--speed", "0.09"], "--speed must be a number from 0.1 to 20, got 0.09"),
        (["zero", "--seconds", "0"], "--seconds"),
        (["zero", "-o", "out.mp4"], "--output must name a GIF"),
        (["zero", "-o", "out.gif", "--seconds", "33", "--speed", "0.1"], "at most 1000 pictures, got 8250"),
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
