// Elements of the page, and text in them.

/** Returns an element by its id. */
export function element(id) { return document.getElementById(id); }

/** Calls a function at an event of an element. */
export function on(id, event, listener) { element(id).addEventListener(event, listener); }

/** Shows a text in an element. */
export function show(id, text) { setText(element(id), text); }

/** Sets the text of a node unless it has it, since that would interrupt a selection. */
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** Sets what a screen reader says of a slider's value. */
export function sayValue(id, text) { element(id).setAttribute("aria-valuetext", text); }

/** Says a text by the screen reader. */
export function announce(text) { show("status", text); }

/** Shows an error, or hides the last one if the text is empty. */
export function complain(text) {
  element("trouble").hidden = text === "";
  show("trouble", text);
}

/** Adds a row with a heading to the body of a table. */
export function addRow(id, heading) {
  const row = element(id).insertRow();
  const head = document.createElement("th");
  head.scope = "row";
  head.textContent = heading;
  row.append(head);
  return row;
}
