// Tables of the score. The server creates their strings, as for the report.

import { byId, element } from "./dom.js";
import { TERMS, helpButton } from "./terms.js";

const STYLES = { pass: "pass", fail: "fail" };
const FIRST = ["headline", "verdicts", "covered", "map-covered", "readings"]; // other tables are folded

/** Show all tables of a report. */
export function showTables(run) {
  const report = run.report;
  const tables = report?.tables ?? [];
  const first = tables.filter((table) => FIRST.includes(table.name));
  byId("figure-table").replaceChildren(...first.flatMap((table) => [tableOf(table, true), element("p", "note", table.note)]));
  if (!first.length) byId("figure-table").append(element("p", "note", "not enough data"));
  byId("warnings").replaceChildren(...(report?.warnings ?? []).map((text) => element("li", "", text)));
  showFolded(tables.filter((table) => !FIRST.includes(table.name)));
}

function showFolded(tables) {
  const open = new Set([...document.querySelectorAll("#tables details[open]")].map((item) => item.dataset.name));
  byId("tables").replaceChildren(...tables.map((table) => {
    const box = element("div", "scroll", "", tableOf(table, false));
    const details = element("details", "", "", element("summary", "", table.title), box);
    details.dataset.name = table.name;
    details.open = open.has(table.name);
    if (table.note) details.append(element("p", "note", table.note));
    return details;
  }));
  byId("all").hidden = !tables.length;
}

/** Return a table; with `withHelp` its headings have a "?" button. */
function tableOf(table, withHelp) {
  const head = element("tr");
  for (const column of table.columns) {
    const cell = element("th", column.words ? "words" : "", column.heading);
    cell.scope = "col";
    const term = column.heading.split(",")[0];
    if (withHelp && TERMS[term]) cell.append(" ", helpButton(term));
    head.append(cell);
  }
  const body = element("tbody", "", "", ...table.rows.map((row) => rowOf(row, table.columns)));
  return element("table", "", "", element("thead", "", "", head), body);
}

function rowOf(row, columns) {
  return element("tr", "", "", ...row.map((cell, place) => cellOf(cell, columns[place].words ? "words" : "")));
}

function cellOf(cell, style) {
  if (cell.kind === "head") {
    const head = element("th", "words", cell.text);
    head.scope = "row";
    return head;
  }
  const item = element("td", style, cell.kind === "verdict" ? "" : (cell.text ?? ""));
  if (cell.kind === "verdict") {
    const sign = element("span", "icon", cell.icon ?? "");
    sign.setAttribute("aria-hidden", "true");
    item.className = `verdict ${STYLES[cell.text] ?? "open"}`;
    item.append(sign, " ", cell.text);
  } else if (cell.text === "not enough data") item.classList.add("undefined");
  if (cell.key) item.dataset.key = cell.key;
  return item;
}
