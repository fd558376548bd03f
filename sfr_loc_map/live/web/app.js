// The page: receives, keeps, shows. Each view draws one moment, the latest or an earlier one.

import { offerTurning, showCloud } from "./cloud_view.js";
import { Connection, command } from "./connection.js";
import { byId, clockTime, setPill, setText } from "./dom.js";
import { showReport } from "./figures.js";
import { showImages } from "./images_view.js";
import { Lag } from "./lag.js";
import { showMap } from "./map_view.js";
import { showNodes } from "./nodes_view.js";
import { Panels } from "./panels.js";
import { showError, showPath } from "./path_view.js";
import { offerPlayer, showPlayer } from "./player.js";
import { showCalls } from "./plot.js";
import { Store } from "./store.js";
import { dressAllHelp } from "./terms.js";

const FRAME_MS = 40, THEME_KEY = "sfr-live-theme";
const store = new Store(), lag = new Lag();
let chosen = null; // the moment that is shown; null: the latest
let dirty = true, drawnMs = -FRAME_MS, connected = false, lostAt = 0;

const connection = new Connection({
  figures(message) {
    store.apply(message);
    if (message.type === "hello") lag.begin(message.server.time_s);
    if (message.type === "path") lag.expect(store.rows.at(-1));
    redraw();
  },
  image(header, blob) {
    store.addImage(header, blob);
    redraw();
  },
  values(header, values) {
    store.addValues(header, values);
    redraw();
  },
  state(open) {
    if (open !== connected || !open) {
      if (connected && !open) lostAt = connection.now();
      connected = open;
      redraw();
    }
  },
});

const choice = (id) => byId(id).value;
const cloudOf = (moment) => moment.clouds.get("mapping/points") ?? [...moment.clouds.values()][0];
let turned = 0; // changes with the view of the cloud

const panels = new Panels(redraw);
panels.add("figures", (moment) => showReport(moment.report), (moment) => [moment.report]);
panels.add("path", showPath, (moment) => [moment.rowCount, moment.rows, choice("gain"), byId("follow").checked]);
panels.add("growth", showError, (moment) => [moment.rowCount, moment.rows, moment.underWay], true);
panels.add("cameras", (moment) => showImages(moment, choice("rig"), byId("tracks").checked, noteImage), imagesKey);
panels.add("elevation", (moment) => showMap(moment.elevation, choice("layer"), currentTheme()), (moment) => [moment.elevation, choice("layer")]);
panels.add("cloud", (moment) => showCloud(cloudOf(moment), choice("colour"), currentTheme()), (moment) => [cloudOf(moment), choice("colour")]);
panels.add("calls", (moment) => showCalls(moment.calls, Boolean(store.nodes?.time_line)), (moment) => [moment.calls], true);
panels.add("health", (moment) => showNodes(moment.nodes, moment.ended || store.ended), (moment) => [moment.nodes, store.ended]);

function imagesKey(moment) {
  const lost = moment.rowCount > 0 && moment.rows[moment.rowCount - 1].lost;
  return [choice("rig"), byId("tracks").checked, lost, moment.tracked, ["loc/left", "loc/right", "nav/left", "nav/right"].map((name) => moment.images.get(name)?.stamp_ns).join(" ")];
}

/** Return `light` or `dark`: as the system says, until the button is pressed. */
function currentTheme() {
  return document.documentElement.dataset.theme ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
}

function changeTheme() {
  document.documentElement.dataset.theme = currentTheme() === "dark" ? "light" : "dark";
  localStorage.setItem(THEME_KEY, document.documentElement.dataset.theme);
  redraw();
}

function noteImage(image) {
  if (chosen === null) lag.imageDrawn(image, () => connection.now());
}

/** Draw soon; frames keep a distance, as each takes processor time that the nodes of this host may need. */
function redraw() {
  if (dirty) return;
  dirty = true;
  setTimeout(() => requestAnimationFrame(draw), Math.max(drawnMs + FRAME_MS - performance.now(), 0));
}

function draw() {
  dirty = false;
  drawnMs = performance.now();
  const moment = chosen ?? store.moment(), theme = currentTheme();
  panels.draw(moment, [theme, innerWidth, turned]);
  showHeader(moment);
  showTime();
  showPlayer(store.nodes?.time_line);
  lag.drawn(() => connection.now(), chosen === null);
  showFooter(cloudOf(moment));
  document.documentElement.dataset.drawn = String(moment.rowCount);
}

function showHeader(moment) {
  setText(byId("title"), store.server.title ?? "");
  const row = moment.rows[moment.rowCount - 1], node = moment.nodes?.nodes.find((item) => item.name === "localisation_node");
  const stale = Boolean(moment.nodes?.stale || node?.stale) && !store.ended;
  if (!connected && !store.ended) setPill(byId("state"), "stale", "○", "not known");
  else if (!row) setPill(byId("state"), "open", "…", "no pose yet");
  else if (stale) setPill(byId("state"), "stale", "○", `stale: no pose for ${(moment.nodes.topics["localisation/odometry"]?.age_s ?? 0).toFixed(1)} s`);
  else if (row.lost) setPill(byId("state"), "fail", "✖", node?.state || "lost");
  else setPill(byId("state"), node?.state.startsWith("degraded") ? "open" : "pass", "✔", node?.state || "tracking");
  if (store.ended) setPill(byId("connection"), "open", "■", "the run has ended");
  else if (connected) setPill(byId("connection"), "pass", "●", "connected");
  else setPill(byId("connection"), "fail", "✖", lostAt ? `no connection since ${clockTime(lostAt)}` : "connecting");
  showNodesPill(moment.nodes);
  const problems = moment.nodes?.problems ?? [], notice = byId("notice");
  notice.hidden = !problems.length;
  setText(notice, problems.at(-1) ?? "");
  document.body.classList.toggle("cut", !connected && !store.ended);
}

