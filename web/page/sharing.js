// Copies of the link, and pictures of the stage.

import {stage} from "display.js";
import {announce, element, on} from "elements.js";
import {written} from "numbers.js";
import {player, sceneAddress} from "session.js";

export function bindSharing() {
  on("copy", "click", copyLink);
  on("share", "click", share);
}

async function copyLink() {
  const button = element("copy");
  try {
    await navigator.clipboard.writeText(sceneAddress());
    announce("The link is copied");
    button.textContent = "Copied";
  } catch {
    announce("The link stands in the address of the page");
    button.textContent = "In the address bar";
  }
  setTimeout(() => {
    button.textContent = "Copy link";
  }, 2000);
}

/**
 * Shares a picture of the stage and the link by the system's dialog; saves the picture if there is
 * none.
 */
async function share() {
  const [lane] = player.lanes;
  const {metrics} = lane.at(player.now, false);
  const distance = written(100 * metrics.distance, 1);
  const text = `${lane.title}: ${distance} cm in ${written(player.now, 1)} s`;
  const picture = await stage.picture(text);
  const file = new File([picture], "capsule.png", {type: picture.type});
  const content = {files: [file], text, url: sceneAddress()};
  if (navigator.canShare?.(content)) {
    // A rejection means that the reader has closed the dialog.
    await navigator.share(content).catch(() => {});
    return;
  }
  const save = document.createElement("a");
  save.download = file.name;
  save.href = URL.createObjectURL(picture);
  save.click();
  URL.revokeObjectURL(save.href);
  announce("The picture is saved");
}
