// The path from above: estimate, truth, error enlarged, 3-sigma ellipse, the sub-trajectory under way; error over distance.

import { byId, colour, element, fitted, length, setText, short } from "./dom.js";
import { drawPlot, ticks } from "./plot.js";
import { label } from "./view.js";

const MARGIN = 42;
const FOLLOW_M = 6;
const ERROR_LINES = 120, REACH = 30;
let lastFacts = "";

/** Show the path of a moment. */
export function showPath(moment, view) {
  const rows = moment.rows.slice(0, moment.rowCount);
  drawTop(rows, moment.underWay, view);
  showFacts(rows);
}

/** Show the errors that are judged, with their limits, and the sub-trajectory under way. */
export function showError(moment, view) {
  drawError(moment.rows.slice(0, moment.rowCount), moment.report?.limits ?? [], moment.underWay, view);
  showUnderWay(moment.underWay);
}

function drawTop(rows, underWay, pointed) {
  const canvas = byId("path-canvas"), { context, width, height } = fitted(canvas);
  canvas.dataset.poses = String(rows.length);
  context.font = "11px system-ui, sans-serif";
  if (!rows.length) {
    context.fillStyle = colour("muted");
    context.textAlign = "center";
    context.fillText("no pose yet", width / 2, height / 2);
    return;
  }
  const view = viewOf(rows, width, height, pointed);
  drawGrid(context, view, width, height);
  const gain = gainOf(rows, view);
  setText(byId("gain-text"), gain ? `× ${short(gain)}` : "");
  const start = underWay ? rows.findIndex((row) => row.n >= underWay.start_n) : -1;
  if (start >= 0) trace(context, rows.slice(start).filter((row) => row.truth), (row) => row.truth, view, colour("under"), 7, []);
  drawErrors(context, rows, view, gain);
  trace(context, rows, (row) => row.at, view, colour("estimate"), 3, []);
  trace(context, rows.filter((row) => row.truth), (row) => row.truth, view, colour("truth"), 1.2, [4, 6]);
  drawMarks(context, rows, view);
  if (pointed.pointer) drawPointed(context, rows, view, pointed.pointer, width);
}

/** Write where the pose nearest to the pointer is, and its error. */
function drawPointed(context, rows, view, [x, y], width) {
  const far = (row) => Math.hypot(view.to(row.at)[0] - x, view.to(row.at)[1] - y);
  const near = rows.reduce((best, row) => (far(row) < far(best) ? row : best));
  if (far(near) > REACH) return;
  const error = near.error ? `, error ${length(Math.hypot(...near.error))}` : "";
  context.fillStyle = colour("text");
  context.beginPath(), context.arc(...view.to(near.at), 4, 0, 7), context.fill();
  const text = `pose ${near.n + 1}${near.lost ? " (lost)" : ""}: ${near.at.map((value) => value.toFixed(2)).join(", ")} m${error}`;
  label(context, view.to(near.at), text, width, { text: colour("text"), card: colour("card") });
}

/** Return the range of values without what lies far outside of the most of them. */
function usual(values) {
  const sorted = Float64Array.from(values).sort(), cut = sorted.length < 10 ? 0 : Math.max(Math.floor(sorted.length / 50), 1);
  const low = sorted[cut], high = sorted[sorted.length - 1 - cut], spare = (high - low) / 2;
  return [Math.max(sorted[0], low - spare), Math.min(sorted.at(-1), high + spare)];
}

