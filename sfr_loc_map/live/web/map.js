// One layer of the map from above.

import { byId, length, setText } from "./dom.js";
import { axis, draw } from "./plots.js";

const UNITS = {
  hazard: { title: "hazard, %", factor: 1 },
  slope: { title: "slope, deg", factor: 180 / Math.PI },
  count: { title: "points in a cell", factor: 1 },
}; // all other layers are in metres
const COLOUR_QUANTILES = [0.02, 0.98]; // ends of the colour scale, so that outliers do not determine it

/** Show the chosen layer. */
export function showMap(run) {
  const map = run.map;
  const layer = byId("layer").value;
  const place = map ? map.names.indexOf(layer) : -1;
  const { title, factor } = UNITS[layer] ?? { title: `${layer}, m`, factor: 1 };
  const cells = place < 0 ? [] : cellsOf(map, place, factor);
  const known = cells.flat().filter((value) => value !== null).sort((a, b) => a - b);
  const layout = { xaxis: axis("x, m"), yaxis: axis("y, m", { scaleanchor: "x" }) };
  const traces = known.length ? [heatmap(map, cells, known, title)] : [];
  draw("map-plot", traces, layout, map ? `no ${layer} in this map` : run.missing("no map was received"));
  setText(byId("map-note"), known.length ? noteOf(map, known.length) : "");
}

/** Return the values of a layer as rows of cells; null if unknown. */
function cellsOf(map, place, factor) {
  const { rows, columns, names, values } = map;
  const valueAt = (row, column) => values[(row * columns + column) * names.length + place];
  const cell = (value) => (Number.isFinite(value) ? value * factor : null);
  return Array.from({ length: rows }, (_, row) => (
    Array.from({ length: columns }, (_, column) => cell(valueAt(row, column)))
  ));
}

/** Return the trace of cells; `known` are their sorted values. */
function heatmap(map, cells, known, title) {
  const [zmin, zmax] = COLOUR_QUANTILES.map((share) => known[Math.floor(share * known.length)]);
  return {
    type: "heatmap",
    x0: map.origin_m[0] + map.cell_m / 2,
    dx: map.cell_m,
    y0: map.origin_m[1] + map.cell_m / 2,
    dy: map.cell_m,
    z: cells,
    zmin,
    zmax,
    colorscale: "Viridis",
    colorbar: { title: { text: title, side: "right" }, thickness: 12 },
    hovertemplate: "x %{x:.2f} m, y %{y:.2f} m: %{z:.3g}<extra></extra>",
  };
}

function noteOf(map, count) {
  const thinned = map.every > 1 ? `, each of ${map.every} × ${map.every} cells of the map` : "";
  return `${count} cells of ${length(map.cell_m)}${thinned}; stamp ${map.stamp_ns}`;
}
