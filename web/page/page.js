// The page: its controls, its lanes, and their drawing.

import {check, constants, drivers, sets} from "capsule.mjs";
import {CURVES, PhasePortrait, TimeChart} from "charts.js";
import {Lane} from "lane.js";
import {clamp, written} from "numbers.js";
import {Player} from "player.js";
import {
  disturbancesOf,
  DISTURBED,
  driverNamed,
  END,
  firstScene,
  handAction,
  hasOwnJumps,
  hasRecorded,
  keepFrozen,
  limits,
  ONLY_FROZEN,
  readScene,
  SEEDS,
  takePlant,
  titleOf,
  useTask,
  writeScene,
  YOURSELF
} from "scene.js";
import {Contact, Stage} from "stage.js";

const DT = constants.control_dt;
const SPEEDS = [0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5, 7, 10, 15, 20];
const KINDS = {
  law: "Control laws",
  policy: "Trained policies",
  recording: "The optimum, recorded"
};
const KEYS = {
  ArrowLeft: 1,
  a: 1,
  A: 1,
  ArrowRight: -1,
  d: -1,
  D: -1
};
// Factor by which the helper reduces the strength of the right key.
const RETURN_SHARE = 0.25;
const BEST_KEY = "capsule_gym.best_distance";
// Drag distance for the full torque, pixels.
const DRAG = 140;

/**
 * The measures of an episode: name, unit, and format; the text is empty if the task has no such
 * measure.
 */
const MEASURES = [
  [
    "Goal reached", "s",
    ({success, goal_time}) => success === 1 ? written(goal_time, 2)
      : success === 0                       ? "not yet"
                                            : ""
  ],
  [
    "Velocity error", "%",
    ({velocity_error: error}) => (error === undefined ? "" : written(error, 1))
  ],
  ["Mean speed", "cm/s", (metrics) => written(metrics.mean_speed, 2)],
  ["Cost of transport", "1", (metrics) => written(metrics.cost_of_transport, 2)],
  ["Distance", "cm", (metrics) => written(100 * metrics.distance, 1)],
  ["Energy", "J", (metrics) => written(metrics.energy, 2)],
  ["Peak torque", "N m", (metrics) => written(metrics.peak_torque, 3)],
  ["Time in stick", "%", (metrics) => written(100 * metrics.stuck_fraction, 1)],
  ["Backward / forward", "1", (metrics) => written(metrics.backward_ratio, 3)],
];

const element = (id) => document.getElementById(id);
const reduced = window.matchMedia("(prefers-reduced-motion: reduce)");
const player = new Player();
let scene = firstScene();
let opening = 0;
let dirty = true;
let span = reduced.matches ? 0 : 10;
let told = "";
let best = remembered();

const redraw = () => {
  dirty = true;
};
const contacts = [new Contact(), new Contact()];
const stage = new Stage(element("scene"), redraw);
const charts = makeCharts();

// --- Lanes ---

/** Opens the scene's lanes again at a time, and plays or pauses. */
async function open({time = 0, play = player.playing} = {}) {
  const turn = ++opening;
  player.playing = false;
  try {
    const lanes = [await Lane.open(scene.driver, scene)];
    if (scene.rival) lanes.push(await Lane.open(scene.rival, scene));
    if (turn !== opening) return;
    player.lanes = lanes;
  } catch (error) {
    if (turn === opening) complain(error.message);
    return;
  }
  player.now = 0;
  player.goal = null;
  told = "";
  help();
  if (time > 0) player.seek(time);
  showScene();
  setPlaying(play);
}

player.stepped = (lane) => {
  if (!lane.hand || scene.hand.length) return;
  const {distance} = lane.metrics[lane.steps];
  if (distance > best) remember(distance);
};

function remembered() {
  try {
    return Number(localStorage.getItem(BEST_KEY));
  } catch {
    return 0;
  }
}

function remember(distance) {
  best = distance;
  try {
    localStorage.setItem(BEST_KEY, String(distance));
  } catch {
    // Without storage, the distance is lost when the page closes.
  }
}

