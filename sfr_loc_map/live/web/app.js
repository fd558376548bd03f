// The page: receives, keeps, shows. Each view draws one moment, the latest or an earlier one.

import { offerTurning, showCloud } from "./cloud_view.js";
import { Connection, command } from "./connection.js";
import { byId, setText } from "./dom.js";
import { showLimits, showReport } from "./figures.js";
import { showHeader } from "./header.js";
import { showImages } from "./images_view.js";
import { Lag } from "./lag.js";
import { showMap } from "./map_view.js";
import { showNodes } from "./nodes_view.js";
import { Panels } from "./panels.js";
import { showError, showPath } from "./path_view.js";
import { showCalls } from "./plot.js";
import { Store, stateOf } from "./store.js";
import { dressAllHelp } from "./terms.js";
import { moment as timeText, offerTimeline, showMoment, showTimeline } from "./timeline.js";
import { View } from "./view.js";

const FRAME_MS = 40, THEME_KEY = "sfr-live-theme";
const CHOICES = ["rig", "layer", "colour", "gain"], SWITCHES = ["follow", "tracks"];
const store = new Store(), lag = new Lag();
let chosen = null; // the moment that is shown; null: the latest
let dirty = true, drawnMs = -FRAME_MS, connected = false, lostAt = 0; // since when there is no connection

const connection = new Connection({
  figures(message) {
    store.apply(message);
    if (message.type === "hello") lag.begin(message.server.time_s);
    if (message.type === "path") lag.expect(store.rows.at(-1));
    if (message.type === "nodes") goToWanted();
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
      lostAt = open ? 0 : lostAt || connection.now();
      connected = open;
      redraw();
    }
  },
});

const choice = (id) => byId(id).value;
const cloudOf = (moment) => moment.clouds.get("mapping/points") ?? [...moment.clouds.values()][0];
let turned = 0; // changes with the view of the cloud

const views = {};
for (const id of ["path", "map"]) views[`${id}-canvas`] = new View(byId(`${id}-canvas`), redraw);
for (const id of ["error", "time", "transport", "receive", "memory"]) views[`${id}-canvas`] = new View(byId(`${id}-canvas`), redraw, false);
const seen = (...ids) => ids.map((id) => views[`${id}-canvas`].version).join(" ");

const panels = new Panels(redraw);
panels.add("figures", (moment) => showLimits(moment.report), (moment) => [moment.report]);
panels.add("path", (moment) => showPath(moment, views["path-canvas"]), (moment) => [moment.rowCount, moment.rows, choice("gain"), byId("follow").checked, seen("path")]);
panels.add("growth", (moment) => showError(moment, views["error-canvas"]), (moment) => [moment.rowCount, moment.rows, moment.underWay, moment.report, seen("error")], true);
panels.add("cameras", (moment) => showImages(moment, choice("rig"), byId("tracks").checked, noteImage), imagesKey);
panels.add("elevation", (moment) => showMap(moment.elevation, choice("layer"), currentTheme(), views["map-canvas"]), (moment) => [moment.elevation, choice("layer"), seen("map")]);
panels.add("cloud", (moment) => showCloud(cloudOf(moment), choice("colour"), currentTheme()), (moment) => [cloudOf(moment), choice("colour")]);
panels.add("calls", (moment) => showCalls(moment.calls, moment.report?.limits ?? [], views), (moment) => [moment.calls, moment.report, seen("time", "transport", "receive", "memory")], true);
panels.add("numbers", (moment) => showReport(moment.report), (moment) => [moment.report]);
panels.add("health", (moment) => showNodes(moment.nodes, store.ended), (moment) => [moment.nodes, store.ended]);

function imagesKey(moment) {
  const lost = moment.rowCount > 0 && moment.rows[moment.rowCount - 1].lost;
  return [choice("rig"), byId("tracks").checked, lost && stateOf(moment), moment.tracked, ["loc/left", "loc/right", "nav/left", "nav/right"].map((name) => moment.images.get(name)?.stamp_ns).join(" ")];
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
  const moment = { ...(chosen ?? store.moment()), live: chosen === null }, theme = currentTheme();
  panels.draw(moment, [theme, innerWidth, turned]);
  setText(byId("title"), store.server.title ?? "");
  showHeader(moment, store, connection.now(), lostAt);
  showTime();
  lag.drawn(() => connection.now(), chosen === null);
  showFooter(cloudOf(moment));
  document.documentElement.dataset.drawn = String(moment.rowCount);
}

