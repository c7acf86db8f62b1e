// Checks of arguments: each returns the argument, or throws an error that names it.

/** Checks a finite number within limits. */
export function checkNumber(name, value, low = -Infinity, high = Infinity) {
  const range = Number.isFinite(high) ? ` in [${low}, ${high}]` : "";
  const accepted = `${name} must be a finite number${range}`;
  if (typeof value !== "number") throw new TypeError(`${accepted}, got ${String(value)}`);
  if (!Number.isFinite(value) || value < low || value > high)
    throw new RangeError(`${accepted}, got ${value}`);
  return value;
}

/** Checks a name; the error lists the accepted ones. */
export function checkChoice(what, name, names) {
  if (!names.includes(name))
    throw new RangeError(`${what} must be one of ${names.join(", ")}, got ${String(name)}`);
  return name;
}

/** Checks a whole number from 0 to count - 1. */
export function checkCount(name, value, count) {
  const accepted = `${name} must be a whole number from 0 to ${count - 1}`;
  if (!Number.isInteger(value)) throw new TypeError(`${accepted}, got ${String(value)}`);
  if (value < 0 || value >= count) throw new RangeError(`${accepted}, got ${value}`);
  return value;
}

/** Checks that an object has no other fields than these. */
export function checkFields(name, value, names) {
  const accepted = `${name} must be an object with fields out of ${names.join(", ")}`;
  if (typeof value !== "object" || value === null) throw new TypeError(`${accepted}, got ${value}`);
  const stranger = Object.keys(value).find((key) => !names.includes(key));
  if (stranger !== undefined) throw new RangeError(`${accepted}, got ${stranger}`);
  return value;
}
