// Tables of the score: the strings are those that the server's table model made.

import { byId, element, setPill, setText } from "./dom.js";
import { TERMS, helpButton } from "./terms.js";

const STYLES = { pass: "pass", fail: "fail" };
const FIRST = ["headline", "verdicts", "covered", "map-covered", "readings"]; // beside the path; the others are folded below
let shown = null;

/** Show the verdict and all tables of a report. */
export function showReport(report) {
  if (report === shown) return;
  shown = report;
  const overall = report?.overall;
  setPill(byId("verdict"), overall?.style ?? "open", overall?.icon ?? "–", overall?.state ?? "no report yet", overall?.text);
  setText(byId("overall"), overall?.text ?? "The monitor has not reported yet: there are no figures.");
  const tables = report?.tables ?? [];
  const first = tables.filter((table) => FIRST.includes(table.name));
  byId("figure-table").replaceChildren(...first.flatMap((table) => [tableOf(table, true), element("p", "note", table.note)]));
  if (!first.length) byId("figure-table").append(element("p", "note", "not enough data"));
  byId("warnings").replaceChildren(...(report?.warnings ?? []).map((text) => element("li", "", text)));
  showAll(tables.filter((table) => !FIRST.includes(table.name)));
}

function showAll(tables) {
  const open = new Set([...document.querySelectorAll("#tables details[open]")].map((item) => item.dataset.name));
  byId("tables").replaceChildren(...tables.map((table) => {
    const details = element("details", "", "", element("summary", "", table.title));
    details.dataset.name = table.name;
    details.open = open.has(table.name);
    const box = element("div", "scroll", "", tableOf(table, false));
    details.append(box);
    if (table.note) details.append(element("p", "note", table.note));
    return details;
  }));
}

/** Return a table of the model; with `help` its headings explain themselves. */
export function tableOf(table, help) {
  const head = element("tr");
  for (const column of table.columns) {
    const cell = element("th", column.words ? "words" : "", column.heading);
    cell.scope = "col";
    const term = column.heading.split(",")[0];
    if (help && TERMS[term]) cell.append(" ", helpButton(term));
    head.append(cell);
  }
  const body = element("tbody");
  for (const row of table.rows) body.append(rowOf(row, table.columns));
  return element("table", "", "", element("thead", "", "", head), body);
}

function rowOf(row, columns) {
  const made = element("tr");
  row.forEach((cell, place) => {
    const words = columns[place].words ? "words" : "";
    if (cell.kind === "head") {
      const head = element("th", "words", cell.text);
      head.scope = "row";
      made.append(head);
      return;
    }
    const item = element("td", words);
    if (cell.kind === "verdict") {
      item.className = `verdict ${STYLES[cell.text] ?? "open"}`;
      const sign = element("span", "icon", cell.icon ?? "");
      sign.setAttribute("aria-hidden", "true");
      item.append(sign, " ", cell.text);
    } else {
      item.textContent = cell.text ?? "";
      if (cell.text === "not enough data") item.className += " undefined";
    }
    if (cell.key) item.dataset.key = cell.key;
    made.append(item);
  });
  return made;
}
