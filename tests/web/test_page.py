"""The live page in a browser."""

import os
import shutil
from urllib.parse import parse_qsl

import pytest

from agents.leaderboard.page import GROUPS
from capsule_gym.evaluation.sets import load_set
from tests.capsule_gym.policies.test_recurrent import recurrent_policy
from web.data import describe_policy
from web.episodes import committed_episodes

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
        browser = playwright.chromium.launch(
            executable_path=executable, args=["--no-sandbox", "--disable-gpu"]
        )
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def usual_context(browser):
    return browser.new_context()


@pytest.fixture
def open_page(browser, usual_context, site):
    """Opens the page with a hash; no page may write to the console or request another file."""
    live = (site / "index.html").as_uri()
    pages = []
    said = []

    def note_request(request):
        if not request.url.startswith((live, "data:", "blob:")):
            said.append(request.url)

    def opened(scene="", **settings):
        context = browser.new_context(**settings) if settings else usual_context
        page = context.new_page()
        pages.append(page)
        page.set_default_timeout(PATIENCE)
        page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: said.append(f"error: {error}"))
        page.on("request", note_request)
        page.goto(live + scene)
        shown = "document.getElementById('driver').value && location.hash.length > 1"
        page.wait_for_function(shown)
        return page

    yield opened
    for page in pages:
        page.close()
    assert said == []


def reaches(page, time):
    """Waits until the page shows that time or a later one."""
    shown = "Number(document.getElementById('figure-time').textContent)"
    page.wait_for_function(f"{shown} >= {time}")


def shows(page, name, text, patience=PATIENCE):
    """Waits until an element contains that text."""
    holds = "([id, text]) => document.getElementById(id).textContent.includes(text)"
    page.wait_for_function(holds, arg=[name, text], timeout=patience)


def link(page):
    """The parameters behind the # of the address."""
    return dict(parse_qsl(page.evaluate("location.hash.slice(1)")))


def playing(page):
    """Whether the scene is playing."""
    return page.locator("#play").get_attribute("aria-label") == "Pause"


def pause(page):
    if playing(page):
        page.click("#play")


def check_no_error(page):
    assert page.locator("#trouble").is_hidden(), page.locator("#trouble").text_content()


ALL_PARTS = "#driver=yourself&rival=adaptive&view=lane"
OUTSIDE = """() => [...document.querySelectorAll("button, input, select, canvas, table")]
    .filter((node) => {
        const { left, right, width } = node.getBoundingClientRect();
        return width > 0 && (left < 0 || right > innerWidth + 0.5);
    })
    .map((node) => node.id || node.tagName)"""
NAMELESS = """() => [...document.querySelectorAll("button, input, select, [role]")]
    .filter((node) => {
        const named = node.ariaLabel || node.hasAttribute("aria-labelledby") || node.labels?.length;
        const live = ["status", "alert"].includes(node.role);
        return !named && !live && !node.textContent.trim();
    })
    .map((node) => node.outerHTML)"""


def test_page_fits_any_width_and_every_control_has_a_name(open_page):
    page = open_page(ALL_PARTS, color_scheme="dark")
    assert page.evaluate(NAMELESS) == []
    for width in (360, 1280, 2560):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") == width
        assert page.evaluate(OUTSIDE) == []


def test_a_law_plays_until_the_button_pauses_it(open_page):
    page = open_page(LAW)
    assert playing(page)
    reaches(page, 0.3)
    page.click("#play")
    assert not playing(page)
    time = page.locator("#figure-time").text_content()
    page.wait_for_timeout(200)
    assert page.locator("#figure-time").text_content() == time
    page.click("#play")
    reaches(page, float(time) + 0.2)


def test_a_return_to_a_time_shows_the_same_measures(open_page):
    page = open_page(PAUSED)
    rows = []
    for keys, time in ((["Home"] + ["ArrowRight"] * 5, "0.10"), (["End"], "33.00")) * 2:
        for key in keys:
            page.press("#scrub", key)
        shows(page, "figure-time", time)
        rows.append(page.locator("#rows tr").all_inner_texts())
    assert rows[:2] == rows[2:]
    assert rows[0] != rows[1]


def test_buttons_and_keys_go_step_by_step(open_page):
    page = open_page(PAUSED)
    presses = [
        ("#scrub", "Home", "0.00"),
        ("#step", "Enter", "0.02"),
        ("#stage", ".", "0.04"),
        ("#back", "Enter", "0.02"),
    ]
    for control, key, time in presses:
        page.press(control, key)
        shows(page, "figure-time", time)


