// What every canvas of the page needs: sharp pixels, and the colours of the theme.

const style = getComputedStyle(document.documentElement);
// Asking for the style is slow, and it changes with the theme and with the window only.
const known = new Map();
const forget = () => known.clear();
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", forget);
window.addEventListener("resize", forget);

function remembered(key, find) {
  if (!known.has(key)) known.set(key, find());
  return known.get(key);
}

/** The theme's colour of that name, as page.css and the package have it. */
export function colour(name) {
  return remembered(name, () => style.getPropertyValue(`--${name}`).trim());
}

/** How many CSS pixels a rem is. */
export function rem() {
  return remembered(" rem", () => parseFloat(style.fontSize));
}

/** The page's font at that size in rem. */
export function font(rems, weight = 400) {
  return `${weight} ${rems * rem()}px ${remembered(" family", () => style.fontFamily)}`;
}

/** A canvas that has as many pixels as it covers on the screen, and knows its size in CSS pixels. */
export class Sheet {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {() => void} changed called when it is empty or old: after its size has changed, and when it is scrolled to.
   */
  constructor(canvas, changed) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.width = 0;
    this.height = 0;
    /** Whether any of it is on the screen. */
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
