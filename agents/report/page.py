"""The page of a report: one HTML file that loads no other file."""

from __future__ import annotations

import html
import json
import math
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from agents.analysis.data import SPEED
from agents.controllers import controller_names, describe_policy
from agents.evaluation.episodes import SHARE_OF_OPTIMUM, TABLE_METRICS, TableMetric
from agents.evaluation.policies import BASELINE
from agents.leaderboard.page import RANKING_SET
from agents.leaderboard.rows import Row
from agents.report import COMMAND, figures
from agents.report.data import ROOT, Data, collect
from capsule_gym.files import write_atomically
from capsule_gym.policy import Policy

# The live page, as `make web` builds it.
LIVE = ROOT / "site" / "live" / "index.html"


def write(path: Path, names: Sequence[str] = (), *, trust_controller: bool = False) -> None:
    """Writes the report of some policies, atomically.

    Args:
        path: the page.
        names: as for `agents.report.data.collect`.
        trust_controller: as for `capsule_gym.load_policy`.

    Raises:
        OSError: if a file cannot be read or written.
        ValueError: if there is no such policy, or a file is broken.
    """
    data = collect(names, trust_controller=trust_controller)
    if not LIVE.is_file():
        # As a command, since web imports agents; takes a minute. If it fails, the report says what is missing.
        build = [sys.executable, "-m", "web.build", "--output", str(LIVE.parent)]
        subprocess.run(build, cwd=ROOT, stdout=subprocess.DEVNULL, check=False)
    title = ", ".join(row.name for row in data.subjects) if names else "Leaderboard of capsule_gym"
    write_atomically(path, render(data, title, LIVE))