def test_keys_pause(open_page):
    page = open_page(LAW)
    for key in (".", " "):
        assert playing(page)
        page.press("#stage", key)
        assert not playing(page)
        page.click("#play")


def test_a_held_key_turns_the_motor_until_it_is_released(open_page):
    page = open_page("#driver=yourself&M=0.5&mu=0.01")
    page.keyboard.down("ArrowLeft")
    shows(page, "torque-value", "0.60")
    reaches(page, 0.1)
    page.keyboard.up("ArrowLeft")
    shows(page, "torque-value", "0.00")
    pause(page)
    # The address is written twice a second.
    page.wait_for_function("location.hash.includes('hand=')")


def test_a_drag_across_the_stage_turns_the_motor(open_page):
    page = open_page("#driver=yourself&M=0.5&mu=0.01")
    box = page.locator("#stage").bounding_box()
    x = box["x"] + box["width"] / 2
    y = box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 70, y)
    shows(page, "torque-value", "0.75")
    page.mouse.up()
    shows(page, "torque-value", "0.00")


def test_a_key_is_released_whatever_it_writes_then(open_page):
    page = open_page("#driver=yourself&M=0.5&mu=0.01")
    page.keyboard.down("KeyA")
    shows(page, "torque-value", "0.60")
    page.keyboard.down("Shift")
    # As a browser tells of it: the same key with another letter.
    page.evaluate("document.dispatchEvent(new KeyboardEvent('keyup', {code: 'KeyA', key: 'A'}))")
    shows(page, "torque-value", "0.00")


def test_a_page_that_loses_the_keyboard_releases_its_keys(open_page):
    page = open_page("#driver=yourself&M=0.5&mu=0.01")
    page.keyboard.down("ArrowLeft")
    shows(page, "torque-value", "0.60")
    page.evaluate("window.dispatchEvent(new Event('blur'))")
    shows(page, "torque-value", "0.00")


def touch(session, kind, *points):
    """Sends a touch with all fingers on the screen: numbers, x and y of each."""
    touches = [{"id": finger, "x": x, "y": y} for finger, x, y in points]
    session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})


@pytest.mark.parametrize("control", ["#stage", "#push-left"])
def test_a_second_finger_leaves_the_torque_of_the_first(open_page, control):
    page = open_page("#driver=yourself&M=0.5&mu=0.01", has_touch=True)
    session = page.context.new_cdp_session(page)
    page.locator(control).scroll_into_view_if_needed()
    box = page.locator(control).bounding_box()
    x = box["x"] + box["width"] / 2
    y = box["y"] + box["height"] / 2
    touch(session, "touchStart", (0, x, y))
    touch(session, "touchMove", (0, x - 40, y))
    page.wait_for_function("parseFloat(document.getElementById('torque-value').textContent) > 0.3")
    torque = page.locator("#torque-value").text_content()
    touch(session, "touchStart", (0, x - 40, y), (1, x + 20, y))
    # The second one leaves.
    touch(session, "touchMove", (0, x - 40, y))
    page.wait_for_timeout(100)
    assert page.locator("#torque-value").text_content() == torque
    touch(session, "touchEnd")
    shows(page, "torque-value", "0.00")


def test_the_buttons_of_the_hand_stand_below_the_stage_of_a_telephone(open_page):
    page = open_page("#driver=yourself", viewport={"width": 400, "height": 800})
    stage = page.locator("#stage").bounding_box()
    for button in ("#push-left", "#push-right"):
        box = page.locator(button).bounding_box()
        assert box["y"] + box["height"] <= 800
        assert 0 <= box["y"] - stage["y"] - stage["height"] < 30
        assert box["height"] >= 48


# Counts the writes of the address, and throws at each, as Safari does after 100 of them.
THROWING = """() => {
    window.writes = 0;
    history.replaceState = () => {
        window.writes += 1;
        throw new DOMException("", "SecurityError");
    };
}"""


def test_the_page_runs_on_where_the_address_cannot_be_written(open_page):
    page = open_page(PAUSED)
    page.evaluate(THROWING)
    page.focus("#speed")
    for _ in range(3):
        for key in ("ArrowRight", "ArrowLeft"):
            page.keyboard.press(key)
    page.click("#play")
    reaches(page, 0.6)
    page.select_option("#driver", "pd")
    shows(page, "head-driver", "pd")
    assert page.evaluate("window.writes") > 0
    check_no_error(page)


