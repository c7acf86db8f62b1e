// What the page shows and its playback, which the modules of the page share.

import {complain, element} from "elements.js";
import {Player} from "player.js";
import {firstScene, readScene, writeScene} from "scene.js";

// Shortest time between two writes of the address, ms: Safari refuses more than 100 in 30 s.
const WRITE_PERIOD = 500;

export const reduced = window.matchMedia("(prefers-reduced-motion: reduce)");
export const player = new Player();
export const scene = firstScene();
let outdated = true;
let lastWrite = -Infinity;
let nextWrite;

/** Has the picture drawn in the next frame. */
export function redraw() { outdated = true; }

/** Whether the picture must be drawn; the next call returns false unless there is a reason. */
export function takeRedraw() {
  const due = outdated;
  outdated = false;
  return due;
}

/** M and mu at the shown time. */
export function plantNow() {
  return scene.jumps.findLast(({t}) => t <= player.moment + 1e-9) ?? scene;
}

/** The reader's actions: those of a link, or the recorded ones. */
export function handActions() {
  const [lane] = player.lanes;
  if (!lane?.hand) return [];
  const {replay} = lane.hand;
  if (replay.length > lane.steps) return replay;
  return Array.from(lane.trace.action.subarray(1, lane.steps + 1));
}

/** Turns the helper of the reader's hand on or off. */
export function help() {
  const hand = player.lanes[0]?.hand;
  if (hand) hand.helped = element("help").checked;
}

/** Whether a lane has failed and the failure is on the screen. */
export function hasFailed(lane) { return lane.failure !== "" && player.now >= lane.time - 1e-9; }

/** Whether the reader has failed; this also stops the rival. */
export function handFailed() {
  const [lane] = player.lanes;
  return lane.hand !== null && hasFailed(lane);
}

/** The page's address with the scene, and with the time if the page is paused. */
export function sceneAddress() {
  const time = player.goal ?? player.now;
  scene.t = player.playing || time === 0 ? null : Number(time.toFixed(3));
  const hash = writeScene({...scene, hand: handActions()});
  // In a page embedded in another, relative addresses refer to the outer page.
  return new URL(hash, location.href).href;
}

/** Writes the scene to the page's address, now or once `WRITE_PERIOD` has passed. */
export function writeLink() {
  clearTimeout(nextWrite);
  const wait = lastWrite + WRITE_PERIOD - performance.now();
  if (wait > 0) {
    nextWrite = setTimeout(writeLink, wait);
    return;
  }
  lastWrite = performance.now();
  try {
    history.replaceState(null, "", sceneAddress());
  } catch {
    // The browser refuses the address: "Copy link" still gives it.
  }
}

/** Reads the scene of an address's fragment. */
export function readLink(hash) {
  const {scene: read, complaints} = readScene(hash);
  Object.assign(scene, read);
  complain(complaints.join(". "));
}

export function setPlaying(playing) {
  const changed = playing !== player.playing;
  player.playing = playing;
  const button = element("play");
  const title = playing ? "Pause" : "Play";
  button.classList.toggle("playing", playing);
  button.setAttribute("aria-label", title);
  button.title = title;
  redraw();
  if (changed && !playing) writeLink();
}

/** Pauses, and shows a time (s). */
export function seek(time) {
  setPlaying(false);
  player.seek(time);
  redraw();
}
