// Plots of lines over one axis, on a canvas; those of the calls: time, transport latency, receipt to result, memory.

import { byId, clockTime, colour, fitted, short } from "./dom.js";

const SERIES = [["localisation_node", "localisation", "estimate"], ["mapping_node", "mapping", "under"]];
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
 * Draw series of points [x, y].
 * `plot`: {series: [{name, colour, points, dots}], x: "distance, m", y: "error, mm", marks: [{y, name}], empty}
 */
export function drawPlot(canvas, plot) {
  const { context, width, height } = fitted(canvas);
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
  const top = Math.max(...points.map((point) => point[1]), ...(plot.marks ?? []).map((mark) => mark.y)) * 1.08 || 1;
  const across = (x) => LEFT + ((x - low) / (high - low)) * (width - LEFT - RIGHT);
  const up = (y) => height - BOTTOM - (y / top) * (height - TOP - BOTTOM);
  axes(context, width, height, plot, { low, high, top, across, up });
  for (const series of plot.series) drawSeries(context, series, across, up);
  if (plot.series.length > 1) legend(context, plot.series, width);
}

function axes(context, width, height, plot, scale) {
  context.strokeStyle = colour("grid");
  context.fillStyle = colour("muted");
  context.lineWidth = 1;
  context.textAlign = "right";
  for (const y of ticks(0, scale.top, 4)) {
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