def test_the_address_is_written_a_few_times_a_second(open_page):
    page = open_page(PAUSED)
    page.evaluate(THROWING.replace("throw", "return; throw"))
    began = page.evaluate("performance.now()")
    scrub = "document.getElementById('scrub').dispatchEvent(new Event('change'))"
    for _ in range(3):
        page.evaluate(f"for (let n = 0; n < 200; n++) {scrub}")
        page.wait_for_timeout(600)
    # The last one comes late.
    page.wait_for_function("window.writes >= 2")
    writes = page.evaluate("window.writes")
    seconds = (page.evaluate("performance.now()") - began) / 1000
    assert writes <= 1 + 2 * seconds


def test_a_copied_link_holds_the_present_scene(open_page):
    page = open_page(PAUSED, permissions=["clipboard-read", "clipboard-write"])
    page.evaluate("() => { history.replaceState = () => {}; }")
    page.press("#step", "Enter")
    shows(page, "figure-time", "0.12")
    page.click("#copy")
    shows(page, "copy", "Copied")
    assert "t=0.12" in page.evaluate("navigator.clipboard.readText()")


def test_policies_stand_in_the_groups_of_the_leaderboard(open_page):
    page = open_page(PAUSED)
    groups = page.locator("#driver optgroup")
    assert groups.evaluate_all("groups => groups.map((group) => group.label)") == [*GROUPS]
    for title, names in GROUPS.items():
        inside = page.locator(f"#driver optgroup[label='{title}'] option").all_text_contents()
        assert set(names) <= set(inside)


def test_a_number_under_own_values_takes_the_plant_of_a_set(open_page):
    page = open_page(PAUSED)
    assert page.input_value("#plant") == ""
    page.fill("#plant", "7")
    page.press("#plant", "Tab")
    page.wait_for_function("document.getElementById('set').value === 'paper'")
    plant = load_set("paper").plants[7]
    assert float(page.input_value("#M-number")) == pytest.approx(plant.M)
    page.select_option("#set", "")
    page.wait_for_function("document.getElementById('plant').value === ''")


@pytest.mark.parametrize("control", ["driver", "rival"])
def test_every_driver_steps(open_page, control):
    page = open_page(PAUSED)
    options = page.locator(f"#{control} option")
    for value in options.evaluate_all("options => options.map((one) => one.value)"):
        page.select_option(f"#{control}", value)
        pause(page)
        page.press("#step", "Enter")
        page.wait_for_function("Number(document.getElementById('figure-time').textContent) > 0")
        check_no_error(page)
        # The address follows within half a second.
        part = "(new URLSearchParams(location.hash.slice(1)).get(name) ?? '')"
        page.wait_for_function(f"([name, value]) => {part} === value", arg=[control, value])


TASKS = [
    ("goal", "goal-pulses", "15.00", "Goal reached", 8),
    ("velocity", "velocity-pulses", "20.00", "Velocity error", 8),
    ("speed", "residual-ppo", "33.00", "Mean speed", 7),
]


def test_every_task_has_a_driver_measures_and_a_length_of_its_own(open_page):
    page = open_page(PAUSED)
    for task, driver, end, measure, count in TASKS:
        page.select_option("#task", task)
        chosen = "name => document.getElementById('driver').value === name"
        page.wait_for_function(chosen, arg=driver)
        pause(page)
        page.press("#scrub", "End")
        shows(page, "figure-time", end)
        rows = page.locator("#rows tr:visible").all_inner_texts()
        assert rows[0].startswith(measure)
        assert len(rows) == count
        check_no_error(page)


def test_plant_jumps_while_it_runs(open_page):
    page = open_page(LAW)
    reaches(page, 0.5)
    page.fill("#mu-number", "0.2")
    page.press("#mu-number", "Tab")
    shows(page, "jumps", "0.2000")
    assert playing(page)
    t, *plant = map(float, link(page)["jumps"].split(":"))
    assert plant == [0.5, 0.2]
    assert t >= 0.5
    assert t / 0.02 == pytest.approx(round(t / 0.02))


