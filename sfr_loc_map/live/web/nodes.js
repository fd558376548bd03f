// Health and lifecycle of each node, topics, drops by cause, and the buttons for commands to a node.

import { command } from "./connection.js";
import { byId, element, setText } from "./dom.js";
import { helpButton } from "./terms.js";

const LEVELS = {
  ok: { icon: "✔", style: "pass" },
  warning: { icon: "!", style: "open" },
  error: { icon: "✖", style: "fail" },
  stale: { icon: "○", style: "stale" },
  ended: { icon: "■", style: "stale" },
};
const CONFIRMED = ["deactivate", "reset"]; // actions that cannot be undone, which require a second press
const CONFIRM_MS = 3000;
const cards = new Map(); // elements of each node, by name
const shortName = (name) => name.replace("_node", "");

/** Show the nodes, topics and drops. */
export function showNodes(run) {
  if (!run.live) return;
  const { nodes, topics } = run.live;
  for (const node of nodes) showNode(node, run.ended);
  showTopics(topics, run.ended);
  showDrops(nodes);
}

// ---- topics and drops

function showTopics(topics, ended) {
  const rows = Object.entries(topics).map(([name, topic]) => {
    const age = topic.age_s.toFixed(1);
    const rate = topic.rate_hz === null ? "–" : topic.rate_hz.toFixed(1);
    return [name, rate, topic.stale && !ended ? `stale ${age}` : age, String(topic.lost)];
  });
  showRows(byId("topics"), { headings: ["topic", "rate, Hz", "age, s", "lost"], rows, firstCount: 3 });
}

function showDrops(nodes) {
  const causes = [...new Set(nodes.flatMap((node) => Object.keys(node.drops)))];
  const headings = ["dropped", ...nodes.map((node) => shortName(node.name))];
  const rows = causes.map((cause) => [cause, ...nodes.map((node) => String(node.drops[cause] ?? "–"))]);
  showRows(byId("drops"), { headings, rows, firstCount: 1 });
}

/** Show a table of texts; the columns from `firstCount` on are counts, which are emphasised above zero. */
function showRows(place, { headings, rows, firstCount }) {
  const content = JSON.stringify([headings, rows]);
  if (place.dataset.content === content) return;
  place.dataset.content = content;
  const classOf = (text, column) => {
    if (column === 0) return "words";
    return column >= firstCount && Number(text) > 0 ? "counted" : "";
  };
  const rowOf = (tag, texts) => (
    element("tr", {}, ...texts.map((text, column) => element(tag, { className: classOf(text, column), text })))
  );
  const head = element("thead", {}, rowOf("th", headings));
  const body = element("tbody", {}, ...rows.map((row) => rowOf("td", row)));
  const empty = element("p", { className: "note", text: "nothing yet" });
  place.replaceChildren(rows.length ? element("table", {}, head, body) : empty);
}

// ---- the card of a node

function showNode(node, ended) {
  if (!cards.has(node.name)) cards.set(node.name, makeCard(node.name));
  const card = cards.get(node.name);
  const level = node.level === "stale" && ended ? "ended" : node.level;
  const { icon, style } = LEVELS[level] ?? { icon: "–", style: "open" };
  card.box.className = `node ${style}`;
  card.box.dataset.level = level;
  setText(card.icon, icon);
  setText(card.level, levelText(node, level));
  setText(card.lifecycle, node.lifecycle);
  setText(card.message, messageText(node));
  setText(card.rates, ratesText(node.values));
  showButtons(card, node, ended);
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

function messageText(node) {
  if (node.problem && node.level !== "ok") return `${node.message}; ${node.problem}`;
  return node.message || "–";
}

function ratesText(values) {
  const rate = (name) => (values[name] === undefined ? "–" : Number(values[name]).toFixed(1));
  const bytes = values.resident_memory_bytes;
  return [
    `${rate("received_messages_hz")} messages/s in`,
    `${rate("processed_hz")} calls/s`,
    `${values.waiting ?? "–"} waiting`,
    bytes ? `${Math.round(Number(bytes) / 2 ** 20)} MiB` : "–",
  ].join(", ");
}

function makeCard(name) {
  const icon = element("span", { className: "icon" });
  const level = element("b");
  const lifecycle = element("span", { className: "lifecycle" });
  const message = element("p", { className: "message" });
  const rates = element("p", { className: "note" });
  const row = element("div", { className: "buttons" });
  const answer = element("p", { className: "answer" });
  icon.setAttribute("aria-hidden", "true");
  answer.setAttribute("role", "status");
  const head = element("h3", {}, icon, " ", shortName(name));
  const facts = element("p", {}, level, " · ", lifecycle, " ", helpButton("lifecycle"));
  const box = element("article", { className: "node" }, head, facts, message, rates, row, answer);
  byId("node-cards").append(box);
  return { box, icon, level, lifecycle, message, rates, row, answer, buttons: new Map() };
}

// ---- commands

function showButtons(card, node, ended) {
  for (const action of node.actions) {
    if (!card.buttons.has(action)) addButton(card, node.name, action);
  }
  const isGone = node.level === "stale" && node.in_graph === false;
  const needless = node.lifecycle === "active" ? "activate" : "deactivate";
  card.row.hidden = ended || !node.actions.length;
  for (const [action, button] of card.buttons) button.disabled = isGone || action === needless;
}

function addButton(card, node, action) {
  const button = element("button", { text: action });
  let timer = 0; // while it runs, a press confirms
  const calm = () => {
    clearTimeout(timer);
    timer = 0;
    button.textContent = action;
  };
  button.type = "button";
  button.addEventListener("click", () => {
    if (CONFIRMED.includes(action) && !timer) {
      timer = setTimeout(calm, CONFIRM_MS);
      button.textContent = `${action}: sure?`;
      return;
    }
    calm();
    run(node, action, card.answer);
  });
  card.buttons.set(action, button);
  card.row.append(button);
}

async function run(node, action, answer) {
  answer.textContent = `${action} …`;
  try {
    answer.textContent = await command({ action, node });
  } catch (error) {
    answer.textContent = error.message;
  }
}