/** Changes M and mu from now on; before the first step, changes the episode's plant. */
function jump(M, mu) {
  player.branch();
  if (player.moment === 0) {
    Object.assign(scene, {set: "", M, mu, theta: undefined});
    return open();
  }
  const t = Number(player.moment.toFixed(6));
  const others = scene.jumps.filter((jump) => Math.abs(jump.t - t) > DT / 2);
  // The lanes share this array.
  scene.jumps.splice(0, Infinity, ...[...others, {t, M, mu}].sort((a, b) => a.t - b.t));
  announce(`At ${written(t, 2)} s: ${plantText({M, mu})}`);
  showPlant();
  link();
}

function plantNow() { return scene.jumps.findLast(({t}) => t <= player.moment + 1e-9) ?? scene; }

function plantText({M, mu}) { return `M ${written(M, 4)} kg, μ ${written(mu, 4)}`; }

/** The reader's actions: those of a link, or the recorded ones. */
function handsSoFar() {
  const [lane] = player.lanes;
  if (!lane?.hand) return [];
  const {replay} = lane.hand;
  return replay.length > lane.steps ? replay
                                    : Array.from(lane.trace.action.subarray(1, lane.steps + 1));
}

// --- Manual control ---

const held = new Set();

/** Applies an action of the reader; a nonzero one replaces what was recorded after this step. */
function drive(action) {
  const hand = player.lanes[0]?.hand;
  if (!hand) return;
  const value = handAction(action);
  const text = `${written(value * constants.torque_limit, 2)} N m`;
  // The angle is positive to the left, so the slider has the opposite sign of the torque.
  element("torque").value = -value;
  element("torque").setAttribute("aria-valuetext", text);
  show("torque-value", text);
  if (value === hand.live) return;
  const step = player.lanes[0].stepAt(player.moment);
  const recorded = Math.max(player.lanes[0].steps, hand.replay.length) > step;
  if (value !== 0 && recorded) {
    player.branch();
    hand.replay.length = Math.min(hand.replay.length, step);
    scene.hand = [];
  }
  hand.live = value;
}

function driveByKeys() {
  const turn = clamp([...held].reduce((sum, key) => sum + KEYS[key], 0), -1, 1);
  const share = turn < 0 && element("help").checked ? RETURN_SHARE : 1;
  drive(turn * share * Number(element("strength").value));
}

function followKeys(event) {
  const control = event.target.closest?.("input:not(#torque), select, dialog");
  if (control || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key in KEYS && scene.driver === YOURSELF) {
    event.preventDefault();
    held.add(event.key);
    driveByKeys();
    if (!player.playing && !event.repeat && !player.over) setPlaying(true);
  } else if (event.key === " " && !event.target.closest?.("button, a, input")) {
    event.preventDefault();
    togglePlay();
  } else if (event.key === "." && element("stage") === event.target) {
    player.nudge(1);
  }
}

function release() {
  held.clear();
  drive(0);
}

function bindHands() {
  document.addEventListener("keydown", followKeys);
  document.addEventListener("keyup", (event) => {
    if (held.delete(event.key)) driveByKeys();
  });
  window.addEventListener("blur", release);
  const torque = element("torque");
  torque.addEventListener("input", () => {
    drive(-Number(torque.value));
    if (!player.over) setPlaying(true);
  });
  for (const end of ["change", "pointerup", "pointercancel", "blur"])
    torque.addEventListener(end, release);
  const area = element("stage");
  let begin = null;
  area.addEventListener("pointerdown", (event) => {
    if (scene.driver !== YOURSELF || event.target.closest("button")) return;
    begin = event.clientX;
    area.setPointerCapture(event.pointerId);
    if (!player.over) setPlaying(true);
  });
  area.addEventListener("pointermove", (event) => {
    if (begin !== null) drive((begin - event.clientX) / DRAG);
  });
  for (const end of ["pointerup", "pointercancel"]) {
    area.addEventListener(end, () => {
      if (begin !== null) release();
      begin = null;
    });
  }
  element("strength").addEventListener("input", showStrength);
  element("help").addEventListener("change", help);
  for (const button of document.querySelectorAll(".push")) {
    const {key} = button.dataset;
    button.addEventListener("pointerdown", (event) => {
      button.setPointerCapture(event.pointerId);
      held.add(key);
      driveByKeys();
      if (!player.over) setPlaying(true);
    });
    for (const end of ["pointerup", "pointercancel"]) button.addEventListener(end, release);
  }
}

/** Turns the hand's helper on or off. */
function help() {
  const hand = player.lanes[0]?.hand;
  if (hand) hand.helped = element("help").checked;
}

