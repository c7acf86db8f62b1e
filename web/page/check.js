// The dialog that replays the committed episodes.

import {check} from "capsule.mjs";
import {addRow, element, on, show} from "elements.js";
import {setPlaying} from "session.js";

let checking = false;

export function bindCheck() {
  on("check", "click", () => {
    setPlaying(false);
    element("checks").showModal();
    if (!checking) runCheck();
  });
}

/** Replays the committed episodes and shows the results. */
async function runCheck() {
  checking = true;
  const rows = element("check-rows");
  rows.replaceChildren();
  show("verdict", "Replaying …");
  try {
    const equal = await check(showResult);
    const all = `All ${rows.rows.length} episodes are equal, bit for bit.`;
    show("verdict", equal ? all : "Some episodes are different.");
  } catch (error) {
    show("verdict", `The check failed: ${error.message}`);
  }
  checking = false;
}

function showResult({name, equal, steps, doubles}) {
  const row = addRow("check-rows", name);
  row.insertCell().textContent = steps.toLocaleString("en");
  row.insertCell().textContent = doubles.toLocaleString("en");
  const bits = row.insertCell();
  bits.className = equal ? "equal" : "different";
  bits.textContent = bits.className;
  row.scrollIntoView({block: "nearest"});
}
