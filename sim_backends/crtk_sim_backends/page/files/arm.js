// The picture of arms and tools on their floor, with shadows, frames, paths of the tips, and forces as arrows.

import { IDENTITY, origin, shape } from "./chain.js";
import { Raster } from "./solids.js";

const LIGHT = [0.35, -0.5, 0.79];
const AXES = ["#e0483e", "#35a352", "#3f74e0"];
const PATH = 500; // points of the path of the tip
const FINE = 2; // pixels drawn for one that is shown, in each direction
const SLOW = 14; // ms for a picture, beyond which it is drawn more coarsely while it moves
const STILL = 250; // ms after which it is drawn finely again
const FILLED = 0.84; // of the canvas, by what is held in view
const CELL = 0.12; // of the reach: how finely it is remembered where the arm was

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];
const rgb = (text) => text.split(",").map(Number);

export class ArmPicture {
  // `reach` (m) of the largest of them.
  constructor(canvas, reach) {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d");
    this.reach = reach;
    this.layer = document.createElement("canvas");
    this.fine = FINE;
    this.clear();
    this.home();
    this.listen();
  }

  // Forget where things were.
  clear() {
    this.things = [];
    this.shown = "";
    this.paths = new Map(); // of the tips, by name
    this.held = new Map(); // [point, radius] by its cell
    this.mostForce = 0;
  }

  // Look as at the beginning.
  home() {
    Object.assign(this, { azimuth: -0.85, elevation: 0.36, zoom: 1 });
  }

  // Show things: {name, place, chain, q, tip, force, faded}, transforms in the world (m), q in rad or m; `force` (N) is
  // {at, vector} in the world. What a thing has not is left out.
  show(things) {
    const now = JSON.stringify(things);
    if (now === this.shown) return;
    this.shown = now;
    this.things = things;
    for (const { name, tip, force } of things) {
      if (force) this.mostForce = Math.max(this.mostForce, Math.hypot(...force.vector));
      if (!tip) continue;
      const path = this.paths.get(name) ?? [];
      this.paths.set(name, path);
      const at = origin(tip);
      if (!path.length || Math.hypot(...sub(at, path.at(-1))) > 2e-3) path.push(at);
      if (path.length > PATH) path.shift();
    }
    this.redraw();
  }

  redraw() {
    this.due ??= requestAnimationFrame(() => {
      this.due = null;
      if (this.things.length) this.draw();
    });
  }

  // From the world to the canvas, which holds every place where the arm has been.
  view() {
    const { width, height } = this.canvas;
    const [sa, ca] = [Math.sin(this.azimuth), Math.cos(this.azimuth)];
    const [se, ce] = [Math.sin(this.elevation), Math.cos(this.elevation)];
    const forward = [-ca * ce, -sa * ce, -se];
    const right = [-sa, ca, 0];
    const up = cross(right, forward);
    const focal = 1.9 * Math.min(width, height);
    let target = [0, 0, 0.4 * this.reach];
    let distance = 4 * this.reach;
    const eye = () => target.map((value, k) => value - forward[k] * distance);
    for (let round = 0; round < 4; round++) {
      const from = eye();
      const ends = [Infinity, -Infinity, Infinity, -Infinity];
      for (const [point, radius] of this.held.values()) {
        const ray = sub(point, from);
        const depth = Math.max(dot(ray, forward), 0.1 * this.reach);
        const [across, upward, half] = [dot(ray, right), dot(ray, up), radius].map((x) => x / depth);
        ends[0] = Math.min(ends[0], across - half);
        ends[1] = Math.max(ends[1], across + half);
        ends[2] = Math.min(ends[2], upward - half);
        ends[3] = Math.max(ends[3], upward + half);
      }
      const [aside, above] = [(ends[0] + ends[1]) / 2, (ends[2] + ends[3]) / 2];
      target = target.map((value, k) => value + distance * (aside * right[k] + above * up[k]));
      distance *= (focal / FILLED) * Math.max((ends[1] - ends[0]) / width, (ends[3] - ends[2]) / height);
    }
    distance *= this.zoom;
    const from = eye();
    return {
      eye: from,
      light: LIGHT,
      project: (point) => {
        const ray = sub(point, from);
        const depth = Math.max(dot(ray, forward), 0.02);
        return [
          width / 2 + (focal * dot(ray, right)) / depth,
          height / 2 - (focal * dot(ray, up)) / depth,
          depth,
        ];
      },
    };
  }

