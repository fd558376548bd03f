// Tables of the score: the strings are those that the server's table model made.

import { byId, element } from "./dom.js";
import { TERMS, helpButton } from "./terms.js";

const STYLES = { pass: "pass", fail: "fail" };
const FIRST = ["headline", "verdicts", "covered", "map-covered", "readings"]; // beside the path; the others are folded below
const MOST = 1.5; // share of a limit at the end of its bar
let shown = null;

/** Show every limit as a bar: the value as a share of it, its interval, the margin; the worst first. */
export function showLimits(report) {
  const limits = report?.limits ?? [];
  const empty = report ? "No limits were given: there is no verdict." : "The monitor has not reported yet: there are no figures.";
  byId("limits").replaceChildren(...(limits.length ? limits.map(barOf) : [element("p", "note", empty)]));
}

function barOf(limit) {
  const sign = element("span", `sign ${limit.style}`, limit.icon), bar = element("span", "bar"), place = (share) => `${Math.min(share / MOST, 1) * 100}%`;
  if (limit.share === null) {
    bar.className = "bar undefined";
    bar.textContent = limit.value;
  } else {
    const fill = element("i", `fill ${limit.style}`);
    fill.style.width = place(limit.share);
    bar.append(fill);
  }
  if (limit.low !== null) {
    const whisker = element("i", "whisker");
    whisker.style.left = place(limit.low);
    whisker.style.width = `${Math.max(Math.min(limit.high, MOST) - Math.min(limit.low, MOST), 0) / MOST * 100}%`;
    bar.append(whisker);
  }
  const line = element("i", "line");
  line.style.left = place(1);
  if (limit.share !== null) bar.append(line);
  bar.title = limit.interval ? `${limit.text}; 95 % interval ${limit.interval}` : limit.text;
  const words = [["name", limit.name], ["value", limit.share === null ? "–" : limit.value], ["bound", limit.limit], ["margin", limit.margin || "–"]].map(([name, text]) => element("span", name, text));
  const row = element("div", "limit", "", sign, words[0], bar, ...words.slice(1));
  row.setAttribute("role", "listitem");
  row.setAttribute("aria-label", `${limit.state}: ${bar.title}`);
  row.dataset.metric = limit.metric;
  return row;
}

/** Show all tables of a report. */
export function showReport(report) {
  if (report === shown) return;
  shown = report;
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
