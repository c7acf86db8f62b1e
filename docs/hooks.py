"""What mkdocs does besides: rows of the leaderboard get links to the live page, and every link is checked.

Nothing of the site is fetched from elsewhere: it reads the same without a network and from any host.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from mkdocs.exceptions import PluginError

RANKED = re.compile(r"(?P<place><td>\d+)(?P<between></td>\s*<td>)(?P<name>[\w-]+)(?=</td>)")
# Made by `make web` behind this build, into the same folder.
LIVE = "live/"
# What loads a file; any other link may lead elsewhere.
LOADING = {"audio", "iframe", "img", "link", "script", "source", "video"}
# Links that load nothing, among those of `link`.
UNLOADED = {"canonical", "next", "prev"}


def _watch(match: re.Match[str]) -> str:
    """A row of the ranking with a link to its policy on the live page, beside the paper's controller."""
    name = match["name"]
    scene = f"../{LIVE}index.html#driver={name}&amp;rival=adaptive&amp;set=paper&amp;plant=0"
    link = f'<a class="watch" href="{scene}" title="Watch {name}" aria-label="Watch {name}">&#9654;</a>'
    return f"{match['place']} {link}{match['between']}{name}"


def on_page_content(content: str, page: Any, **_: Any) -> str:
    """Links the leaderboard to the live page."""
    return RANKED.sub(_watch, content) if page.file.src_uri == "leaderboard.md" else content


class _Links(HTMLParser):
    """What a page links to: pairs of an address and whether the page loads it."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, bool]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        loaded = tag in LOADING and given.get("rel") not in UNLOADED
        self.found += [(address, loaded) for name in ("href", "src") if (address := given.get(name))]


def broken_links(site: Path, base: str = "/") -> Iterator[str]:
    """What is wrong with the links of a built site, in words.

    Args:
        site: its folder.
        base: the path of the address that it will stand at, which begins addresses from the root.
    """
    for page in sorted(site.rglob("*.html")):
        name = page.relative_to(site).as_posix()
        if name.startswith(LIVE):
            continue
        links = _Links()
        links.feed(page.read_text(encoding="utf-8"))
        for address, loaded in links.found:
            parts = urlsplit(address)
            if parts.scheme or parts.netloc:
                if loaded and parts.scheme != "data":
                    yield f"{name} loads {address} from elsewhere"
            elif parts.path and not _exists(site, page, unquote(parts.path), base):
                yield f"{name} links to {address}, which does not exist"


def _exists(site: Path, page: Path, path: str, base: str) -> bool:
    target = site / path.removeprefix(base).lstrip("/") if path.startswith("/") else page.parent / path
    target = target.resolve()
    if target.is_relative_to((site / LIVE).resolve()):
        return True
    return (target / "index.html").is_file() if target.is_dir() else target.is_file()


def on_post_build(config: Any, **_: Any) -> None:
    """Fails where a link or a picture of the built site leads nowhere, or a page loads something from elsewhere."""
    broken = list(broken_links(Path(config["site_dir"]), urlsplit(config["site_url"] or "").path or "/"))
    if broken:
        raise PluginError("\n".join(["The site is broken:", *broken]))
