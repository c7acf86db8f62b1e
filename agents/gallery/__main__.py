"""Draws a moving picture of each of some drivers, the figure that compares them, and the site's card."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from agents.evaluation.policies import find_candidate
from agents.gallery.card import write_card
from agents.recording import NOMINAL_TITLE, Recording, draw_comparison, record
from capsule_gym.command_line import parse
from capsule_gym.rendering import write_gif

COMMAND = "python -m agents.gallery"
ROOT = Path(__file__).resolve().parents[2]
DRIVERS = (
    *("adaptive", "epc", "feedback-linearising", "gait-guarded"),
    *("residual-ppo", "residual-on-gait", "direct-ppo", "efficient"),
)
COMPARED = ("adaptive", "efficient", "residual-on-gait")
# The part of an episode that moves, s: the paper's controller slips once in it.
BEGIN, SECONDS = 12.0, 3.4
FRAME_SECONDS, WIDTH = 0.08, 480
# On the card the pendulum stands to the side.
CARD_DRIVER, CARD_FRAME = "residual-on-gait", 5


@dataclass(frozen=True)
class Options:
    """Draws the gallery of the site on the paper's plant: DIR/media/*.gif, DIR/media/card.png, DIR/figures/gallery.png.

    Examples:
      python -m agents.gallery
      python -m agents.gallery --output elsewhere
    """

    output: Annotated[Path, arg(metavar="DIR", aliases=["-o"])] = ROOT / "docs"
    """Where; the pictures of the same names there are replaced."""


def moving(name: str) -> Recording:
    """A driver on the paper's plant, with pictures; of a trained one the first seed."""
    policy = find_candidate(name).policies[0]
    return record(policy, seconds=BEGIN + SECONDS, frames_from=BEGIN, frame_seconds=FRAME_SECONDS, name=name)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    media, figures = options.output / "media", options.output / "figures"
    for folder in (media, figures):
        folder.mkdir(parents=True, exist_ok=True)
    for name in DRIVERS:
        frames = moving(name).frames
        write_gif(frames, media / f"{name}.gif", FRAME_SECONDS, WIDTH)
        if name == CARD_DRIVER:
            write_card(frames[CARD_FRAME], media / "card.png")
        print(f"Written: {media / name}.gif", flush=True)
    compared = [record(find_candidate(name).policies[0], name=name) for name in COMPARED]
    draw_comparison(compared, figures / "gallery.png", NOMINAL_TITLE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