function showStrength() {
  show("strength-value", `${written(element("strength").value * constants.torque_limit, 2)} N m`);
}

// --- Playback ---

function setPlaying(playing) {
  const changed = playing !== player.playing;
  player.playing = playing;
  const button = element("play");
  button.classList.toggle("playing", playing);
  button.setAttribute("aria-label", playing ? "Pause" : "Play");
  button.title = playing ? "Pause" : "Play";
  redraw();
  if (changed && !playing) link();
}

function togglePlay() {
  if (player.playing) return setPlaying(false);
  if (player.over || handFailed()) return restart();
  setPlaying(true);
}

function restart() {
  scene.hand = [];
  open({play: true});
}

/** Writes the scene to the page's address, with the time if the page is paused. */
function link() {
  const time = player.goal ?? player.now;
  scene.t = player.playing || time === 0 ? null : Number(time.toFixed(3));
  // In a page embedded in another, relative addresses refer to the outer page.
  history.replaceState(
    null, "", new URL(writeScene({...scene, hand: handsSoFar()}), location.href));
}

function bindPlayback() {
  element("play").addEventListener("click", togglePlay);
  element("restart").addEventListener("click", restart);
  element("again").addEventListener("click", restart);
  element("step").addEventListener("click", () => nudge(1));
  element("back").addEventListener("click", () => nudge(-1));
  const scrub = element("scrub");
  scrub.step = DT;
  scrub.addEventListener("input", () => seek(Number(scrub.value)));
  scrub.addEventListener("change", link);
  const speed = element("speed");
  speed.max = SPEEDS.length - 1;
  speed.addEventListener("input", () => {
    scene.speed = SPEEDS[speed.value];
    showSpeed();
    link();
  });
}

function nudge(steps) {
  setPlaying(false);
  player.nudge(steps);
  redraw();
}

function seek(time) {
  setPlaying(false);
  player.seek(time);
  redraw();
}

function showSpeed() {
  player.speed = scene.speed;
  const distances = SPEEDS.map((speed) => Math.abs(Math.log(speed / scene.speed)));
  const slider = element("speed");
  slider.value = distances.indexOf(Math.min(...distances));
  slider.setAttribute("aria-valuetext", `${scene.speed} times`);
  show("speed-value", `${scene.speed} ×`);
}

// --- Controls ---

function option(value, text) { return new Option(text, value); }

/** Fills the lists with the choices of the scene's task. */
function fillChoices() {
  element("driver").replaceChildren(option(YOURSELF, "Yourself"));
  element("rival").replaceChildren(option("", "none"));
  for (const select of [element("driver"), element("rival")]) {
    for (const [kind, label] of Object.entries(KINDS)) {
      const rows = drivers.filter((driver) => driver.kind === kind && driver.task === scene.task);
      if (rows.length === 0) continue;
      const group = document.createElement("optgroup");
      group.label = label;
      group.append(...rows.map((driver) => option(driver.name, driver.name)));
      select.append(group);
    }
  }
  const known = Object.keys(sets).filter((name) => sets[name].task === scene.task);
  element("set").replaceChildren(
    option("", "own values"), ...known.map((name) => option(name, name)));
  element("scrub").max = END;
  for (const row of element("rows").rows)
    row.hidden = row.dataset.task !== undefined && row.dataset.task !== scene.task;
}

function setRanges() {
  // Friction spans two powers of ten: its slider is logarithmic.
  for (const [name, map] of [["M", Number], ["mu", Math.log10]]) {
    [element(name).min, element(name).max] = limits[name].map(map);
    [element(`${name}-number`).min, element(`${name}-number`).max] = limits[name];
  }
  for (const [name, bounds] of Object.entries(DISTURBED))
    [element(name).min, element(name).max] = bounds;
}

