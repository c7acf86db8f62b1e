from unittest.mock import Mock

import numpy as np
import pytest

from capsule_gym import demo
from capsule_gym.demo import KEYBOARD, NAMES, STRENGTH, Episode, find_policy
from capsule_gym.envs.env import shown_state
from capsule_gym.evaluation.sets import load_set
from capsule_gym.tasks.task import Termination

Image, ImageSequence = pytest.importorskip("PIL.Image"), pytest.importorskip("PIL.ImageSequence")
pygame = pytest.importorskip("pygame")

PAPER = load_set("paper")
PLANT = PAPER.plants[0]
pytestmark = pytest.mark.usefixtures("no_screen")
KEYS = pygame.K_LEFT, pygame.K_a, pygame.K_RIGHT, pygame.K_d


def state(episode):
    return shown_state(episode.env.simulation, 0)


def test_every_policy_has_one_name_and_acts():
    assert {"adaptive", "gait-guarded", "direct-ppo", "keyboard"} <= set(NAMES)
    assert len(NAMES) == len(set(NAMES))
    for name in ("pd", "lqr", "dp-oracle", "direct-ppo/seed-2"):
        episode = Episode(find_policy(name), PAPER, PLANT)
        episode.advance(0.2)
        assert episode.policy.name in name and state(episode)["torque"] != 0.0


@pytest.mark.parametrize(
    ("name", "found", "horizon"), [("residual-ppo", "nominal", 33.0), ("goal", "goal", 15.0)]
)
def test_an_episode_is_the_environments_and_stands_still_at_its_end(name, found, horizon):
    episode = Episode(find_policy(name), load_set(found), load_set(found).plants[0])
    episode.advance(0.1)
    assert episode.time == pytest.approx(0.1) and episode.end is None
    episode.advance(2.0 * horizon)
    assert episode.end is Termination.none and episode.time == pytest.approx(horizon)
    assert episode.speed == f"{name} {episode.env.episode_metrics(1650)['mean_speed']:.2f} cm/s"
    last, time = state(episode), episode.time
    assert last["time"] == pytest.approx(time)
    episode.advance(3.0 * horizon)
    assert (state(episode), episode.time) == (last, time)


def test_a_window_without_a_display_is_an_error(monkeypatch, capfd):
    for name in ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(SystemExit):
        demo.main(["keyboard", "--seconds", "0.1"])
    assert "a window needs a display" in capfd.readouterr().err


def test_a_file_has_the_pictures_that_were_asked_for(tmp_path, capsys, refused):
    def pictures(*options, path=tmp_path / "out.gif"):
        assert demo.main([*options, "-o", str(path)]) == 0
        with Image.open(path) as picture:
            assert picture.info["duration"] == 40
            return [
                np.asarray(each.convert("RGB"), int) for each in ImageSequence.Iterator(picture)
            ]

    both = pictures("direct-ppo", "--rival", "pd", "--seconds", "0.4")
    episodes = [Episode(find_policy(name), PAPER, PLANT) for name in ("direct-ppo", "pd")]
    for episode in episodes:
        episode.advance(0.4)
    speeds = "; ".join(
        f"{each.policy.name} {100.0 * state(each)['x'] / 0.4:.2f} cm/s" for each in episodes
    )
    assert capsys.readouterr().out.startswith(
        f"{speeds} over 0.4 s on M = {PLANT.M:g} kg, mu = {PLANT.mu:g}"
    )
    assert len(both) == 11 and (both[0] != both[10]).any()
    # Without the rival.
    alone = pictures("direct-ppo", "--seconds", "0.4", path=tmp_path / "alone.gif")
    assert (np.abs(alone[10] - both[10]).max(axis=2) > 8).sum() > 500
    refused(demo.main, ["adaptive", "--seconds", "0.1", "-o", str(tmp_path / "out.gif")])
    with Image.open(tmp_path / "out.gif") as picture:
        assert picture.n_frames == 11
    assert (
        len(pictures("pd", "--seconds", "0.2", "--speed", "0.5", "--M", "0.6", "--overwrite")) == 11
    )
    assert f"M = 0.6 kg, mu = {PLANT.mu:g}" in capsys.readouterr().out


def test_held_keys_apply_torque_and_cancel_each_other(monkeypatch):
    held = set()
    monkeypatch.setattr(pygame.key, "get_pressed", lambda: {key: key in held for key in KEYS})
    episode = Episode(KEYBOARD, PAPER, PLANT)
    for keys, action in (
        *((key, 1.0 - index // 2 * 2.0) for index, key in enumerate(KEYS)),
        (KEYS, 0.0),
        ((), 0.0),
    ):
        held.clear()
        held.update(np.atleast_1d(keys).tolist())
        episode.advance(episode.time + 0.02)
        assert state(episode)["torque"] == pytest.approx(1.5 * STRENGTH * action)


def test_the_command_ends_with_its_window_and_by_an_interrupt(monkeypatch):
    events = [], [pygame.event.Event(pygame.QUIT)], KeyboardInterrupt
    monkeypatch.setattr(pygame.event, "get", Mock(side_effect=events))
    assert demo.main(["keyboard", "--rival", "adaptive", "--set", "nominal"]) == 0
    assert not pygame.display.get_init()
    with pytest.raises(SystemExit) as ended:
        demo.main(["adaptive"])
    assert ended.value.code == 130
