// Time and memory of the calls of localiser and mapper, with their limits.

import { localTime } from "./dom.js";
import { LEGEND_LINE_PX, axis, colour, draw, fitting, limitLine, scaleOf, timeAxis } from "./plots.js";

const LOCALISATION = { node: "localisation_node", name: "localisation", fill: "estimate", mode: "lines" };
const MAPPING = { node: "mapping_node", name: "mapping", fill: "under", mode: "markers" }; // calls are rare
const RESULT_LATENCY = "latency_receive_to_publish_s";
const MILLISECONDS = 1000;
const MEBIBYTES = 2 ** -20;

/** Show the plots of time and memory. */
export function showCalls(run) {
  const limits = (run.score?.limits ?? []).filter((limit) => !limit.is_of_target);
  const empty = run.missing("no call was received");
  const trace = (...what) => traceOf(run.calls, ...what);
  drawPlot({
    id: "time-plot",
    title: "time per call, ms",
    factor: MILLISECONDS,
    empty,
    limits: limits.filter((limit) => limit.subject === "timing"),
    traces: [
      trace(LOCALISATION, "processing_time_s", MILLISECONDS),
      trace(MAPPING, "processing_time_s", MILLISECONDS),
      trace(LOCALISATION, "latency_transport_s", MILLISECONDS, { suffix: ", transport", dash: "dot" }),
      trace(LOCALISATION, RESULT_LATENCY, MILLISECONDS, { suffix: ", receipt to result", dash: "dash" }),
    ],
  });
  drawPlot({
    id: "memory-plot",
    title: "peak memory, MiB",
    factor: MEBIBYTES,
    empty,
    limits: limits.filter((limit) => limit.figure === "peak"),
    traces: [trace(LOCALISATION, "memory_bytes", MEBIBYTES), trace(MAPPING, "memory_bytes", MEBIBYTES)],
  });
}

/** Return a field of the calls of a task over the time of their reception, multiplied by `factor`. */
function traceOf(allCalls, task, field, factor, { suffix = "", dash = "solid" } = {}) {
  const calls = allCalls.filter((call) => call.node === task.node && Number.isFinite(call[field]));
  return {
    name: task.name + suffix,
    mode: task.mode,
    line: { color: colour(task.fill), width: 1.5, dash },
    marker: { color: colour(task.fill), size: 6 },
    x: calls.map((call) => localTime(call.received_s)),
    y: calls.map((call) => call[field] * factor),
  };
}

function drawPlot({ id, title, factor, limits, traces, empty }) {
  const shown = traces.filter((trace) => trace.x.length);
  const times = shown.flatMap((trace) => trace.x).sort();
  if (times.length) {
    const nameOf = (limit) => fitting(id, `limit of ${limit.name}`, LEGEND_LINE_PX);
    shown.push(...limits.map((limit) => limitLine(times, limit.bound * factor, nameOf(limit))));
  }
  const scale = scaleOf(shown.flatMap((trace) => trace.y));
  const layout = { xaxis: timeAxis(id), yaxis: axis(title, scale), showlegend: true, plotHeight: 200 };
  draw(id, shown, layout, empty);
}
