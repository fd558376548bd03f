// The path from above, and the judged position errors.

import { byId, element, length, short } from "./dom.js";
import { LEGEND_LINE_PX, axis, colour, draw, fitting, limitLine, scaleOf } from "./plots.js";

const ERROR_LINES = 120; // maximum number of drawn errors, evenly spread over the path
const ERROR_SHARE = 0.12; // length of the largest drawn error, as a fraction of the extent
const ELLIPSE_POINTS = 48;

/** Show estimate and truth from above, x to the right and y up, with enlarged errors and last covariance. */
export function showPath(run) {
  const poses = run.poses;
  const withTruth = poses.filter((pose) => pose.truth_m);
  const extent = extentOf(poses);
  const errors = poses.filter((pose) => pose.error_m && !pose.lost).map((pose) => Math.hypot(pose.error_m[0], pose.error_m[1]));
  const gain = gainOf(errors.reduce((a, b) => Math.max(a, b), 0), extent);
  const sigma = run.lastPose?.covariance_xy_m2 ? Math.sqrt(Math.max(...run.lastPose.covariance_xy_m2.slice(0, 2))) : 0;
  const ellipseGain = gainOf(3 * sigma, extent);
  const traces = [
    line(`error × ${short(gain)}`, errorLines(withTruth, gain), { color: colour("error"), width: 1 }),
    line("estimate", poses.map((pose) => pose.position_m), { color: colour("estimate"), width: 2.5 }, poses.map(describe)),
    line("truth", withTruth.map((pose) => pose.truth_m), { color: colour("truth"), width: 1.5, dash: "dot" }),
    line(`3 sigma × ${short(ellipseGain)}`, ellipseOf(run.lastPose, 3 * ellipseGain), { color: colour("estimate"), width: 1 }),
    dots("lost", poses.filter((pose) => pose.lost).map((pose) => pose.position_m), colour("lost"), "x"),
    dots("last pose", poses.slice(-1).map((pose) => pose.position_m), colour("estimate"), "circle"),
  ].filter((trace) => trace.x.length);
  const layout = { xaxis: axis("x, m"), yaxis: axis("y, m", { scaleanchor: "x" }) };
  draw("path-plot", traces, layout, "no pose yet");
  showFacts(run);
}

function line(name, points, style, texts = null) {
  const trace = { name, mode: "lines", line: style, x: points.map((point) => point[0]), y: points.map((point) => point[1]) };
  return texts ? { ...trace, text: texts, hoverinfo: "text" } : { ...trace, hoverinfo: "skip" };
}

function dots(name, points, fill, symbol) {
  const marker = { color: fill, size: 9, symbol };
  return { name, mode: "markers", marker, hoverinfo: "skip", x: points.map((point) => point[0]), y: points.map((point) => point[1]) };
}

function describe(pose) {
  const position = pose.position_m.map((value) => value.toFixed(2)).join(", ");
  const error = pose.error_m ? `, error ${length(Math.hypot(...pose.error_m))}` : "";
  return `pose ${pose.n + 1}${pose.lost ? " (lost)" : ""}: ${position} m${error}`;
}

/** Return the larger side of the rectangle around the path, at least one metre. */
function extentOf(poses) {
  const sides = [0, 1].map((place) => {
    const values = poses.map((pose) => pose.position_m[place]);
    return values.reduce((a, b) => Math.max(a, b), -Infinity) - values.reduce((a, b) => Math.min(a, b), Infinity);
  });
  return Math.max(...sides, 1);
}

/** Return the factor, 1, 2 or 5 times a power of ten, by which a length is enlarged for a path of an extent. */
function gainOf(size, extent) {
  if (!size) return 1;
  const wanted = (ERROR_SHARE * extent) / size;
  const power = 10 ** Math.floor(Math.log10(wanted));
  return Math.max([5, 2, 1].find((factor) => factor * power <= wanted) * power, 1);
}

/** Return enlarged lines from truth to estimate, separated by gaps. */
function errorLines(poses, gain) {
  const every = Math.max(Math.ceil(poses.length / ERROR_LINES), 1);
  return poses
    .filter((_, place) => place % every === 0 || place === poses.length - 1)
    .flatMap(({ truth_m: truth, error_m: error }) => [truth, [truth[0] + gain * error[0], truth[1] + gain * error[1]], [null, null]]);
}

/** Return the ellipse of a pose's covariance at a number of standard deviations. */
function ellipseOf(pose, deviations) {
  if (!pose?.covariance_xy_m2) return [];
  const [xx, yy, xy] = pose.covariance_xy_m2;
  const mean = (xx + yy) / 2;
  const root = Math.hypot((xx - yy) / 2, xy);
  const major = deviations * Math.sqrt(mean + root);
  const minor = deviations * Math.sqrt(Math.max(mean - root, 0));
  const angle = 0.5 * Math.atan2(2 * xy, xx - yy);
  return Array.from({ length: ELLIPSE_POINTS + 1 }, (_, place) => {
    const turn = (2 * Math.PI * place) / ELLIPSE_POINTS;
    const [along, across] = [major * Math.cos(turn), minor * Math.sin(turn)];
    const [x, y] = pose.position_m;
    return [x + along * Math.cos(angle) - across * Math.sin(angle), y + along * Math.sin(angle) + across * Math.cos(angle)];
  });
}

function showFacts(run) {
  const last = run.lastPose;
  const facts = !last ? [] : [
    ["poses", String(last.n + 1)],
    ["path travelled", `${(run.beforeM + last.distance_m).toFixed(2)} m`],
    ["position", `${last.position_m.map((value) => value.toFixed(2)).join(", ")} m`],
    ["error now", last.error_m ? length(Math.hypot(...last.error_m)) : "no truth"],
    ["sigma (x, y)", last.covariance_xy_m2 ? length(Math.sqrt(last.covariance_xy_m2[0] + last.covariance_xy_m2[1])) : "unknown"],
  ];
  byId("path-facts").replaceChildren(...facts.map(([name, value]) => element("div", "", "", element("dt", "", name), element("dd", "", value))));
}

/** Show the position error of each sub-trajectory of the monitor's report, with its limits. */
export function showError(run) {
  const errors = run.report?.errors;
  const frames = errors?.end_frame ?? [];
  const limits = (run.report?.limits ?? []).filter((limit) => limit.figure === "position" && limit.condition === errors?.condition);
  const traces = frames.length ? [
    {
      name: `error over ${errors.over}`,
      mode: frames.length < 60 ? "lines+markers" : "lines",
      line: { color: colour("error"), width: 1.5 },
      x: frames,
      y: errors.position_m.map((value) => (value === null ? null : value * 1000)),
    },
    ...limits.map((limit) => limitLine(frames, limit.bound * 1000, fitting("error-plot", `limit ${limit.limit} of ${limit.name}`, LEGEND_LINE_PX))),
  ] : [];
  const scale = scaleOf(traces.flatMap((trace) => trace.y));
  const layout = { xaxis: axis("frame at the end"), yaxis: axis("position error, mm", scale) };
  const hasTruth = run.poses.some((pose) => pose.truth_m);
  const waiting = hasTruth ? "no sub-trajectory has ended yet" : "no ground truth: the error is unknown";
  draw("error-plot", traces, layout, run.poses.length ? waiting : "no pose yet");
}
