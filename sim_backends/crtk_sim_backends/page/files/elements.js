// What all pages are made of: elements, texts that are set when they change, and gauges.

import { ends } from "./chart.js";

const NEAR = 0.03; // of a range, from its end: where a value is marked
export const $ = (id) => document.getElementById(id);
export const slug = (text) => text.toLowerCase().replace(/[^a-z0-9]+/g, "-");

export function make(kind, { parent, ...properties } = {}) {
  const made = Object.assign(document.createElement(kind), properties);
  parent?.append(made);
  return made;
}

export function set(id, text, level = "") {
  const element = $(id);
  if (element.textContent !== text) element.textContent = text;
  if (element.dataset.level !== level) element.dataset.level = level;
}

const number = (value, digits) => (value === null ? "not finite" : value.toFixed(digits));
const end = (value) => (value === undefined ? "no limit" : `${+value.toFixed(1)}`);

export function makeGauge(parent, id, { name }) {
  const row = make("div", { parent, className: "gauge" });
  make("span", { parent: row, className: "name", textContent: name });
  const scale = make("div", { parent: row, className: "scale" });
  const track = make("div", { parent: scale, className: "track" });
  make("i", { parent: track, className: "fill", id: `${id}-fill` });
  make("i", { parent: track, className: "zero", id: `${id}-zero` });
  make("i", { parent: track, className: "goal", id: `${id}-goal` });
  make("i", { parent: track, className: "mark", id: `${id}-mark` });
  make("small", { parent: scale, id: `${id}-low` });
  make("small", { parent: scale, id: `${id}-high` });
  make("span", { parent: row, className: "value", id: `${id}-value` });
  make("span", { parent: row, className: "rate", id: `${id}-rate` });
  make("small", { parent: row, className: "state", id: `${id}-state` });
}

function place(element, share) {
  element.hidden = share === null;
  if (share !== null) element.style.left = `${100 * Math.max(0, Math.min(1, share))}%`;
}

export function tellGauge(id, gauge, digits) {
  const { low, high, span, value, goal = null, rate, state } = gauge;
  const [from, to] = ends(gauge);
  const share = (at) => (at === null ? null : (at - from) / (to - from));
  const limited = low !== null || high !== null;
  const at = share(value);
  const close = limited && at !== null && (1 - at < NEAR || (from < 0 && at < NEAR));
  place($(`${id}-mark`), at);
  place($(`${id}-goal`), share(goal));
  place($(`${id}-zero`), from < 0 && to > 0 ? share(0) : null);
  const [left, right] = [Math.min(at, share(0)), Math.max(at, share(0))].map((x) => Math.max(0, Math.min(1, x)));
  Object.assign($(`${id}-fill`).style, { left: `${100 * left}%`, width: `${100 * (right - left)}%` });
  $(`${id}-mark`).dataset.level = close ? "bad" : "";
  set(`${id}-low`, end(low ?? (span && -span)));
  set(`${id}-high`, end(high ?? span));
  set(`${id}-state`, state?.[0] ?? "", state?.[1] ?? "");
  set(`${id}-value`, number(value, digits), close || value === null ? "bad" : "");
  set(`${id}-rate`, rate === undefined ? "" : number(rate, 1));
}

// The token of the address that was told: it stays in this tab, and goes out of the address.

export function takeToken() {
  if (location.hash.length > 1) {
    sessionStorage.setItem("token", location.hash.slice(1));
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("token");
}
