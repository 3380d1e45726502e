"use strict";
// One run: its figures from rows/N.js, and its picture from runs/I.js where it was drawn.

const BLOCK = 250, SIZE = 560, MARGIN = 42;
const GREEN = "#1b7f3b", RED = "#c62828", BLUE = "#1f5fa8", GREY = "#9a9a9a", PALE = "#9fb8d6", ORANGE = "#e08a00";
const COLOURS = { tp: GREEN, tn: GREEN, fp: RED, fn: ORANGE, skipped: GREY };
let index = 0;

const element = (id) => document.getElementById(id);

function load(path, absent) {
  const script = document.createElement("script");
  script.src = path;
  script.onerror = absent;
  document.head.append(script);
}

function open() {
  index = Number(location.hash.slice(1)) || 0;
  element("before").href = "#" + Math.max(0, index - 1);
  element("after").href = "#" + (index + 1);
  element("plots").replaceChildren();
  element("note").textContent = "";
  load(`rows/${Math.floor(index / BLOCK)}.js`, () => { element("title").textContent = "There is no such run."; });
}

function receive(name, data) { // called by the scripts that are loaded
  if (name === "block") describe(data[index % BLOCK]);
  if (name === "picture") draw(data);
}

function describe(run) {
  if (!run) { element("title").textContent = "There is no such run."; return; }
  const v = run.values;
  document.title = element("title").textContent = `${v.scenario}: ${v.method}, seed ${v.seed}` + (v.status === "done" ? "" : ` – ${v.status}`);
  element("command").textContent = run.command;
  element("values").replaceChildren(...Object.entries(v).flatMap(([key, value]) => {
    const name = document.createElement("dt"), text = document.createElement("dd");
    name.textContent = key;
    text.textContent = String(value);
    return [name, text];
  }));
  element("detail").hidden = !run.detail;
  element("detail").textContent = run.detail || "";
  load(`runs/${index}.js`, () => { element("note").textContent = "Not drawn: tomthumb report --pages N draws more runs; the command above repeats this one."; });
}

// ---- drawing: an SVG with its own scales; x to the right, y up ----

function node(name, attributes, text) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

function extent(values) {
  let low = Infinity, high = -Infinity;
  for (const v of values) if (v !== null && v !== undefined) { low = Math.min(low, v); high = Math.max(high, v); }
  return low <= high ? [low, high] : [0, 1];
}

function canvas(xs, ys, equal, height = SIZE) {
  let [x0, x1] = extent(xs), [y0, y1] = extent(ys);
  if (equal) {
    const half = 0.56 * Math.max(x1 - x0, y1 - y0, 0.2), cx = (x0 + x1) / 2, cy = (y0 + y1) / 2;
    [x0, x1, y0, y1] = [cx - half, cx + half, cy - half, cy + half];
  } else if (y1 === y0) { y0 -= 1; y1 += 1; }
  if (x1 === x0) x1 = x0 + 1;
  const svg = node("svg", { viewBox: `0 0 ${SIZE} ${height}`, role: "img" });
  const x = (v) => MARGIN + (v - x0) / (x1 - x0) * (SIZE - MARGIN - 10);
  const y = (v) => height - 28 - (v - y0) / (y1 - y0) * (height - 38);
  const plot = { svg, x, y };
  ticks(x0, x1).forEach((v) => svg.append(
    node("line", { x1: x(v), x2: x(v), y1: height - 28, y2: 10, stroke: "#eee" }),
    node("text", { x: x(v), y: height - 12, "font-size": 11, "text-anchor": "middle" }, v)));
  ticks(y0, y1).forEach((v) => svg.append(
    node("line", { x1: MARGIN, x2: SIZE - 10, y1: y(v), y2: y(v), stroke: "#eee" }),
    node("text", { x: MARGIN - 5, y: y(v) + 4, "font-size": 11, "text-anchor": "end" }, v)));
  return plot;
}

function ticks(low, high) {
  const raw = (high - low) / 6, ten = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * ten).find((s) => s >= raw);
  const out = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) out.push(Number((k * step).toPrecision(10)));
  return out;
}

function line(plot, points, colour, more = {}) {
  let path = "", pen = "M";
  for (const [a, b] of points) {
    if (a === null || b === null) { pen = "M"; continue; }
    path += `${pen}${plot.x(a).toFixed(1)} ${plot.y(b).toFixed(1)}`;
    pen = "L";
  }
  plot.svg.append(node("path", { d: path, fill: "none", stroke: colour, "stroke-width": 1.4, ...more }));
}

function dots(plot, points, colour, radius, more = {}) {
  const group = node("g", { fill: colour, ...more });
  for (const [a, b] of points) if (a !== null && b !== null) group.append(node("circle", { cx: plot.x(a).toFixed(1), cy: plot.y(b).toFixed(1), r: radius }));
  plot.svg.append(group);
}

