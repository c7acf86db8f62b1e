"""The page of a report: one HTML file that loads nothing, from elsewhere or from beside it."""

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

from agents.browser import describe_policy
from agents.drivers import driver_names
from agents.evaluation.episodes import SHARE_OF_OPTIMUM, TABLE_METRICS, TableMetric
from agents.evaluation.policies import BASELINE
from agents.evidence.material import SPEED
from agents.leaderboard.page import RANKING_SET
from agents.leaderboard.rows import Row
from agents.report import COMMAND, figures
from agents.report.material import ROOT, Material, collect, fastest
from capsule_gym.files import write_atomically
from capsule_gym.policy import Policy

# The live page, as `make web` builds it.
LIVE = ROOT / "site" / "live" / "index.html"
HERE = Path(__file__).parent


def write(path: Path, names: Sequence[str] = (), *, trust_controller: bool = False) -> None:
    """Writes the report of some policies, whole or not at all.

    Args:
        path: the page.
        names: as for `agents.report.material.collect`.
        trust_controller: as for `capsule_gym.load_policy`.

    Raises:
        OSError: if a file cannot be read or written.
        ValueError: if there is no such policy, or a file is not what it should be.
    """
    material = collect(names, trust_controller=trust_controller)
    title = ", ".join(row.name for row in material.subjects) if names else "Leaderboard of capsule_gym"
    write_atomically(path, render(material, title, live_page()))


def live_page() -> Path:
    """The live page; where there is none yet, it is built, which takes a minute or two and says so on stderr."""
    if not LIVE.is_file():
        # As a command: it is made of what lies above the agents. Without it, a report says what it lacks.
        command = [sys.executable, "-m", "web.build", "--output", str(LIVE.parent)]
        subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL, check=False)
    return LIVE


def render(material: Material, title: str, live: Path) -> str:
    """The whole page.

    Args:
        material: what it shows.
        title: of the page.
        live: the live page; where there is none, it is left out.
    """
    evidence, subjects = material.evidence, material.subjects
    still = ", ".join(row.name for row in evidence.rows if _cost(material, row) is None)
    parts = [
        f"<h1>{html.escape(title)}</h1>",
        *(f"<p>{_sentence(material, row)}</p>" for row in subjects[:1]),
        _live(live, material),
        _learning(material),
        "<h2>On every set</h2>",
        _table(material),
        '<div class="figures">',
        _figure(
            "transport",
            "Speed against cost of transport",
            "Interquartile means over the episodes on nominal; bars: 95 % over training seeds. The fronts are found, "
            f"not proved: they hold one start.{f' Without progress, so without a cost: {still}.' if still else ''}",
            figures.transport,
            evidence.rows,
        ),
        _figure(
            "profiles",
            "Performance profile",
            "The share of episodes that are faster, of all training seeds; bands: 95 %, whole seeds resampled, of a "
            "single seed its episodes.",
            figures.profiles,
            evidence.rows,
            evidence.shown_sets,
        ),
        _figure(
            "plants",
            "On which plants",
            "A point per episode of the sets whose plants do not change on the way: its mean speed, averaged over the "
            "training seeds. A cross: an episode that failed with at least one of them.",
            figures.plants,
            evidence.rows,
            evidence.sets,
        ),
        "</div>",
        *(_config(name, config) for name, config in material.configs.items()),
        _footer(material),
    ]
    return _document(title, "\n".join(part for part in parts if part))