function bindChoices() {
  const choose = (id, key, after) => element(id).addEventListener("change", () => {
    scene[key] = element(id).value;
    after();
  });
  choose("task", "task", () => {
    useTask(scene.task);
    const first = firstScene();
    const own =
      scene.task === first.task ? first.driver : drivers.find(({task}) => task === scene.task).name;
    const set = Object.keys(sets).find((name) => sets[name].task === scene.task);
    Object.assign(scene, {driver: own, rival: "", hand: []});
    takePlant(scene, set, 0);
    open({play: !reduced.matches});
  });
  choose("driver", "driver", () => {
    scene.hand = [];
    keepFrozen(scene);
    // With manual control, the reader starts the episode.
    open({play: scene.driver !== YOURSELF && !reduced.matches});
  });
  choose("rival", "rival", () => {
    const other = keepFrozen(scene);
    scene.hand = other ? [] : handsSoFar();
    open({time: other ? 0 : player.now});
  });
  choose("view", "view", () => {
    showScene();
    link();
  });
  element("span").addEventListener("change", () => {
    span = Number(element("span").value);
    redraw();
  });
}

function bindPlant() {
  const choosePlant = () => {
    const set = element("set").value;
    const index = element("plant");
    if (set) {
      const [wanted, last] = [Number(index.value), sets[set].plants.length - 1];
      index.value = clamp(Math.trunc(wanted) || 0, 0, last);
      const right = wanted === Number(index.value);
      complain(
        right ? "" : `Plant must be a whole number from 0 to ${last}: ${index.value} is taken`);
      takePlant(scene, set, Number(index.value));
    } else {
      Object.assign(scene, {set: "", theta: undefined, jumps: []});
    }
    scene.hand = [];
    open();
  };
  element("set").addEventListener("change", choosePlant);
  element("plant").addEventListener("change", choosePlant);
  const values = {M: [Number, (value) => value], mu: [Math.log10, (value) => 10 ** value]};
  for (const [name, [, back]] of Object.entries(values)) {
    const [slider, field] = [element(name), element(`${name}-number`)];
    const set = (given) => {
      const value = Number(given.toPrecision(4));
      const kept = clamp(Number.isFinite(value) ? value : plantNow()[name], ...limits[name]);
      complain(
        kept === value
          ? ""
          : `${name} must be a number from ${limits[name].join(" to ")}: ${kept} is taken`);
      field.value = kept;
      jump(...["M", "mu"].map((other) => (other === name ? kept : plantNow()[other])));
    };
    slider.addEventListener("input", () => {
      field.value = Number(back(Number(slider.value)).toPrecision(4));
    });
    slider.addEventListener("change", () => set(back(Number(slider.value))));
    field.addEventListener("change", () => set(field.value === "" ? NaN : Number(field.value)));
  }
  element("seed").addEventListener("change", () => {
    scene.seed = clamp(Math.trunc(Number(element("seed").value)) || 0, 0, SEEDS - 1);
    scene.hand = [];
    open();
  });
  const disturb = (changed) => {
    Object.assign(scene, {set: "", theta: undefined, hand: []}, changed);
    open();
  };
  element("disturbances").addEventListener("change", () => {
    const own =
      element("disturbances").value === "own" ? {latency: 0.01, noise: 1} : {latency: 0, noise: 0};
    disturb({disturbances: element("disturbances").value, ...own});
  });
  for (const name of Object.keys(DISTURBED)) {
    const value = () => Number(element(name).value);
    element(name).addEventListener(
      "input", () => show(`${name}-value`, disturbanceText(name, value())));
    const own = name === "latency" || name === "noise" ? {disturbances: "own"} : {};
    element(name).addEventListener("change", () => disturb({[name]: value(), ...own}));
  }
  element("jump").addEventListener("click", () => {
    const range = constants.ranges.wide ?? Object.fromEntries(Object.entries(limits));
    const [M, mu] = ["M", "mu"].map((name) => drawn(...range[name], name === "mu"));
    jump(M, mu);
  });
  element("clear").addEventListener("click", () => {
    scene.hand = handsSoFar();
    const time = player.now;
    if (scene.set) takePlant(scene, scene.set, scene.plant);
    else scene.jumps = [];
    open({time});
  });
}

function disturbanceText(name, value) {
  const shown = {
    latency: [1000 * value, 0, "ms"],
    noise: [value, 1, "× real"],
    motor: [value, 2, "N m"]
  };
  const [number, digits, unit] = shown[name] ?? [value, 1, "°"];
  return `${written(number, digits)} ${unit}`;
}

/** Draws a number between two, uniformly or log-uniformly, with four digits. */
function drawn(low, high, logarithmic) {
  const share = Math.random();
  return Number(
    (logarithmic ? low * (high / low) ** share : low + (high - low) * share).toPrecision(4));
}

