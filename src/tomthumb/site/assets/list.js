"use strict";
// Tables that sort by the head that is clicked, and the list of all runs, of which only a page is ever in the document.

const PAGE = 50;

function compare(a, b) {
  if (a === null || a === undefined) return b === null || b === undefined ? 0 : 1; // what is not known comes last
  if (b === null || b === undefined) return -1;
  if (typeof a === "number" && typeof b === "number") return a - b;
  return String(a).localeCompare(String(b), undefined, { numeric: true });
}

function directed(order, a, b) {
  const known = (x) => x !== null && x !== undefined;
  return known(a) && known(b) ? order * compare(a, b) : compare(a, b);
}

function mark(heads, column, order) {
  heads.forEach((head, i) => {
    if (i === column) head.setAttribute("aria-sort", order > 0 ? "ascending" : "descending");
    else head.removeAttribute("aria-sort");
  });
}

function sortable(table) {
  const heads = [...table.querySelectorAll("th")];
  const body = table.tBodies[0];
  heads.forEach((head, column) => head.addEventListener("click", () => {
    const order = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    const value = (row) => {
      const cell = row.cells[column];
      return cell.dataset.v === undefined ? cell.textContent : Number(cell.dataset.v);
    };
    const rows = [...body.rows].map((row) => [value(row), row]);
    rows.sort((a, b) => directed(order, a[0], b[0]));
    body.append(...rows.map((pair) => pair[1]));
    mark(heads, column, order);
  }));
}

function shown(value, head) {
  if (value === null || value === undefined) return "–";
  if (typeof value !== "number" || !head) return String(value);
  return String(Number((value * head.scale).toPrecision(6)));
}

function listOfRuns(data) {
  const names = Object.keys(data.columns);
  const drawn = new Set(data.drawn);
  const all = Array.from({ length: data.count }, (_, i) => i);
  const text = all.map((i) => ["scenario", "method", "status", "failure"].map((n) => data.columns[n][i] ?? "").join(" ").toLowerCase());
  let chosen = all.slice(), first = 0;
  const table = document.getElementById("runs");

  function show() {
    const body = table.tBodies[0];
    body.replaceChildren(...chosen.slice(first, first + PAGE).map((i) => {
      const row = document.createElement("tr");
      const link = document.createElement("a");
      link.href = "run.html#" + i;
      link.textContent = drawn.has(i) ? "page, drawn" : "page";
      row.insertCell().append(link);
      for (const name of names) row.insertCell().textContent = shown(data.columns[name][i], data.heads[name]);
      return row;
    }));
    const last = Math.min(first + PAGE, chosen.length);
    document.getElementById("where").textContent = chosen.length ? `${first + 1} to ${last} of ${chosen.length}` : "none";
  }

  function sortBy(name, order) {
    const column = data.columns[name];
    chosen.sort((a, b) => directed(order, column[a], column[b]) || a - b);
    first = 0;
    show();
  }

  function filter(words) {
    const wanted = words.toLowerCase().split(/\s+/).filter(Boolean);
    const seed = (word) => word.startsWith("seed=") ? Number(word.slice(5)) : null;
    chosen = all.filter((i) => wanted.every((w) => seed(w) === null ? text[i].includes(w) : data.columns.seed[i] === seed(w)));
    first = 0;
    show();
  }

  const row = table.tHead.insertRow();
  row.append(document.createElement("th"));
  names.forEach((name) => {
    const head = document.createElement("th"), button = document.createElement("button");
    button.type = "button";
    button.textContent = data.heads[name] ? data.heads[name].title : name;
    head.append(button);
    head.addEventListener("click", () => {
      const order = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
      mark([...row.cells], head.cellIndex, order);
      sortBy(name, order);
    });
    row.append(head);
  });
  document.getElementById("filter").addEventListener("input", (event) => filter(event.target.value));
  document.getElementById("back").addEventListener("click", () => { first = Math.max(0, first - PAGE); show(); });
  document.getElementById("forth").addEventListener("click", () => { if (first + PAGE < chosen.length) first += PAGE; show(); });
  show();
}

document.querySelectorAll("table.sortable").forEach(sortable);

function receive(name, data) { // called by rows.js
  if (name === "list") listOfRuns(data);
}
