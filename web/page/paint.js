// Common code of the page's canvases: sharp pixels, the colours of the theme, and shapes.

const style = getComputedStyle(document.documentElement);
// Cached: reading the style is slow, and it changes only with the theme and the window.
const known = new Map();
const forget = () => known.clear();
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", forget);
window.addEventListener("resize", forget);

function remembered(key, find) {
  if (!known.has(key)) known.set(key, find());
  return known.get(key);
}

/** The theme's colour by name, from page.css and the package. */
export function colour(name) {
  return remembered(name, () => style.getPropertyValue(`--${name}`).trim());
}

/** Length of a rem in CSS pixels. */
export function rem() { return remembered(" rem", () => parseFloat(style.fontSize)); }

/** The page's font at a size in rem. */
export function font(rems, weight = 400) {
  return `${weight} ${rems * rem()}px ${remembered(" family", () => style.fontFamily)}`;
}

function trace(context, points) {
  context.beginPath();
  for (const [x, y] of points) context.lineTo(x, y);
}

/** Draws a line through points. */
export function line(context, points, width, ink) {
  trace(context, points);
  stroke(context, width, ink);
}

/** Strokes the current path. */
export function stroke(context, width, ink) {
  context.lineWidth = width;
  context.strokeStyle = ink;
  context.stroke();
}

/** Draws a filled rectangle. */
export function rectangle(context, [x, y, width, height], fill) {
  context.fillStyle = fill;
  context.fillRect(x, y, width, height);
}

/** Draws a filled polygon. */
export function polygon(context, points, fill) {
  trace(context, points);
  context.fillStyle = fill;
  context.fill();
}

/** Draws a filled disc. */
export function disc(context, [x, y], radius, fill) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fillStyle = fill;
  context.fill();
}

/** A canvas with one pixel per pixel of the screen; its width and height are in CSS pixels. */
export class Sheet {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {() => void} changed called when the canvas is empty or outdated: after a change of size
   *   or scrolling to it.
   */
  constructor(canvas, changed) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.width = 0;
    this.height = 0;
    /** Whether a part of the canvas is on the screen. */
    this.seen = true;
    new IntersectionObserver((entries) => {
      this.seen = entries.at(-1).isIntersecting;
      if (this.seen) changed();
    }).observe(canvas);
    new ResizeObserver(() => {
      this.fit();
      changed();
    }).observe(canvas);
    this.fit();
  }

  fit() {
    const ratio = window.devicePixelRatio || 1;
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    this.canvas.width = Math.round(this.width * ratio);
    this.canvas.height = Math.round(this.height * ratio);
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
  }
}
