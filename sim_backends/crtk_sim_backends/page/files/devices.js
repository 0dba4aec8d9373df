// The page of all devices on the graph: it asks for a picture when it has drawn the last one (see looking.py).

import { ArmPicture } from "./arm.js";
import { apply, compose, reach } from "./chain.js";
import { Chart } from "./chart.js";
import { Card } from "./device_card.js";
import { $, make, set, takeToken } from "./elements.js";
import { Pilot } from "./pilot.js";

const AGAIN = 1000; // ms after which a lost connection is tried again
const LEAST = 0.05; // to both sides: of which a strip shows a share at least
const SMALL = 0.5; // m: what is held in view where nothing has a length
const FIRST = 3; // traces that are drawn unless others are chosen
const TELLING = [" measured_js position", " measured_cf force", " measured_cp position"]; // the first of each device

let socket = null;
let scene = null;
let live = null;
let picture = null;
let mayCommand = false;
let asked = 0; // version of the scene that was asked for last
let chosen = []; // traces that are drawn, by their titles
let touched = false; // whether somebody has chosen them
let offered = ""; // of the list of traces
const chart = new Chart($("chart"));
const cards = new Map(); // by namespace
const told = { delays: [], draws: [], pictures: 0 }; // ms, for whoever measures
window.told = told;

const send = (message) => {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
};
const pilot = new Pilot((command) => send({ command }));

// The connection

function connect() {
  socket = new WebSocket(`ws://${location.host}/socket`);
  socket.onopen = () => {
    asked = 0;
    const token = takeToken();
    if (token !== null) send({ token });
    send({ scene: true });
    send({ look: true });
  };
  socket.onmessage = ({ data }) => {
    const message = JSON.parse(data);
    if ("live" in message) take(message.live);
    else if (message.scene) show(message.scene);
    else if ("control" in message) allow(message.control);
    else if (message.answer) tellLine(message.answer);
  };
  socket.onclose = ({ reason }) => {
    pilot.lost();
    set("link", reason || "no connection", "bad");
    setTimeout(connect, AGAIN);
  };
}

function take(found) {
  if (!found) {
    set("link", "it does not answer: it hangs", "bad");
    send({ look: true });
    return;
  }
  live = found;
  requestAnimationFrame(() => {
    const began = performance.now();
    draw();
    told.pictures += 1;
    told.draws.push(performance.now() - began);
    if (found.sampled) told.delays.push(Date.now() - found.sampled);
    if (told.delays.length > 3000) told.delays.shift();
    if (told.draws.length > 3000) told.draws.shift();
    send({ look: true });
  });
}

function allow(may) {
  mayCommand = may;
  $("hold").hidden = !may;
  if (scene) show(scene);
}

// What does not change

function show(found) {
  scene = found;
  const { devices } = scene;
  $("detail").textContent = `${devices.length} on the graph${mayCommand ? ", commanded from here" : ""}`;
  const names = devices.map(({ namespace }) => namespace);
  for (const [name, card] of cards) if (!names.includes(name)) card.remove(), cards.delete(name);
  for (const device of devices) {
    const { namespace } = device;
    if (!cards.has(namespace)) cards.set(namespace, new Card($("cards"), namespace, pilot));
    cards.get(namespace).show(device, mayCommand);
  }
  const lengths = devices.filter(({ chain }) => chain).map(({ chain }) => reach(chain));
  const size = Math.max(SMALL, ...lengths);
  if (picture?.reach !== size) {
    picture ??= new ArmPicture($("picture"), size);
    picture.reach = size;
  }
  picture.clear();
  $("nobody").hidden = devices.length > 0;
  offerTraces();
}

// What changes

function draw() {
  if (live.version !== scene?.version && live.version !== asked) {
    asked = live.version;
    send({ scene: true });
  }
  set("link", "live", "good");
  if (!scene) return;
  const groups = [];
  const things = [];
  for (const device of scene.devices) {
    const now = live.devices[device.namespace];
    if (!now) continue;
    cards.get(device.namespace)?.tell(now);
    things.push(thingOf(device, now));
    groups.push(...groupsOf(device.namespace, now));
  }
  picture.show(things);
  if (!touched) chosen = firstOf(groups);
  chart.show(groups, chosen);
  offerTraces(groups);
  tellAll();
}

