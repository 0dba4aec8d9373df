// The values of the gauges over the last seconds: a strip for each group, with a scale of its own.

const SPAN = 10; // s
const LEAST = 0.02; // of the range, that a strip shows
const PAD = 6; // pixels

// Where the scale of a gauge begins and ends.
export const ends = ({ low, high, span = 360 }) => [low ?? -span, high ?? span];

export class Chart {
  constructor(canvas) {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d");
    this.samples = []; // [time in s, values of each group by its title]
  }

  // Keep the values of all groups, and draw those that are `chosen` by their titles; without them, all.
  show(all, chosen) {
    const now = performance.now() / 1000;
    const values = all.map(({ title, gauges }) => [title, gauges.map(({ value }) => value)]);
    const groups = chosen ? all.filter(({ title }) => chosen.includes(title)) : all;
    this.samples.push([now, Object.fromEntries(values)]);
    while (this.samples[0][0] < now - SPAN) this.samples.shift();
    this.groups = groups;
    this.due ??= requestAnimationFrame(() => {
      this.due = null;
      this.draw();
    });
  }

  draw() {
    const { canvas, pen, groups } = this;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    Object.assign(canvas, { width: width * devicePixelRatio, height: height * devicePixelRatio });
    pen.scale(devicePixelRatio, devicePixelRatio);
    const strip = height / groups.length;
    groups.forEach((group, g) => this.drawStrip(group, g * strip, strip, width));
  }

  drawStrip({ title, unit, gauges, digits, label = "" }, top, height, width) {
    const { pen, samples } = this;
    const style = getComputedStyle(this.canvas);
    const colour = (name) => style.getPropertyValue(`--${name}`);
    const values = samples.flatMap(([, all]) => all[title] ?? []).filter((value) => value !== null);
    if (!values.length) return;
    const range = Math.max(...gauges.map(ends).map(([from, to]) => to - from));
    let [low, high] = [Math.min(...values), Math.max(...values)];
    const short = (LEAST * range - (high - low)) / 2;
    if (short > 0) [low, high] = [low - short, high + short];
    const y = (value) => top + PAD + ((high - value) / (high - low)) * (height - 2 * PAD);
    const x = (time) => width - ((samples.at(-1)[0] - time) / SPAN) * width;
    pen.strokeStyle = colour("line");
    pen.lineWidth = 1;
    pen.strokeRect(0.5, top + 3.5, width - 1, height - 7);
    if (low < 0 && high > 0) this.line([[0, y(0)], [width, y(0)]]);
    pen.lineWidth = 1.5;
    let legend = 8;
    gauges.forEach(({ name }, i) => {
      pen.strokeStyle = pen.fillStyle = `hsl(${210 + (360 * i) / gauges.length} 65% 52%)`;
      const points = samples.filter(([, all]) => Number.isFinite(all[title]?.[i]));
      this.line(points.map(([time, all]) => [x(time), y(all[title][i])]));
      const label = name.split(":")[0];
      pen.fillText(label, legend, top + height - 9);
      legend += pen.measureText(label).width + 8;
    });
    pen.fillStyle = colour("soft");
    pen.fillText(`${label}${low.toFixed(digits)} to ${high.toFixed(digits)} ${unit}, ${SPAN} s`, 8, top + 16);
  }

  line(points) {
    this.pen.beginPath();
    for (const [x, y] of points) this.pen.lineTo(x, y);
    this.pen.stroke();
  }
}
