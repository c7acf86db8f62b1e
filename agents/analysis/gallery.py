"""The animations of the site on the paper's plant, the figure that compares three of them, and the site's card."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from agents.analysis.data import Document
from agents.evaluation.policies import find_candidate
from agents.recording import NOMINAL_TITLE, draw_comparison, record
from capsule_gym.files import replacing
from capsule_gym.rendering import FLOOR, HEADER, INK, PAPER, RULER, SLATE, write_gif

POLICIES = (
    *("adaptive", "epc", "feedback-linearising", "gait-guarded"),
    *("residual-ppo", "residual-on-gait", "direct-ppo", "efficient"),
)
COMPARED = ("adaptive", "efficient", "residual-on-gait")
# The part of an episode that is animated, s: the paper's controller slips once in it.
BEGIN, SECONDS, FRAME_SECONDS = 12.0, 3.4, 0.08
# The card shows a frame with the pendulum to the side.
CARD_POLICY, CARD_FRAME = "residual-on-gait", 5


def document(policies: Sequence[str] = ()) -> Document:
    """The files of the gallery.

    Args:
        policies: names or paths; by default those of the site.
    """
    media: dict[str, Any] = {f"media/{Path(name).name}.gif": partial(animate, name) for name in policies or POLICIES}
    if not policies:
        media["media/card.png"] = draw_card
    return Document(figures={**media, "figures/gallery.png": partial(compare, policies[:4] or COMPARED)})


@cache
def frames_of(name: str) -> tuple[np.ndarray, ...]:
    """Frames of a policy's animation; of a trained one the first seed."""
    policy = find_candidate(name).policies[0]
    end = BEGIN + SECONDS
    return record(policy, seconds=end, frames_from=BEGIN, frame_seconds=FRAME_SECONDS, name=name).frames


def animate(name: str, path: Path) -> None:
    """Writes the animation of a policy as a GIF."""
    write_gif(frames_of(name), path, FRAME_SECONDS, 480)


def compare(names: Sequence[str], path: Path) -> None:
    """Writes the figure that compares policies."""
    recordings = [record(find_candidate(name).policies[0], name=name) for name in names]
    draw_comparison(recordings, path, NOMINAL_TITLE)


def draw_card(path: Path) -> None:
    """Writes the picture that links to the site are shown with: the robot under its name."""
    from matplotlib.font_manager import findfont
    from PIL import Image, ImageDraw, ImageFont

    # The size that most link previews ask for.
    width, height = 1200, 630
    font = findfont("DejaVu Sans")
    card = Image.new("RGB", (width, height), PAPER[:3])
    # The scene without the text in its corner.
    scene = frames_of(CARD_POLICY)[CARD_FRAME][HEADER + 34 : FLOOR + RULER].copy()
    scene[:18, :240] = PAPER[:3]
    picture = Image.fromarray(scene)
    picture = picture.resize((width, round(picture.height * width / picture.width)), Image.Resampling.LANCZOS)
    card.paste(picture, (0, height - picture.height))
    pen = ImageDraw.Draw(card)
    pen.text((60, 50), "capsule_gym", INK[:3], ImageFont.truetype(font, 84))
    pen.text((64, 160), "A robot without legs: a pendulum and dry friction", SLATE[:3], ImageFont.truetype(font, 32))
    with replacing(path) as temporary:
        card.save(temporary, optimize=True)
