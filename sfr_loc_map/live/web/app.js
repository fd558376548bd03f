// The page: receives the messages of the server and draws the panels whose data have changed.

import { Connection, command } from "./connection.js";
import { byId } from "./dom.js";
import { showHeader } from "./header.js";
import { showImages } from "./images.js";
import { showNodes } from "./nodes.js";
import { showCalls, showEvents, showLimits, showMap } from "./panels.js";
import { showError, showPath } from "./path.js";
import { Run } from "./run.js";
import { showTables } from "./tables.js";
import { dressAllHelp } from "./terms.js";

const PLOT_MS = 500; // minimum interval between two drawings of a plot
const TICK_MS = 100;
const run = new Run();
const state = { isOpen: false, lostMs: 0, nowMs: Date.now() };

// Each panel with its data. A panel is redrawn when a value or object of its data has changed.
const panels = [
  { id: "figures", show: showLimits, data: () => [run.report] },
  { id: "path", show: showPath, data: () => [run.poses, run.ended] },
  { id: "growth", show: showError, data: () => [run.report, run.poses.length > 0] },
  { id: "events", show: showEvents, data: () => [run.events, run.nodes] },
  { id: "cameras", show: showImages, data: () => [...run.images.values(), run.nodes, run.poses, byId("rig").value], everyMs: TICK_MS },
  { id: "elevation", show: showMap, data: () => [run.map, byId("layer").value] },
  { id: "calls", show: showCalls, data: () => [run.calls, run.report] },
  { id: "numbers", show: showTables, data: () => [run.report] },
  { id: "health", show: showNodes, data: () => [run.nodes] },
];
for (const panel of panels) Object.assign(panel, { drawn: null, drawnMs: -PLOT_MS, isVisible: true });

const connection = new Connection({
  figures: (message) => run.take(message),
  media: (header, bytes) => run.takeMedia(header, bytes),
  state(isOpen) {
    if (isOpen) state.lostMs = 0;
    else if (state.isOpen) state.lostMs = Date.now();
    state.isOpen = isOpen;
  },
});

function draw() {
  if (document.hidden) return;
  state.nowMs = Date.now();
  showHeader(run, state);
  for (const panel of panels) drawPanel(panel);
  document.documentElement.dataset.poses = String(run.poses.length);
}

function drawPanel(panel) {
  const data = [...panel.data(), innerWidth, isDark.matches];
  const isSame = panel.drawn?.length === data.length && data.every((value, place) => value === panel.drawn[place]);
  const isEarly = performance.now() - panel.drawnMs < (panel.everyMs ?? PLOT_MS);
  if (isSame || isEarly || !panel.isVisible) return;
  panel.drawn = data;
  panel.drawnMs = performance.now();
  panel.show(run);
}

async function bookmark() {
  const button = byId("bookmark");
  try {
    await command({ action: "bookmark", text: `bookmark at stamp ${run.lastPose?.stamp_ns ?? "unknown"}` });
    button.textContent = "Bookmarked";
  } catch (error) {
    button.textContent = error.message.slice(0, 40);
  }
  setTimeout(() => (button.textContent = "Bookmark"), 1500);
}

const isDark = matchMedia("(prefers-color-scheme: dark)");
const watcher = new IntersectionObserver((entries) => {
  for (const entry of entries) panels.find((panel) => panel.id === entry.target.id).isVisible = entry.isIntersecting;
}, { rootMargin: "200px" });
for (const panel of panels) watcher.observe(byId(panel.id));
const tellViews = () => connection.want(document.hidden ? [] : ["images", "maps"]);
document.addEventListener("visibilitychange", tellViews);
byId("bookmark").addEventListener("click", bookmark);
dressAllHelp();
tellViews();
setInterval(draw, TICK_MS);
Object.assign(window, { sfrLive: { run, connection } }); // for tests
