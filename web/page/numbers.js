// Functions for numbers.

/** Formats a number with a true minus sign and never as "-0"; a dash if it is not finite. */
export function written(value, decimals) {
  if (!Number.isFinite(value)) return "–";
  const text = value.toFixed(decimals);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
}

/** The smallest of 1, 2, 5 times a power of ten that is at least `least`. */
export function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return ([1, 2, 5].find((factor) => factor * power >= least * (1 - 1e-9)) ?? 10) * power;
}

/** Number of decimals that distinguish multiples of `step`. */
export function decimals(step) { return Math.max(0, -Math.floor(Math.log10(step) + 1e-9)); }

/** Clamps the value to [low, high]. */
export function clamp(value, low, high) { return Math.min(high, Math.max(low, value)); }
