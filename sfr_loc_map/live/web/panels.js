// Other plots: limits, events, map from above, time and memory of the calls.

import { byId, dateTime, length, localTime, setText } from "./dom.js";
import { LEGEND_LINE_PX, axis, colour, draw, fitting, limitLine, plain, scaleOf, timeAxis } from "./plots.js";

const SHARE_SHOWN = 1.5; // end of the axis, as a fraction of the limit
const LIMIT_ROW_PX = 54;
const NODES = { localisation_node: ["localisation", "estimate"], mapping_node: ["mapping", "under"] };
const ROWS = ["run", "limits", "nodes", "localisation"]; // rows of the events, from below
const LANES = { tracking: "localisation", degraded: "localisation", lost: "localisation", stale: "localisation" };
Object.assign(LANES, { node: "nodes", compiling: "nodes", limit: "limits", clock: "run", aborted: "run" });
const EVENT_KINDS = { tracking: "under", degraded: "degraded", lost: "lost", stale: "stale", compiling: "accent" };
Object.assign(EVENT_KINDS, { node: "open", limit: "fail", clock: "accent", aborted: "fail" });
const EVENT_NAMES = { stale: "no pose (stale)", node: "node silent or in error", limit: "limit missed", clock: "jump of the stamps" };
const HATCHED = { degraded: "/", stale: "\\" }; // distinguishable without colours
const MAP_UNITS = { hazard: ["hazard, %", 1], slope: ["slope, deg", 180 / Math.PI], count: ["points in a cell", 1] };

/** Show each limit as a bar: the judged value as a fraction of the limit, with its 95 % interval; worst first. */
export function showLimits(run) {
  const limits = run.report?.limits ?? [];
  const box = byId("limits-plot");
  const cut = (text) => fitting("limits-plot", text, 16);
  const rows = limits.map((_, place) => place);
  const shares = limits.map((limit) => Math.min(limit.share ?? 0, SHARE_SHOWN));
  const high = limits.map((limit, row) => (limit.high === null ? 0 : Math.max(Math.min(limit.high, SHARE_SHOWN) - shares[row], 0)));
  const low = limits.map((limit, row) => (limit.low === null ? 0 : Math.max(shares[row] - limit.low, 0)));
  const trace = {
    type: "bar",
    orientation: "h",
    x: shares,
    y: rows,
    width: 0.16,
    marker: { color: limits.map((limit) => colour(limit.style)) },
    error_x: { type: "data", symmetric: false, array: high, arrayminus: low, color: colour("text"), thickness: 1.5, width: 4 },
    hovertext: limits.map((limit) => plain(limit.interval ? `${limit.text}; 95 % interval ${limit.interval}` : limit.text)),
    hoverinfo: "text",
  };
  const labels = limits.flatMap((limit, row) => [
    label(row, 28, cut(`${limit.icon} ${limit.name}`), colour(limit.style)),
    label(row, 13, cut(`${limit.value}, limit ${limit.limit}${limit.margin ? `, margin ${limit.margin}` : ""}`), colour("text")),
  ]);
  const ticks = { tickvals: [0, 0.5, 1], ticktext: ["0", "50 %", "limit"], range: [0, SHARE_SHOWN], fixedrange: true };
  draw("limits-plot", limits.length ? [trace] : [], {
    plotHeight: Math.max(limits.length, 2) * LIMIT_ROW_PX + 34,
    margin: { l: 8, r: 8, t: 8, b: 26 },
    xaxis: axis("", ticks),
    yaxis: { visible: false, range: [limits.length - 0.7, -0.8], fixedrange: true },
    shapes: [{ type: "line", x0: 1, x1: 1, y0: 0, y1: 1, yref: "paper", layer: "below", line: { color: colour("text"), width: 2 } }],
    annotations: labels,
    showlegend: false,
  }, run.report ? "No limits were given, so that there is no verdict." : "The monitor has not reported yet.");
  box.setAttribute("aria-label", limits.map((limit) => `${limit.state}: ${limit.text}`).join("; ") || "no limits");
}

function label(row, yshift, text, fill) {
  return { x: 0, xanchor: "left", y: row, yshift, text, showarrow: false, bgcolor: colour("card"), font: { color: fill, size: 12 } };
}

/** Show the events over time, with one row each for localisation, nodes, limits and the run, coloured by kind. */
export function showEvents(run) {
  const now = run.ended ? run.nodes.ended_at : (run.nodes?.time_s ?? 0);
  const traces = Object.keys(EVENT_KINDS).map((kind) => eventTrace(kind, run.events.filter((event) => event.kind === kind), now));
  draw("events-plot", traces.filter((trace) => trace.x.length), {
    barmode: "overlay",
    plotHeight: 150,
    margin: { l: 8, r: 12, t: 8, b: 30 },
    xaxis: timeAxis("events-plot"),
    yaxis: axis("", { type: "category", categoryorder: "array", categoryarray: ROWS, range: [-0.5, ROWS.length - 0.5], fixedrange: true }),
    showlegend: true,
  }, "nothing has happened yet");
}

