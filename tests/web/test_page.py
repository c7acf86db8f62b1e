import json
import os
import shutil
from urllib.parse import parse_qs

import pytest

from web import episodes

COMMITTED = json.loads(episodes.FILE.read_text(encoding="utf-8"))
# .ci/run installs the first browser if none is present.
BROWSERS = ("chromium", "chromium-browser", "google-chrome")

LAW = "#driver=adaptive&M=0.5&mu=0.01"
PAUSED = f"{LAW}&t=0.1"
# Time that a busy machine may take for a wait, ms; the check may take longer.
PATIENCE = 60_000


@pytest.fixture(scope="module")
def browser():
    """A headless browser. It is optional on a user's machine and required in CI."""
    executable = next(filter(None, map(shutil.which, BROWSERS)), None)
    if executable is None and "CI" not in os.environ:
        pytest.skip(f"needs a browser: one of {', '.join(BROWSERS)}")
    assert executable, f"CI must have one of {', '.join(BROWSERS)}"
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def open_page(browser, site):
    """Opens the page with a hash; at the end, checks that no page wrote to the console or requested
    another file."""
    live = (site / "index.html").as_uri()
    contexts, said = [], []

    def opened(scene="", **settings):
        contexts.append(
            browser.new_context(**{"viewport": {"width": 1280, "height": 800}, **settings})
        )
        page = contexts[-1].new_page()
        page.set_default_timeout(PATIENCE)
        page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: said.append(f"error: {error}"))
        page.on(
            "request",
            lambda one: (
                None if one.url.startswith((live, "data:", "blob:")) else said.append(one.url)
            ),
        )
        page.goto(live + scene)
        page.wait_for_function(
            "document.getElementById('driver').value && location.hash.length > 1"
        )
        return page

    yield opened
    for context in contexts:
        context.close()
    assert said == []


def reaches(page, time):
    """Waits until the page shows that time or a later one."""
    page.wait_for_function(
        "time => Number(document.getElementById('figure-time').textContent) >= time", arg=time
    )


def shows(page, name, text, patience=PATIENCE):
    """Waits until an element contains that text."""
    holds = "([id, text]) => document.getElementById(id).textContent.includes(text)"
    page.wait_for_function(holds, arg=[name, text], timeout=patience)


def link(page):
    """The parameters behind the # of the address."""
    return {
        key: values[0] for key, values in parse_qs(page.evaluate("location.hash.slice(1)")).items()
    }


def playing(page):
    """Whether the scene is playing."""
    return page.locator("#play").get_attribute("aria-label") == "Pause"