  hold(solids) {
    const cell = CELL * this.reach;
    for (const { from, to, radius } of solids) {
      for (const point of [from, to]) {
        const key = point.map((value) => Math.round(value / cell)).join();
        if (!(this.held.get(key)?.[1] >= radius)) this.held.set(key, [point, radius]);
      }
    }
  }

  colour(name) {
    return getComputedStyle(this.canvas).getPropertyValue(`--${name}`).trim();
  }

  draw() {
    const canvas = this.canvas;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((size) =>
      Math.max(1, Math.round(size * devicePixelRatio)),
    );
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const colours = Object.fromEntries(
      ["base", "link", "elbow", "joint", "cap", "tool"].map((part) => [part, rgb(this.colour(part))]),
    );
    const solids = this.things
      .filter(({ chain, q }) => chain && q)
      .flatMap(({ chain, q, place, tip }) => shape(chain, q, place, tip))
      .map((each) => ({ ...each, colour: colours[each.part] }));
    this.hold(solids);
    const alone = this.things.flatMap(({ place, chain, tip, force }) =>
      chain ? [] : [place && origin(place), tip && origin(tip), ...(force ? this.arrow(force) : [])].filter(Boolean),
    );
    this.hold(alone.map((point) => ({ from: point, to: point, radius: 0.12 * this.reach })));
    const looking = this.view();
    this.pen.clearRect(0, 0, width, height);
    this.drawFloor(looking, 1.3 * this.extent());
    this.drawShadow(looking, solids);
    this.drawAxes(looking, IDENTITY, 0.28 * this.reach, 2);
    this.drawSolids(looking, solids);
    for (const path of this.paths.values()) {
      if (path.length > 1) this.line(path.map(looking.project), this.colour("path"), 1.8);
    }
    for (const thing of this.things) this.drawThing(looking, thing);
  }

  // Half the size of the floor: as far as anything has been.
  extent() {
    let most = this.reach;
    for (const [[x, y]] of this.held.values()) most = Math.max(most, Math.hypot(x, y) / 1.2);
    return most;
  }

  drawThing(looking, { name, place, tip, force }) {
    if (place && name) {
      this.drawAxes(looking, place, 0.12 * this.reach, 2);
      this.text(looking.project(origin(place)), name);
    }
    if (tip) this.drawAxes(looking, tip, 0.13 * this.reach, 2.5);
    if (force) this.drawForce(looking, force);
  }

  // Both ends of a force; the largest that was seen, but at least 1 N, is 0.4 of the reach.
  arrow({ at, vector }) {
    const scale = (0.4 * this.reach) / Math.max(1, this.mostForce);
    return [at, at.map((value, k) => value + scale * vector[k])];
  }

  drawForce({ project }, force) {
    const { vector } = force;
    const [at, end] = this.arrow(force);
    if (Math.hypot(...sub(end, at)) < 0.01 * this.reach) return;
    const [from, to] = [project(at), project(end)];
    const style = this.colour("force");
    this.line([from, to], style, 4);
    const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
    const size = 5 * devicePixelRatio;
    const length = Math.hypot(dx, dy) || 1;
    const [ux, uy] = [(dx / length) * size, (dy / length) * size];
    this.pen.fillStyle = style;
    this.pen.beginPath();
    this.pen.moveTo(to[0] + 2 * ux, to[1] + 2 * uy);
    this.pen.lineTo(to[0] - uy, to[1] + ux);
    this.pen.lineTo(to[0] + uy, to[1] - ux);
    this.pen.fill();
    this.text(to, `${Math.hypot(...vector).toFixed(1)} N`, style);
  }

  text([x, y], words, style = this.colour("soft")) {
    this.pen.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
    this.pen.fillStyle = style;
    this.pen.fillText(words, x + 8 * devicePixelRatio, y + 14 * devicePixelRatio);
  }

