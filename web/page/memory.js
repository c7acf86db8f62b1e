// The memory of a recurrent policy over time.

import {Timeline} from "charts.js";
import {niceStep} from "numbers.js";
import {colour, rectangle} from "paint.js";

/** A row per unit of the driver's memory; its colour fades from -1 and 1 to the background at 0. */
export class MemoryStrip extends Timeline {
  constructor(canvas, changed) {
    super(canvas, changed);
    this.image = document.createElement("canvas").getContext("2d");
  }

  vertical([{units}]) {
    const step = Math.max(1, niceStep(units / 4));
    return {low: 0, high: units, step};
  }

  plot([lane]) {
    const {first, last, each} = this.shownSteps(lane);
    const columns = Math.floor((last - first) / each) + 1;
    if (columns < 1) return;
    this.paint(lane, first, columns, each);
    const {context} = this.sheet;
    // The memory of step k chose the action between the times of steps k - 1 and k.
    const left = this.x((first - 1) * lane.dt);
    const width = columns * each * lane.dt * this.perValue;
    const place = [left, this.top, width, this.bottom - this.top];
    rectangle(context, place, colour("surface"));
    context.imageSmoothingEnabled = false;
    context.drawImage(this.image.canvas, ...place);
  }

  /**
   * Paints the image of every `each`th step: a pixel per step and unit, the first unit at the
   * bottom.
   */
  paint({units, trace}, first, columns, each) {
    const {image} = this;
    const negative = this.parts("accent");
    const positive = this.parts("warning");
    image.canvas.width = columns;
    image.canvas.height = units;
    const pixels = image.createImageData(columns, units);
    for (let column = 0; column < columns; column++) {
      const from = (first + column * each) * units;
      for (let unit = 0; unit < units; unit++) {
        const value = trace.memory[from + unit];
        const place = 4 * ((units - 1 - unit) * columns + column);
        pixels.data.set(value < 0 ? negative : positive, place);
        pixels.data[place + 3] = 255 * Math.abs(value);
      }
    }
    image.putImageData(pixels, 0, 0);
  }

  /** Red, green and blue of a colour of the theme. */
  parts(name) {
    this.image.fillStyle = colour(name);
    const number = parseInt(this.image.fillStyle.slice(1), 16);
    return [number >> 16, (number >> 8) & 255, number & 255];
  }
}