function viewOf(rows, width, height, pointed) {
  const points = rows.map((row) => row.at).concat(rows.flatMap((row) => (row.truth ? [row.truth] : [])));
  let [left, right] = usual(points.map((point) => point[0])), [low, high] = usual(points.map((point) => point[1]));
  if (byId("follow").checked) {
    const [x, y] = rows.at(-1).at;
    [left, right, low, high] = [x - FOLLOW_M / 2, x + FOLLOW_M / 2, y - FOLLOW_M / 2, y + FOLLOW_M / 2];
  }
  const scale = Math.min((width - 2 * MARGIN) / Math.max(right - left, 0.2), (height - 2 * MARGIN) / Math.max(high - low, 0.2));
  const middle = [(left + right) / 2, (low + high) / 2], zoomed = scale * pointed.zoom;
  const seen = [middle[0] - pointed.x / zoomed, middle[1] + pointed.y / zoomed];
  return { scale: zoomed, middle: seen, to: ([x, y]) => [width / 2 + (x - seen[0]) * zoomed, height / 2 - (y - seen[1]) * zoomed] };
}

function drawGrid(context, view, width, height) {
  const half = [width / 2 / view.scale, height / 2 / view.scale], [x0, y0] = view.middle;
  context.strokeStyle = colour("grid");
  context.fillStyle = colour("muted");
  context.lineWidth = 1;
  const step = ticks(0, Math.max(half[0], half[1]) * 2, 8)[1] ?? 1;
  context.textAlign = "center";
  for (const x of ticks(x0 - half[0], x0 + half[0], (2 * half[0]) / step + 1)) {
    const [at] = view.to([x, 0]);
    context.beginPath(), context.moveTo(at, 0), context.lineTo(at, height), context.stroke();
    if (at > 36 && at < width - 46) context.fillText(`${short(x)}`, at, height - 4);
  }
  context.textAlign = "left";
  for (const y of ticks(y0 - half[1], y0 + half[1], (2 * half[1]) / step + 1)) {
    const [, at] = view.to([0, y]);
    context.beginPath(), context.moveTo(0, at), context.lineTo(width, at), context.stroke();
    if (at > 14 && at < height - 16) context.fillText(`${short(y)}`, 3, at - 3);
  }
  context.textAlign = "right";
  context.fillText("x, m", width - 4, height - 4);
  context.textAlign = "left";
  context.fillText("y, m", 3, 11);
}

/** Return by how much the error is enlarged: as chosen, or so that the largest is an eighth of the view. */
function gainOf(rows, view) {
  const chosen = Number(byId("gain").value);
  if (chosen) return chosen;
  const [, largest] = rows.some((row) => row.error) ? usual(rows.flatMap((row) => (row.error ? [Math.hypot(row.error[0], row.error[1])] : []))) : [0, 0];
  if (!largest) return 0;
  const wanted = 60 / view.scale / largest, power = 10 ** Math.floor(Math.log10(wanted));
  return Math.max([5, 2, 1].find((factor) => factor * power <= wanted) * power, 1);
}

function trace(context, rows, pointOf, view, style, width, dash) {
  context.strokeStyle = style;
  context.lineWidth = width;
  context.lineJoin = context.lineCap = "round";
  context.setLineDash(dash);
  context.beginPath();
  rows.forEach((row, place) => (place ? context.lineTo(...view.to(pointOf(row))) : context.moveTo(...view.to(pointOf(row)))));
  context.stroke();
  context.setLineDash([]);
}

function drawErrors(context, rows, view, gain) {
  const every = Math.max(Math.ceil(rows.length / ERROR_LINES), 1);
  context.strokeStyle = colour("error");
  context.lineWidth = 1;
  context.beginPath();
  rows.forEach((row, place) => {
    if (!row.error || !gain || (place % every && place !== rows.length - 1)) return;
    context.moveTo(...view.to(row.truth));
    context.lineTo(...view.to([row.truth[0] + gain * row.error[0], row.truth[1] + gain * row.error[1]]));
  });
  context.stroke();
}

function drawMarks(context, rows, view) {
  context.fillStyle = colour("lost");
  for (const row of rows) if (row.lost) {
    const [x, y] = view.to(row.at);
    context.fillRect(x - 3, y - 3, 6, 6);
  }
  const last = rows.at(-1), [x, y] = view.to(last.at);
  if (last.covariance) drawEllipse(context, last.covariance, x, y, view.scale);
  context.fillStyle = colour(last.lost ? "lost" : "estimate");
  context.beginPath(), context.arc(x, y, 5, 0, 2 * Math.PI), context.fill();
}