function bindPage() {
  element("copy").addEventListener("click", async () => {
    link();
    try {
      await navigator.clipboard.writeText(location.href);
      announce("The link is copied");
      element("copy").textContent = "Copied";
    } catch {
      announce("The link stands in the address of the page");
      element("copy").textContent = "In the address bar";
    }
    setTimeout(() => {
      element("copy").textContent = "Copy link";
    }, 2000);
  });
  element("share").addEventListener("click", share);
  element("check").addEventListener("click", runCheck);
  // The previous scene may have changed the address since the event.
  window.addEventListener("hashchange", (event) => readLink(new URL(event.newURL).hash));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
}

/**
 * Shares a picture of the stage and the link by the system's dialog; saves the picture if there is
 * none.
 */
async function share() {
  link();
  const {metrics} = player.lanes[0].at(player.now, false);
  const text = `${player.lanes[0].title}: ${written(100 * metrics.distance, 1)} cm in ${
    written(player.now, 1)} s`;
  const picture = await stage.picture(text);
  const files = [new File([picture], "capsule.png", {type: picture.type})];
  const content = {files, text, url: location.href};
  if (navigator.canShare?.(content)) return navigator.share(content).catch(() => {});
  const save = document.createElement("a");
  save.download = files[0].name;
  save.href = URL.createObjectURL(picture);
  save.click();
  URL.revokeObjectURL(save.href);
  announce("The picture is saved");
}

let checking = false;

/** Replays the committed episodes and shows the results. */
async function runCheck() {
  setPlaying(false);
  element("checks").showModal();
  if (checking) return;
  checking = true;
  const rows = element("check-rows");
  rows.replaceChildren();
  show("verdict", "Replaying …");
  try {
    const equal = await check(({name, equal, steps, doubles}) => {
      const row = rows.insertRow();
      const head = document.createElement("th");
      head.scope = "row";
      head.textContent = name;
      row.append(head);
      for (const text of [steps, doubles])
        row.insertCell().textContent = Number(text).toLocaleString("en");
      const bits = row.insertCell();
      bits.textContent = equal ? "equal" : "different";
      bits.className = bits.textContent;
      row.scrollIntoView({block: "nearest"});
    });
    const all = `All ${rows.rows.length} episodes are equal, bit for bit.`;
    show("verdict", equal ? all : "Some episodes are different.");
  } catch (error) {
    show("verdict", `The check failed: ${error.message}`);
  }
  checking = false;
}

// --- Display ---

function show(id, text) {
  const node = element(id);
  if (node.textContent !== text) node.textContent = text;
}

function announce(text) { show("status", text); }

function complain(text) {
  element("trouble").hidden = text === "";
  show("trouble", text);
}

/** Shows the scene's settings; `draw` shows all that changes with time. */
function showScene() {
  fillChoices();
  element("task").value = scene.task;
  element("driver").value = scene.driver;
  element("rival").value = scene.rival;
  element("view").value = scene.view;
  element("view").disabled = !scene.rival;
  const own =
    "Keys, buttons or the slider below the stage, or a finger on it: hold to turn the motor.";
  const described = (name) => driverNamed(name).description.replaceAll("`", "");
  show("driver-text", scene.driver === YOURSELF ? own : described(scene.driver));
  show("rival-text", scene.rival ? described(scene.rival) : "");
  element("hand").hidden = scene.driver !== YOURSELF;
  element("stage").classList.toggle("driving", scene.driver === YOURSELF);
  element("stage").classList.toggle("two", scene.view === "lane" && scene.rival !== "");
  show("head-driver", titleOf(scene.driver));
  show("head-rival", scene.rival ? titleOf(scene.rival) : "");
  show("key-driver", titleOf(scene.driver));
  show("key-rival", scene.rival ? titleOf(scene.rival) : "");
  element("key-rival-part").hidden = !scene.rival;
  showSpeed();
  showPlant();
  redraw();
  link();
}

