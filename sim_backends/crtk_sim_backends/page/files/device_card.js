// The card of one device: state, gauges, health, and its buttons where it may be commanded.

import { make, makeGauge, set, slug, tellGauge } from "./elements.js";

const DEGREES = 180 / Math.PI;
const TOOL = ["x", "y", "z", "about x", "about y", "about z"];
const TEXTS = { enable: "enable", disable: "disable", home: "home", hold: "hold" };

export class Card {
  constructor(parent, namespace, pilot) {
    this.namespace = namespace;
    this.pilot = pilot;
    this.id = `card${slug(namespace)}`;
    this.element = make("article", { parent, id: this.id });
    this.shown = "";
    this.gauges = "";
    this.spans = new Map();
  }

  remove() {
    this.element.remove();
  }

  // What does not change.
  show(device, mayCommand) {
    const text = JSON.stringify([device, mayCommand]);
    if (text === this.shown) return;
    this.shown = text;
    this.device = device;
    this.gauges = "";
    const { id } = this;
    this.element.replaceChildren();
    const heading = make("h2", { parent: this.element, textContent: this.namespace });
    make("small", { parent: heading, textContent: device.about });
    make("b", { parent: heading, id: `${id}-state` });
    make("small", { parent: heading, id: `${id}-homed` });
    make("p", { parent: this.element, className: "reason", id: `${id}-reason` });
    if (mayCommand) this.makeActions(device);
    make("div", { parent: this.element, id: `${id}-gauges` });
    make("div", { parent: this.element, className: "health", id: `${id}-health` });
    if (mayCommand) this.makeJogs(device);
  }

  makeActions({ actions, poses }) {
    const { element, namespace, pilot } = this;
    const row = make("div", { parent: element, className: "actions" });
    for (const each of actions.filter((name) => name in TEXTS)) {
      const button = make("button", { parent: row, textContent: TEXTS[each], className: each });
      button.dataset.action = each;
      button.onclick = () => pilot.ask(namespace, each);
    }
    if (actions.includes("store")) {
      const stored = make("div", { parent: element, className: "poses" });
      const name = make("input", { parent: stored, placeholder: "name", size: 10, maxLength: 40 });
      const store = make("button", { parent: stored, textContent: "store this pose" });
      store.onclick = () => pilot.ask(namespace, "store", { name: name.value });
      for (const each of poses) {
        const go = make("button", { parent: stored, textContent: `move to ${each}` });
        go.onclick = () => pilot.ask(namespace, "go", { name: each });
      }
    }
  }

  makeJogs({ actions, joints, stop }) {
    const { element, namespace, pilot } = this;
    const names = { joint: joints.map(({ name }) => name), tool: TOOL };
    for (const space of ["joint", "tool"].filter((each) => actions.includes(each))) {
      const heading = make("h3", { parent: element, textContent: space === "joint" ? "Jog joints" : "Jog the tool" });
      make("span", { parent: heading, textContent: "as long as the button is pressed" });
      const table = make("div", { parent: element, className: "jog" });
      names[space].forEach((name, axis) => {
        make("span", { parent: table, textContent: name });
        for (const sign of [-1, 1]) {
          const button = make("button", { parent: table, textContent: sign < 0 ? "−" : "+" });
          Object.assign(button.dataset, { space, axis, sign });
          pilot.jogs(button, { device: namespace, space, axis }, sign);
        }
      });
    }
    if (actions.includes("joint") || actions.includes("tool")) {
      const speed = make("label", { parent: element, textContent: "speed " });
      const slider = make("input", { parent: speed, type: "range", min: 5, max: 100, value: 100 * pilot.share });
      slider.oninput = () => (pilot.share = slider.value / 100);
      make("small", { parent: element, textContent: ` ${stop}` });
    }
  }

  // What changes.
  tell({ state, level, homed, busy, reason, health, old, traces, jogs }) {
    const { id } = this;
    set(`${id}-state`, jogs ? `${state}, jogged` : state, level);
    set(`${id}-homed`, homed === null ? "" : `${homed ? "homed" : "not homed"}${busy ? ", busy" : ""}`, homed === false ? "fair" : "");
    set(`${id}-reason`, reason === state ? "" : reason, level);
    this.tellHealth(health);
    this.tellGauges(this.groups(traces, old));
  }

