// The page: draws the arm on a plain canvas, tells modes and numbers, and lets faults begin.

import { compose, frames, fromPose, origin, shape } from "./arm.js";

const JOINTS = ["base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3"];
const FAULTS = [
  ["protective_stop", "protective stop"],
  ["emergency_stop", "emergency stop"],
  ["safeguard_stop", "safeguard stop"],
  ["reduced_mode", "reduced mode"],
  ["power_loss", "power loss"],
  ["stall", "controller hangs"],
];
const GOOD = ["RUNNING", "NORMAL", "PLAYING"];
const BAD = ["PROTECTIVE_STOP", "ROBOT_EMERGENCY_STOP", "VIOLATION", "FAULT"];
const COLOURS = { link: [196, 203, 212], joint: [78, 140, 190], tool: [210, 130, 60] };
const LIGHT = [0.35, -0.5, 0.79];
const SIDES = 20;
const PATH = 400; // points of the path of the TCP

const $ = (id) => document.getElementById(id);
const canvas = $("picture");
const pen = canvas.getContext("2d");
const camera = { azimuth: -0.9, elevation: 0.42, distance: 2.8 };
const path = [];
let arm = null;
let found = null;

// Vectors

const sub = (a, b) => a.map((value, i) => value - b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];
const unit = (a) => {
  const length = Math.hypot(...a);
  return a.map((value) => value / length);
};

// From the world to the canvas

function view() {
  const reach = Math.abs(arm.a[1]) + Math.abs(arm.a[2]);
  const [sa, ca] = [Math.sin(camera.azimuth), Math.cos(camera.azimuth)];
  const [se, ce] = [Math.sin(camera.elevation), Math.cos(camera.elevation)];
  const target = [0, 0, 0.35 * reach];
  const forward = [-ca * ce, -sa * ce, -se]; // from the eye to the target
  const eye = target.map((value, i) => value - forward[i] * camera.distance * reach);
  const right = [-sa, ca, 0];
  const up = cross(right, forward);
  const scale = 1.35 * Math.min(canvas.width, canvas.height);
  return {
    eye,
    depth: (p) => dot(sub(p, eye), forward),
    project: (p) => {
      const ray = sub(p, eye);
      const depth = Math.max(dot(ray, forward), 0.01);
      return [
        canvas.width / 2 + (scale * dot(ray, right)) / depth,
        canvas.height / 2 - (scale * dot(ray, up)) / depth,
      ];
    },
  };
}

// Faces of a cylinder that look towards the eye: {points, normal, colour}

