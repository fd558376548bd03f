// Time per call, transport latency, receipt to result and memory: one plot each.

import { byId, clockTime } from "./dom.js";
import { drawPlot } from "./plot.js";

const SERIES = [["localisation_node", "localisation", "estimate"], ["mapping_node", "mapping", "under"]];

/** Show the calls of a moment: over the time of day, those of a recording over their stamps. */
export function showCalls(calls, recorded) {
  const first = calls.length ? Number(calls[0].stamp_ns) : 0;
  const timeOf = recorded ? (call) => (Number(call.stamp_ns) - first) / 1e9 : (call) => call.received_s;
  const draw = (...plot) => drawCalls(calls, timeOf, recorded, ...plot);
  draw("time-canvas", "processing_time_s", 1e3, "ms");
  draw("transport-canvas", "latency_transport_s", 1e3, "ms");
  draw("receive-canvas", "latency_receive_to_publish_s", 1e3, "ms");
  draw("memory-canvas", "memory_bytes", 1 / 2 ** 20, "MiB");
}

function drawCalls(calls, timeOf, recorded, id, name, factor, unit) {
  const series = SERIES.map(([node, label, colour]) => ({
    name: label,
    colour,
    dots: label === "mapping",
    points: calls.filter((call) => call.node === node && Number.isFinite(call[name])).map((call) => [timeOf(call), call[name] * factor]),
  })).filter((item) => item.points.length);
  drawPlot(byId(id), { series, x: recorded ? "s" : "time of day", y: unit, tick: recorded ? undefined : clockTime, empty: "no call yet" });
}
