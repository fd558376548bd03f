// The cloud in three dimensions: projected point by point into an image with a depth for each pixel.

import { byId, colour, drawScale, fitted, length, percentiles, setText, shade } from "./dom.js";
import { countText } from "./map_view.js";

const view = { turn: 1.25, tilt: 0.45, zoom: 1 };
let changed = true, drawn = "", bounds = null, boundsOf = null;

/** Let the pointer, the wheel and the keys turn the cloud. */
export function offerTurning(redraw) {
  const canvas = byId("cloud-canvas");
  const turn = (across, up) => {
    view.turn += across;
    view.tilt = Math.min(Math.max(view.tilt + up, -1.5), 1.5);
    changed = true;
    redraw();
  };
  const zoom = (factor) => {
    view.zoom = Math.min(Math.max(view.zoom * factor, 0.2), 30);
    changed = true;
    redraw();
  };
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => event.buttons && turn(event.movementX * 0.008, event.movementY * 0.008));
  canvas.addEventListener("wheel", (event) => (event.preventDefault(), zoom(Math.exp(-event.deltaY * 0.001))), { passive: false });
  const keys = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
  canvas.addEventListener("keydown", (event) => {
    if (keys[event.key]) turn(...keys[event.key]);
    else if (event.key === "+" || event.key === "-") zoom(event.key === "+" ? 1.2 : 1 / 1.2);
    else return;
    event.preventDefault();
    event.stopPropagation();
  });
}

/** Show the cloud of a moment. */
export function showCloud(cloud, by, theme) {
  const canvas = byId("cloud-canvas"), key = [cloud?.topic, cloud?.stamp_ns, cloud?.count, by, theme, canvas.clientWidth].join(" ");
  if (key === drawn && !changed) return;
  [drawn, changed] = [key, false];
  const { context, width, height, ratio } = fitted(canvas);
  const column = { height: 2, sigma: 3, error: 4 }[by];
  canvas.dataset.points = "0";
  if (!cloud || !cloud.count || column >= cloud.columns) {
    context.fillStyle = colour("muted");
    context.textAlign = "center";
    context.fillText(cloud ? `no ${by} in this cloud` : "no cloud yet", width / 2, height / 2);
    return;
  }
  const image = new ImageData(Math.round(width * ratio), Math.round(height * ratio));
  const [low, high] = project(cloud, column, image, ratio);
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.putImageData(image, 0, 0);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  canvas.dataset.points = String(cloud.count);
  drawScale(context, width, height, length(low), length(high), colour("text"), colour("backing"));
  setText(byId("cloud-note"), `${countText(cloud)}, coloured by ${by}; drag to turn, wheel to zoom`);
}

function boundsOfCloud(cloud) {
  if (boundsOf !== cloud.values) {
    const axis = (place) => Float32Array.from({ length: cloud.count }, (_, i) => cloud.values[i * cloud.columns + place]);
    bounds = [0, 1, 2].map((place) => percentiles(axis(place), 3, 92));
    boundsOf = cloud.values;
  }
  return bounds;
}

/** Fill an image with the points of a cloud; return the ends of the scale of colours. */
function project(cloud, column, image, ratio) {
  const { values, columns, count } = cloud, range = boundsOfCloud(cloud);
  const middle = range.map(([low, high]) => (low + high) / 2);
  const size = Math.max(range[0][1] - range[0][0], range[1][1] - range[1][0], 0.1);
  const coloured = Float32Array.from({ length: count }, (_, i) => values[i * columns + column]).filter(Number.isFinite);
  const [low, high] = coloured.length ? percentiles(coloured, 2, 95) : [0, 1], span = high - low || 1;
  const { width, height, data } = image, scale = (Math.min(width, height * 1.4) / size) * view.zoom;
  const [ct, st, ci, si] = [Math.cos(view.turn), Math.sin(view.turn), Math.cos(view.tilt), Math.sin(view.tilt)];
  const depth = new Float32Array(width * height).fill(Infinity), dot = Math.max(Math.round(2 * ratio), 1);
  for (let i = 0; i < count; i++) {
    const at = i * columns, x = values[at] - middle[0], y = values[at + 1] - middle[1], z = values[at + 2] - middle[2];
    const across = x * ct - y * st, away = x * st + y * ct;
    const u = Math.round(width / 2 + across * scale), v = Math.round(height / 2 - (z * ci + away * si) * scale), far = away * ci - z * si;
    if (u < 0 || v < 0 || u >= width - dot || v >= height - dot) continue;
    const value = values[at + column], [r, g, b] = Number.isFinite(value) ? shade((value - low) / span) : [128, 128, 128];
    for (let dv = 0; dv < dot; dv++) for (let du = 0; du < dot; du++) {
      const pixel = (v + dv) * width + u + du;
      if (far >= depth[pixel]) continue;
      depth[pixel] = far;
      [data[4 * pixel], data[4 * pixel + 1], data[4 * pixel + 2], data[4 * pixel + 3]] = [r, g, b, 255];
    }
  }
  return [low, high];
}
