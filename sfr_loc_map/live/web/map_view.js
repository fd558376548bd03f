// The map from above: cells with layers, coloured by one of them.

import { byId, colour, drawScale, fitted, length, percentiles, setText, shade, short } from "./dom.js";
import { label } from "./view.js";

const WRITE = { hazard: (value) => `${short(value)} %`, slope: (value) => `${short((value * 180) / Math.PI)} deg`, count: short };
let drawn = "";

/** Show the map of a moment. */
export function showMap(grid, layer, theme, view) {
  const canvas = byId("map-canvas"), key = [grid?.stamp_ns, grid?.names, grid?.published_s, layer, theme, canvas.clientWidth, view.version].join(" ");
  if (key === drawn) return;
  drawn = key;
  const { context, width, height } = fitted(canvas);
  canvas.dataset.cells = "0";
  const cells = grid?.names.includes(layer) ? cellsOf(grid, layer) : null;
  if (!cells || !cells.filled) {
    context.fillStyle = colour("muted");
    context.textAlign = "center";
    context.fillText(grid ? `no ${layer} in this map` : "no map yet", width / 2, height / 2);
    return;
  }
  canvas.dataset.cells = String(cells.filled);
  const [low, high] = paint(context, cells, width, height, view), write = WRITE[layer] ?? length;
  axes(context, cells, width, height);
  drawScale(context, width, height, write(low), write(high), colour("text"), colour("backing"));
  if (view.pointer) drawPointed(context, cells, view.pointer, write, width);
  const thinned = grid.every > 1 ? ` (${grid.every} × ${grid.every} of the map's, thinned)` : "";
  setText(byId("map-note"), `${cells.filled} cells of ${length(grid.cell_m)}${thinned}, ${layer} from ${write(low)} to ${write(high)}; stamp ${grid.stamp_ns}`);
}

/** Return how many points of how many are shown, in words. */
export function countText(cloud) {
  return cloud.count < cloud.total ? `${cloud.count} of ${cloud.total} points (thinned)` : `${cloud.count} points`;
}

/** Return one layer of a grid, cut to the cells that any layer knows. */
function cellsOf(grid, layer) {
  const { rows, columns, names, values } = grid, at = names.indexOf(layer), height = names.indexOf("height");
  let [top, bottom, left, right, filled] = [rows, -1, columns, -1, 0];
  for (let row = 0; row < rows; row++) for (let column = 0; column < columns; column++) {
    const place = (row * columns + column) * names.length;
    if (!Number.isFinite(values[place + height])) continue;
    [top, bottom, left, right] = [Math.min(top, row), Math.max(bottom, row), Math.min(left, column), Math.max(right, column)];
  }
  const wide = Math.max(right - left + 1, 0), tall = Math.max(bottom - top + 1, 0), shown = new Float32Array(wide * tall);
  for (let row = 0; row < tall; row++) for (let column = 0; column < wide; column++) {
    const value = values[((top + row) * columns + left + column) * names.length + at];
    shown[row * wide + column] = value;
    filled += Number.isFinite(value);
  }
  return { values: shown, wide, tall, filled, size: grid.cell_m, left: grid.origin_m[0] + left * grid.cell_m, low: grid.origin_m[1] + top * grid.cell_m };
}

/** Write the value of the cell under the pointer. */
function drawPointed(context, cells, pointer, write, width) {
  const column = Math.floor((pointer[0] - cells.at[0]) / cells.scale), row = cells.tall - 1 - Math.floor((pointer[1] - cells.at[1]) / cells.scale);
  if (column < 0 || row < 0 || column >= cells.wide || row >= cells.tall) return;
  const value = cells.values[row * cells.wide + column], place = [cells.left + (column + 0.5) * cells.size, cells.low + (row + 0.5) * cells.size];
  label(context, pointer, `${place.map((metres) => metres.toFixed(2)).join(", ")} m: ${Number.isFinite(value) ? write(value) : "not known"}`, width, { text: colour("text"), card: colour("card") });
}

function paint(context, cells, width, height, view) {
  const known = cells.values.filter(Number.isFinite), [low, high] = percentiles(known, 2, 98);
  const image = new ImageData(cells.wide, cells.tall), span = high - low || 1;
  for (let y = 0; y < cells.tall; y++) for (let x = 0; x < cells.wide; x++) {
    const cell = y * cells.wide + x, at = 4 * ((cells.tall - 1 - y) * cells.wide + x);
    if (!Number.isFinite(cells.values[cell])) continue;
    const [r, g, b] = shade((cells.values[cell] - low) / span);
    [image.data[at], image.data[at + 1], image.data[at + 2], image.data[at + 3]] = [r, g, b, 255];
  }
  const small = new OffscreenCanvas(cells.wide, cells.tall);
  small.getContext("2d").putImageData(image, 0, 0);
  const whole = Math.min(width / cells.wide, height / cells.tall), scale = whole * view.zoom;
  cells.scale = scale;
  cells.at = view.at((width - cells.wide * whole) / 2, (height - cells.tall * whole) / 2, width, height);
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
