// The page: receives the messages of the server and draws the panels whose data have changed.

import { showCalls } from "./calls.js";
import { showCameras } from "./cameras.js";
import { Connection, command } from "./connection.js";
import { byId } from "./dom.js";
import { showErrors } from "./errors.js";
import { showEvents } from "./events.js";
import { showFigures } from "./figures.js";
import { showHeader } from "./header.js";
import { showLimits } from "./limits.js";
import { showMap } from "./map.js";
import { showNodes } from "./nodes.js";
import { showPath } from "./path.js";
import { Run } from "./run.js";
import { addTerms, dressAllHelp } from "./terms.js";

const TICK_MS = 100; // interval between two checks for new data
const PLOT_MS = 500; // minimum interval between two drawings of a panel
const ANSWER_MS = 1500; // time for which the button shows the answer to a bookmark

const run = new Run();
const connection = new Connection({
  onMessage: takeMessage,
  onMedia: (header, bytes) => run.takeMedia(header, bytes),
});
const isDark = matchMedia("(prefers-color-scheme: dark)");

// Each panel with its section and its data. A panel is redrawn when a value or object of its data has changed, and at
// the end of the run.
const panels = [
  { id: "events", show: showEvents, data: () => [run.events, run.live] },
  { id: "limits", show: showLimits, data: () => [run.score] },
  { id: "path", show: showPath, data: () => [run.keptPoses, run.lastPose, run.beforeM] },
  { id: "cameras", show: showCameras, everyMs: TICK_MS, data: camerasData },
  { id: "errors", show: showErrors, data: () => [run.score, run.poses.length > 0] },
  { id: "map", show: showMap, data: () => [run.map, byId("layer").value] },
  { id: "calls", show: showCalls, data: () => [run.calls, run.score] },
  { id: "nodes", show: showNodes, data: () => [run.live] },
  { id: "figures", show: showFigures, data: () => [run.score] },
].map((panel) => ({ everyMs: PLOT_MS, drawn: null, drawnMs: -PLOT_MS, isVisible: true, ...panel }));

function takeMessage(message) {
  if (message.type === "hello") addTerms(message.terms);
  run.take(message);
}

function camerasData() {
  return [run.live, byId("rig").value, ...run.images.values()];
}

function draw() {
  if (document.hidden) return;
  showHeader(run, connection);
  panels.forEach(drawPanel);
  document.documentElement.dataset.poses = String(run.poses.length);
}

function drawPanel(panel) {
  const data = [...panel.data(), run.ended, innerWidth, isDark.matches];
  const isSame = panel.drawn?.length === data.length && data.every((value, place) => value === panel.drawn[place]);
  const isEarly = performance.now() - panel.drawnMs < panel.everyMs;
  if (isSame || isEarly || !panel.isVisible) return;
  panel.drawn = data;
  panel.drawnMs = performance.now();
  panel.show(run);
}

/** Draw only the panels that are on the screen or close to it. */
function watchVisibility() {
  const watcher = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      panels.find((panel) => panel.id === entry.target.id).isVisible = entry.isIntersecting;
    }
  }, { rootMargin: "200px" });
  for (const panel of panels) watcher.observe(byId(panel.id));
}

function reportVisibility() {
  connection.reportVisible(!document.hidden);
}

async function bookmark() {
  const button = byId("bookmark");
  try {
    await command({ action: "bookmark", text: `bookmark at stamp ${run.lastPose?.stamp_ns ?? "unknown"}` });
    button.textContent = "Bookmarked";
  } catch (error) {
    button.textContent = error.message.slice(0, 40);
  }
  setTimeout(() => (button.textContent = "Bookmark"), ANSWER_MS);
}

dressAllHelp();
watchVisibility();
document.addEventListener("visibilitychange", reportVisibility);
byId("bookmark").addEventListener("click", bookmark);
reportVisibility();
setInterval(draw, TICK_MS);
Object.assign(window, { sfrLive: { run, connection } }); // for tests
