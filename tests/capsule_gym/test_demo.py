from unittest.mock import Mock

import numpy as np
import pytest

from capsule_gym import demo
from capsule_gym.demo import KEYBOARD, NAMES, STRENGTH, Episode, find_policy
from capsule_gym.envs.env import shown_state
from capsule_gym.evaluation.sets import EvaluationSet, PlantSpec, load_set
from capsule_gym.tasks.task import Termination
from tests.capsule_gym.policies.test_policy import POLICY, make_policy

Image = pytest.importorskip("PIL.Image")
ImageSequence = pytest.importorskip("PIL.ImageSequence")
pygame = pytest.importorskip("pygame")

PAPER = load_set("paper")
PLANT = PAPER.plants[0]
pytestmark = pytest.mark.usefixtures("no_screen")


def state(episode):
    return shown_state(episode.env.simulation, 0)


def test_every_policy_has_one_name():
    assert {"adaptive", "gait-guarded", "direct-ppo", "keyboard"} <= set(NAMES)
    assert len(NAMES) == len(set(NAMES))


@pytest.mark.parametrize("name", ["pd", "lqr", "dp-oracle", "direct-ppo/seed-2"])
def test_a_policy_with_a_name_acts(name):
    episode = Episode(find_policy(name), PAPER, PLANT)
    episode.advance(0.2)
    assert episode.policy.name in name
    assert state(episode)["torque"] != 0.0


@pytest.mark.parametrize(
    ("name", "found", "horizon"), [("residual-ppo", "nominal", 33.0), ("goal", "goal", 15.0)]
)
def test_an_episode_is_the_environments_and_stands_still_at_its_end(name, found, horizon):
    episode = Episode(find_policy(name), load_set(found), load_set(found).plants[0])
    episode.advance(0.1)
    assert episode.time == pytest.approx(0.1)
    assert episode.end is None

    episode.advance(2.0 * horizon)
    assert episode.end is Termination.none
    assert episode.time == pytest.approx(horizon)
    assert episode.speed == f"{name} {episode.env.episode_metrics(1650)['mean_speed']:.2f} cm/s"

    last = state(episode)
    time = episode.time
    assert last["time"] == pytest.approx(time)
    episode.advance(3.0 * horizon)
    assert (state(episode), episode.time) == (last, time)


def test_a_scripted_policy_without_a_task_fits_any_set():
    goals = load_set("goal")
    assert Episode(KEYBOARD, goals, goals.plants[0]).env.simulation.task.name == "goal"


def test_a_window_without_a_display_is_an_error(monkeypatch, capfd):
    for name in ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(SystemExit):
        demo.main(["keyboard", "--seconds", "0.1"])
    assert "a window needs a display" in capfd.readouterr().err


@pytest.fixture
def pictures(tmp_path):
    """Writes a GIF, and returns its pictures."""

    def write(*options, file="out.gif"):
        path = tmp_path / file
        assert demo.main([*options, "-o", str(path)]) == 0
        with Image.open(path) as picture:
            assert picture.info["duration"] == 40
            frames = ImageSequence.Iterator(picture)
            return [np.asarray(frame.convert("RGB"), int) for frame in frames]

    return write


def test_a_file_shows_an_episode(pictures, capsys):
    frames = pictures("direct-ppo", "--rival", "pd", "--seconds", "0.4")
    speeds = []
    for name in ("direct-ppo", "pd"):
        episode = Episode(find_policy(name), PAPER, PLANT)
        episode.advance(0.4)
        speeds.append(f"{name} {100.0 * state(episode)['x'] / 0.4:.2f} cm/s")
    plant = f"M = {PLANT.M:g} kg, mu = {PLANT.mu:g}"
    printed = capsys.readouterr().out
    assert printed.startswith(f"{speeds[0]}; {speeds[1]} over 0.4 s on {plant}")
    assert len(frames) == 11
    assert (frames[0] != frames[10]).any()