def test_page_fits_any_width_and_every_control_has_a_name(open_page):
    page = open_page("#driver=yourself&rival=adaptive&view=lane", color_scheme="dark")
    for width in (360, 1280, 2560):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") == width
        outside = page.evaluate(
            """() => [...document.querySelectorAll("button, input, select, canvas, table")].filter((node) => {
                const { left, right, width } = node.getBoundingClientRect();
                return width > 0 && (left < 0 || right > innerWidth + 0.5);
            }).map((node) => node.id || node.tagName)"""
        )
        assert outside == []
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("button, input, select, [role]")].filter((node) =>
            !node.labels?.length && !node.ariaLabel && !node.textContent.trim() && !node.hasAttribute("aria-labelledby")
            && !["status", "alert"].includes(node.role)).map((node) => node.outerHTML)"""
    )
    assert nameless == []


def test_plays_pauses_steps_and_scrubs_by_mouse_and_keyboard(open_page):
    page = open_page(LAW)
    assert playing(page)
    reaches(page, 0.3)
    page.click("#play")
    assert not playing(page)
    shown = page.locator("#figure-time")
    before = float(shown.text_content())
    page.wait_for_timeout(200)
    assert float(shown.text_content()) == before
    page.click("#play")
    reaches(page, before + 0.2)
    page.click("#play")
    rows = []
    for keys, time in ((["Home"] + ["ArrowRight"] * 5, "0.10"), (["End"], "33.00")) * 2:
        for key in keys:
            page.press("#scrub", key)
        shows(page, "figure-time", time)
        rows.append(page.locator("#rows tr").all_inner_texts())
    assert rows[:2] == rows[2:] and rows[0] != rows[1]
    presses = (
        ("scrub", "Home", "0.00"),
        ("step", "Enter", "0.02"),
        ("stage", ".", "0.04"),
        ("back", "Enter", "0.02"),
    )
    for name, key, time in presses:
        page.press(f"#{name}", key)
        shows(page, "figure-time", time)


def test_every_driver_drives_and_is_the_rival(open_page):
    page = open_page(PAUSED)
    for control in ("driver", "rival"):
        for value in page.locator(f"#{control} option").evaluate_all(
            "options => options.map((one) => one.value)"
        ):
            page.select_option(f"#{control}", value)
            if control == "driver":
                page.click("#play") if playing(page) else None
            page.press("#step", "Enter")
            page.wait_for_function("Number(document.getElementById('figure-time').textContent) > 0")
            assert page.locator("#trouble").is_hidden(), page.locator("#trouble").text_content()
            assert link(page).get(control, "") == value


def test_every_task_has_drivers_measures_and_sets_of_its_own(open_page):
    page = open_page(PAUSED)
    tasks = (
        ("goal", "15.00", "Goal reached"),
        ("velocity", "20.00", "Velocity error"),
        ("speed", "33.00", ""),
    )
    for task, end, row in tasks:
        driver = f"{task}-pulses" if row else "residual-ppo"
        page.select_option("#task", task)
        page.wait_for_function(
            "name => document.getElementById('driver').value === name", arg=driver
        )
        page.click("#play") if playing(page) else None
        page.press("#scrub", "End")
        shows(page, "figure-time", end)
        rows = page.locator("#rows tr:visible").all_inner_texts()
        assert rows[0].startswith(row or "Mean speed") and len(rows) == (8 if row else 7)
        assert page.locator("#trouble").is_hidden(), page.locator("#trouble").text_content()


def test_plant_jumps_while_it_runs(open_page):
    page = open_page(LAW)
    reaches(page, 0.5)
    page.fill("#mu-number", "0.2")
    page.press("#mu-number", "Tab")
    shows(page, "jumps", "0.2000")
    assert playing(page)
    t, mass, friction = (float(part) for part in link(page)["jumps"].split(":"))
    assert (
        (mass, friction) == (0.5, 0.2) and t >= 0.5 and t / 0.02 == pytest.approx(round(t / 0.02))
    )
    page.click("#jump")
    page.wait_for_function("location.hash.split(',').length === 2")
    page.click("#clear")
    shows(page, "jumps", "No changes.")


SCENES = [
    "#driver=epc&rival=adaptive&view=lane&set=drift&plant=3&speed=0.5&t=7.5",
    "#driver=adaptive&M=0.45&mu=0.02&jumps=1:0.5:0.01,2.5:0.6:0.1&t=3",
    "#driver=yourself&rival=epc&M=0.5&mu=0.01&t=0.8&hand=10uK20z9u",
    "#driver=dp-nominal&rival=pd&set=paper&plant=9&t=2",
    "#driver=gait-predictive&rival=gait-guarded&M=0.5&mu=0.01&seed=3&disturbances=real&t=0.5",
    "#driver=gait-predictive&M=0.5&mu=0.01&latency=0.005&noise=0.5&motor=0.05&slope=-2&t=0.5",
    "#driver=gait-predictive&set=real&plant=7&t=0.5",
    "#driver=goal-pulses&set=goal&plant=3&t=1",
    "#driver=yourself&task=velocity&rival=velocity-pulses&M=0.5&mu=0.2&seed=4&t=0.4&hand=10uK9u",
]
WRONG = [
    ("#driver=nobody", 'driver must be one of .* got "nobody"'),
    ("#driver=epc&set=moon", 'set must be one of .* got "moon"'),
    ("#driver=epc&jumps=1:2", 'jumps must be t:M:mu.* got "1:2"'),
    ("#driver=epc&t=99", 'a number from 0 to 33, got "99"'),
    ("#driver=yourself&hand=!", "hand must be letters"),
    ("#driver=dp-oracle&M=0.6&t=1", "recorded on the plants of the sets"),
]


@pytest.mark.parametrize("scene", SCENES)
def test_links_hold_the_whole_scene(open_page, scene):
    page = open_page(scene)
    page.wait_for_function("scene => location.hash === scene", arg=scene)


def test_what_is_wrong_in_a_link_is_shown(open_page):
    page = open_page(PAUSED)
    # The previous scene may write its own address before the page reads the new one.
    follow = "scene => { location.hash = scene; history.replaceState(null, '', '#driver=epc'); }"
    for scene, words in WRONG:
        page.evaluate(follow, scene)
        page.wait_for_function(
            "words => RegExp(words).test(document.getElementById('trouble').textContent)", arg=words
        )
        assert page.locator("#trouble").is_visible()


def test_check_replays_the_committed_episodes(open_page):
    page = open_page(PAUSED)
    page.press("#check", "Enter")
    shows(page, "verdict", "equal, bit for bit", 5 * PATIENCE)
    assert page.locator("#check-rows td:last-child").all_inner_texts() == ["equal"] * len(COMMITTED)
    page.keyboard.press("Escape")
    assert page.locator("#checks").is_hidden()
    assert page.evaluate("document.activeElement.id") == "check"