/** Show where in time it is: the bar spans the recording, or the run as far as it is known. */
function showTime() {
  const now = store.nodes?.time_s ?? 0, events = store.events;
  const begin = Math.min(store.moments[0]?.time ?? now, events[0]?.from ?? now);
  const last = store.ended ? Math.max(...events.map((event) => event.to ?? event.from), begin) : now, end = Math.max(last, begin + 1);
  showTimeline({ begin, end, at: chosen ? chosen.time : end, events });
  const words = chosen ? `${timeText(chosen.time)}, ${(now - chosen.time).toFixed(0)} s ago` : store.ended ? "ended" : "live";
  showMoment(words, !chosen, Boolean(chosen));
  document.body.classList.toggle("paused", Boolean(chosen));
  writeHash(chosen?.time ?? null);
}

function showFooter(cloud) {
  setText(byId("lag"), lag.text());
  const parts = [];
  if (store.thinned.images) parts.push(`images reduced from ${store.thinned.images.join(" × ")}`);
  if (cloud && cloud.count < cloud.total) parts.push(`${cloud.count} of ${cloud.total} points`);
  setText(byId("thinned"), parts.length ? `Thinned: ${parts.join("; ")}.` : "Nothing thinned.");
}

/** Show the moment of a time. */
function goTo(time) {
  const last = store.moments.at(-1);
  chosen = !last || time >= last.time ? null : store.momentAt(time);
  redraw();
}

function step(by) {
  const at = chosen ? store.moments.findLastIndex((moment) => moment.time <= chosen.time) : store.moments.length - 1;
  const found = store.moments[Math.min(Math.max(at + by, 0), store.moments.length - 1)];
  if (found) chosen = store.momentAt(found.time);
  redraw();
}

function now() {
  chosen = null;
  redraw();
}

function pause() {
  if (chosen) now();
  else step(0);
}

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
  const own = event.target.closest("select, dialog") || (event.key === " " && event.target.closest("button, input[type=checkbox]"));
  if (event.ctrlKey || event.metaKey || event.altKey || own || !KEYS[event.key]) return;
  event.preventDefault();
  KEYS[event.key]();
});
// What was pressed with the pointer gives the keys back to the page.
for (const kind of ["pointerup", "change"]) document.addEventListener(kind, () => setTimeout(() => document.activeElement?.matches("button, input, select:not(:open)") && document.activeElement.blur()));

// The view, and the moment where it is not the latest, stand in the address: a reload or a link shows them again.
let wanted = Number(new URLSearchParams(location.hash.slice(1)).get("t")) || null;

function readHash() {
  const given = new URLSearchParams(location.hash.slice(1));
  for (const id of CHOICES) if ([...byId(id).options].some((option) => option.value === given.get(id))) byId(id).value = given.get(id);
  for (const id of SWITCHES) if (given.has(id)) byId(id).checked = given.get(id) === "1";
}

function writeHash(time) {
  if (wanted !== null) return;
  const kept = new URLSearchParams(time === null ? {} : { t: time.toFixed(1) });
  for (const id of CHOICES) if (!byId(id).options[0].selected) kept.set(id, choice(id));
  for (const id of SWITCHES) if (byId(id).checked !== byId(id).defaultChecked) kept.set(id, byId(id).checked ? "1" : "0");
  const hash = kept.size ? `#${kept}` : location.pathname + location.search;
  if (location.hash.slice(1) !== String(kept)) history.replaceState(null, "", hash);
}

/** Go to the moment of the address once it is known what there is. */
function goToWanted() {
  if (wanted === null || !store.nodes || !store.moments.length) return;
  goTo(wanted);
  wanted = null;
}

byId("pause").addEventListener("click", pause);
byId("live").addEventListener("click", now);
byId("bookmark").addEventListener("click", bookmark);
byId("keys").addEventListener("click", KEYS["?"]);
byId("tracks").addEventListener("change", () => (tellViews(), redraw()));
for (const id of [...CHOICES, "follow"]) byId(id).addEventListener("change", redraw);
document.addEventListener("visibilitychange", tellViews);
window.addEventListener("resize", redraw);
if (/^(light|dark)$/.test(localStorage.getItem(THEME_KEY))) document.documentElement.dataset.theme = localStorage.getItem(THEME_KEY);
byId("theme").addEventListener("click", changeTheme);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
offerTurning(() => ((turned += 1), redraw()));
offerTimeline(goTo);
dressAllHelp();
readHash();
tellViews();
setInterval(() => lostAt && redraw(), 1000);
dirty = false;
redraw();
Object.assign(window, { sfrLive: { store, lag, connection } }); // for tests
