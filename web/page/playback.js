// Opening of the scene's episodes, and the buttons and sliders that play them.

import {constants} from "capsule.mjs";
import {complain, element, on} from "elements.js";
import {Lane} from "lane.js";
import {handFailed, help, player, redraw, scene, seek, setPlaying, writeLink} from "session.js";
import {showScene, showSpeed, SPEEDS} from "settings.js";

let openings = 0;

/** Opens the scene's lanes again at a time, and plays or pauses. */
export async function open({time = 0, play = player.playing} = {}) {
  const opening = ++openings;
  player.playing = false;
  try {
    const lanes = [await Lane.open(scene.driver, scene)];
    if (scene.rival) lanes.push(await Lane.open(scene.rival, scene));
    // Another scene may have been chosen meanwhile.
    if (opening !== openings) return;
    player.lanes = lanes;
  } catch (error) {
    if (opening === openings) complain(error.message);
    return;
  }
  player.now = 0;
  player.goal = null;
  help();
  if (time > 0) player.seek(time);
  showScene();
  setPlaying(play);
}

/** Begins the episode again, without the reader's actions. */
function restart() {
  scene.hand = [];
  open({play: true});
}

export function togglePlay() {
  if (player.playing) setPlaying(false);
  else if (player.over || handFailed()) restart();
  else setPlaying(true);
}

/** Pauses, and goes forward or back by steps. */
export function nudge(steps) {
  setPlaying(false);
  player.nudge(steps);
  redraw();
}

export function bindPlayback() {
  on("play", "click", togglePlay);
  on("restart", "click", restart);
  on("again", "click", restart);
  on("step", "click", () => nudge(1));
  on("back", "click", () => nudge(-1));
  const scrub = element("scrub");
  scrub.step = constants.control_dt;
  scrub.addEventListener("input", () => seek(Number(scrub.value)));
  scrub.addEventListener("change", writeLink);
  on("speed", "input", () => {
    scene.speed = SPEEDS[element("speed").value];
    showSpeed();
    writeLink();
  });
}