def render(data: Data, title: str, live: Path) -> str:
    """The whole page as HTML.

    Args:
        data: what it shows.
        title: of the page.
        live: the live page; left out if the file does not exist.
    """
    results = data.results
    costs = {row.name: data.summaries[row.name]["nominal"]["cost_of_transport"]["iqm"] for row in results.rows}
    absent = ", ".join(name for name, cost in costs.items() if cost is None or not math.isfinite(cost))
    parts = [
        f"<h1>{html.escape(title)}</h1>",
        f"<p>{_sentence(data, data.subjects[0])}</p>",
        _motion(live, data),
        _figure(
            "learning",
            "Learning curve",
            "Evaluations on each run's validation plants, never on a frozen set. Grey: the training seeds; blue: their "
            "interquartile mean; band: 95 %.",
            figures.draw_learning,
            results,
        )
        if results.learning
        else "",
        f"<h2>On every set</h2>\n{_table(data)}",
        '<div class="figures">',
        _figure(
            "transport",
            "Speed against cost of transport",
            "Interquartile means over the episodes on nominal; bars: 95 % over training seeds. The fronts are found, "
            f"not proved: they hold one start.{f' Without progress, so without a cost: {absent}.' if absent else ''}",
            figures.draw_transport,
            results.rows,
        ),
        _figure(
            "profiles",
            "Performance profile",
            "The share of episodes that are faster, of all training seeds; bands: 95 %, whole seeds resampled, of a "
            "single seed its episodes.",
            figures.draw_profiles,
            results,
        ),
        _figure(
            "plants",
            "On which plants",
            "A point per episode of the sets with constant parameters: its mean speed, averaged over the training "
            "seeds. A cross: an episode that failed with at least one of them.",
            figures.draw_plants,
            results.rows,
            results.sets,
        ),
        "</div>",
        *(_settings(name, config) for name, config in data.configs.items()),
        _footer(data),
    ]
    body = "\n".join(part for part in parts if part)
    css, script = (Path(__file__).with_name(f"page.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>\n{css}</style>\n</head>\n<body>\n<main>\n{body}\n</main>\n"
        f"<script>\n{script}</script>\n</body>\n</html>\n"
    )


def _sentence(data: Data, row: Row) -> str:
    """What a policy is, how fast it is, and how often it fails."""
    summary, reference = (data.summaries[name][RANKING_SET] for name in (row.name, BASELINE))
    ratio = summary[SPEED]["iqm"] / reference[SPEED]["iqm"]
    description = re.sub("`([^`]+)`", r"<code>\1</code>", html.escape(row.header["description"]))
    return (
        f"<strong>{html.escape(row.name)}</strong> ({description}): "
        f"{TABLE_METRICS[SPEED].with_interval(summary[SPEED])} cm/s on the set <code>{RANKING_SET}</code>, {ratio:.2f} "
        f"times as fast as the paper's controller; {summary['failures']} of {summary['episodes']} episodes failed."
    )


def _figure(name: str, heading: str, caption: str, draw: Any, *arguments: Any) -> str:
    svg = figures.to_svg(draw, name, *arguments)
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{html.escape(heading)}"', 1)
    return (
        f"<section>\n<h2>{html.escape(heading)}</h2>\n<figure>\n{svg}\n"
        f"<figcaption>{html.escape(caption)}</figcaption>\n</figure>\n</section>"
    )


def _table(data: Data) -> str:
    """All measures of all policies on all sets."""
    sets = [each.name for each in data.results.sets]
    heads = ["policy", "set", *(metric.label for metric in TABLE_METRICS.values()), SHARE_OF_OPTIMUM.label, "failed"]
    options = [f'<option value="{name}"{" selected" * (name == RANKING_SET)}>{name}</option>' for name in sets]
    lines = [_line(row.name, name, data.summaries[row.name][name]) for row in data.results.rows for name in sets]
    return (
        '<p><label for="set">Set</label> <select id="set"><option value="">all</option>'
        + "".join(options)
        + '</select></p>\n<div class="wide" tabindex="0" role="region" aria-label="Measures on every set">\n<table>\n'
        + "<thead><tr>"
        + "".join(f'<th scope="col"><button>{html.escape(head)}</button></th>' for head in heads)
        + "</tr></thead>\n<tbody>\n"
        + "\n".join(lines)
        + "\n</tbody>\n</table>\n</div>"
    )


def _line(policy: str, set_name: str, summary: Mapping[str, Any]) -> str:
    failed = summary["failures"] / summary["episodes"]
    cells = [
        f'<th scope="row">{html.escape(policy)}</th>',
        f"<td>{set_name}</td>",
        *(_number(metric, summary[metric.name]) for metric in TABLE_METRICS.values()),
        _number(SHARE_OF_OPTIMUM, summary.get(SHARE_OF_OPTIMUM.name, {"iqm": None, "low": None, "high": None})),
        f'<td data-value="{failed:.6g}">{summary["failures"]}/{summary["episodes"]}</td>',
    ]
    return f'<tr data-set="{set_name}">{"".join(cells)}</tr>'


def _number(metric: TableMetric, summary: Mapping[str, Any]) -> str:
    value = summary["iqm"]
    number, _, interval = metric.with_interval(summary).partition(" ")
    # A missing value is NaN in JavaScript.
    key = f"{value:.6g}" if value is not None and math.isfinite(value) else "NaN"
    return f'<td data-value="{key}">{number} <span class="low">{interval}</span></td>'


def _settings(name: str, config: Mapping[str, Any]) -> str:
    """The settings of a run, folded."""
    shown = {key: config[key] for key in ("algo", "task", "seed", "revision") if key in config}
    shown |= config.get("hyperparameters", {})
    entries = "".join(f"<dt>{html.escape(key)}</dt><dd>{html.escape(str(value))}</dd>" for key, value in shown.items())
    return (
        f"<h2>Settings of {html.escape(name)}</h2>\n<details><summary>All of them</summary><dl>{entries}</dl></details>"
    )


def _footer(data: Data) -> str:
    results = data.results
    versions = ", ".join(f"{name} {number}" for name, number in results.rows[0].header["versions"].items())
    hashes = ", ".join(f"{each.name} {each.hash[:12]}" for each in results.sets)
    return (
        "<footer><p>Numbers are interquartile means with 95 % intervals: over training seeds, resampled whole, or of "
        "a single seed over its episodes. The mean speed of a failed episode is its distance over the whole "
        f"33 s. Written by <code>{COMMAND}</code> with {html.escape(versions)}. Sets: {hashes}.</p></footer>"
    )


def _motion(live: Path, data: Data) -> str:
    """The live page with the fastest policy that it can run, compared with the paper's controller."""
    if not live.is_file():
        return "<p>After <code>make web</code> a report shows its policy in motion, in a page inside of this one.</p>"
    own, known = own_controllers(data.policies), controller_names()
    # The rows are sorted: the first is the fastest.
    shown = [row.name for row in data.subjects if row.name in own or (row.header["disturbed"] and row.name in known)]
    if not shown:
        return ""
    name = shown[0]
    added = [own[name]] if name in own else []
    driver = added[0]["name"] if added else name
    scene = urlencode({"driver": driver, "rival": BASELINE, "set": RANKING_SET, "plant": 0})
    return f"<h2>In motion</h2>\n{embed(live.read_text(encoding='utf-8'), scene, f'{name} and {BASELINE}', added)}"


def own_controllers(policies: Mapping[str, Policy]) -> dict[str, dict[str, Any]]:
    """Policies as the live page takes them, by name; without those whose law, capsule or numbers it does not know."""
    found: dict[str, dict[str, Any]] = {}
    for name, policy in policies.items():
        try:
            # The names of committed policies are in use.
            described = describe_policy(f"own-{name}" if name in controller_names() else name, policy)
            controller = {**described, "network": described["network"].tolist()}
            # JSON has no infinite numbers.
            json.dumps(controller, allow_nan=False)
        except ValueError:
            continue
        found[name] = controller
    return found


def embed(page: str, scene: str, title: str, controllers: Sequence[Mapping[str, Any]] = ()) -> str:
    """A self-contained page as an iframe.

    Args:
        page: its HTML.
        scene: fragment of its address.
        title: for screen readers.
        controllers: policies that are added to the live page, as `addDriver` of web/capsule.mjs takes them.
    """
    begin = f"<script>location.hash = {json.dumps(scene)}</script>"
    if controllers:
        data = json.dumps(controllers).replace("<", r"\u003c")
        begin += f'<script type="application/json" id="own-drivers">{data}</script>'
    whole = html.escape(page.replace("<head>", f"<head>{begin}", 1))
    return f'<iframe title="{html.escape(title)}" loading="lazy" srcdoc="{whole}"></iframe>'
