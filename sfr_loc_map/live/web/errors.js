// The judged position errors.

import { LEGEND_LINE_PX, axis, colour, draw, fitting, limitLine, scaleOf } from "./plots.js";

const PLOT = "errors-plot";
const MILLIMETRES = 1000;
const FEW = 60; // number of errors below which each is marked by a point

/** Show the position error of each sub-trajectory of the score of the monitor, with its limits. */
export function showErrors(run) {
  const errors = run.score?.errors ?? null;
  const limits = (run.score?.limits ?? []).filter((limit) => isOfErrors(limit, errors));
  const frames = errors?.end_frame ?? [];
  const traces = frames.length ? [errorLine(errors), ...limits.map((limit) => lineOf(limit, frames))] : [];
  const scale = scaleOf(traces.flatMap((trace) => trace.y));
  const layout = { xaxis: axis("frame at the end"), yaxis: axis("position error, mm", scale) };
  draw(PLOT, traces, layout, whyEmpty(run));
}

function isOfErrors(limit, errors) {
  return limit.figure === "position" && limit.condition === errors?.condition;
}

function errorLine(errors) {
  return {
    name: `error over ${errors.over}`,
    mode: errors.end_frame.length < FEW ? "lines+markers" : "lines",
    line: { color: colour("error"), width: 1.5 },
    x: errors.end_frame,
    y: errors.position_m.map((value) => (value === null ? null : value * MILLIMETRES)),
  };
}

function lineOf(limit, frames) {
  const name = fitting(PLOT, `limit ${limit.limit} of ${limit.name}`, LEGEND_LINE_PX);
  return limitLine(frames, limit.bound * MILLIMETRES, name);
}

function whyEmpty(run) {
  if (!run.poses.length) return run.missing("no pose was received");
  const hasTruth = run.poses.some((pose) => pose.truth_m);
  return hasTruth ? run.missing("no sub-trajectory has ended") : "no ground truth: the error is unknown";
}