  tellHealth(rows) {
    const shown = JSON.stringify(rows);
    if (shown === this.health) return;
    this.health = shown;
    const parent = document.getElementById(`${this.id}-health`);
    parent.replaceChildren();
    for (const [name, text, level] of rows) make("span", { parent, textContent: `${name}: ${text}` }).dataset.level = level;
  }

  groups(traces, old) {
    const groups = [];
    const { chain, joints } = this.device;
    const limits = new Map(joints.map((each) => [each.name, each]));
    const part = (name, wanted) => traces[name]?.find(([each]) => each === wanted);
    const position = part("measured_js", "position");
    if (position) {
      const [, , names, values] = position;
      const goals = old.includes("setpoint_js") ? null : part("setpoint_js", "position")?.[3];
      const rates = part("measured_js", "velocity")?.[3];
      const kinds = names.map((name) => {
        const at = chain ? chain.names.indexOf(name) : -1;
        return at < 0 ? "" : chain.slides[at] ? "mm" : "deg";
      });
      for (const kind of new Set(kinds)) {
        const scale = { deg: DEGREES, mm: 1000, "": 1 }[kind];
        const scaled = (value) => (value === null || value === undefined ? null : scale * value);
        const gauges = names.flatMap((name, i) => {
          if (kinds[i] !== kind) return [];
          const { low, high } = limits.get(name) ?? {};
          return [{
            name: name.replace(/_joint$/, ""), low: scaled(low), high: scaled(high), value: scaled(values[i]),
            goal: scaled(goals?.[i]), rate: scaled(rates?.[i] ?? 0), state: this.state(old, "measured_js"),
            ...(low === null || high === null || low === undefined ? { span: kind === "deg" ? 360 : scale * 2 * Math.PI } : {}),
          }];
        });
        groups.push({ title: "Joints", unit: kind || "rad (m)", digits: kind === "deg" ? 2 : kind ? 1 : 4, gauges });
      }
    }
    for (const [wanted, unit, least] of [["force", "N", 1], ["torque", "N·m", 0.1]]) {
      const found = part("measured_cf", wanted);
      if (!found) continue;
      const [, , names, values] = found;
      const span = this.span(wanted, values, least);
      const state = this.state(old, "measured_cf");
      const gauges = names.map((name, i) => ({ name, low: null, high: null, span, value: values[i], state }));
      groups.push({ title: wanted === "force" ? "Force" : "Torque", unit, digits: wanted === "force" ? 2 : 3, gauges });
    }
    if (!groups.length && part("measured_cp", "position")) {
      const [, , names, values] = part("measured_cp", "position");
      const span = this.span("position", values, 0.5);
      const state = this.state(old, "measured_cp");
      groups.push({ title: "Pose", unit: "m", digits: 4, gauges: names.map((name, i) => ({ name, low: null, high: null, span, value: values[i], state })) });
    }
    return groups;
  }

  state(old, name) {
    return old.includes(name) ? ["not valid now", "bad"] : ["", ""];
  }

  // A scale of 1, 2 or 5 times a power of ten, that holds all that was seen.
  span(name, values, least) {
    const most = Math.max(this.spans.get(name) ?? least, ...values.map((value) => Math.abs(value ?? 0)));
    const power = 10 ** Math.floor(Math.log10(most));
    const span = [1, 2, 5, 10].map((step) => step * power).find((end) => most <= end * (1 + 1e-9));
    this.spans.set(name, span);
    return span;
  }

  tellGauges(groups) {
    const { id } = this;
    const names = JSON.stringify(groups.map(({ title, unit, gauges }) => [title, unit, gauges.map(({ name }) => name)]));
    if (names !== this.gauges) {
      this.gauges = names;
      const parent = document.getElementById(`${id}-gauges`);
      parent.replaceChildren();
      groups.forEach(({ title, unit, gauges }, g) => {
        const heading = make("h3", { parent, textContent: title });
        make("span", { parent: heading, textContent: unit });
        const section = make("section", { parent });
        const longest = Math.max(...gauges.map(({ name }) => name.length));
        section.style.setProperty("--name", `${0.6 * longest + 0.6}em`);
        gauges.forEach((gauge, i) => makeGauge(section, `${id}-${g}-${i}`, gauge));
      });
    }
    groups.forEach(({ gauges, digits }, g) => gauges.forEach((gauge, i) => tellGauge(`${id}-${g}-${i}`, gauge, digits)));
  }
}
