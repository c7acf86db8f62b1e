"""Hooks of mkdocs: pages of notebooks, links to the live page, words without line breaks."""

import base64
import html
import json
import re
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlencode

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File
from mkdocs.utils import get_relative_url

from capsule_gym.tasks.registry import TASKS
from capsule_gym.tasks.task import METRICS

ROOT = Path(__file__).resolve().parents[1]
# `make web` writes into this folder after mkdocs.
LIVE = "live/"
# By default mkdocs would write the page about the live page to the live page's own file.
ABOUT_LIVE = "live.md"
ABOUT_LIVE_AT = "in_the_browser/index.html"
# The paper's controller, which the live page shows next to each policy.
BASELINE = "adaptive"
# Pages with a ranking of policies.
RANKINGS = ("index.md", "leaderboard.md")
TABLE = re.compile(r"<table>.*?</table>", re.DOTALL)
POLICY = re.compile(r"(?<=<tr>\n<td>)[^<]+(?=</td>)")
# On a telephone a figure is too small to read: a tap opens it alone.
FIGURE = re.compile(r'<img\b[^>]*\bsrc="(?P<file>[^"]*figures/[^"]*)"[^>]*>')
# A telephone would break a line after the hyphens of --set and of 1e-12, and inside short names.
INLINE_CODE = re.compile(r"(?<!<pre><code>)(?<!<span></span><code>)(?<=<code>)[^<]+(?=</code>)")
EXPONENTIAL = re.compile(r"\b\d(?:\.\d+)?e-\d+\b")
LONGEST_WHOLE = 20
# On GitHub such a link leads to the page about the live page; on the site it leads to the scene.
SCENE = re.compile(r"\[(?P<text>[^\]]+)\]\(live\.md#(?P<scene>driver=[^)\s]+)\)")
# In a page: where the table of metrics is inserted.
METRICS_MARK = "<!-- metrics -->"
COLAB = "https://colab.research.google.com/github/"


@cache
def drivers() -> frozenset[str]:
    """The policies that the live page can show, each with an episode in web/episodes.json."""
    episodes = json.loads((ROOT / "web" / "episodes.json").read_text(encoding="utf-8"))
    return frozenset(episode["driver"] for episode in episodes)


def on_files(files: Any, config: Any) -> Any:
    """Adds CONTRIBUTING.md and the notebooks, and moves the page about the live page.

    mkdocs would write that page over the live page itself.

    Raises:
        PluginError: if another file would be written into the folder of the live page.
    """
    files.get_file_from_path(ABOUT_LIVE).dest_uri = ABOUT_LIVE_AT
    clashing = [file.src_uri for file in files if file.dest_uri.startswith(LIVE)]
    if clashing:
        raise PluginError(f"`make web` writes into the same folder {LIVE} as {', '.join(clashing)}")
    contributing = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    content = contributing.replace("](docs/", "](")
    files.append(File.generated(config, "contributing.md", content=content))
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        for name, file in notebook_files(path, config.repo_url or "").items():
            files.append(File.generated(config, f"notebooks/{name}", content=file))
    return files


