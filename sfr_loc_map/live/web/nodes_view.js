// Health and lifecycle of each node, topics, drops by cause; the buttons that ask something of a node.

import { command } from "./connection.js";
import { byId, element, setText } from "./dom.js";
import { helpButton } from "./terms.js";

const ICONS = { ok: "✔", warning: "!", error: "✖", stale: "○" };
const STYLES = { ok: "pass", warning: "open", error: "fail", stale: "stale" };
const ACTIONS = {
  localisation_node: ["activate", "deactivate", "reset"],
  mapping_node: ["activate", "deactivate", "reset", "finish"],
  monitor_node: ["activate", "deactivate", "reset", "save"],
};
const CONFIRMED = new Set(["deactivate", "reset"]);
const ASKS_MS = 3000;
const cards = new Map();

/** Show the nodes, topics and drops of a moment. */
export function showNodes(nodes, ended) {
  if (!nodes) return;
  for (const node of nodes.nodes) showNode(node, new Set(nodes.actions), ended);
  showRows(byId("topics"), ["topic", "rate, Hz", "age, s", "lost"], Object.entries(nodes.topics).map(([name, topic]) => [
    name, topic.rate_hz === null ? "–" : topic.rate_hz.toFixed(1), topic.stale && !ended ? `stale ${topic.age_s.toFixed(1)}` : topic.age_s.toFixed(1), String(topic.lost),
  ]));
  const causes = [...new Set(nodes.nodes.flatMap((node) => Object.keys(node.values).filter((name) => name.startsWith("dropped_"))))];
  showRows(byId("drops"), ["dropped", ...nodes.nodes.map((node) => node.name.replace("_node", ""))], causes.map((cause) => [
    cause.slice(8).replaceAll("_", " "), ...nodes.nodes.map((node) => node.values[cause] ?? "–"),
  ]));
}

function showNode(node, actions, ended) {
  if (!cards.has(node.name)) cards.set(node.name, makeCard(node.name));
  const card = cards.get(node.name), level = node.level === "stale" && ended ? "ended" : node.level;
  card.box.className = `node ${STYLES[level] ?? "open"}`;
  card.box.dataset.level = level;
  setText(card.icon, ICONS[level] ?? "–");
  setText(card.level, level === "ended" ? "ended" : node.stale ? staleText(node) : level === "stale" ? "no input" : level);
  setText(card.lifecycle, node.lifecycle);
  setText(card.message, node.problem && node.level !== "ok" ? `${node.message}; ${node.problem}` : node.message || "–");
  setText(card.rates, ratesText(node.values));
  card.row.hidden = !Object.keys(card.buttons).some((name) => actions.has(name));
  for (const [name, button] of Object.entries(card.buttons)) {
    const idle = (name === "activate" && node.lifecycle === "active") || (name === "deactivate" && node.lifecycle !== "active");
    button.disabled = !actions.has(name) || ended || idle || (node.level === "stale" && node.in_graph === false);
  }
}

function staleText(node) {
  const silent = node.age_s === null ? "not heard yet" : `silent for ${node.age_s.toFixed(1)} s`;
  return node.in_graph === false ? `stale: gone, ${silent}` : `stale: ${silent}`;
}

function ratesText(values) {
  const rate = (name) => (values[name] === undefined ? "–" : Number(values[name]).toFixed(1));
  const memory = values.resident_memory_bytes ? `${Math.round(Number(values.resident_memory_bytes) / 2 ** 20)} MiB` : "–";
  return `${rate("received_messages_hz")} messages/s in, ${rate("processed_hz")} calls/s, ${values.waiting ?? "–"} waiting, ${memory}`;
}

function makeCard(name) {
  const icon = element("span", "icon"), level = element("b"), lifecycle = element("span", "lifecycle");
  const message = element("p", "message"), rates = element("p", "note"), answer = element("p", "answer");
  icon.setAttribute("aria-hidden", "true");
  answer.setAttribute("role", "status");
  const buttons = {}, row = element("div", "buttons");
  for (const action of ACTIONS[name] ?? []) {
    buttons[action] = makeButton(name, action, answer);
    row.append(buttons[action]);
  }
  const head = element("h3", "", "", icon, " ", element("span", "", name.replace("_node", "")));
  const facts = element("p", "facts-line", "", level, " · ", lifecycle, " ", helpButton("lifecycle"));
  const box = element("article", "node", "", head, facts, message, rates, row, answer);
  byId("nodes").append(box);
  return { box, icon, level, lifecycle, message, rates, row, buttons };
}

/** Return a button; what cannot be taken back asks for a second press. */
function makeButton(node, action, answer) {
  const button = element("button", "", action);
  button.type = "button";
  let asks = 0; // the timer while it asks
  const calm = () => {
    clearTimeout(asks);
    asks = 0;
    button.textContent = action;
  };
  button.addEventListener("click", async () => {
    if (CONFIRMED.has(action) && !asks) {
      asks = setTimeout(calm, ASKS_MS);
      button.textContent = `${action}: sure?`;
      return;
    }
    calm();
    answer.textContent = `${action} …`;
    try {
      answer.textContent = await command({ action, node });
    } catch (error) {
      answer.textContent = error.message;
    }
  });
  return button;
}

function showRows(place, headings, rows) {
  const text = JSON.stringify(rows);
  if (place.dataset.rows === text) return;
  place.dataset.rows = text;
  if (!rows.length) {
    place.replaceChildren(element("p", "note", "nothing yet"));
    return;
  }
  const head = element("tr", "", "", ...headings.map((heading, column) => element("th", column ? "" : "words", heading)));
  const counts = headings.at(-1) === "lost" ? [headings.length - 1] : headings.map((_, column) => column).slice(1);
  const body = rows.map((row) => element("tr", "", "", ...row.map((cell, column) => {
    const bad = counts.includes(column) && Number(cell) > 0 ? "counted" : "";
    return element("td", column ? bad : "words", cell);
  })));
  place.replaceChildren(element("table", "", "", element("thead", "", "", head), element("tbody", "", "", ...body)));
}