function eventTrace(kind, events, now) {
  const seconds = (event) => Math.max((event.to ?? now) - event.from, 0);
  return {
    type: "bar",
    orientation: "h",
    name: EVENT_NAMES[kind] ?? kind,
    base: events.map((event) => localTime(event.from)),
    x: events.map((event) => seconds(event) * 1000),
    y: events.map(() => LANES[kind]),
    width: 0.7,
    marker: {
      color: colour(EVENT_KINDS[kind]),
      line: { color: colour(EVENT_KINDS[kind]), width: 1 }, // keeps short events visible
      pattern: { shape: HATCHED[kind] ?? "", fillmode: "overlay", fgcolor: colour("card") },
    },
    hovertext: events.map((event) => plain(`${event.text}: ${dateTime(event.from)}, ${seconds(event).toFixed(1)} s`)),
    hoverinfo: "text",
  };
}

/** Show one layer of the map from above. */
export function showMap(run) {
  const map = run.map;
  const layer = byId("layer").value;
  const place = map ? map.names.indexOf(layer) : -1;
  const [title, factor] = MAP_UNITS[layer] ?? [`${layer}, m`, 1];
  const cells = place < 0 ? [] : cellsOf(map, place, factor);
  const known = cells.flat().filter((value) => value !== null).sort((a, b) => a - b);
  const trace = {
    type: "heatmap",
    x0: map ? map.origin_m[0] + map.cell_m / 2 : 0,
    dx: map?.cell_m,
    y0: map ? map.origin_m[1] + map.cell_m / 2 : 0,
    dy: map?.cell_m,
    z: cells,
    zmin: known[Math.floor(0.02 * known.length)], // quantiles, so that outliers do not determine the colour scale
    zmax: known[Math.floor(0.98 * known.length)],
    colorscale: "Viridis",
    colorbar: { title: { text: title, side: "right" }, thickness: 12 },
    hovertemplate: `x %{x:.2f} m, y %{y:.2f} m: %{z:.3g}<extra></extra>`,
  };
  const layout = { xaxis: axis("x, m"), yaxis: axis("y, m", { scaleanchor: "x" }) };
  draw("map-plot", known.length ? [trace] : [], layout, map ? `no ${layer} in this map` : "no map yet");
  const thinned = map?.every > 1 ? `, each of ${map.every} × ${map.every} cells of the map` : "";
  setText(byId("map-note"), known.length ? `${known.length} cells of ${length(map.cell_m)}${thinned}; stamp ${map.stamp_ns}` : "");
}

function cellsOf(map, place, factor) {
  const { rows, columns, names, values } = map;
  return Array.from({ length: rows }, (_, row) => Array.from({ length: columns }, (_, column) => {
    const value = values[(row * columns + column) * names.length + place];
    return Number.isFinite(value) ? value * factor : null;
  }));
}

/** Show time and memory of each call, with their limits. */
export function showCalls(run) {
  const limits = (run.report?.limits ?? []).filter((limit) => !limit.is_of_target);
  const times = [
    ...Object.keys(NODES).map((node) => callTrace(run.calls, node, "processing_time_s", 1000, "")),
    callTrace(run.calls, "localisation_node", "latency_transport_s", 1000, ", transport", "dot"),
    callTrace(run.calls, "localisation_node", "latency_receive_to_publish_s", 1000, ", receipt to result", "dash"),
  ];
  drawCalls("time-plot", times, limits.filter((limit) => limit.subject === "timing"), 1000, "time per call, ms");
  const memory = Object.keys(NODES).map((node) => callTrace(run.calls, node, "memory_bytes", 2 ** -20, ""));
  drawCalls("memory-plot", memory, limits.filter((limit) => limit.figure === "peak"), 2 ** -20, "peak memory, MiB");
}

function callTrace(calls, node, figure, factor, suffix, dash = "solid") {
  const [name, fill] = NODES[node];
  const own = calls.filter((call) => call.node === node && Number.isFinite(call[figure]));
  return {
    name: name + suffix,
    mode: node === "mapping_node" ? "markers" : "lines",
    line: { color: colour(fill), width: 1.5, dash },
    marker: { color: colour(fill), size: 6 },
    x: own.map((call) => localTime(call.received_s)),
    y: own.map((call) => call[figure] * factor),
  };
}

function drawCalls(id, traces, limits, factor, title) {
  const shown = traces.filter((trace) => trace.x.length);
  const xs = shown.flatMap((trace) => trace.x).sort();
  if (xs.length) shown.push(...limits.map((limit) => limitLine(xs, limit.bound * factor, fitting(id, `limit of ${limit.name}`, LEGEND_LINE_PX))));
  const scale = scaleOf(shown.flatMap((trace) => trace.y));
  draw(id, shown, { xaxis: timeAxis(id), yaxis: axis(title, scale), showlegend: true, plotHeight: 200 }, "no call yet");
}