function showDisturbances(recorded) {
  const ofSet = sets[scene.set]?.disturbances ?? "none";
  const varied = scene.task === "speed" && !recorded;
  element("disturbed").hidden = scene.task !== "speed";
  element("disturbances").value = scene.set ? ofSet : scene.disturbances;
  element("disturbances").disabled = !varied;
  for (const name of Object.keys(DISTURBED)) {
    element(name).value = scene[name];
    element(name).disabled = !varied;
    element(name).setAttribute("aria-valuetext", disturbanceText(name, scene[name]));
    const said =
      name === "latency" || name === "noise" ? element("disturbances").value === "real" : false;
    show(`${name}-value`, said ? "real" : disturbanceText(name, scene[name]));
  }
  const real = "Real: noise, bias and drift, 5 to 15 ms of latency, a motor with lag and friction.";
  show("disturbed-text", recorded ? `${ONLY_FROZEN}.` : real);
  element("seed").value = scene.seed;
  const drawn = scene.task !== "speed" || disturbancesOf(scene) !== "none";
  element("seed-row").hidden = scene.set !== "" || !drawn;
}

function showPlant() {
  element("set").value = scene.set;
  element("plant").value = scene.plant;
  element("plant").disabled = !scene.set;
  const {M, mu} = plantNow();
  if (document.activeElement !== element("M-number")) element("M-number").value = M;
  if (document.activeElement !== element("mu-number")) element("mu-number").value = mu;
  element("M").value = M;
  element("mu").value = Math.log10(mu);
  element("M").setAttribute("aria-valuetext", `${M} kg`);
  element("mu").setAttribute("aria-valuetext", String(mu));
  const jumps = scene.jumps.map((jump) => `${written(jump.t, 2)} s: ${plantText(jump)}`);
  show("jumps", jumps.length ? `Changes: ${jumps.join("; ")}` : "No changes.");
  element("clear").disabled = !hasOwnJumps(scene);
  const recorded = hasRecorded(scene);
  for (const id of ["M", "M-number", "mu", "mu-number", "jump"]) element(id).disabled = recorded;
  element("set").options[0].disabled = recorded;
  showDisturbances(recorded);
}

