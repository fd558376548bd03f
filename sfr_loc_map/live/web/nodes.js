// Health and lifecycle of each node, topics, drops by cause, and the buttons for commands to a node.

import { command } from "./connection.js";
import { byId, element, setText } from "./dom.js";
import { helpButton } from "./terms.js";

const ICONS = { ok: "✔", warning: "!", error: "✖", stale: "○", ended: "■" };
const STYLES = { ok: "pass", warning: "open", error: "fail", stale: "stale", ended: "stale" };
const CONFIRMED = new Set(["deactivate", "reset"]);
const ASKS_MS = 3000;
const cards = new Map();

/** Show the nodes, topics and drops. */
export function showNodes(run) {
  const { nodes, ended } = run;
  if (!nodes) return;
  for (const node of nodes.nodes) showNode(node, ended);
  showTopics(nodes.topics, ended);
  showDrops(nodes.nodes);
}

function showTopics(topics, ended) {
  const rows = Object.entries(topics).map(([name, topic]) => {
    const age = topic.age_s.toFixed(1);
    return [name, topic.rate_hz === null ? "–" : topic.rate_hz.toFixed(1), topic.stale && !ended ? `stale ${age}` : age, String(topic.lost)];
  });
  showRows(byId("topics"), ["topic", "rate, Hz", "age, s", "lost"], rows);
}

function showDrops(nodes) {
  const causes = new Set(nodes.flatMap((node) => Object.keys(node.drops)));
  const headings = ["dropped", ...nodes.map((node) => node.name.replace("_node", ""))];
  const rows = [...causes].map((cause) => [cause, ...nodes.map((node) => String(node.drops[cause] ?? "–"))]);
  showRows(byId("drops"), headings, rows);
}

function showNode(node, ended) {
  if (!cards.has(node.name)) cards.set(node.name, makeCard(node.name));
  const card = cards.get(node.name);
  for (const action of node.actions) addButton(card, node.name, action);
  const level = node.level === "stale" && ended ? "ended" : node.level;
  card.box.className = `node ${STYLES[level] ?? "open"}`;
  card.box.dataset.level = level;
  setText(card.icon, ICONS[level] ?? "–");
  setText(card.level, levelText(node, level));
  setText(card.lifecycle, node.lifecycle);
  setText(card.message, node.problem && node.level !== "ok" ? `${node.message}; ${node.problem}` : node.message || "–");
  setText(card.rates, ratesText(node.values));
  card.row.hidden = ended || !node.actions.length;
  const isGone = node.level === "stale" && node.in_graph === false;
  const isActive = node.lifecycle === "active";
  for (const [name, button] of Object.entries(card.buttons)) {
    const isIdle = (name === "activate" && isActive) || (name === "deactivate" && !isActive);
    button.disabled = isIdle || isGone;
  }
}

function levelText(node, level) {
  if (level === "ended") return "ended";
  if (node.stale) return staleText(node);
  return level === "stale" ? "no input" : level;
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
  const icon = element("span", "icon");
  const level = element("b");
  const lifecycle = element("span", "lifecycle");
  const message = element("p", "message");
  const rates = element("p", "note");
  const answer = element("p", "answer");
  icon.setAttribute("aria-hidden", "true");
  answer.setAttribute("role", "status");
  const row = element("div", "buttons");
  const head = element("h3", "", "", icon, " ", element("span", "", name.replace("_node", "")));
  const facts = element("p", "facts-line", "", level, " · ", lifecycle, " ", helpButton("lifecycle"));
  const box = element("article", "node", "", head, facts, message, rates, row, answer);
  byId("nodes").append(box);
  return { box, icon, level, lifecycle, message, rates, answer, row, buttons: {} };
}

function addButton(card, name, action) {
  if (card.buttons[action]) return;
  card.buttons[action] = makeButton(name, action, card.answer);
  card.row.append(card.buttons[action]);
}

/** Return a button; an action that cannot be undone requires a second press. */
function makeButton(node, action, answer) {
  const button = element("button", "", action);
  button.type = "button";
  let asks = 0; // timer during which a second press confirms
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
