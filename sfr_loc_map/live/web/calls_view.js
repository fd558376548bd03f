// Time per call, transport latency, receipt to result and memory: one plot each.

import { byId, clockTime } from "./dom.js";
import { drawPlot } from "./plot.js";

const SERIES = [["localisation_node", "localisation", "estimate"], ["mapping_node", "mapping", "under"]];

/** Show the calls of a moment. */
export function showCalls(calls) {
  draw("time-canvas", calls, "processing_time_s", 1e3, "ms");
  draw("transport-canvas", calls, "latency_transport_s", 1e3, "ms");
  draw("receive-canvas", calls, "latency_receive_to_publish_s", 1e3, "ms");
  draw("memory-canvas", calls, "memory_bytes", 1 / 2 ** 20, "MiB");
}

function draw(id, calls, name, factor, unit) {
  const series = SERIES.map(([node, label, colour]) => ({
    name: label,
    colour,
    dots: label === "mapping",
    points: calls.filter((call) => call.node === node && Number.isFinite(call[name])).map((call) => [call.received_s, call[name] * factor]),
  })).filter((item) => item.points.length);
  drawPlot(byId(id), { series, x: "time of day", y: unit, tick: clockTime, empty: "no call yet" });
}
