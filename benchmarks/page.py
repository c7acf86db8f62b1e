"""What share of a frame the live page uses: `python -m benchmarks.page`.

The page runs in a real browser, headless. Measured is the processor's time of the page's thread, which simulates, lays
out and issues what is drawn; what the browser then does with that in other threads is not in it. Other work of the
machine is not counted either, but where it makes frames fewer, each has more to simulate, in code that is not warm.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from baselines.tables import markdown_table, text_table
from benchmarks.machine import describe, machine
from benchmarks.output import Output, check_at_least_one
from capsule_gym.command_line import Count, parse, refuse
from web import build

COMMAND = "python -m benchmarks.page"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
SIZE = (1280, 800)
WARM_UP = 1000
SCENES = {
    "adaptive": "#driver=adaptive",
    "robust beside adaptive": "#driver=robust&rival=adaptive",
    "robust beside adaptive, two lanes": "#driver=robust&rival=adaptive&view=lane",
    "residual-ppo beside adaptive": "#driver=residual-ppo&rival=adaptive",
    "robust beside adaptive, 5 times as fast": "#driver=robust&rival=adaptive&speed=5",
}
# Counts the frames.
COUNT = """
window.frames_taken = 0;
const request = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (callback) => {
  window.frames_taken += 1;
  return request(callback);
};
"""


@dataclass(frozen=True)
class Busy:
    """What one scene took.

    Attributes:
        frames: how many there were.
        seconds: processor's time of the page's thread, s.
    """

    frames: int
    seconds: float

    @property
    def share(self) -> float:
        """Of 1/60 s, per frame."""
        return 60.0 * self.seconds / self.frames


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


def watch(browser: Any, address: str, seconds: int) -> Busy:
    """Lets a scene play.

    Args:
        browser: from `started`.
        address: of the page, with its scene.
        seconds: how long it is watched.
    """
    width, height = SIZE
    page = browser.new_page(viewport={"width": width, "height": height}, reduced_motion="no-preference")
    page.add_init_script(COUNT)
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})

    def count() -> tuple[int, float]:
        metrics = {each["name"]: each["value"] for each in session.send("Performance.getMetrics")["metrics"]}
        return page.evaluate("window.frames_taken"), metrics["TaskDuration"]

    page.goto(address)
    page.wait_for_timeout(WARM_UP)
    frames, busy = count()
    page.wait_for_timeout(1000 * seconds)
    last, total = count()
    page.close()
    return Busy(last - frames, total - busy)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    executable = find_browser()
    if executable is None:
        refuse(COMMAND, f"a browser must be installed, one of {', '.join(BROWSERS)}")
    measured = {}
    try:
        with tempfile.TemporaryDirectory() as folder, started(executable) as browser:
            build.main(["--output", folder])
            address = (Path(folder) / "index.html").as_uri()
            for name, scene in SCENES.items():
                measured[name] = watch(browser, address + scene, options.seconds)
            version = browser.version
    except ImportError as error:
        refuse(COMMAND, str(error))
    table = [["scene", "frames/s", "ms per frame", "of 1/60 s"]]
    for name, busy in measured.items():
        rate, each = busy.frames / options.seconds, 1000.0 * busy.seconds / busy.frames
        table.append([name, f"{rate:.0f}", f"{each:.1f}", f"{busy.share:.0%}"])
    found = machine()
    note = (
        f"Processor's time of the page's thread, {SIZE[0]} by {SIZE[1]} pixels, {options.seconds} s of each scene. "
        f"{describe(found)}, Chromium {version}, headless."
    )
    print(text_table(table, left=1, last_left=False), note, sep="\n\n")
    numbers: dict[str, Any] = {
        "machine": found,
        "browser": version,
        "seconds": options.seconds,
        "scenes": {name: asdict(busy) for name, busy in measured.items()},
    }
    options.write(COMMAND, numbers, [markdown_table(table), "", note])
    return 0


if __name__ == "__main__":
    sys.exit(main())
