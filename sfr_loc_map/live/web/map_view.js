// The map from above: the cloud's points in cells, coloured by height, sigma, error or count.

import { drawScale, percentiles, shade } from "./colours.js";
import { byId, colour, fitted, length, setText, short } from "./dom.js";

const CELLS = 160;
let drawn = "";

/** Show the map of a moment. */
export function showMap(cloud, layer, theme) {
  const canvas = byId("map-canvas"), key = [cloud?.topic, cloud?.stamp_ns, cloud?.count, layer, theme, canvas.clientWidth].join(" ");
  if (key === drawn) return;
  drawn = key;
  const { context, width, height, ratio } = fitted(canvas);
  canvas.dataset.cells = "0";
  const cells = cloud && cloud.count ? cellsOf(cloud, layer, width / height) : null;
  if (!cells || !cells.filled) {
    context.fillStyle = colour("muted");
    context.textAlign = "center";
    context.fillText(cloud ? `no ${layer} in this cloud` : "no cloud yet", width / 2, height / 2);
    return;
  }
  canvas.dataset.cells = String(cells.filled);
  const [low, high] = paint(context, cells, width, height, ratio);
  axes(context, cells, width, height);
  const write = layer === "count" ? short : length;
  drawScale(context, width, height, write(low), write(high), colour("text"), colour("backing"));
  setText(byId("map-note"), `${cells.filled} cells of ${length(cells.size)}, ${layer} from ${write(low)} to ${write(high)}; ${countText(cloud)}, stamp ${cloud.stamp_ns}`);
}

/** Return how many points of how many are shown, in words. */
export function countText(cloud) {
  return cloud.count < cloud.total ? `${cloud.count} of ${cloud.total} points (thinned)` : `${cloud.count} points`;
}

/** Return the mean of a layer in cells over the middle of the cloud. */
function cellsOf(cloud, layer, aspect) {
  const { values, columns, count } = cloud, xs = new Float32Array(count), ys = new Float32Array(count);
  for (let i = 0; i < count; i++) [xs[i], ys[i]] = [values[i * columns], values[i * columns + 1]];
  const [left, right] = percentiles(xs, 2, 94), [low, high] = percentiles(ys, 3, 97);
  const size = Math.max((right - left) / CELLS, ((high - low) / CELLS) * aspect, 1e-3);
  const wide = Math.max(Math.ceil((right - left) / size), 1), tall = Math.max(Math.ceil((high - low) / size), 1);
  const sums = new Float64Array(wide * tall), counts = new Uint32Array(wide * tall);
  const column = { height: 2, sigma: 3, error: 4, count: 2 }[layer];
  let filled = 0;
  for (let i = 0; i < count && column < columns; i++) {
    const x = Math.floor((xs[i] - left) / size), y = Math.floor((ys[i] - low) / size), value = values[i * columns + column];
    if (x < 0 || y < 0 || x >= wide || y >= tall || !Number.isFinite(value)) continue;
    const cell = y * wide + x;
    if (!counts[cell]) filled += 1;
    sums[cell] += value;
    counts[cell] += 1;
  }
  const means = Float32Array.from(sums, (sum, cell) => (layer === "count" ? counts[cell] : sum / counts[cell]));
  return { means, counts, wide, tall, size, left, low, filled };
}

function paint(context, cells, width, height, ratio) {
  const known = cells.means.filter((value, cell) => cells.counts[cell]), [low, high] = percentiles(known, 2, 98);
  const image = new ImageData(cells.wide, cells.tall), span = high - low || 1;
  for (let y = 0; y < cells.tall; y++) for (let x = 0; x < cells.wide; x++) {
    const cell = y * cells.wide + x, at = 4 * ((cells.tall - 1 - y) * cells.wide + x);
    if (!cells.counts[cell]) continue;
    const [r, g, b] = shade((cells.means[cell] - low) / span);
    [image.data[at], image.data[at + 1], image.data[at + 2], image.data[at + 3]] = [r, g, b, 255];
  }
  const small = new OffscreenCanvas(cells.wide, cells.tall);
  small.getContext("2d").putImageData(image, 0, 0);
  const scale = Math.min(width / cells.wide, height / cells.tall);
  cells.scale = scale;
  cells.at = [(width - cells.wide * scale) / 2, (height - cells.tall * scale) / 2];
  context.imageSmoothingEnabled = false;
  context.drawImage(small, ...cells.at, cells.wide * scale, cells.tall * scale);
  return [low, high];
}

function axes(context, cells, width, height) {
  const [left, top] = cells.at, metre = cells.scale / cells.size, bar = [0.1, 0.5, 1, 2, 5, 10, 20, 50].find((size) => size * metre > 50) ?? 50;
  context.fillStyle = colour("backing");
  context.fillRect(4, height - 32, bar * metre + 12, 28);
  context.strokeStyle = context.fillStyle = colour("text");
  context.font = "11px system-ui, sans-serif";
  context.lineWidth = 2;
  context.beginPath(), context.moveTo(10, height - 12), context.lineTo(10 + bar * metre, height - 12), context.stroke();
  context.textAlign = "left";
  context.fillText(`${bar} m`, 14, height - 17);
  const x = left + (0 - cells.left) * metre, y = top + cells.tall * cells.scale - (0 - cells.low) * metre;
  if (x > 0 && x < width && y > 0 && y < height) {
    context.beginPath(), context.arc(x, y, 4, 0, 7), context.stroke();
    context.fillText("LM origin", x + 8, y + 4);
  }
}
