// The tables of the score. The server creates their strings.

import { byId, element } from "./dom.js";
import { helpButton, isDefined } from "./terms.js";

const STYLES = { pass: "pass", fail: "fail" }; // of a verdict; all others are open
const FIRST = ["verdicts", "headline"]; // other tables are folded

/** Show the first tables, the warnings, and the other tables folded. */
export function showFigures(run) {
  const tables = run.score?.tables ?? [];
  const warnings = run.score?.warnings ?? [];
  const first = tables.filter((table) => FIRST.includes(table.name));
  const withNotes = first.flatMap((table) => [tableOf(table, { withHelp: true }), noteOf(table.note)]);
  const empty = noteOf(run.score ? "not enough data" : run.missing("no score was received"));
  byId("figure-table").replaceChildren(...(first.length ? withNotes : [empty]));
  byId("warnings").replaceChildren(...warnings.map((text) => element("li", { text })));
  showFolded(tables.filter((table) => !FIRST.includes(table.name)));
  byId("all").hidden = !tables.length;
}

/** Show folded tables; those that were opened stay open. */
function showFolded(tables) {
  const open = [...document.querySelectorAll("#tables details[open]")].map((details) => details.dataset.name);
  byId("tables").replaceChildren(...tables.map((table) => foldedOf(table, open.includes(table.name))));
}

function foldedOf(table, isOpen) {
  const box = element("div", { className: "scroll" }, tableOf(table));
  const details = element("details", {}, element("summary", { text: table.title }), box);
  details.dataset.name = table.name;
  details.open = isOpen;
  if (table.note) details.append(noteOf(table.note));
  return details;
}

function noteOf(text) {
  return element("p", { className: "note", text });
}

/** Return a table; with `withHelp` its headings have a "?" button. */
function tableOf(table, { withHelp = false } = {}) {
  const head = element("tr", {}, ...table.columns.map((column) => headingOf(column, withHelp)));
  const cellsOf = (row) => row.map((cell, place) => cellOf(cell, table.columns[place]));
  const rows = table.rows.map((row) => element("tr", {}, ...cellsOf(row)));
  return element("table", {}, element("thead", {}, head), element("tbody", {}, ...rows));
}

function headingOf(column, withHelp) {
  const heading = element("th", { className: classOf(column), text: column.heading });
  const term = column.heading.split(",")[0]; // without the unit
  heading.scope = "col";
  if (withHelp && isDefined(term)) heading.append(" ", helpButton(term));
  return heading;
}

function classOf(column) {
  return column.words ? "words" : "";
}

function cellOf(cell, column) {
  if (cell.kind === "head") return rowHeadOf(cell);
  const made = cell.kind === "verdict" ? verdictOf(cell) : figureOf(cell, column);
  if (cell.key) made.dataset.key = cell.key;
  return made;
}

function rowHeadOf(cell) {
  const head = element("th", { className: "words", text: cell.text });
  head.scope = "row";
  return head;
}

function figureOf(cell, column) {
  const figure = element("td", { className: classOf(column), text: cell.text });
  figure.classList.toggle("undefined", cell.text === "not enough data");
  return figure;
}

function verdictOf(cell) {
  const sign = element("span", { className: "icon", text: cell.icon });
  sign.setAttribute("aria-hidden", "true");
  return element("td", { className: `verdict ${STYLES[cell.text] ?? "open"}` }, sign, " ", cell.text);
}
