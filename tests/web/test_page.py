"""The live page: every control by mouse and by keyboard, links, and how it stands on screens of any width."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import pytest

from agents.report.page import embed, own_controllers
from benchmarks.web import BROWSERS, find_browser, started
from capsule_gym import load_policy
from web import build

LAW = "#driver=adaptive&M=0.5&mu=0.01"
PAUSED = f"{LAW}&t=0.1"
# Milliseconds that a machine with other work may take over anything here, but for the check.
PATIENCE = 60_000
MINUS = "\N{MINUS SIGN}"
SIZE = {"width": 1280, "height": 800}

Open = Callable[..., Any]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A browser. A user's machine may have none, CI must."""
    executable = find_browser()
    if executable is None and "CI" not in os.environ:
        pytest.skip(f"needs a browser: one of {', '.join(BROWSERS)}")
    assert executable, f"CI must have one of {', '.join(BROWSERS)}"
    with started(executable) as browser:
        yield browser


@pytest.fixture
def open_page(browser: Any, site: Path) -> Iterator[Open]:
    """Opens the page with a hash; at the end no page may have written to the console or asked for another file."""
    live = (site / "index.html").as_uri()
    contexts: list[Any] = []
    said: list[str] = []

    def opened(scene: str = "", **settings: Any) -> Any:
        context = browser.new_context(**{"viewport": SIZE, **settings})
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(PATIENCE)
        page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: said.append(f"error: {error}"))
        page.on("request", lambda request: said.extend([request.url] if not _own(request.url, live) else []))
        page.goto(live + scene)
        page.wait_for_function("document.getElementById('driver').value && location.hash.length > 1")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert said == []


def _own(url: str, live: str) -> bool:
    return url.startswith((live, "data:", "blob:"))


def figure(page: Any, name: str) -> float:
    """One of the numbers above the stage."""
    return float(page.locator(f"#figure-{name}").text_content().replace(MINUS, "-"))


def reaches(page: Any, time: float) -> None:
    """Waits until that time is shown, or a later one."""
    page.wait_for_function("time => Number(document.getElementById('figure-time').textContent) >= time", arg=time)


def shows(page: Any, name: str, text: str, patience: int = PATIENCE) -> None:
    """Waits until an element holds that text."""
    holds = "([id, text]) => document.getElementById(id).textContent.includes(text)"
    page.wait_for_function(holds, arg=[name, text], timeout=patience)


def link(page: Any) -> dict[str, str]:
    """What the address says behind the #."""
    return {key: values[0] for key, values in parse_qs(page.evaluate("location.hash.slice(1)")).items()}


def measures(page: Any) -> list[str]:
    """The table of measures, row by row."""
    return page.locator("#rows tr").all_inner_texts()


def playing(page: Any) -> bool:
    """Whether time goes on."""
    return page.locator("#play").get_attribute("aria-label") == "Pause"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [360, 1280, 2560])
def test_page_fits_any_width(open_page: Open, width: int, scheme: str) -> None:
    page = open_page(
        "#driver=yourself&rival=adaptive&view=lane", viewport={"width": width, "height": 800}, color_scheme=scheme
    )
    assert page.evaluate("document.documentElement.scrollWidth") == width
    outside = page.evaluate(
        """() => [...document.querySelectorAll("button, input, select, canvas, table")].filter((node) => {
            const { left, right, width } = node.getBoundingClientRect();
            return width > 0 && (left < 0 || right > innerWidth + 0.5);
        }).map((node) => node.id || node.tagName)"""
    )
    assert outside == []


def test_themes_differ_and_follow_the_system(open_page: Open) -> None:
    page = open_page(PAUSED)
    shows(page, "figure-time", "0.10")
    light = [page.locator(name).screenshot() for name in ("header", "#scene", "figure canvas >> nth=0")]
    page.emulate_media(color_scheme="dark")
    page.wait_for_timeout(200)
    dark = [page.locator(name).screenshot() for name in ("header", "#scene", "figure canvas >> nth=0")]
    assert all(before != after for before, after in zip(light, dark, strict=True))