/** Draw the 3-sigma ellipse of a covariance [xx, yy, xy], enlarged as needed to be seen; the factor is written beside. */
function drawEllipse(context, [xx, yy, xy], x, y, scale) {
  const mean = (xx + yy) / 2, root = Math.hypot((xx - yy) / 2, xy);
  const axes = [mean + root, Math.max(mean - root, 0)].map((variance) => 3 * Math.sqrt(variance) * scale);
  const gain = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].find((factor) => axes[0] * factor >= 14) ?? 1000;
  const angle = -0.5 * Math.atan2(2 * xy, xx - yy);
  context.beginPath();
  context.ellipse(x, y, axes[0] * gain, Math.max(axes[1] * gain, 0.5), angle, 0, 2 * Math.PI);
  context.fillStyle = colour("ellipse");
  context.fill();
  context.strokeStyle = colour("estimate");
  context.lineWidth = 1;
  context.stroke();
  if (gain > 1) {
    context.fillStyle = colour("muted");
    const right = x + 100 < context.canvas.clientWidth;
    context.textAlign = right ? "left" : "right";
    context.fillText(`3 sigma × ${gain}`, right ? x + 12 : x - 12, y - axes[0] * gain - 4 > 12 ? y - axes[0] * gain - 4 : y + 16);
  }
}

function drawError(rows, limits, underWay, view) {
  const judged = rows.filter((row) => row.judged !== null), sigma = judged.filter((row) => row.judgedSigma !== null);
  const series = [{ name: "error of a sub-trajectory", colour: "error", dots: judged.length < 60, points: judged.map((row) => [row.distance, row.judged * 1000]) }];
  series.push({ name: "3 sigma, growth of the covariance", colour: "estimate", points: sigma.map((row) => [row.distance, 3000 * row.judgedSigma]) });
  const on = limits.filter((limit) => limit.metric.startsWith("position_") && (!underWay || limit.over === underWay.condition));
  const marks = on.map((limit) => ({ y: limit.bound * 1000, name: `limit of ${limit.name}: ${limit.limit}` }));
  for (const limit of on.filter((item) => item.share && item.share < 10)) marks.push({ y: limit.share * limit.bound * 1000, name: `${limit.name}: ${limit.value}`, colour: "muted", dash: [2, 3] });
  const none = rows.some((row) => row.truth) ? "no sub-trajectory has ended yet" : "no truth: the error is not known";
  drawPlot(byId("error-canvas"), { series: series.filter((item) => item.points.length), marks, view, x: "path travelled, m", y: "mm", empty: rows.length ? none : "no pose yet" });
}

function showUnderWay(underWay) {
  byId("under-progress").value = underWay?.progress ?? 0;
  const text = underWay
    ? `${Math.round(underWay.progress * 100)} % of ${underWay.condition}, error now ${length(Math.hypot(...underWay.error))}`
    : "none";
  setText(byId("under-text"), text);
}

function showFacts(rows) {
  const last = rows.at(-1);
  const facts = last ? [
    ["poses", String(last.n + 1)],
    ["path travelled", `${last.distance.toFixed(2)} m`],
    ["position", last.at.map((value) => value.toFixed(2)).join(", ") + " m"],
    ["error now", last.error ? length(Math.hypot(...last.error)) : "no truth"],
    ["sigma (x, y)", last.covariance ? length(Math.sqrt(last.covariance[0] + last.covariance[1])) : "not known"],
  ] : [];
  const text = JSON.stringify(facts);
  if (text === lastFacts) return;
  lastFacts = text;
  byId("path-facts").replaceChildren(...facts.map(([name, value]) => element("div", "", "", element("dt", "", name), element("dd", "", value))));
}