function showNodesPill(nodes) {
  const pill = byId("nodes-pill"), all = nodes?.nodes ?? [], name = (node) => node.name.replace("_node", "");
  const stale = store.ended ? [] : all.filter((node) => node.stale), bad = all.filter((node) => node.level === "error" && !node.stale);
  const warned = all.filter((node) => node.level === "warning");
  if (!all.length) setPill(pill, "open", "…", "no node yet");
  else if (!connected && !store.ended) setPill(pill, "stale", "○", "nodes not known");
  else if (bad.length) setPill(pill, "fail", "✖", `${bad.map(name).join(", ")}: error`, bad[0].message);
  else if (stale.length) setPill(pill, "stale", "○", `${stale.map(name).join(", ")}: silent`);
  else if (warned.length) setPill(pill, "open", "!", `${warned.map(name).join(", ")}: warning`, warned[0].message);
  else setPill(pill, "pass", "✔", `${all.length} nodes`);
}

function showTime() {
  const scrub = byId("scrub"), last = store.moments.length - 1;
  scrub.max = String(Math.max(last, 0));
  const place = chosen === null ? last : store.moments.indexOf(chosen);
  scrub.value = String(Math.max(place, 0));
  const paused = chosen !== null;
  byId("pause").setAttribute("aria-pressed", String(paused));
  setText(byId("pause"), paused ? "Go on" : "Pause");
  byId("live").disabled = !paused;
  document.body.classList.toggle("paused", paused);
  const now = store.moments.at(-1)?.time ?? 0;
  setText(byId("moment"), paused ? `${clockTime(chosen.time)}, ${(now - chosen.time).toFixed(0)} s ago` : "live");
}

function showFooter(cloud) {
  setText(byId("lag"), lag.text());
  const parts = [];
  if (store.thinned.images) parts.push(`images reduced from ${store.thinned.images.join(" × ")}`);
  if (cloud && cloud.count < cloud.total) parts.push(`${cloud.count} of ${cloud.total} points`);
  setText(byId("thinned"), parts.length ? `Thinned: ${parts.join("; ")}.` : "Nothing thinned.");
}

function choose(place) {
  if (!store.moments.length) return;
  chosen = store.moments[Math.min(Math.max(place, 0), store.moments.length - 1)];
  redraw();
}

function step(by) {
  choose((chosen === null ? store.moments.length - 1 : store.moments.indexOf(chosen)) + by);
}

function now() {
  chosen = null;
  redraw();
}

const pause = () => (chosen === null ? choose(store.moments.length - 1) : now());

async function bookmark() {
  const button = byId("bookmark"), row = (chosen ?? store.moment()).rows.at(-1);
  try {
    await command({ action: "bookmark", text: `bookmark at stamp ${row?.stamp ?? "unknown"}` });
    button.textContent = "Bookmarked";
  } catch (error) {
    button.textContent = error.message.slice(0, 40);
  }
  setTimeout(() => (button.textContent = "Bookmark"), 1500);
}

function tellViews() {
  const views = document.hidden ? [] : ["images", "clouds"];
  if (!document.hidden && byId("tracks").checked) views.push("tracks");
  connection.want(views);
}

const KEYS = { " ": pause, ArrowLeft: () => step(-1), ArrowRight: () => step(1), l: now, b: bookmark, t: changeTheme, "?": () => byId("keys-dialog").showModal() };
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, select, button, dialog") || !KEYS[event.key]) return;
  event.preventDefault();
  KEYS[event.key]();
});

byId("pause").addEventListener("click", pause);
byId("live").addEventListener("click", now);
byId("scrub").addEventListener("input", (event) => choose(Number(event.target.value)));
byId("bookmark").addEventListener("click", bookmark);
byId("keys").addEventListener("click", KEYS["?"]);
byId("tracks").addEventListener("change", () => (tellViews(), redraw()));
for (const id of ["rig", "layer", "colour", "gain", "follow"]) byId(id).addEventListener("change", redraw);
document.addEventListener("visibilitychange", tellViews);
window.addEventListener("resize", redraw);
if (/^(light|dark)$/.test(localStorage.getItem(THEME_KEY))) document.documentElement.dataset.theme = localStorage.getItem(THEME_KEY);
byId("theme").addEventListener("click", changeTheme);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
offerTurning(() => ((turned += 1), redraw()));
offerPlayer();
dressAllHelp();
tellViews();
dirty = false;
redraw();
Object.assign(window, { sfrLive: { store, lag, connection } }); // for tests