def test_every_control_has_a_name(open_page: Open) -> None:
    page = open_page("#driver=yourself&rival=adaptive")
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("button, input, select, [role]")].filter((node) =>
            !node.labels?.length && !node.ariaLabel && !node.textContent.trim() && !node.hasAttribute("aria-labelledby")
            && !["status", "alert"].includes(node.role)).map((node) => node.outerHTML)"""
    )
    assert nameless == []


def test_every_control_is_reached_by_the_tab_key(open_page: Open) -> None:
    page = open_page("#driver=yourself&rival=adaptive&t=0.1&hand=5u")
    page.wait_for_timeout(100)
    expected = page.evaluate(
        """() => [...document.querySelectorAll("button, input, select, #stage")]
            .filter((node) => node.checkVisibility() && !node.disabled).map((node) => node.id)"""
    )
    reached = []
    for _ in range(len(expected) + 5):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("document.activeElement.id"))
    assert set(expected) <= set(reached)


def test_plays_and_pauses_by_mouse(open_page: Open) -> None:
    page = open_page(LAW)
    assert playing(page)
    reaches(page, 0.3)
    page.click("#play")
    assert not playing(page)
    before = figure(page, "time")
    page.wait_for_timeout(200)
    assert figure(page, "time") == before
    page.click("#play")
    reaches(page, before + 0.2)


def test_plays_and_pauses_by_keyboard(open_page: Open) -> None:
    page = open_page(PAUSED)
    page.focus("#stage")
    page.keyboard.press("Space")
    reaches(page, 0.5)
    page.keyboard.press("Space")
    assert not playing(page)
    page.focus("#play")
    page.keyboard.press("Enter")
    assert playing(page)


def test_goes_step_by_step(open_page: Open) -> None:
    page = open_page(PAUSED)
    shows(page, "figure-time", "0.10")
    page.click("#step")
    shows(page, "figure-time", "0.12")
    page.focus("#stage")
    page.keyboard.press(".")
    shows(page, "figure-time", "0.14")
    page.focus("#back")
    page.keyboard.press("Enter")
    shows(page, "figure-time", "0.12")


def test_scrubs_there_and_back_to_the_same_picture(open_page: Open) -> None:
    page = open_page(PAUSED)
    shows(page, "figure-time", "0.10")
    before = measures(page)
    page.focus("#scrub")
    page.keyboard.press("End")
    shows(page, "figure-time", "33.00")
    assert measures(page) != before
    page.keyboard.press("Home")
    shows(page, "figure-time", "0.00")
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    shows(page, "figure-time", "0.10")
    assert measures(page) == before


def test_a_chart_seeks_where_it_is_clicked(open_page: Open) -> None:
    page = open_page(f"{LAW}&t=9")
    shows(page, "figure-time", "9.00")
    page.locator("figure canvas").first.click(position={"x": 200, "y": 40})
    page.wait_for_function("Number(document.getElementById('figure-time').textContent) < 8.9")
    assert figure(page, "time") > 0.5


def test_speed_is_what_time_passes_at(open_page: Open) -> None:
    page = open_page(f"{LAW}&speed=20")
    reaches(page, 0.1)
    begin = figure(page, "time")
    page.wait_for_timeout(300)
    quick = figure(page, "time") - begin
    page.focus("#speed")
    page.keyboard.press("Home")
    shows(page, "speed-value", "0.1 ")
    assert link(page)["speed"] == "0.1"
    begin = figure(page, "time")
    page.wait_for_timeout(300)
    assert figure(page, "time") - begin < quick
    page.keyboard.press("End")
    shows(page, "speed-value", "20 ")
    assert link(page)["speed"] == "20"


def test_every_driver_drives_and_is_the_rival(open_page: Open) -> None:
    page = open_page(PAUSED)
    for control in ("driver", "rival"):
        for value in page.locator(f"#{control} option").evaluate_all("options => options.map((one) => one.value)"):
            page.select_option(f"#{control}", value)
            if control == "driver":
                page.click("#play") if playing(page) else None
            page.focus("#step")
            page.keyboard.press("Enter")
            page.wait_for_function("Number(document.getElementById('figure-time').textContent) > 0")
            assert page.locator("#trouble").is_hidden(), page.locator("#trouble").text_content()
            assert link(page).get(control, "") == value


def test_rival_as_a_ghost_or_in_a_lane_of_its_own(open_page: Open) -> None:
    page = open_page(f"{PAUSED}&rival=epc")
    assert all(len(row.split("\t")) == 3 and row.split("\t")[2] for row in measures(page))
    low = page.locator("#stage").bounding_box()["height"]
    page.select_option("#view", "lane")
    assert page.locator("#stage").bounding_box()["height"] > low
    assert link(page)["view"] == "lane"
    page.select_option("#rival", "")
    assert page.locator("#view").is_disabled()
    assert "rival" not in link(page)


def test_plants_of_a_set(open_page: Open) -> None:
    page = open_page(PAUSED)
    page.select_option("#set", "paper")
    first = page.input_value("#M-number")
    page.fill("#plant", "7")
    page.keyboard.press("Tab")
    page.wait_for_function("first => document.getElementById('M-number').value !== first", arg=first)
    assert (link(page)["set"], link(page)["plant"]) == ("paper", "7")
    assert page.locator("#trouble").is_hidden()
    page.fill("#plant", "1000")
    page.keyboard.press("Tab")
    page.wait_for_function("document.getElementById('plant').value === '99'")
    shows(page, "trouble", "Plant must be a whole number from 0 to 99: 99 is taken")
    page.select_option("#set", "")
    page.wait_for_function("document.getElementById('plant').disabled")


def test_plant_is_set_before_the_first_step(open_page: Open) -> None:
    page = open_page(LAW, reduced_motion="reduce")
    page.fill("#M-number", "0.6")
    page.keyboard.press("Tab")
    page.wait_for_function("location.hash.includes('M=0.6')")
    page.focus("#mu")
    page.keyboard.press("Home")
    page.wait_for_function("!location.hash.includes('mu=0.01&') && !location.hash.endsWith('mu=0.01')")
    assert "jumps" not in link(page)
    assert link(page)["M"] == "0.6"


def test_a_recorded_driver_keeps_the_plants_of_the_sets(open_page: Open) -> None:
    page = open_page(PAUSED)
    page.select_option("#driver", "optimum-oracle")
    page.wait_for_function("location.hash.includes('set=nominal')")
    for control in ("#M", "#M-number", "#mu", "#mu-number", "#jump"):
        assert page.locator(control).is_disabled()
    assert page.locator("#set option").first.is_disabled()
    shows(page, "plant-text", "recorded on the plants of the sets")
    page.select_option("#set", "drift")
    page.wait_for_function("location.hash.includes('set=drift')")
    page.select_option("#driver", "epc")
    page.wait_for_function("!document.getElementById('jump').disabled")
    page.click("#play") if playing(page) else None
    # A rival asks for the same.
    page.click("#jump")
    page.wait_for_function("!location.hash.includes('set=') || location.hash.includes('jumps=')")
    page.select_option("#rival", "optimum-nominal")
    page.wait_for_function("location.hash.includes('set=') && !location.hash.includes('jumps=')")
    assert page.locator("#trouble").is_hidden()


def test_mass_out_of_range_is_said_and_kept_within(open_page: Open) -> None:
    page = open_page(LAW, reduced_motion="reduce")
    page.fill("#M-number", "9")
    page.keyboard.press("Enter")
    shows(page, "trouble", "M must be a number from 0.25 to 1.2: 1.2 is taken")
    assert page.input_value("#M-number") == "1.2"
    page.wait_for_function("location.hash.includes('M=1.2')")
    for key in ("Home", "End"):
        page.focus("#mu")
        page.keyboard.press(key)
        shows(page, "trouble", "")
        assert page.locator("#trouble").is_hidden()


def test_a_hand_that_failed_stands_still_until_space_begins_again(open_page: Open) -> None:
    page = open_page("#driver=yourself&rival=adaptive&M=0.5&mu=0.01")
    page.focus("#stage")
    page.keyboard.down("ArrowRight")
    shows(page, "banner-text", "Space begins again.")
    page.keyboard.up("ArrowRight")
    page.wait_for_function("document.getElementById('play').getAttribute('aria-label') === 'Play'")
    assert 0.2 < figure(page, "time") < 1.0
    page.keyboard.press(" ")
    page.wait_for_function("document.getElementById('banner').hidden")
    assert playing(page)


def test_plant_jumps_while_it_runs(open_page: Open) -> None:
    page = open_page(LAW)
    reaches(page, 0.5)
    page.fill("#mu-number", "0.2")
    page.keyboard.press("Tab")
    shows(page, "jumps", "0.2000")
    assert playing(page)
    t, mass, friction = (float(part) for part in link(page)["jumps"].split(":"))
    assert (mass, friction) == (0.5, 0.2)
    assert t >= 0.5
    assert abs(t / 0.02 - round(t / 0.02)) < 1e-6
    page.click("#jump")
    page.wait_for_function("location.hash.split(',').length === 2")
    page.click("#clear")
    shows(page, "jumps", "No jumps.")


def test_a_jump_made_by_hand_is_the_jump_of_a_link(open_page: Open) -> None:
    page = open_page(f"{LAW}&rival=epc&t=2")
    shows(page, "figure-time", "2.00")
    page.fill("#mu-number", "0.15")
    page.keyboard.press("Tab")
    page.wait_for_function("location.hash.includes('jumps=2:0.5:0.15')")
    page.evaluate("location.hash = location.hash.replace('t=2&', '').replace(/&t=2$/, '') + '&t=9'")
    shows(page, "figure-time", "9.00")
    other = open_page(f"{LAW}&rival=epc&jumps=2:0.5:0.15&t=9")
    shows(other, "figure-time", "9.00")
    assert measures(page) == measures(other)
    without = open_page(f"{LAW}&rival=epc&t=9")
    shows(without, "figure-time", "9.00")
    assert measures(page) != measures(without)


def test_a_jump_in_the_past_begins_another_future(open_page: Open) -> None:
    page = open_page(f"{LAW}&t=9")
    shows(page, "figure-time", "9.00")
    page.locator("#scrub").evaluate(
        "node => { node.value = 2; node.dispatchEvent(new Event('input')); node.dispatchEvent(new Event('change')); }"
    )
    shows(page, "figure-time", "2.00")
    page.fill("#mu-number", "0.15")
    page.keyboard.press("Tab")
    page.locator("#scrub").evaluate("node => { node.value = 9; node.dispatchEvent(new Event('input')); }")
    shows(page, "figure-time", "9.00")
    other = open_page(f"{LAW}&jumps=2:0.5:0.15&t=9")
    shows(other, "figure-time", "9.00")
    assert measures(page) == measures(other)


@pytest.mark.parametrize(
    "scene",
    [
        "#driver=epc&rival=adaptive&view=lane&set=drift&plant=3&speed=0.5&t=7.5",
        "#driver=adaptive&M=0.45&mu=0.02&jumps=1:0.5:0.01,2.5:0.6:0.1&t=3",
        "#driver=yourself&rival=epc&M=0.5&mu=0.01&t=0.8&hand=10uK20z9u",
        "#driver=optimum-nominal&rival=random&set=paper&plant=9&t=2",
    ],
)
def test_links_hold_the_whole_scene(open_page: Open, scene: str) -> None:
    page = open_page(scene)
    page.wait_for_function("scene => location.hash === scene", arg=scene)


def test_links_are_followed_in_an_open_page(open_page: Open) -> None:
    page = open_page(PAUSED)
    page.evaluate("location.hash = '#driver=epc&rival=adaptive&set=paper&plant=5&t=1'")
    shows(page, "figure-time", "1.00")
    assert page.input_value("#driver") == "epc"
    assert page.input_value("#plant") == "5"


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        ("#driver=nobody", 'driver must be one of .* got "nobody"'),
        ("#driver=epc&set=moon", 'set must be one of .* got "moon"'),
        ("#driver=epc&M=heavy", 'M must be a number from .* got "heavy"'),
        ("#driver=epc&jumps=1:2", 'jumps must be t:M:mu.* got "1:2"'),
        ("#driver=epc&t=99", 'a number from 0 to 33, got "99"'),
        ("#driver=yourself&hand=!", "hand must be letters"),
        ("#driver=optimum-oracle&M=0.6&t=1", "recorded on the plants of the sets"),
    ],
)
def test_what_a_link_cannot_mean_is_said(open_page: Open, scene: str, words: str) -> None:
    page = open_page(scene)
    assert re.search(words, page.locator("#trouble").text_content())
    assert page.locator("#trouble").is_visible()


def test_keys_turn_the_motor_while_they_are_held(open_page: Open) -> None:
    page = open_page("#driver=yourself&speed=0.1")
    page.focus("#stage")
    for key, torque in (("ArrowLeft", "0.30"), ("d", f"{MINUS}0.30")):
        page.keyboard.down(key)
        page.wait_for_function("torque => document.getElementById('figure-torque').textContent === torque", arg=torque)
        page.keyboard.up(key)
        shows(page, "torque-value", "0.00")
    assert page.input_value("#torque") == "0"


def test_slider_springs_back(open_page: Open) -> None:
    page = open_page("#driver=yourself&speed=0.1")
    box = page.locator("#torque").bounding_box()
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + box["width"] / 2, y)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.25 * box["width"], y)
    shows(page, "torque-value", "0.7")
    assert playing(page)
    page.mouse.up()
    shows(page, "torque-value", "0.00")
    assert page.input_value("#torque") == "0"


def test_a_drag_across_the_stage_turns_the_motor(open_page: Open) -> None:
    page = open_page("#driver=yourself&speed=0.1")
    box = page.locator("#stage").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + 60
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 70, y)
    shows(page, "torque-value", "0.75 N m")
    page.mouse.up()
    shows(page, "torque-value", "0.00")


def test_a_run_by_hand_is_told_by_its_link(open_page: Open) -> None:
    page = open_page("#driver=yourself&speed=0.2")
    page.focus("#torque")
    page.keyboard.down("ArrowLeft")
    reaches(page, 0.1)
    page.keyboard.up("ArrowLeft")
    reaches(page, 0.2)
    page.click("#play")
    page.wait_for_function("location.hash.includes('hand=')")
    other = open_page(page.evaluate("location.hash"))
    shows(other, "figure-time", page.locator("#figure-time").text_content())
    assert measures(other) == measures(page)
    page.click("#restart")
    page.click("#play")
    assert "hand" not in link(page) or set(link(page)["hand"]) <= set("0123456789u")


def test_best_speed_of_the_session(open_page: Open) -> None:
    page = open_page("#driver=yourself&speed=20")
    assert page.locator("#best").text_content() == "none yet"
    page.click("#play")
    reaches(page, 11.0)
    shows(page, "best", "cm/s")
    page.reload()
    shows(page, "best", "cm/s")


def test_failure_is_named_and_restarted(open_page: Open) -> None:
    page = open_page("#driver=yourself")
    page.locator("#strength").evaluate("node => { node.value = 1; }")
    page.focus("#stage")
    page.keyboard.down("ArrowRight")
    shows(page, "banner-text", "Yourself failed at")
    page.keyboard.up("ArrowRight")
    assert re.search(r"\((\|θ\| reached 90°|the normal force fell to 0)\)", page.text_content("#banner-text"))
    assert "failed" in page.text_content("#status")
    assert not playing(page)
    page.click("#again")
    page.wait_for_function("document.getElementById('banner').hidden")
    assert playing(page)


def test_end_of_the_episode(open_page: Open) -> None:
    page = open_page(f"{LAW}&speed=20")
    shows(page, "banner-text", "The episode of 33 s has ended.")
    assert figure(page, "time") == 33.0
    assert not playing(page)


def test_reduced_motion_waits(open_page: Open) -> None:
    page = open_page(LAW, reduced_motion="reduce")
    page.wait_for_timeout(300)
    assert not playing(page)
    assert figure(page, "time") == 0.0
    page.click("#play")
    reaches(page, 0.1)


def test_copies_the_link(open_page: Open) -> None:
    page = open_page(f"{PAUSED}&rival=epc", permissions=["clipboard-read", "clipboard-write"])
    shows(page, "figure-time", "0.10")
    page.click("#copy")
    shows(page, "copy", "Copied")
    assert page.evaluate("navigator.clipboard.readText()") == page.url


def test_check_replays_the_committed_episodes(open_page: Open) -> None:
    page = open_page(PAUSED)
    page.focus("#check")
    page.keyboard.press("Enter")
    shows(page, "verdict", "equal, bit for bit", 5 * PATIENCE)
    bits = page.locator("#check-rows td:last-child").all_inner_texts()
    assert bits
    assert set(bits) == {"equal"}
    page.keyboard.press("Escape")
    assert page.locator("#checks").is_hidden()
    assert page.evaluate("document.activeElement.id") == "check"


def test_links_to_the_documentation_where_it_lies_beside(open_page: Open) -> None:
    # The fixture's site is what `make web` alone writes.
    assert open_page(PAUSED).locator("#documentation").is_hidden()
    assert re.search('<a id="documentation" href="../index.html">', build.build_page("", documented=True))


def test_inside_of_a_report_the_page_shows_a_policy_of_ones_own(browser: Any, site: Path, tmp_path: Path) -> None:
    (own,) = own_controllers({"mine": load_policy("direct-ppo")}).values()
    live = (site / "index.html").read_text("utf-8")
    report = tmp_path / "report.html"
    report.write_text(f"<!doctype html>{embed(live, 'driver=mine&rival=adaptive&t=2', 'x', [own])}", "utf-8")
    assert report.stat().st_size < 3_000_000
    page = browser.new_page()
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: said.extend([request.url] if not _own(request.url, report.as_uri()) else []))
    page.goto(report.as_uri())
    frame = page.frames[1]
    frame.wait_for_function("document.getElementById('figure-time').textContent === '2.00'", timeout=PATIENCE)
    assert frame.input_value("#driver") == "mine"
    assert frame.locator("#trouble").is_hidden()
    # Neither leads anywhere there.
    assert frame.locator("#documentation").is_hidden()
    assert frame.locator("#copy").is_hidden()
    assert "t=2" in frame.url
    page.close()
    assert said == []


def test_price_of_energy_changes_what_the_policy_does(open_page: Open) -> None:
    page = open_page("#driver=pareto&weight=0.1&M=0.5&mu=0.01&t=4")
    shows(page, "figure-time", "4.00")
    cheap = measures(page)
    page.focus("#weight")
    page.keyboard.press("End")
    page.wait_for_function("location.hash.includes('weight=20')")
    page.evaluate("location.hash = location.hash + '&t=4'")
    shows(page, "figure-time", "4.00")
    assert measures(page) != cheap
    page.select_option("#driver", "adaptive")
    assert page.locator("#weight").is_hidden()
