import {HEADER} from "./archive.mjs";
import {drive} from "./episode.mjs";

/** Steps between two pauses of a replay, which keep the page responsive. */
const STEPS_PER_PAUSE = 200;

/** Returns the sha256 of concatenated typed arrays. */
async function digest(arrays) {
  const content = await new Blob(arrays).arrayBuffer();
  const hash = new Uint8Array(await crypto.subtle.digest("SHA-256", content));
  return Array.from(hash, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Replays one committed episode; resolves to its hash and the numbers of steps and doubles. */
async function replay({driver, actions, hold, ...options}) {
  const episode = await drive(driver, options);
  const shown = [];
  let steps = 0;
  let doubles = 0;
  for (let over = false; !over;) {
    const action = actions?.[Math.floor(steps / hold) % actions.length];
    const {terminated, truncated} = actions ? episode.step(action) : episode.tick();
    for (const part of episode.compared) {
      shown.push(part);
      if (part instanceof Float64Array) doubles += part.length;
    }
    over = terminated || truncated;
    steps += 1;
    if (steps % STEPS_PER_PAUSE === 0) await new Promise((resolve) => setTimeout(resolve));
  }
  return {hash: await digest(shown), steps, doubles};
}

/**
 * Replays the committed episodes, and compares every bit of what they show with Python's by hash.
 *
 * @param report called with {name, equal, steps, doubles} after each episode.
 */
export async function check(report = () => {}) {
  let all = true;
  for (const {name, steps: expected, sha256, ...episode} of HEADER.episodes) {
    const {hash, steps, doubles} = await replay(episode);
    const equal = hash === sha256 && steps === expected;
    all &&= equal;
    report({name, equal, steps, doubles});
  }
  return all;
}