function crosses(plot, points, colour) {
  const path = points.filter((p) => p[0] !== null).map(([a, b]) => {
    const x = plot.x(a), y = plot.y(b);
    return `M${(x - 4).toFixed(1)} ${y.toFixed(1)}h8m-4 -4v8`;
  }).join("");
  plot.svg.append(node("path", { d: path, stroke: colour, "stroke-width": 1.2, fill: "none" }));
}

function titled(title, plot, key) {
  const figure = document.createElement("figure"), caption = document.createElement("figcaption");
  caption.className = "key";
  caption.append(title.replace(/\.?$/, ". "));
  for (const [colour, text] of key) {
    const span = document.createElement("span");
    span.style.color = colour;
    span.textContent = "● " + text;
    caption.append(span);
  }
  plot.svg.setAttribute("aria-label", title);
  figure.append(plot.svg, caption);
  return figure;
}

function trail(p) {
  const all = [...p.pose, ...(p.truth || []), ...p.map, ...(p.landmarks || [])];
  const plot = canvas(all.map((q) => q[0]), all.map((q) => q[1]), true);
  if (p.landmarks) crosses(plot, p.landmarks, GREY);
  if (p.truth) line(plot, p.truth, RED, { "stroke-dasharray": "5 3" });
  line(plot, p.pose, BLUE);
  dots(plot, p.right, GREEN, 1.3, { "fill-opacity": 0.35, class: "right" });
  for (const [x0, y0, x1, y1] of p.wrong) line(plot, [[x0, y0], [x1, y1]], RED, { "stroke-width": 0.7, class: "wrong" });
  dots(plot, p.wrong.map((w) => w.slice(2)), RED, 2.6);
  dots(plot, p.map, BLUE, 2, { fill: "none", stroke: BLUE });
  if (p.first) dots(plot, [p.first.at], "none", 9, { stroke: RED, "stroke-width": 2 });
  return titled(`Trail and map, m; ${p.mistakes} wrong decisions`, plot, [[BLUE, "estimate"], [RED, "truth (dashed), wrong association"], [GREEN, "right association"], [GREY, "true landmark"]]);
}

function errorPlot(p, k, name, scale) {
  const values = p.error.map((e) => e[k] === null ? null : scale * e[k]), bounds = p.bound.map((b) => scale * b[k]);
  const plot = canvas(p.t, [...values, ...bounds, ...bounds.map((b) => -b)], false, 240);
  for (const sign of [1, -1]) line(plot, p.t.map((t, i) => [t, sign * bounds[i]]), PALE);
  line(plot, p.t.map((t, i) => [t, values[i]]), BLUE);
  return titled(name, plot, [[BLUE, "error"], [PALE, "99 % bounds"]]);
}

function firstMistake(f) {
  const near = [f.pose, f.true_pose, ...f.scan, f.taken_for, f.was].filter((q) => q && q[0] !== null);
  near.push([f.pose[0] - 0.4, f.pose[1] - 0.4], [f.pose[0] + 0.4, f.pose[1] + 0.4]);
  const plot = canvas(near.map((q) => q[0]), near.map((q) => q[1]), true);
  robot(plot, f.true_pose, RED);
  robot(plot, f.pose, BLUE);
  f.scan.forEach((q, i) => dots(plot, [q], COLOURS[f.outcomes[i]], 4));
  if (f.taken_for) { line(plot, [f.at, f.taken_for], RED); crosses(plot, [f.taken_for], RED); }
  if (f.was) { line(plot, [f.at, f.was], GREEN, { "stroke-dasharray": "4 3" }); crosses(plot, [f.was], GREEN); }
  dots(plot, [f.at], "none", 9, { stroke: RED, "stroke-width": 2, class: "first-mistake" });
  return titled(`The first mistake. ${f.text}`, plot, [[GREEN, "right; what it was (dashed)"], [RED, "wrong; what it was taken for"], [ORANGE, "missed"], [BLUE, "robot as estimated"]]);
}

function robot(plot, pose, colour) {
  if (!pose || pose[0] === null) return;
  const [x, y, a] = pose;
  const at = (r, b) => [x + r * Math.cos(a + b), y + r * Math.sin(a + b)];
  line(plot, [at(0.35, 0), at(0.25, 2.5), at(0.25, -2.5), at(0.35, 0)], colour, { "stroke-width": 2 });
}

function draw(p) {
  element("note").textContent = p.note || "";
  if (!p.pose) return;
  const plots = document.createElement("div");
  plots.className = "plots";
  plots.append(trail(p));
  if (p.first) plots.append(firstMistake(p.first));
  plots.append(errorPlot(p, 0, "Error in x, m, over time, s", 1), errorPlot(p, 1, "Error in y, m, over time, s", 1), errorPlot(p, 2, "Error in heading, deg, over time, s", 180 / Math.PI));
  element("plots").replaceChildren(plots);
}

window.addEventListener("hashchange", open);
open();