function makeCharts() {
  const make = (title, unit, build, shape = "") => {
    const figure = document.createElement("figure");
    figure.className = shape;
    const caption = document.createElement("figcaption");
    caption.textContent = unit === "1" ? title : `${title}, ${unit}`;
    const canvas = document.createElement("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Chart: ${caption.textContent}`);
    figure.append(caption, canvas);
    element("charts").append(figure);
    return build(canvas);
  };
  const [first, ...others] = CURVES.map(
    (curve) => () =>
      make(curve.title, curve.unit, (canvas) => new TimeChart(canvas, curve, redraw)),
  );
  const portrait = () => make(
    "Phase portrait: rate, rad/s, over angle", "1", (canvas) => new PhasePortrait(canvas, redraw),
    "tall");
  const made = [first, portrait, ...others].map((build) => build());
  for (const chart of made.filter(({curve}) => curve)) {
    chart.sheet.canvas.addEventListener("click", (event) => {
      seek(chart.value(event.offsetX));
      link();
    });
  }
  return made;
}

function makeRows() {
  for (const [name, unit] of MEASURES) {
    const row = element("rows").insertRow();
    const head = document.createElement("th");
    head.scope = "row";
    head.textContent = unit === "1" ? name : `${name}, ${unit}`;
    row.append(head);
    row.insertCell();
    row.insertCell();
    const task = {"Goal reached": "goal", "Velocity error": "velocity"}[name];
    if (task) row.dataset.task = task;
  }
}

/** Draws all that changes with time. */
function draw() {
  const smooth = !reduced.matches;
  const views =
    player.lanes.map((lane) => ({name: named(lane), view: lane.at(player.now, smooth)}));
  const [driver, rival = null] = views;
  for (const [index, {view}] of views.entries())
    view.contact = contacts[index].see(view.x_dot === 0);
  if (stage.sheet.seen) stage.draw(driver, rival, {lanes: scene.view === "lane", still: !smooth});
  drawings += 1;
  for (const [index, chart] of charts.entries()) {
    // While playing, charts are drawn in every second frame, half of them in each.
    const due = chart.sheet.seen && (index + drawings) % 2 === 0;
    if (due || !player.playing) chart.draw(player.lanes, player.now, span);
  }
  showFigures(driver.view);
  if (!player.playing) describe(views);
  MEASURES.forEach(([, , text], index) => {
    const cells = element("rows").rows[index].cells;
    [driver, rival].forEach((one, column) => {
      const value = one ? text(one.view.metrics) : "";
      if (cells[column + 1].textContent !== value) cells[column + 1].textContent = value;
    });
  });
  const change = player.moment === 0 ? "A change sets the plant of the episode."
                                     : "A change acts from this time on.";
  show("plant-text", hasRecorded(scene) ? `${ONLY_FROZEN}.` : change);
  showEnd();
}

function showFigures({x, x_dot, torque, metrics, contact}) {
  const {now} = player;
  show("figure-time", written(now, 2));
  show("figure-x", written(100 * x, 1));
  show("figure-speed", written(100 * x_dot, 1));
  show("figure-mean", written(metrics.mean_speed, 2));
  show("figure-torque", written(torque, 2));
  const words = {stick: "stick", slip: x_dot > 0 ? "slip →" : "← slip", both: "stick, slip"};
  show("figure-contact", words[contact]);
  element("figure-contact").dataset.contact = contact;
  const scrub = element("scrub");
  scrub.value = player.goal ?? now;
  scrub.setAttribute("aria-valuetext", `${written(now, 2)} s`);
  show("scrub-value", `${written(now, 2)} s`);
  show("best", best > 0 ? `${written(100 * best, 1)} cm` : "none yet");
  const {hand} = player.lanes[0];
  for (const [id, turn] of [["push-left", 1], ["push-right", -1]]) {
    element(id).classList.toggle("now", hand?.helped === true && hand.turn === turn);
  }
}

/** Describes a still picture in words. */
function describe(views) {
  const told = views.map(({name, view}) => {
    const contact =
      view.x_dot === 0 ? "in stick" : `slipping at ${written(100 * view.x_dot, 1)} cm/s`;
    const angle = written((view.theta * 180) / Math.PI, 0);
    const pendulum = `pendulum at ${angle}°, torque ${written(view.torque, 2)} N m`;
    return `${name}: at ${written(100 * view.x, 1)} cm, ${contact}, ${pendulum}`;
  });
  element("scene").setAttribute(
    "aria-label", `At ${written(player.now, 2)} s. ${told.join(". ")}.`);
}

/** Whether a lane has failed and the failure is on the screen. */
function hasFailed(lane) { return lane.failure !== "" && player.now >= lane.time - 1e-9; }

/** Whether the reader has failed; this also stops the rival. */
function handFailed() { return player.lanes[0].hand !== null && hasFailed(player.lanes[0]); }

/** A lane's title, with the time of its failure if any. */
function named(lane) {
  return hasFailed(lane) ? `${lane.title} failed at ${written(lane.time, 2)} s` : lane.title;
}

/** Shows failures and the end of the episode once they are on the screen. */
function showEnd() {
  const failures = player.lanes.filter(hasFailed).map((lane) => `${named(lane)}: ${lane.failure}.`);
  if (player.over && failures.length < player.lanes.length)
    failures.push(`The episode of ${END} s has ended.`);
  if (handFailed()) failures.push("Space begins again.");
  const text = failures.join(" ");
  element("banner").hidden = text === "";
  show("banner-text", text);
  if (text !== told) announce(text);
  told = text;
}

// --- The loop ---

let last = performance.now();
let shownPlant = null;
let drawings = 0;
let sought = false;

function frame(time) {
  const elapsed = Math.max(0, time - last) / 1000;
  last = time;
  if (player.lanes.length > 0) {
    if (player.pass(elapsed)) dirty = true;
    if (dirty) draw();
    dirty = false;
    if (plantNow() !== shownPlant) {
      shownPlant = plantNow();
      showPlant();
    }
    if (player.playing && (player.over || handFailed())) setPlaying(false);
    if (sought && player.goal === null) link();
    sought = player.goal !== null;
  }
  requestAnimationFrame(frame);
}

/** Shows the scene of an address's fragment. */
async function readLink(hash) {
  const {scene: read, complaints} = readScene(hash);
  scene = read;
  complain(complaints.join(". "));
  await open(
    {time: scene.t ?? 0, play: scene.t === null && scene.driver !== YOURSELF && !reduced.matches});
}

makeRows();
setRanges();
bindPlayback();
bindHands();
bindChoices();
bindPlant();
bindPage();
showStrength();
element("span").value = String(span);
requestAnimationFrame(frame);
await readLink(location.hash);
