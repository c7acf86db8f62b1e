"""What mkdocs does besides: the leaderboard and links to scenes lead to the live page."""

from __future__ import annotations

import html
import json
import re
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlencode

from mkdocs.exceptions import PluginError
from mkdocs.utils import get_relative_url

ROOT = Path(__file__).resolve().parents[1]
# Made by `make web` behind this build, into the same folder.
LIVE = "live/"
# The page about it, which mkdocs would write to the same file, and where it lies instead.
ABOUT_LIVE = "live.md"
ABOUT_LIVE_AT = "in_the_browser/index.html"
# The paper's controller, which the live page shows beside all others.
BASELINE = "adaptive"
# Pages with a ranking of policies.
RANKINGS = ("index.md", "leaderboard.md")
TABLE = re.compile(r"<table>.*?</table>", re.DOTALL)
ROW = re.compile(r"(?<=<tr>).*?(?=</tr>)", re.DOTALL)
# A figure is wider than a telephone: a touch opens it by itself.
FIGURE = re.compile(r'<img\b[^>]*\bsrc="(?P<file>[^"]*figures/[^"]*)"[^>]*>')
CELL = re.compile(r"(?<=<td>).*?(?=</td>)")
# On GitHub such a link leads to the page about the live page, here to the scene itself.
SCENE = re.compile(r"\[(?P<text>[^\]]+)\]\(live\.md#(?P<scene>driver=[^)\s]+)\)")


@cache
def drivers() -> frozenset[str]:
    """What the live page can show: each of its drivers has an episode in web/episodes.json."""
    episodes = json.loads((ROOT / "web" / "episodes.json").read_text(encoding="utf-8"))
    return frozenset(episode["driver"] for episode in episodes)


def on_files(files: Any, config: Any) -> Any:
    """Puts the page about the live page beside the folder of that name, where the live page itself comes to lie.

    Raises:
        PluginError: if another file would come to lie in that folder.
    """
    files.get_file_from_path(ABOUT_LIVE).dest_uri = ABOUT_LIVE_AT
    lost = [file.src_uri for file in files if file.dest_uri.startswith(LIVE)]
    if lost:
        raise PluginError(f"`make web` writes into the same folder {LIVE} as {', '.join(lost)}")
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Makes links to live.md#driver=.. links to that scene of the live page."""
    return SCENE.sub(lambda match: _link(page, match["scene"], match["text"], {}), markdown)


def on_page_content(content: str, page: Any, **_: Any) -> str:
    """Links figures to themselves, and rankings to the live page."""
    content = FIGURE.sub(lambda match: f'<a href="{match["file"]}" title="By itself">{match[0]}</a>', content)
    if page.file.src_uri not in RANKINGS:
        return content
    return TABLE.sub(lambda match: _watched(page, match[0]), content)


def _watched(page: Any, table: str) -> str:
    """A ranking with links to its policies on the live page, next to the paper's law; other tables as they are."""
    heads = re.findall("<th>(.*?)</th>", table)
    if not {"policy", f"x {BASELINE}"} <= {*heads}:
        return table
    return ROW.sub(lambda row: _watched_row(page, row[0], heads.index("policy")), table)


def _watched_row(page: Any, row: str, column: int) -> str:
    """A row of a ranking, whose first cell gets the link, to the first plant of the paper's ranges, if it is shown."""
    cells = CELL.findall(row)
    if not cells or cells[column] not in drivers():
        return row
    words = f"Watch {cells[column]}"
    rival = {} if cells[column] == BASELINE else {"rival": BASELINE}
    scene = urlencode({"driver": cells[column], **rival, "set": "paper", "plant": 0})
    link = _link(page, scene, "&#9654;", {"class": "watch", "title": words, "aria-label": words})
    return CELL.sub(lambda cell: f"{cell[0]} {link}", row, count=1)


def _link(page: Any, scene: str, text: str, attributes: dict[str, str]) -> str:
    """A link to a scene of the live page.

    Raises:
        PluginError: if the live page has none of its drivers.
    """
    given = parse_qs(scene)
    strangers = {*given["driver"], *given.get("rival", [])} - drivers()
    if strangers:
        raise PluginError(f"{page.file.src_uri} links to drivers that the live page lacks: {', '.join(strangers)}")
    address = f"{get_relative_url(LIVE + 'index.html', page.url)}#{scene}"
    written = (f'{name}="{html.escape(value)}"' for name, value in {**attributes, "href": address}.items())
    return f"<a {' '.join(written)}>{text}</a>"