def _document(title: str, body: str) -> str:
    css, script = ((HERE / f"page.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>\n{css}</style>\n</head>\n<body>\n<main>\n{body}\n</main>\n"
        f"<script>\n{script}</script>\n</body>\n</html>\n"
    )


def _cost(material: Material, row: Row) -> float | None:
    cost: float | None = material.summaries[row.name]["nominal"]["cost_of_transport"]["iqm"]
    return cost if cost is not None and math.isfinite(cost) else None


def _sentence(material: Material, row: Row) -> str:
    """What there is to say first: what a policy is, how fast, and whether it fails."""
    summary, reference = (material.summaries[name][RANKING_SET] for name in (row.name, BASELINE))
    speed = summary[SPEED]
    ratio = speed["iqm"] / reference[SPEED]["iqm"]
    description = re.sub("`([^`]+)`", r"<code>\1</code>", html.escape(row.header["description"]))
    return (
        f"<strong>{html.escape(row.name)}</strong> ({description}): "
        f"{TABLE_METRICS[SPEED].with_interval(speed)} cm/s on the set <code>{RANKING_SET}</code>, {ratio:.2f} times "
        f"as fast as the paper's controller; {summary['failures']} of {summary['episodes']} episodes failed."
    )


def _figure(name: str, heading: str, caption: str, figure_of: Any, *arguments: Any) -> str:
    svg = figures.draw(figure_of, name, *arguments)
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{html.escape(heading)}"', 1)
    return (
        f"<section>\n<h2>{html.escape(heading)}</h2>\n<figure>\n{svg}\n"
        f"<figcaption>{html.escape(caption)}</figcaption>\n</figure>\n</section>"
    )


def _learning(material: Material) -> str:
    if not material.evidence.learning:
        return ""
    return _figure(
        "learning",
        "Learning curve",
        "Evaluations on each run's own draws, never on a frozen set. Grey: the training seeds; blue: their "
        "interquartile mean; band: 95 %.",
        figures.learning,
        material.evidence,
    )


def _table(material: Material) -> str:
    """All measures of all policies on all sets."""
    evidence = material.evidence
    heads = ["policy", "set", *(measure.label for measure in TABLE_METRICS.values()), SHARE_OF_OPTIMUM.label, "failed"]
    rows = [
        _line(row.name, each.name, material.summaries[row.name][each.name])
        for row in evidence.rows
        for each in evidence.sets
    ]
    chosen = {True: " selected", False: ""}
    options = "".join(
        f'<option value="{each.name}"{chosen[each.name == RANKING_SET]}>{each.name}</option>' for each in evidence.sets
    )
    return (
        f'<p><label for="set">Set</label> <select id="set"><option value="">all</option>{options}</select></p>\n'
        '<div class="wide" tabindex="0" role="region" aria-label="Measures on every set">\n<table>\n<thead><tr>'
        + "".join(f'<th scope="col"><button>{html.escape(head)}</button></th>' for head in heads)
        + "</tr></thead>\n<tbody>\n"
        + "\n".join(rows)
        + "\n</tbody>\n</table>\n</div>"
    )


def _line(policy: str, set_name: str, summary: Mapping[str, Any]) -> str:
    failed = summary["failures"] / summary["episodes"]
    cells = [
        f'<th scope="row">{html.escape(policy)}</th>',
        f"<td>{set_name}</td>",
        *(_number(measure, summary[measure.name]) for measure in TABLE_METRICS.values()),
        _number(SHARE_OF_OPTIMUM, summary.get(SHARE_OF_OPTIMUM.name, {"iqm": None, "low": None, "high": None})),
        f'<td data-value="{failed:.6g}">{summary["failures"]}/{summary["episodes"]}</td>',
    ]
    return f'<tr data-set="{set_name}">{"".join(cells)}</tr>'


def _number(measure: TableMetric, summary: Mapping[str, Any]) -> str:
    value = summary["iqm"]
    number, _, interval = measure.with_interval(summary).partition(" ")
    # As JavaScript reads it: what does not exist is NaN.
    key = f"{value:.6g}" if value is not None and math.isfinite(value) else "NaN"
    return f'<td data-value="{key}">{number} <span class="low">{interval}</span></td>'


def _config(name: str, config: Mapping[str, Any]) -> str:
    """What a run was told, folded."""
    told = {key: config[key] for key in ("algo", "task", "seed", "revision") if key in config} | config.get(
        "hyperparameters", {}
    )
    entries = "".join(f"<dt>{html.escape(key)}</dt><dd>{html.escape(str(value))}</dd>" for key, value in told.items())
    return (
        f"<h2>Settings of {html.escape(name)}</h2>\n<details><summary>All of them</summary><dl>{entries}</dl></details>"
    )


def _footer(material: Material) -> str:
    evidence = material.evidence
    versions = ", ".join(f"{name} {number}" for name, number in evidence.rows[0].header["versions"].items())
    hashes = ", ".join(f"{each.name} {each.hash[:12]}" for each in evidence.sets)
    return (
        "<footer><p>Numbers are interquartile means with 95 % intervals: over training seeds, resampled whole, or of "
        "a single seed over its episodes. A failed episode's mean speed is the distance it had made over the whole "
        f"33 s. Written by <code>{COMMAND}</code> with {html.escape(versions)}. Sets: {hashes}.</p></footer>"
    )


def _live(live: Path, material: Material) -> str:
    """The fastest policy that the live page can show, beside the paper's controller."""
    if not live.is_file():
        return "<p>After <code>make web</code> a report shows its policy in motion, in a page inside of this one.</p>"
    own = own_drivers(material.policies)
    shown = [
        row for row in material.subjects if row.name in own or (row.header["disturbed"] and row.name in driver_names())
    ]
    if not shown:
        return ""
    row = fastest(shown)
    added = [own[row.name]] if row.name in own else []
    driver = added[0]["name"] if added else row.name
    scene = urlencode({"driver": driver, "rival": BASELINE, "set": RANKING_SET, "plant": 0})
    page = embedded(live.read_text(encoding="utf-8"), scene, f"{row.name} beside {BASELINE}", added)
    return f"<h2>In motion</h2>\n{page}"


def own_drivers(policies: Mapping[str, Policy]) -> dict[str, dict[str, Any]]:
    """Policies as the live page takes them, by name; without those whose law, capsule or numbers it lacks."""
    found: dict[str, dict[str, Any]] = {}
    for name, policy in policies.items():
        try:
            # The page has committed policies under their names.
            described = describe_policy(f"own-{name}" if name in driver_names() else name, policy)
            driver = {**described, "network": described["network"].tolist()}
            # JSON has no number that is not finite.
            json.dumps(driver, allow_nan=False)
        except ValueError:
            continue
        found[name] = driver
    return found


def embedded(page: str, scene: str, title: str, drivers: Sequence[Mapping[str, Any]] = ()) -> str:
    """A self-contained page inside of another, at a scene of its own.

    Args:
        page: its HTML.
        scene: what stands behind the # of its address.
        title: says what it shows, for those who do not see it.
        drivers: what the live page is to have besides its own drivers, as `addDriver` of web/capsule.mjs takes them.
    """
    begin = f"<script>location.hash = {json.dumps(scene)}</script>"
    if drivers:
        data = json.dumps(drivers).replace("<", r"\u003c")
        begin += f'<script type="application/json" id="own-drivers">{data}</script>'
    whole = html.escape(page.replace("<head>", f"<head>{begin}", 1))
    return f'<iframe title="{html.escape(title)}" loading="lazy" srcdoc="{whole}"></iframe>'
