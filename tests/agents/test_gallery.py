import pytest
from PIL import Image

from agents.evaluation import policies
from agents.gallery import __main__ as gallery
from tests.agents.fakes import Sine

SIZE = 400_000


def test_gallery_is_drawn(tmp_path, monkeypatch):
    known = {name: Sine(0.3, name="a folder's name") for name in ("one", "two")}
    monkeypatch.setattr(policies, "SCRIPTED", known)
    for name, value in {
        "DRIVERS": ("one", "two"),
        "COMPARED": ("one", "two"),
        "CARD_DRIVER": "two",
        "CARD_FRAME": 1,
        "BEGIN": 0.1,
        "SECONDS": 0.4,
    }.items():
        monkeypatch.setattr(gallery, name, value)
    assert gallery.main(["--output", str(tmp_path)]) == 0
    with Image.open(tmp_path / "media" / "two.gif") as moving:
        assert (moving.n_frames, moving.width, moving.info["duration"]) == (6, 480, 80)
    with Image.open(tmp_path / "media" / "card.png") as card:
        assert card.size == (1200, 630)
    assert {path.name for path in tmp_path.rglob("*.*")} == {"one.gif", "two.gif", "card.png", "gallery.png"}


@pytest.mark.parametrize("name", gallery.DRIVERS)
def test_committed_pictures_are_small(name):
    assert 10_000 < (gallery.ROOT / "docs" / "media" / f"{name}.gif").stat().st_size < SIZE
