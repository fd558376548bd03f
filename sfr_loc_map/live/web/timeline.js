// The one bar of time, of a run: what happened when, the moment shown; a click goes there.

import { byId, clockTime, colour, element, fitted, setText } from "./dom.js";

const EDGE = 8; // half of the thumb of a range input, which lies over the bar
const LANES = { tracking: [0, 12], degraded: [0, 12], lost: [0, 12], stale: [0, 12], compiling: [15, 6], node: [15, 6], limit: [24, 6] };
const COLOURS = { tracking: "under", degraded: "degraded", lost: "lost", stale: "stale", compiling: "accent", node: "open", limit: "fail", clock: "accent", aborted: "fail" };
const NEAR = 4;
let shown = { begin: 0, end: 1, events: [] }, dragged = false;

/** Let the bar ask for moments: `go(time)` while it is dragged, `last` once it is let go. */
export function offerTimeline(go) {
  const slider = byId("scrub"), tip = byId("tip");
  slider.addEventListener("pointerdown", () => (dragged = true));
  slider.addEventListener("input", () => go(Number(slider.value), false));
  slider.addEventListener("change", () => ((dragged = false), go(Number(slider.value), true)));
  for (const end of ["pointerup", "pointercancel"]) slider.addEventListener(end, () => (dragged = false));
  slider.addEventListener("pointermove", (event) => {
    const time = timeAt(event.offsetX), words = eventsAt(time).map(wordsOf);
    tip.replaceChildren(...[`${moment(time)}`, ...words].map((text) => element("div", "", text)));
    tip.hidden = false;
    tip.style.left = `${Math.max(Math.min(event.clientX - 20, innerWidth - tip.offsetWidth - 8), 8)}px`;
    tip.style.top = `${slider.getBoundingClientRect().bottom + 8}px`;
  });
  slider.addEventListener("pointerleave", () => (tip.hidden = true));
}

/** Show the events from `begin` to `end` and the moment `at`, seconds. */
export function showTimeline(model) {
  shown = model;
  const slider = byId("scrub"), canvas = byId("timeline"), { context, width, height } = fitted(canvas);
  [slider.min, slider.max, slider.step] = [String(model.begin), String(model.end), "any"];
  if (!dragged) slider.value = String(model.at);
  slider.setAttribute("aria-valuetext", moment(model.at));
  canvas.dataset.events = String(model.events.length);
  context.fillStyle = colour("grid");
  context.fillRect(EDGE, 0, width - 2 * EDGE, 12);
  for (const event of model.events) draw(context, event, height);
  const x = placeOf(Math.min(Math.max(Number(slider.value), model.begin), model.end));
  context.fillStyle = colour("text");
  context.fillRect(x - 1, 0, 2, height);
  context.beginPath(), context.arc(x, 6, 5, 0, 7), context.fill();
}

/** Return a time of the day in words. */
export function moment(time) {
  return clockTime(time);
}

function draw(context, event, height) {
  const from = placeOf(Math.max(event.from, shown.begin)), to = placeOf(Math.min(event.to ?? shown.end, shown.end));
  if (to < EDGE || (event.to ?? shown.end) < shown.begin) return;
  const [top, tall] = LANES[event.kind] ?? [0, height];
  context.fillStyle = colour(COLOURS[event.kind] ?? "muted");
  context.fillRect(from, top, Math.max(to - from, 2), tall);
  if (event.kind === "degraded" || event.kind === "stale") hatch(context, from, to, top, tall);
}

/** What is not tracking is told by more than its colour. */
function hatch(context, from, to, top, tall) {
  context.save();
  context.beginPath(), context.rect(from, top, to - from, tall), context.clip();
  context.strokeStyle = colour("card");
  context.lineWidth = 1;
  context.beginPath();
  for (let x = from - tall; x < to; x += 5) context.moveTo(x, top + tall), context.lineTo(x + tall, top);
  context.stroke();
  context.restore();
}

const span = () => Math.max(shown.end - shown.begin, 1e-3);
const wide = () => Math.max(byId("timeline").clientWidth - 2 * EDGE, 1);
const placeOf = (time) => EDGE + ((time - shown.begin) / span()) * wide();
const timeAt = (x) => shown.begin + (Math.min(Math.max(x - EDGE, 0), wide()) / wide()) * span();

function eventsAt(time) {
  const near = (NEAR / wide()) * span();
  return shown.events.filter((event) => event.from <= time + near && (event.to ?? shown.end) >= time - near).slice(-6);
}

function wordsOf(event) {
  const long = (event.to ?? shown.end) - event.from;
  return long > 0 ? `${event.text}, ${long.toFixed(1)} s from ${moment(event.from)}` : `${event.text}, at ${moment(event.from)}`;
}

/** Show whether it plays, and where it is. */
export function showMoment(text, playing, canGoBack) {
  setText(byId("moment"), text);
  setText(byId("pause"), playing ? "Pause" : "Play");
  byId("pause").setAttribute("aria-pressed", String(!playing));
  byId("live").disabled = !canGoBack;
}