  line(points, style, width) {
    this.pen.beginPath();
    points.forEach(([x, y], i) => (i ? this.pen.lineTo(x, y) : this.pen.moveTo(x, y)));
    this.pen.strokeStyle = style;
    this.pen.lineWidth = width * devicePixelRatio;
    this.pen.stroke();
  }

  drawFloor({ project }, extent) {
    const steps = 8;
    const style = this.colour("grid");
    for (let i = -steps; i <= steps; i++) {
      const at = (i / steps) * extent;
      const half = Math.sqrt(Math.max(0, extent ** 2 - at ** 2));
      this.line([project([at, -half, 0]), project([at, half, 0])], style, 1);
      this.line([project([-half, at, 0]), project([half, at, 0])], style, 1);
    }
  }

  drawShadow({ project }, solids) {
    const shadow = new Path2D();
    const fall = ([x, y, z]) => [x - (z * LIGHT[0]) / LIGHT[2], y - (z * LIGHT[1]) / LIGHT[2], 0];
    const points = 16;
    for (const { from, to, radius } of solids) {
      const [a, b] = [fall(from), fall(to)];
      const along = Math.atan2(b[1] - a[1], b[0] - a[0]);
      for (let i = 0; i <= points; i++) {
        const angle = along + Math.PI / 2 + (2 * Math.PI * i) / points;
        const centre = 2 * i <= points ? a : b;
        const [x, y] = project([
          centre[0] + radius * Math.cos(angle), centre[1] + radius * Math.sin(angle), 0,
        ]);
        if (i) shadow.lineTo(x, y);
        else shadow.moveTo(x, y);
      }
      shadow.closePath();
    }
    this.pen.fillStyle = this.colour("shadow");
    this.pen.fill(shadow);
  }

  drawAxes({ project }, t, length, width) {
    const start = origin(t);
    AXES.forEach((style, axis) => {
      const end = start.map((value, row) => value + length * t[4 * row + axis]);
      this.line([project(start), project(end)], style, width);
    });
  }

  drawSolids(looking, solids) {
    const { width, height } = this.canvas;
    const [columns, rows] = [width, height].map((size) => Math.round(size * this.fine));
    if (this.raster?.width !== columns || this.raster.height !== rows) {
      this.raster = new Raster(columns, rows, this.fine);
      Object.assign(this.layer, { width: columns, height: rows });
    }
    const begun = performance.now();
    this.raster.clear();
    for (const solid of solids) this.raster.draw(solid, looking);
    this.layer.getContext("2d").putImageData(this.raster.image, 0, 0);
    this.pen.drawImage(this.layer, 0, 0, width, height);
    if (performance.now() - begun > SLOW) this.fine = 1;
    clearTimeout(this.later);
    if (this.fine < FINE) {
      this.later = setTimeout(() => {
        this.fine = FINE;
        this.redraw();
      }, STILL);
    }
  }

  // Drag to turn it, scroll or pinch to come closer, double-click to look as at the beginning.
  listen() {
    const canvas = this.canvas;
    const fingers = new Map();
    const spread = () => {
      const [a, b] = [...fingers.values()];
      return Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
    };
    canvas.onpointerdown = (event) => {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, event);
    };
    canvas.onpointerup = canvas.onpointercancel = (event) => fingers.delete(event.pointerId);
    canvas.onpointermove = (event) => {
      if (!fingers.has(event.pointerId)) return;
      const before = fingers.size === 2 ? spread() : 0;
      const last = fingers.get(event.pointerId);
      fingers.set(event.pointerId, event);
      if (before) this.closer(before / Math.max(1, spread()));
      else {
        this.azimuth -= 0.008 * (event.clientX - last.clientX);
        const elevation = this.elevation + 0.008 * (event.clientY - last.clientY);
        this.elevation = Math.max(0.03, Math.min(1.5, elevation));
      }
      this.redraw();
    };
    canvas.onwheel = (event) => {
      event.preventDefault();
      this.closer(Math.exp(0.001 * event.deltaY));
      this.redraw();
    };
    canvas.ondblclick = () => {
      this.home();
      this.redraw();
    };
  }

  closer(factor) {
    this.zoom = Math.max(0.3, Math.min(4, this.zoom * factor));
  }
}