function faces({ from, to, radius, part }, eye) {
  const axis = unit(sub(to, from));
  const side = unit(cross(axis, Math.abs(axis[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]));
  const other = cross(axis, side);
  const ring = (centre) =>
    Array.from({ length: SIDES }, (_, i) => {
      const [s, c] = [Math.sin((2 * Math.PI * i) / SIDES), Math.cos((2 * Math.PI * i) / SIDES)];
      return centre.map((value, k) => value + radius * (c * side[k] + s * other[k]));
    });
  const [low, high] = [ring(from), ring(to)];
  const all = [
    { points: low, normal: axis.map((value) => -value) },
    { points: high, normal: axis },
  ];
  for (let i = 0; i < SIDES; i++) {
    const next = (i + 1) % SIDES;
    const turn = (2 * Math.PI * (i + 0.5)) / SIDES;
    const normal = side.map((value, k) => Math.cos(turn) * value + Math.sin(turn) * other[k]);
    all.push({ points: [low[i], low[next], high[next], high[i]], normal });
  }
  return all
    .filter(({ points, normal }) => dot(normal, sub(eye, points[0])) > 0)
    .map((face) => ({ ...face, colour: COLOURS[part] }));
}

function line(points, style, width) {
  pen.beginPath();
  points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.strokeStyle = style;
  pen.lineWidth = width * devicePixelRatio;
  pen.stroke();
}

function drawFloor({ project }, extent) {
  const steps = 5;
  for (let i = -steps; i <= steps; i++) {
    const at = (i / steps) * extent;
    line([project([at, -extent, 0]), project([at, extent, 0])], "#d5dbe2", 1);
    line([project([-extent, at, 0]), project([extent, at, 0])], "#d5dbe2", 1);
  }
}

function drawAxes({ project }, t, length, width) {
  const start = origin(t);
  ["#d04040", "#3a9a4a", "#3a66d0"].forEach((style, axis) => {
    const end = start.map((value, row) => value + length * t[4 * row + axis]);
    line([project(start), project(end)], style, width);
  });
}

function drawArm(looking, tool) {
  const all = shape(arm, found.actual_q, tool).flatMap((each) => faces(each, looking.eye));
  const far = ({ points }) => points.reduce((sum, p) => sum + looking.depth(p), 0) / points.length;
  all.forEach((face) => (face.depth = far(face)));
  all.sort((a, b) => b.depth - a.depth);
  for (const { points, normal, colour } of all) {
    const light = 0.55 + 0.45 * Math.max(0, dot(normal, LIGHT));
    pen.beginPath();
    points.map(looking.project).forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.closePath();
    pen.fillStyle = pen.strokeStyle = `rgb(${colour.map((value) => Math.round(value * light))})`;
    pen.lineWidth = 1;
    pen.fill();
    pen.stroke();
  }
}

function draw() {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = width * devicePixelRatio;
  canvas.height = height * devicePixelRatio;
  if (!found) return;
  const looking = view();
  const reach = Math.abs(arm.a[1]) + Math.abs(arm.a[2]);
  const tool = fromPose(found.tcp_offset);
  const tip = compose(frames(arm, found.actual_q)[6], tool);
  drawFloor(looking, 1.25 * reach);
  drawAxes(looking, fromPose([0, 0, 0, 0, 0, 0]), 0.3 * reach, 2);
  if (path.length > 1) line(path.map(looking.project), "#e08030", 1.5);
  drawArm(looking, tool);
  drawAxes(looking, tip, 0.15 * reach, 3);
}

// Text

const degrees = (value) => ((value * 180) / Math.PI).toFixed(2);

function makeRows() {
  const rows = JOINTS.map((name, i) => {
    const row = document.createElement("tr");
    row.innerHTML =
      `<th></th><td id="q${i}"></td><td><meter id="bar${i}" max="1"></meter></td><td id="qd${i}"></td>`;
    row.firstChild.textContent = name;
    return row;
  });
  $("joints").replaceChildren(...rows);
}

function mode(id, text) {
  $(id).textContent = text;
  $(id).className = GOOD.includes(text) ? "good" : BAD.includes(text) ? "bad" : "fair";
}

function tell() {
  for (const name of ["robot_mode", "safety_mode", "runtime_state"]) mode(name, found[name]);
  $("program").textContent = found.program;
  $("control").textContent = found.remote ? "remote" : "local";
  $("slider").textContent = `${Math.round(100 * found.target_speed_fraction)} %`;
  $("scaling").textContent = `${Math.round(100 * found.speed_scaling)} %`;
  for (let i = 0; i < 6; i++) {
    const limit = arm.position[i] ?? 2 * Math.PI;
    $(`q${i}`).textContent = degrees(found.actual_q[i]);
    $(`qd${i}`).textContent = degrees(found.actual_qd[i]);
    $(`bar${i}`).value = 0.5 + (0.5 * found.actual_q[i]) / limit;
  }
  $("position").textContent = found.actual_TCP_pose.slice(0, 3).map((v) => v.toFixed(4)).join("  ");
  $("rotation").textContent = found.actual_TCP_pose.slice(3).map((v) => v.toFixed(3)).join("  ");
  $("force").textContent = found.actual_TCP_force.slice(0, 3).map((v) => v.toFixed(1)).join("  ");
  $("time").textContent = found.time.toFixed(2);
  $("pace").textContent = `${found.reached.toFixed(2)} of ${found.speed}`;
  $("late").textContent = `${found.late} late, ${found.skipped} left out of ${found.ticks}`;
  const clients = Object.entries(found.clients).filter(([, count]) => count);
  $("clients").textContent = clients.map(([name, count]) => `${name} ${count}`).join(", ");
  $("faults").textContent = found.faults.join(", ") || "none";
  $("faults").className = found.faults.length ? "bad" : "";
  $("popup").textContent = found.popup ?? "";
}

// What arrives

async function connect() {
  arm = await (await fetch("/arm.json")).json();
  document.title = `${arm.title} at ${arm.host}`;
  $("title").textContent = `${arm.title} ${arm.version} at ${arm.host}`;
  makeRows();
  const events = new EventSource("/events");
  events.onmessage = ({ data }) => {
    const news = JSON.parse(data);
    $("link").textContent = news ? "live" : "the simulator does not answer: it hangs";
    if (!news) return;
    found = news;
    const tip = found.actual_TCP_pose.slice(0, 3);
    if (!path.length || Math.hypot(...sub(tip, path.at(-1))) > 2e-3) path.push(tip);
    if (path.length > PATH) path.shift();
    tell();
    requestAnimationFrame(draw);
  };
  events.onerror = () => ($("link").textContent = "no connection");
}

// What is asked for

async function ask(what, request) {
  const answer = await fetch(what, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(request),
  });
  $("answer").textContent = answer.ok ? "" : await answer.text();
}

function button(text, act) {
  const made = document.createElement("button");
  made.textContent = text;
  made.onclick = act;
  $("buttons").append(made);
}

for (const [kind, text] of FAULTS) {
  button(text, () => ask("/inject", { kind, parameters: {} }));
}
button("end all faults", () => ask("/clear", {}));

canvas.onpointerdown = (event) => canvas.setPointerCapture(event.pointerId);
canvas.onpointermove = (event) => {
  if (!event.buttons) return;
  camera.azimuth -= 0.008 * event.movementX;
  camera.elevation = Math.max(-0.2, Math.min(1.5, camera.elevation + 0.008 * event.movementY));
  requestAnimationFrame(draw);
};
canvas.onwheel = (event) => {
  event.preventDefault();
  camera.distance = Math.max(1.2, Math.min(8, camera.distance * Math.exp(0.001 * event.deltaY)));
  requestAnimationFrame(draw);
};
onresize = () => requestAnimationFrame(draw);

connect();
