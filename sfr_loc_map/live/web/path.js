// The path from above.

import { byId, element, length, position, short } from "./dom.js";
import { axis, colour, draw } from "./plots.js";

const ERROR_LINES = 120; // maximum number of drawn errors, evenly spread over the path
const ERROR_SHARE = 0.12; // length of the largest drawn error, as a fraction of the extent
const ELLIPSE_POINTS = 48;

/** Show estimate and truth from above, x to the right and y up, with enlarged errors and last covariance. */
export function showPath(run) {
  const poses = run.poses;
  const withTruth = poses.filter((pose) => pose.truth_m);
  const lost = poses.filter((pose) => pose.lost);
  const extent = extentOf(poses);
  const gain = gainOf(largestError(poses), extent);
  const ellipseGain = gainOf(3 * largestSigma(run.lastPose), extent);
  const ellipse = ellipseOf(run.lastPose, 3 * ellipseGain);
  const estimate = line("estimate", positions(poses), { color: colour("estimate"), width: 2.5 });
  const traces = [
    line(`error × ${short(gain)}`, errorLines(poses, gain), { color: colour("error"), width: 1 }),
    { ...estimate, text: poses.map(describe), hoverinfo: "text" },
    line("truth", withTruth.map((pose) => pose.truth_m), { color: colour("truth"), width: 1.5, dash: "dot" }),
    line(`3 sigma × ${short(ellipseGain)}`, ellipse, { color: colour("estimate"), width: 1 }),
    dots("lost", positions(lost), colour("lost"), "x"),
    dots("last pose", positions(poses.slice(-1)), colour("estimate"), "circle"),
  ];
  const layout = { xaxis: axis("x, m"), yaxis: axis("y, m", { scaleanchor: "x" }) };
  draw("path-plot", traces.filter((trace) => trace.x.length), layout, run.missing("no pose was received"));
  showFacts(run);
}

const positions = (poses) => poses.map((pose) => pose.position_m);
const coordinates = (points) => ({ x: points.map((point) => point[0]), y: points.map((point) => point[1]) });

function line(name, points, style) {
  return { name, mode: "lines", line: style, hoverinfo: "skip", ...coordinates(points) };
}

function dots(name, points, fill, symbol) {
  const marker = { color: fill, size: 9, symbol };
  return { name, mode: "markers", marker, hoverinfo: "skip", ...coordinates(points) };
}

/** Return the largest horizontal error of the poses that are not lost, m. */
function largestError(poses) {
  const known = poses.filter((pose) => pose.error_m && !pose.lost);
  return known.reduce((largest, { error_m: [x, y] }) => Math.max(largest, Math.hypot(x, y)), 0);
}

/** Return the larger standard deviation of x and y, m; 0 if unknown. */
function largestSigma(pose) {
  if (!pose?.covariance_xy_m2) return 0;
  const [xx, yy] = pose.covariance_xy_m2;
  return Math.sqrt(Math.max(xx, yy));
}

function describe(pose) {
  const error = pose.error_m ? `, error ${length(Math.hypot(...pose.error_m))}` : "";
  return `pose ${pose.n + 1}${pose.lost ? " (lost)" : ""}: ${position(pose.position_m)}${error}`;
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

/** Return enlarged lines from truth to estimate, separated by gaps. A truth that the monitor converts has no error. */
function errorLines(poses, gain) {
  const known = poses.filter((pose) => pose.error_m);
  const every = Math.max(Math.ceil(known.length / ERROR_LINES), 1);
  const shown = known.filter((_, place) => place % every === 0 || place === known.length - 1);
  const endOf = ({ truth_m: truth, error_m: error }) => [truth[0] + gain * error[0], truth[1] + gain * error[1]];
  return shown.flatMap((pose) => [pose.truth_m, endOf(pose), [null, null]]);
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
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  const [x, y] = pose.position_m;
  return Array.from({ length: ELLIPSE_POINTS + 1 }, (_, place) => {
    const turn = (2 * Math.PI * place) / ELLIPSE_POINTS;
    const along = major * Math.cos(turn);
    const across = minor * Math.sin(turn);
    return [x + along * cos - across * sin, y + along * sin + across * cos];
  });
}

function showFacts(run) {
  const facts = run.lastPose ? factsOf(run.lastPose, run.beforeM) : [];
  const boxOf = ([name, text]) => element("div", {}, element("dt", { text: name }), element("dd", { text }));
  byId("path-facts").replaceChildren(...facts.map(boxOf));
}

function factsOf(pose, beforeM) {
  const { covariance_xy_m2: covariance, error_m: error } = pose;
  const whyUnknown = pose.truth_m ? "unknown: the monitor converts the truth" : "no truth";
  return [
    ["poses", String(pose.n + 1)],
    ["path travelled", `${(beforeM + pose.distance_m).toFixed(2)} m`],
    ["position", position(pose.position_m)],
    ["error now", error ? length(Math.hypot(...error)) : whyUnknown],
    ["sigma (x, y)", covariance ? length(Math.sqrt(covariance[0] + covariance[1])) : "unknown"],
  ];
}
