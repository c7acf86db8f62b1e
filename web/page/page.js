// The page: it binds the controls, and draws what they change.

import {bindCheck} from "check.js";
import {bindControls} from "controls.js";
import {draw, makeDisplay} from "display.js";
import {bindHand, keepBest} from "hand.js";
import {bindPlayback, open} from "playback.js";
import {YOURSELF} from "scene.js";
import {
  handFailed,
  plantNow,
  player,
  readLink,
  redraw,
  reduced,
  scene,
  setPlaying,
  takeRedraw,
  writeLink
} from "session.js";
import {setRanges, showPlant} from "settings.js";
import {bindSharing} from "sharing.js";

let last = performance.now();
let shownPlant = null;
let sought = false;

function frame(time) {
  // First, since an error below would end the animation.
  requestAnimationFrame(frame);
  const elapsed = Math.max(0, time - last) / 1000;
  last = time;
  if (player.lanes.length > 0) advance(elapsed);
}

/** Advances the page by real time (s). */
function advance(elapsed) {
  if (player.pass(elapsed)) redraw();
  if (takeRedraw()) draw();
  if (plantNow() !== shownPlant) {
    shownPlant = plantNow();
    showPlant();
  }
  if (player.playing && (player.over || handFailed())) setPlaying(false);
  if (sought && player.goal === null) writeLink();
  sought = player.goal !== null;
}

/** Shows the scene of an address's fragment. */
async function openLink(hash) {
  readLink(hash);
  const play = scene.t === null && scene.driver !== YOURSELF && !reduced.matches;
  await open({time: scene.t ?? 0, play});
}

player.stepped = keepBest;
makeDisplay();
setRanges();
bindPlayback();
bindHand();
bindControls();
bindSharing();
bindCheck();
// The previous scene may have changed the address since the event.
window.addEventListener("hashchange", (event) => openLink(new URL(event.newURL).hash));
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
requestAnimationFrame(frame);
await openLink(location.hash);
