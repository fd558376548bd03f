// Plots of lines over one axis, on a canvas; those of the calls: time, transport latency, receipt to result, memory.

import { byId, clockTime, colour, fitted, short } from "./dom.js";
import { label } from "./view.js";

const SERIES = [["localisation_node", "localisation", "estimate"], ["mapping_node", "mapping", "under"]];
const FAR = 6;
const LEFT = 58, RIGHT = 26, TOP = 8, BOTTOM = 30;

/** Return round numbers that divide a range into about `count` parts. */
export function ticks(low, high, count) {
  const step = 10 ** Math.floor(Math.log10((high - low) / count || 1));
  const size = [1, 2, 5, 10].map((factor) => factor * step).find((item) => (high - low) / item <= count) ?? step;
  const found = [];
  for (let value = Math.ceil(low / size) * size; value <= high + size * 1e-9; value += size) found.push(Number(value.toPrecision(12)));
  return found;
}

/**
 * Draw series of points [x, y], with a line for each mark. Where the largest is far beyond the usual the scale is
 * logarithmic, so that one slow call or a far limit does not flatten the rest.
 * `plot`: {series: [{name, colour, points, dots}], x: "distance, m", y: "error, mm", marks: [{y, name, colour}], empty}
 */
export function drawPlot(canvas, plot) {
  const { context, width, height } = fitted(canvas), marks = plot.marks ?? [];
  const points = plot.series.flatMap((series) => series.points);
  context.font = "11px system-ui, sans-serif";
  context.fillStyle = colour("muted");
  if (!points.length) {
    context.textAlign = "center";
    context.fillText(plot.empty ?? "no data yet", width / 2, height / 2);
    canvas.dataset.points = "0";
    return;
  }
  canvas.dataset.points = String(points.length);
  let [low, high] = extent(points.map((point) => point[0]));
  if (low === high) high = low + 1;
  const scale = scaleOf(points.map((point) => point[1]), marks.map((mark) => mark.y)), tall = height - TOP - BOTTOM;
  const across = (x) => LEFT + ((x - low) / (high - low)) * (width - LEFT - RIGHT);
  const up = (y) => height - BOTTOM - Math.min(Math.max(scale.share(y), 0), 1) * tall;
  axes(context, width, height, plot, { low, high, ticks: scale.ticks, across, up });
  for (const series of plot.series) drawSeries(context, series, across, up);
  for (const mark of marks) drawMark(context, mark, up(mark.y), width);
  if (plot.series.length > 1 || marks.length) legend(context, plot.series, width);
  canvas.dataset.marks = marks.map((mark) => mark.name).join("; ");
  if (plot.view?.pointer) drawPointed(context, plot, points, across, up, width);
}

/** Return the scale of values and marks: from 0, logarithmic where the largest is more than `FAR` times the median. */
function scaleOf(values, marks) {
  const known = values.filter((value) => value > 0).sort((a, b) => a - b), at = (share) => known[Math.floor(share * (known.length - 1))] ?? 1;
  const top = Math.max(Math.min(at(1), at(0.95) * 1e3), ...marks) * 1.15 || 1;
  if (top < FAR * at(0.5)) return { share: (y) => y / top, ticks: ticks(0, top, 4) };
  const low = Math.log10(at(0.02) / 1.5), long = (Math.log10(top) - low) * 1.12 || 1, powers = [];
  for (let power = Math.floor(low); power <= Math.log10(top); power++) for (const step of long < 1.5 ? [1, 2, 5] : [1]) powers.push(step * 10 ** power);
  return { share: (y) => (y > 0 ? (Math.log10(y) - low) / long : 0), ticks: powers.filter((y) => y >= 10 ** low && y <= top) };
}

function drawMark(context, mark, y, width) {
  context.strokeStyle = context.fillStyle = colour(mark.colour ?? "fail");
  context.lineWidth = 1.5;
  context.setLineDash(mark.dash ?? [7, 4]);
  line(context, LEFT, y, width - RIGHT, y);
  context.setLineDash([]);
  context.textAlign = "left";
  context.fillText(mark.name, LEFT + 6, y < TOP + 24 ? y + 13 : y - 4);
}