def notebook_files(path: Path, repository: str) -> dict[str, str | bytes]:
    """A notebook as a Markdown page and its pictures.

    Args:
        path: the notebook.
        repository: its address on GitHub; without one the page has no link to Colab.

    Returns:
        The content of each file by its name.
    """
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in json.loads(path.read_text("utf-8"))["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            # The page lies one folder below the others.
            source = source.replace("](../docs/", "](../")
            source = source.replace("](../LEADERBOARD.md", "](../leaderboard.md")
            parts.append(source)
        else:
            parts.append(f"```python\n{source}\n```")
            # Adds to `pictures`.
            parts += _outputs(cell["outputs"], path.stem, pictures)
    owner = repository.partition("github.com/")[2].strip("/")
    if owner:
        address = f"{COLAB}{owner}/blob/main/notebooks/{path.name}"
        # Below the title.
        parts.insert(1, f"[![Open in Colab](../media/colab.svg)]({address})")
    page = "\n\n".join(parts) + "\n"
    return {f"{path.stem}.md": page, **pictures}


def _outputs(outputs: list[Any], stem: str, pictures: dict[str, bytes]) -> list[str]:
    """The outputs of a cell in Markdown; adds its pictures to those of the notebook."""
    parts: list[str] = []
    for output in outputs:
        data = output.get("data", {})
        if "image/png" in data:
            name = f"{stem}_{len(pictures)}.png"
            pictures[name] = base64.b64decode(data["image/png"])
            parts.append(f"![What the cell shows]({name})")
            continue
        lines = output.get("text", data.get("text/plain", ""))
        text = "".join(lines).rstrip()
        before = "```text\n"
        if parts and parts[-1].startswith(before):
            # A notebook stores what a cell prints in pieces.
            before = parts.pop().removesuffix("```")
        parts.append(f"{before}{text}\n```")
    return parts


def metrics_table() -> str:
    """The metrics of an episode, which the core defines, as a Markdown table."""
    lines = ["|metric|description|", "|---|---|"]
    for task in TASKS.values():
        # The metrics that all tasks share stand once, before those of the first task.
        metrics = {**METRICS, **task.metrics} if task.name == "speed" else task.metrics
        for name, text in metrics.items():
            # A bar would end a cell.
            escaped = text.replace("|", "&#124;")
            lines.append(f"|`{name}`|{escaped}|")
    return "\n".join(lines)


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links live.md#driver=.. to that scene of the live page, and inserts the table of metrics."""
    markdown = markdown.replace(METRICS_MARK, metrics_table())
    return SCENE.sub(lambda match: _link(page, match["scene"], match["text"], {}), markdown)


def on_page_content(content: str, page: Any, **_: Any) -> str:
    """Links figures to files and ranked policies to the live page; keeps short words whole."""
    content = FIGURE.sub(_figure_link, content)
    content = INLINE_CODE.sub(_whole_words, content)
    content = TABLE.sub(_whole_numbers, content)
    if page.file.src_uri not in RANKINGS:
        return content
    return TABLE.sub(lambda table: _watched(page, table[0]), content)


def _figure_link(image: re.Match[str]) -> str:
    return f'<a href="{image["file"]}" title="Open the figure">{image[0]}</a>'


def _whole_words(code: re.Match[str]) -> str:
    return re.sub(r"\S+", _whole, code[0])


def _whole_numbers(table: re.Match[str]) -> str:
    return EXPONENTIAL.sub(_whole, table[0])


def _whole(word: re.Match[str]) -> str:
    """Prevents line breaks in a short word; returns a longer word unchanged."""
    if len(html.unescape(word[0])) > LONGEST_WHOLE:
        return word[0]
    return f'<span class="whole">{word[0]}</span>'


def _watched(page: Any, table: str) -> str:
    """Links the policies in the first column of a ranking to the live page."""
    headings = re.findall("<th>(.*?)</th>", table)
    if not {"policy", "senses"} <= set(headings):
        return table
    return POLICY.sub(lambda cell: _watch(page, cell[0]), table)


def _watch(page: Any, policy: str) -> str:
    """A policy's name with a link to its scene, next to the paper's controller."""
    if policy not in drivers():
        return policy
    scene = {"driver": policy}
    if policy != BASELINE:
        scene["rival"] = BASELINE
    scene |= {"set": "paper", "plant": "0"}
    title = f"Watch {policy}"
    attributes = {"class": "watch", "title": title, "aria-label": title}
    link = _link(page, urlencode(scene), "&#9654;", attributes)
    return f"{policy} {link}"


def _link(page: Any, scene: str, text: str, attributes: dict[str, str]) -> str:
    """A link to a scene of the live page.

    Raises:
        PluginError: if the live page cannot show a policy of the scene.
    """
    given = parse_qs(scene)
    shown = given["driver"] + given.get("rival", [])
    strangers = ", ".join(set(shown) - drivers())
    if strangers:
        source = page.file.src_uri
        raise PluginError(f"{source} links to drivers that the live page lacks: {strangers}")
    address = get_relative_url(LIVE + "index.html", page.url)
    written = ""
    for name, value in {**attributes, "href": f"{address}#{scene}"}.items():
        written += f' {name}="{html.escape(value)}"'
    return f"<a{written}>{text}</a>"
