"""The card that stands for the site where it is linked to: the robot under its name."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from capsule_gym.files import replacing
from capsule_gym.rendering import FLOOR, HEADER, INK, PAPER, RULER, SLATE

# As most places that show such cards ask for it.
WIDTH, HEIGHT = 1200, 630
TITLE, LINE = "capsule_gym", "A robot without legs: a pendulum and dry friction"


def write_card(frame: np.ndarray, path: Path) -> None:
    """Writes the card.

    Args:
        frame: a picture of the robot by `capsule_gym.rendering.Renderer`.
        path: the PNG; written whole or not at all.
    """
    from matplotlib.font_manager import findfont
    from PIL import Image, ImageDraw, ImageFont

    font = findfont("DejaVu Sans")
    card = Image.new("RGB", (WIDTH, HEIGHT), PAPER[:3])
    # The stage alone, without the words in its corner.
    scene = frame[HEADER + 34 : FLOOR + RULER].copy()
    scene[:18, :240] = PAPER[:3]
    stage = Image.fromarray(scene)
    height = round(stage.height * WIDTH / stage.width)
    card.paste(stage.resize((WIDTH, height), Image.Resampling.LANCZOS), (0, HEIGHT - height))
    pen = ImageDraw.Draw(card)
    pen.text((60, 50), TITLE, INK[:3], ImageFont.truetype(font, 84))
    pen.text((64, 160), LINE, SLATE[:3], ImageFont.truetype(font, 32))
    with replacing(path) as temporary:
        card.save(temporary, optimize=True)