/** Write the value of the point nearest to the pointer. */
function drawPointed(context, plot, points, across, up, width) {
  const [x, y] = plot.view.pointer, far = (point) => Math.abs(across(point[0]) - x) + 0.3 * Math.abs(up(point[1]) - y);
  const near = points.reduce((best, point) => (far(point) < far(best) ? point : best));
  context.fillStyle = colour("text");
  context.beginPath(), context.arc(across(near[0]), up(near[1]), 4, 0, 7), context.fill();
  const unit = plot.x.split(", ")[1] ?? "";
  label(context, [across(near[0]), up(near[1])], `${plot.tick ? plot.tick(near[0]) : `${short(near[0])} ${unit}`}: ${short(near[1])} ${plot.y}`, width, { text: colour("text"), card: colour("card") });
}

function axes(context, width, height, plot, scale) {
  context.strokeStyle = colour("grid");
  context.fillStyle = colour("muted");
  context.lineWidth = 1;
  context.textAlign = "right";
  for (const y of scale.ticks) {
    line(context, LEFT, scale.up(y), width - RIGHT, scale.up(y));
    context.fillText(short(y), LEFT - 6, scale.up(y) + 4);
  }
  context.textAlign = "center";
  for (const x of ticks(scale.low, scale.high, Math.max(width / 90, 2))) context.fillText(plot.tick ? plot.tick(x) : short(x), scale.across(x), height - BOTTOM + 14);
  context.fillText(plot.x, LEFT + (width - LEFT - RIGHT) / 2, height - 4);
  context.save();
  context.translate(11, TOP + (height - TOP - BOTTOM) / 2);
  context.rotate(-Math.PI / 2);
  context.fillText(plot.y, 0, 0);
  context.restore();
}

function drawSeries(context, series, across, up) {
  context.strokeStyle = context.fillStyle = colour(series.colour);
  context.lineWidth = 1.5;
  if (series.dots) {
    for (const [x, y] of series.points) context.fillRect(across(x) - 2, up(y) - 2, 4, 4);
    return;
  }
  context.beginPath();
  series.points.forEach(([x, y], place) => (place ? context.lineTo(across(x), up(y)) : context.moveTo(across(x), up(y))));
  context.stroke();
}

function legend(context, series, width) {
  context.textAlign = "right";
  let right = width - RIGHT;
  for (const item of [...series].reverse()) {
    context.fillStyle = colour("text");
    context.fillText(item.name, right, TOP + 8);
    right -= context.measureText(item.name).width + 6;
    context.fillStyle = colour(item.colour);
    context.fillRect(right - 8, TOP, 8, 8);
    right -= 20;
  }
}

function line(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

/** Return the smallest and the largest of many values. */
export function extent(values) {
  let low = Infinity, high = -Infinity;
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return [low, high];
}

/** Show the calls of a moment with their limits over the time of day. */
export function showCalls(calls, limits, views) {
  const timeOf = (call) => call.received_s;
  const draw = (id, name, factor, unit, end) => {
    const on = limits.filter((limit) => end && limit.metric.endsWith(end) && !limit.metric.startsWith("target "));
    const marks = on.map((limit) => ({ y: limit.bound * factor, name: `limit of ${limit.name}` }));
    drawCalls(calls, timeOf, id, name, factor, unit, marks, views[id]);
  };
  draw("time-canvas", "processing_time_s", 1e3, "ms", "_s");
  draw("transport-canvas", "latency_transport_s", 1e3, "ms");
  draw("receive-canvas", "latency_receive_to_publish_s", 1e3, "ms");
  draw("memory-canvas", "memory_bytes", 1 / 2 ** 20, "MiB", "peak_bytes");
}

function drawCalls(calls, timeOf, id, name, factor, unit, marks, view) {
  const series = SERIES.map(([node, label, colour]) => ({
    name: label,
    colour,
    dots: label === "mapping",
    points: calls.filter((call) => call.node === node && Number.isFinite(call[name])).map((call) => [timeOf(call), call[name] * factor]),
  })).filter((item) => item.points.length);
  drawPlot(byId(id), { series, x: "time of day", y: unit, tick: clockTime, empty: "no call yet", marks, view });
}