def test_jumps_at_random_are_undone(open_page):
    page = open_page(f"{PAUSED}&jumps=0.06:0.5:0.2")
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
    "#driver=gait-predictive&M=0.5&mu=0.01&latency=0.005&noise=0.5&lost=0.2&motor=0.05&slope=-2&t=0.5",
    "#driver=gait-predictive&set=real&plant=7&t=0.5",
    "#driver=goal-pulses&set=goal&plant=3&t=1",
    "#driver=yourself&task=velocity&rival=velocity-pulses&M=0.5&mu=0.2&seed=4&t=0.4&hand=10uK9u",
]


@pytest.mark.parametrize("scene", SCENES)
def test_links_hold_the_whole_scene(open_page, scene):
    page = open_page(scene)
    page.wait_for_function("scene => location.hash === scene", arg=scene)


WRONG = {
    "#driver=nobody": 'driver must be one of .* got "nobody"',
    "#driver=epc&set=moon": 'set must be one of .* got "moon"',
    "#driver=epc&jumps=1:2": 'jumps must be t:M:mu.* got "1:2"',
    "#driver=epc&t=99": 'a number from 0 to 33, got "99"',
    "#driver=yourself&hand=!": "hand must be letters",
    "#driver=dp-oracle&M=0.6&t=1": "recorded on the plants of the sets",
}


def test_what_is_wrong_in_a_link_is_shown(open_page):
    page = open_page(PAUSED)
    # The previous scene may write its own address before the page reads the new one.
    follow = "scene => { location.hash = scene; history.replaceState(null, '', '#driver=epc'); }"
    shown = "words => RegExp(words).test(document.getElementById('trouble').textContent)"
    for scene, words in WRONG.items():
        page.evaluate(follow, scene)
        page.wait_for_function(shown, arg=words)
        assert page.locator("#trouble").is_visible()


ADD_DRIVER = """async (driver) => {
    const { addDriver } = await import("capsule.mjs");
    addDriver(driver);
}"""
# The number of different columns with blue or orange pixels; text and lines are grey.
MEMORIES = """() => {
    const canvas = document.getElementById("memory");
    const { width, height } = canvas;
    const copy = new OffscreenCanvas(width, height).getContext("2d");
    copy.fillStyle = "white";
    copy.fillRect(0, 0, width, height);
    copy.drawImage(canvas, 0, 0);
    const { data } = copy.getImageData(0, 0, width, height);
    const columns = new Set();
    for (let x = 0; x < width; x++) {
        const pixels = Array.from({ length: height }, (_, y) => 4 * (y * width + x));
        const hues = pixels.map((at) => data[at] - data[at + 2]);
        if (hues.some((hue) => Math.abs(hue) > 40)) columns.add(hues.join());
    }
    return columns.size;
}"""


def follow(page, scene):
    page.evaluate("scene => { location.hash = scene; }", scene)


def test_the_memory_of_a_recurrent_policy_is_drawn_over_time(open_page):
    without = "#driver=direct-ppo&M=0.5&mu=0.01&t=0.2"
    page = open_page(without)
    shows(page, "figure-time", "0.20")
    memory = page.locator("#memory")
    assert memory.is_hidden()
    policy = recurrent_policy("gru")
    described = describe_policy("mine", policy)
    described["network"] = policy._network.tolist()
    page.evaluate(ADD_DRIVER, described)
    page.select_option("#span", "5")
    for steps in (10, 30):
        follow(page, f"#driver=mine&M=0.5&mu=0.01&t={steps * 0.02:g}")
        memory.wait_for()
        page.wait_for_function(f"({MEMORIES})() >= {steps - 2}")
        assert page.evaluate(MEMORIES) <= steps + 2
    assert page.inner_text("figure:has(#memory) figcaption").startswith("Memory of mine: ")
    check_no_error(page)
    follow(page, without)
    memory.wait_for(state="hidden")


def test_check_replays_the_committed_episodes(open_page):
    page = open_page(PAUSED)
    page.press("#check", "Enter")
    shows(page, "verdict", "equal, bit for bit", 5 * PATIENCE)
    results = page.locator("#check-rows td:last-child").all_inner_texts()
    assert results == ["equal"] * len(committed_episodes())


def test_escape_closes_the_check_and_returns_to_its_button(open_page):
    page = open_page(PAUSED)
    page.press("#check", "Enter")
    page.keyboard.press("Escape")
    assert page.locator("#checks").is_hidden()
    assert page.evaluate("document.activeElement.id") == "check"
