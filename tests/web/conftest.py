"""The built page in a real browser, headless."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from web.bundle import bundle

# A user's machine may have none of these; a machine of CI must.
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
SIZE = {"width": 1280, "height": 800}

Open = Callable[..., Any]


@pytest.fixture(scope="session")
def live(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page as a file."""
    path = tmp_path_factory.mktemp("live") / "index.html"
    path.write_text(bundle(Path(os.environ["CAPSULE_MODULE"]).read_text("utf-8")), "utf-8")
    return path


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A browser that this machine has."""
    executable = next(filter(None, map(shutil.which, BROWSERS)), None)
    if executable is None and not os.environ.get("CI"):
        pytest.skip(f"needs a browser: one of {', '.join(BROWSERS)}")
    assert executable, f"CI must have one of {', '.join(BROWSERS)}"
    sync_api = pytest.importorskip("playwright.sync_api", exc_type=ImportError)
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def open_page(browser: Any, live: Path) -> Iterator[Open]:
    """Opens the page with a hash; at the end no page may have written to the console or asked for another file."""
    contexts: list[Any] = []
    said: list[str] = []

    def opened(scene: str = "", **settings: Any) -> Any:
        context = browser.new_context(**{"viewport": SIZE, **settings})
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(20_000)
        page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: said.append(f"error: {error}"))
        page.on("request", lambda request: said.extend([request.url] if not _own(request.url, live) else []))
        page.goto(live.as_uri() + scene)
        page.wait_for_function("document.getElementById('driver').value && location.hash.length > 1")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert said == []


def _own(url: str, live: Path) -> bool:
    return url.startswith((live.as_uri(), "data:", "blob:"))
