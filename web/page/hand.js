// Manual control by keys, buttons, slider and drags.

import {constants} from "capsule.mjs";
import {element, on, sayValue, show} from "elements.js";
import {clamp, written} from "numbers.js";
import {nudge, togglePlay} from "playback.js";
import {handAction, YOURSELF} from "scene.js";
import {help, player, scene, setPlaying} from "session.js";

// The directions of the keys by their code, which Shift does not change: 1 is to the left.
const KEYS = {
  ArrowLeft: 1,
  KeyA: 1,
  ArrowRight: -1,
  KeyD: -1
};
// Factor by which the helper reduces the strength of the right key.
const RETURN_SHARE = 0.25;
const BEST_KEY = "capsule_gym.best_distance";
// Drag distance for the full torque, pixels.
const DRAG = 140;

const held = new Set();
let best = readBest();

function readBest() {
  try {
    return Number(localStorage.getItem(BEST_KEY));
  } catch {
    return 0;
  }
}

/** Stores the reader's distance if it is the longest. */
export function keepBest(lane) {
  if (!lane.hand || scene.hand.length) return;
  const {distance} = lane.metrics[lane.steps];
  if (distance > best) storeBest(distance);
}

function storeBest(distance) {
  best = distance;
  try {
    localStorage.setItem(BEST_KEY, String(distance));
  } catch {
    // Without storage, the distance is lost when the page closes.
  }
}

export function showBest() { show("best", best > 0 ? `${written(100 * best, 1)} cm` : "none yet"); }

function torqueText(share) { return `${written(share * constants.torque_limit, 2)} N m`; }

/** Applies an action of the reader; a nonzero one replaces what was recorded after this step. */
function drive(action) {
  const [lane] = player.lanes;
  const hand = lane?.hand;
  if (!hand) return;
  const value = handAction(action);
  // The angle is positive to the left, so the slider has the opposite sign of the torque.
  element("torque").value = -value;
  sayValue("torque", torqueText(value));
  show("torque-value", torqueText(value));
  if (value === hand.live) return;
  const step = lane.stepAt(player.moment);
  const recorded = Math.max(lane.steps, hand.replay.length);
  if (value !== 0 && recorded > step) {
    player.branch();
    hand.replay.length = Math.min(hand.replay.length, step);
    scene.hand = [];
  }
  hand.live = value;
}

/** Applies the torque of the held keys. */
function driveByKeys() {
  const directions = [...held].reduce((sum, key) => sum + KEYS[key], 0);
  const turn = clamp(directions, -1, 1);
  const share = turn < 0 && element("help").checked ? RETURN_SHARE : 1;
  drive(turn * share * Number(element("strength").value));
}

/** Plays if the episode has not ended. */
function playOn() {
  if (!player.over) setPlaying(true);
}

function release() {
  held.clear();
  drive(0);
}

function pressKey(event) {
  const within = (selector) => event.target.closest?.(selector);
  if (within("input:not(#torque), select, dialog")) return;
  if (event.ctrlKey || event.metaKey || event.altKey) {
    // macOS does not tell of a key that is released while Command is held.
    release();
    return;
  }
  if (event.code in KEYS && scene.driver === YOURSELF) {
    event.preventDefault();
    held.add(event.code);
    driveByKeys();
    if (!player.playing && !event.repeat) playOn();
  } else if (event.key === " " && !within("button, a, input")) {
    event.preventDefault();
    togglePlay();
  } else if (event.key === "." && event.target === element("stage")) {
    nudge(1);
  }
}

export function bindHand() {
  document.addEventListener("keydown", pressKey);
  document.addEventListener("keyup", (event) => {
    if (held.delete(event.code)) driveByKeys();
  });
  window.addEventListener("blur", release);
  on("torque", "input", () => {
    drive(-Number(element("torque").value));
    playOn();
  });
  for (const end of ["change", "pointerup", "pointercancel", "blur"]) on("torque", end, release);
  on("strength", "input", showStrength);
  on("help", "change", help);
  showStrength();
  bindDrag();
  for (const button of document.querySelectorAll(".push")) bindPush(button);
}

function showStrength() { show("strength-value", torqueText(element("strength").value)); }

/** Binds drags across the stage. */
function bindDrag() {
  let begin = 0;
  bindPointer(element("stage"), {
    down: (event) => {
      begin = event.clientX;
    },
    move: (event) => drive((begin - event.clientX) / DRAG),
    up: driveByKeys,
  });
}

/** Binds a button that acts as a key. */
function bindPush(button) {
  const {key} = button.dataset;
  bindPointer(button, {
    down: () => {
      held.add(key);
      driveByKeys();
    },
    move: () => {},
    up: () => {
      held.delete(key);
      driveByKeys();
    },
  });
}

/** Binds the first pointer that touches a node, until it leaves; others have no effect. */
function bindPointer(node, {down, move, up}) {
  let pointer = null;
  node.addEventListener("pointerdown", (event) => {
    if (scene.driver !== YOURSELF || pointer !== null) return;
    // First, since it may throw, and since `lostpointercapture` says when the pointer leaves.
    node.setPointerCapture(event.pointerId);
    pointer = event.pointerId;
    down(event);
    playOn();
  });
  node.addEventListener("pointermove", (event) => {
    if (event.pointerId === pointer) move(event);
  });
  node.addEventListener("lostpointercapture", (event) => {
    if (event.pointerId !== pointer) return;
    pointer = null;
    up();
  });
}
