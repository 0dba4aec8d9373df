// The page of a simulator or a device: what it told to show (scene.json), what it tells all the time (events), its faults.

import { ArmPicture } from "./arm.js";
import { compose, flange, fromPose, IDENTITY, reach } from "./chain.js";
import { Chart } from "./chart.js";
import { $, make, makeGauge, set, slug, takeToken, tellGauge } from "./elements.js";

let scene = null;
let picture = null; // of the arm, or else
let chart = null; // of the gauges
let shown = ""; // names of the rows and gauges that are there

// What is there, made anew only when it changes

function makeAll({ gauges, sections }) {
  const groups = gauges.map(({ title, unit, rate, gauges: each }, g) => {
    const section = make("section", { className: "gauges" });
    const heading = make("h2", { parent: section, textContent: title });
    make("span", { parent: heading, textContent: rate ? `${unit}, ${rate}` : unit });
    const longest = Math.max(...each.map(({ name }) => name.length));
    section.style.setProperty("--name", `${0.6 * longest + 0.6}em`);
    each.forEach((gauge, i) => makeGauge(section, `gauge-${g}-${i}`, gauge));
    return section;
  });
  const tables = Object.entries(sections).map(([title, rows]) => {
    const section = make("section", { className: "rows", id: `section-${slug(title)}` });
    make("h2", { parent: section, textContent: title });
    const list = make("dl", { parent: section });
    for (const [name] of rows) {
      const row = make("div", { parent: list });
      make("dt", { parent: row, textContent: name });
      make("dd", { parent: row, id: `row-${slug(name)}` });
      if (scene.notes[name]) make("p", { parent: row, textContent: scene.notes[name] });
    }
    return section;
  });
  const [state, ...others] = tables;
  if (picture) $("panels").replaceChildren(state, ...groups, ...others);
  else {
    $("gauges").replaceChildren(...groups);
    $("panels").replaceChildren(...tables);
  }
}

// What changes

function tell(live) {
  const names = JSON.stringify([
    live.gauges.map(({ title, gauges }) => [title, gauges.map(({ name }) => name)]),
    Object.entries(live.sections).map(([title, rows]) => [title, rows.map(([name]) => name)]),
  ]);
  if (names !== shown) makeAll(live);
  shown = names;
  live.gauges.forEach(({ gauges, digits }, g) =>
    gauges.forEach((gauge, i) => tellGauge(`gauge-${g}-${i}`, gauge, digits)),
  );
  for (const rows of Object.values(live.sections)) {
    for (const [name, text, level] of rows) set(`row-${slug(name)}`, text, level);
  }
  for (const each of document.querySelectorAll("#buttons [data-kind]")) {
    each.ariaPressed = String(live.faults.includes(each.dataset.kind));
  }
  chart?.show(live.gauges);
  if (picture && live.q?.every((value) => value !== null)) {
    const tip = compose(flange(scene.chain, live.q), fromPose(live.tool));
    picture.show([{ name: "", chain: scene.chain, place: IDENTITY, q: live.q, tip }]);
  }
}

function connected(text, level) {
  set("link", text, level);
}

function listen() {
  const events = new EventSource("/events");
  events.onmessage = ({ data }) => {
    const live = JSON.parse(data);
    if (live) {
      connected("live", "good");
      tell(live);
    } else connected("it does not answer: it hangs", "bad");
  };
  events.onerror = () => connected("no connection", "bad");
}

// Faults: with the token that is in the address the simulator told; it stays in this tab

async function ask(path, request) {
  const answer = await fetch(path, {
    method: "POST",
    headers: { "Content-Type": "application/json", Authorization: `Bearer ${takeToken()}` },
    body: JSON.stringify(request),
  });
  $("answer").textContent = answer.ok ? "" : await answer.text();
}

function makeButtons() {
  const known = takeToken() !== null;
  const add = (text, act, kind) => {
    const made = make("button", { parent: $("buttons"), textContent: text, disabled: !known });
    if (kind) made.dataset.kind = kind;
    made.onclick = () => act(made);
  };
  for (const { text, kind, parameters } of scene.buttons) {
    add(
      text,
      ({ ariaPressed }) =>
        ariaPressed === "true" ? ask("/clear", { kind }) : ask("/inject", { kind, parameters }),
      kind,
    );
  }
  add("end all faults", () => ask("/clear", {}));
  if (!known) $("answer").textContent = "To let faults begin, open the page by the address that the simulator told.";
}

async function begin() {
  const answer = await fetch("/scene.json");
  if (!answer.ok) return connected(await answer.text(), "bad");
  scene = await answer.json();
  document.title = `${scene.title} at ${scene.host}`;
  $("title").textContent = scene.title;
  $("detail").textContent = `${scene.detail}, at ${scene.host}`;
  $("faults").hidden = !scene.buttons.length;
  $("picture").hidden = !scene.chain;
  $("large").hidden = Boolean(scene.chain);
  if (scene.chain) {
    picture = new ArmPicture($("picture"), reach(scene.chain));
    new ResizeObserver(() => picture.redraw()).observe($("picture"));
  } else chart = new Chart($("chart"));
  makeButtons();
  listen();
}

begin();
