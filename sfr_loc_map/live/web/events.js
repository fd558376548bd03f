// The events over the time of day.

import { dateTime, localTime } from "./dom.js";
import { axis, colour, draw, plain, timeAxis } from "./plots.js";

const ROWS = ["run", "limits", "nodes", "localisation"]; // from below
// Each kind of event with its row, its colour, its name in the legend, and its hatch, which needs no colour.
const KINDS = {
  tracking: { row: "localisation", fill: "under" },
  degraded: { row: "localisation", fill: "degraded", hatch: "/" },
  lost: { row: "localisation", fill: "lost" },
  stale: { row: "localisation", fill: "stale", name: "no pose (stale)", hatch: "\\" },
  compiling: { row: "nodes", fill: "accent" },
  silent: { row: "nodes", fill: "stale", name: "node silent", hatch: "\\" },
  node: { row: "nodes", fill: "open", name: "node in error" },
  limit: { row: "limits", fill: "fail", name: "limit missed" },
  clock: { row: "run", fill: "accent", name: "jump of the stamps" },
  aborted: { row: "run", fill: "fail" },
};

/** Show the events, with one row each for localisation, nodes, limits and the run, coloured by kind. */
export function showEvents(run) {
  const nowS = run.ended ? run.live.ended_at : (run.live?.time_s ?? 0); // end of the events in progress
  const traces = Object.keys(KINDS).map((kind) => traceOf(kind, run.events, nowS));
  const rows = { type: "category", categoryorder: "array", categoryarray: ROWS, range: [-0.5, ROWS.length - 0.5] };
  const layout = {
    barmode: "overlay",
    plotHeight: 150,
    margin: { l: 8, r: 12, t: 8, b: 30 },
    xaxis: timeAxis("events-plot"),
    yaxis: axis("", { ...rows, fixedrange: true }),
    showlegend: true,
  };
  draw("events-plot", traces.filter((trace) => trace.x.length), layout, "nothing has happened yet");
}

function traceOf(kind, allEvents, nowS) {
  const { row, fill, name = kind, hatch = "" } = KINDS[kind];
  const events = allEvents.filter((event) => event.kind === kind);
  const durationS = (event) => Math.max((event.to ?? nowS) - event.from, 0);
  const hoverText = (event) => plain(`${event.text}: ${dateTime(event.from)}, ${durationS(event).toFixed(1)} s`);
  return {
    type: "bar",
    orientation: "h",
    name,
    base: events.map((event) => localTime(event.from)),
    x: events.map((event) => durationS(event) * 1000),
    y: events.map(() => row),
    width: 0.7,
    marker: {
      color: colour(fill),
      line: { color: colour(fill), width: 1 }, // keeps short events visible
      pattern: { shape: hatch, fillmode: "overlay", fgcolor: colour("card") },
    },
    hovertext: events.map(hoverText),
    hoverinfo: "text",
  };
}
