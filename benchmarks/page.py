"""What share of a frame the live page uses: `python -m benchmarks.page`.

The page runs in a real browser, headless, and the time that its callback takes is measured in every frame: simulating,
and issuing what is drawn. What the browser then does with that, in other threads, is not in it.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baselines.tables import markdown_table, text_table
from benchmarks.machine import describe, machine
from benchmarks.output import Output, check_at_least_one
from capsule_gym.command_line import Count, parse, refuse
from web import build

COMMAND = "python -m benchmarks.page"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
SIZE = (1280, 800)
FRAME = 1000.0 / 60.0
WARM_UP = 1000
SCENES = {
    "adaptive": "#driver=adaptive",
    "robust beside adaptive": "#driver=robust&rival=adaptive",
    "robust beside adaptive, two lanes": "#driver=robust&rival=adaptive&view=lane",
    "residual-ppo beside adaptive": "#driver=residual-ppo&rival=adaptive",
    "robust beside adaptive, 5 times as fast": "#driver=robust&rival=adaptive&speed=5",
}
# Every callback of a frame, in ms.
MEASURE = """
window.frames_taken = [];
const request = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (callback) => request((time) => {
  const begin = performance.now();
  callback(time);
  window.frames_taken.push(performance.now() - begin);
});
"""


@dataclass(frozen=True, kw_only=True)
class Options(Output):
    """What share of a frame of 1/60 s the live page uses, in a browser of this machine.

    Examples:
        python -m benchmarks.page --seconds 10
    """

    seconds: Count = 5
    """How long each scene is measured."""

    def check(self) -> None:
        """Refuses what cannot be measured or written."""
        super().check()
        check_at_least_one("--seconds", self.seconds)


def find_browser() -> str | None:
    """The path of one of `BROWSERS`; None where this machine has none."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


@contextmanager
def started(executable: str) -> Iterator[Any]:
    """A browser, headless, as playwright shows it.

    Raises:
        ImportError: if playwright is not installed.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise ImportError('the page needs playwright to be driven: pip install "capsule-gym[dev]"') from error
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        yield browser
        browser.close()


def frames(browser: Any, address: str, seconds: int) -> list[float]:
    """How long the page's callback took in every frame, ms.

    Args:
        browser: from `started`.
        address: of the page, with its scene.
        seconds: how long it is watched.
    """
    width, height = SIZE
    page = browser.new_page(viewport={"width": width, "height": height}, reduced_motion="no-preference")
    page.add_init_script(MEASURE)
    page.goto(address)
    page.wait_for_timeout(WARM_UP)
    page.evaluate("window.frames_taken.length = 0")
    page.wait_for_timeout(1000 * seconds)
    taken: list[float] = page.evaluate("window.frames_taken")
    page.close()
    return taken


def row(name: str, taken: Sequence[float], seconds: int) -> list[str]:
    """A row of the table."""
    middle, most = np.percentile(taken, (50.0, 95.0))
    return [
        name,
        f"{len(taken) / seconds:.0f}",
        f"{middle:.1f}",
        f"{middle / FRAME:.0%}",
        f"{most:.1f}",
        f"{most / FRAME:.0%}",
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    executable = find_browser()
    if executable is None:
        refuse(COMMAND, f"a browser must be installed, one of {', '.join(BROWSERS)}")
    measured = {}
    try:
        with tempfile.TemporaryDirectory() as folder, started(executable) as browser:
            build.main(["--folder", folder])
            address = (Path(folder) / "index.html").as_uri()
            for name, scene in SCENES.items():
                measured[name] = frames(browser, address + scene, options.seconds)
            version = browser.version
    except ImportError as error:
        refuse(COMMAND, str(error))
    head = ["scene", "frames/s", "median, ms", "of a frame", "95 %, ms", "of a frame"]
    table = [head, *(row(name, taken, options.seconds) for name, taken in measured.items())]
    found = machine()
    note = (
        f"{SIZE[0]} by {SIZE[1]} pixels, all charts; {options.seconds} s of each scene, whose frames of 1/60 s have "
        f"{FRAME:.1f} ms. {describe(found)}, Chromium {version}, headless."
    )
    print(text_table(table, left=1, last_left=False), note, sep="\n\n")
    numbers = {"machine": found, "browser": version, "seconds": options.seconds, "frames": measured}
    options.write(COMMAND, numbers, [markdown_table(table), "", note])
    return 0


if __name__ == "__main__":
    sys.exit(main())