def test_a_file_shows_the_rival(pictures):
    both = pictures("direct-ppo", "--rival", "pd", "--seconds", "0.4")
    alone = pictures("direct-ppo", "--seconds", "0.4", file="alone.gif")
    differences = np.abs(alone[10] - both[10]).max(axis=2)
    assert (differences > 8).sum() > 500


def test_a_file_is_overwritten_only_on_request(pictures, tmp_path, refused):
    pictures("direct-ppo", "--seconds", "0.4")
    path = tmp_path / "out.gif"
    refused(demo.main, ["adaptive", "--seconds", "0.1", "-o", str(path)])
    with Image.open(path) as picture:
        assert picture.n_frames == 11
    assert len(pictures("pd", "--seconds", "0.2", "--overwrite")) == 6


def test_a_file_has_the_speed_and_the_plant_that_were_asked_for(pictures, capsys):
    frames = pictures("pd", "--seconds", "0.2", "--speed", "0.5", "--M", "0.6")
    assert len(frames) == 11
    assert f"M = 0.6 kg, mu = {PLANT.mu:g}" in capsys.readouterr().out


def test_the_command_says_why_an_episode_has_ended(pictures, tmp_path, capsys):
    # The policy pushes in one direction until the pendulum lies down.
    push = np.zeros((1, 5), np.float32), np.full(1, 3.0, np.float32)
    make_policy(layers=(push,)).save(tmp_path / POLICY)
    frames = pictures(str(tmp_path), "--speed", "4")
    assert capsys.readouterr().out.endswith(": the ball met the platform\n")
    assert len(frames) < 10


@pytest.mark.parametrize(
    ("M", "mu", "plant"), [(0.6, None, (0.6, 0.2)), (None, 0.1, (0.4, 0.1)), (0.6, 0.1, (0.6, 0.1))]
)
def test_a_given_mass_or_friction_replaces_the_sets_and_its_changes(M, mu, plant):
    changes = ({"t": 1.0, "M": 0.7, "mu": 0.3},)
    chosen = EvaluationSet("jumps", (PlantSpec(M=0.4, mu=0.2, seed=5, changes=changes),))
    found = demo._find_plant(chosen, 5, M, mu)
    assert (found.M, found.mu) == plant
    assert found.changes == ()


LEFT = pygame.K_LEFT, pygame.K_a
RIGHT = pygame.K_RIGHT, pygame.K_d


@pytest.mark.parametrize(
    ("held", "action"),
    [
        *(([key], 1.0) for key in LEFT),
        *(([key], -1.0) for key in RIGHT),
        ([*LEFT, *RIGHT], 0.0),
        ([], 0.0),
    ],
)
def test_held_keys_apply_torque_and_cancel_each_other(held, action, monkeypatch):
    keys = {key: key in held for key in (*LEFT, *RIGHT)}
    monkeypatch.setattr(pygame.key, "get_pressed", lambda: keys)
    episode = Episode(KEYBOARD, PAPER, PLANT)
    episode.advance(0.02)
    assert state(episode)["torque"] == pytest.approx(1.5 * STRENGTH * action)


def test_the_command_ends_with_its_window(monkeypatch):
    events = [], [pygame.event.Event(pygame.QUIT)]
    monkeypatch.setattr(pygame.event, "get", Mock(side_effect=events))
    clock = Mock()
    monkeypatch.setattr(pygame.time, "Clock", lambda: clock)
    assert demo.main(["keyboard", "--rival", "adaptive", "--set", "nominal"]) == 0
    # A frame is shown for 40 ms, as in a GIF.
    clock.tick.assert_called_with(25)
    assert not pygame.display.get_init()


def test_the_command_ends_by_an_interrupt(monkeypatch):
    monkeypatch.setattr(pygame.event, "get", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(SystemExit) as ended:
        demo.main(["adaptive"])
    assert ended.value.code == 130