function thingOf({ namespace, chain, place }, { q, tool, force, old }) {
  const finite = (numbers) => numbers?.every((value) => value !== null);
  const thing = { name: namespace, place };
  if (chain && finite(q)) Object.assign(thing, { chain, q });
  if (finite(tool) && !old.includes("measured_cp")) thing.tip = compose(place, tool);
  else if (thing.chain) Object.assign(thing, { chain: null });
  if (force && finite(force.vector)) {
    const [at, end] = [force.at, force.at.map((value, k) => value + force.vector[k])];
    const from = apply(place, at);
    thing.force = { at: from, vector: apply(place, end).map((value, k) => value - from[k]) };
  }
  return thing;
}

// Groups of a chart, one for each trace

function groupsOf(namespace, { traces }) {
  return Object.entries(traces).flatMap(([name, parts]) =>
    parts.map(([part, unit, names, values]) => {
      const title = `${namespace} ${name} ${part}`.trim();
      const gauges = names.map((each, i) => ({ name: each, value: values[i], span: LEAST }));
      return { title, unit, digits: 3, label: `${title}  `, gauges };
    }),
  );
}

// One trace of each device, of the first devices.
function firstOf(groups) {
  const found = scene.devices.map(({ namespace }) =>
    TELLING.map((end) => namespace + end).find((each) => groups.some(({ title }) => title === each)),
  );
  return found.filter(Boolean).slice(0, FIRST);
}

function choose(titles) {
  touched = true;
  chosen = titles;
}

function offerTraces(groups = []) {
  if (!scene) return;
  const known = new Set(groups.map(({ title }) => title));
  const more = scene.devices.flatMap(({ namespace, offered: values }) =>
    Object.keys(values)
      .map((name) => `${namespace} ${name}`)
      .filter((title) => ![...known].some((each) => each === title || each.startsWith(`${title} `))),
  );
  const options = [...known, ...more];
  const text = JSON.stringify([options, chosen]);
  if (text === offered) return;
  offered = text;
  const list = $("more");
  list.replaceChildren(make("option", { value: "", textContent: "draw ..." }));
  for (const each of options) {
    if (!chosen.includes(each)) make("option", { parent: list, value: each, textContent: each });
  }
  for (const each of [...$("chosen").querySelectorAll("button")]) each.remove();
  for (const each of chosen) {
    const button = make("button", { textContent: each, title: "draw it no more" });
    button.onclick = () => choose(chosen.filter((other) => other !== each));
    list.before(button);
  }
}

$("more").onchange = ({ target }) => {
  const [namespace, name, part] = target.value.split(" ");
  if (!namespace) return;
  const known = live && groupsOf(namespace, live.devices[namespace]).some(({ title }) => title === target.value);
  if (!known && !part) {
    send({ watch: [namespace, name] });
    awaited.push(target.value);
  } else choose([...chosen, target.value]);
  target.value = "";
};

const awaited = []; // values that were asked for, until they come

// Refusals with their remedies, and what became of commands

const lines = []; // [time in s, text] of what this page was answered

function tellLine(text) {
  lines.push([Date.now() / 1000, text]);
  if (lines.length > 4) lines.shift();
}

function tellAll() {
  for (const each of [...awaited]) {
    const [namespace] = each.split(" ");
    const found = groupsOf(namespace, live.devices[namespace] ?? { traces: {} });
    const titles = found.map(({ title }) => title).filter((title) => title === each || title.startsWith(`${each} `));
    if (!titles.length) continue;
    choose([...chosen, ...titles]);
    awaited.splice(awaited.indexOf(each), 1);
  }
  const all = [
    ...live.refusals.map(([at, where, command, message, remedy]) => [at, `${where} refused ${command}: ${message}`, remedy]),
    ...live.notices,
    ...lines,
  ].sort(([a], [b]) => b - a);
  const text = JSON.stringify(all);
  if ($("told").dataset.text === text) return;
  $("told").dataset.text = text;
  $("told").replaceChildren(
    ...all.map(([at, words, remedy = ""]) => {
      const line = make("p");
      make("time", { parent: line, textContent: new Date(1000 * at).toLocaleTimeString() });
      line.append(words);
      if (remedy) make("em", { parent: line, textContent: ` ${remedy}` });
      return line;
    }),
  );
}

$("hold").onclick = () => {
  pilot.release();
  send({ command: { do: "hold" } });
};
new ResizeObserver(() => picture?.redraw()).observe($("picture"));
connect();
