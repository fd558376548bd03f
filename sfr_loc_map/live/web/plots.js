// Plots with plotly.js in the colours of the style sheet.

/* global Plotly */

import { byId } from "./dom.js";

const CONFIG = { displayModeBar: false, responsive: true, doubleClick: "autosize" };
const LOGARITHMIC_FROM = 6; // ratio of maximum to median above which a linear scale would flatten the other values
const MOST_DETAILED_POWERS = 4; // number of powers of ten up to which ticks between the powers do not overlap
const TIME_TICK_PX = 100; // distance between two ticks of the time of day
const HEIGHT_PX = 280; // height of a plot without its legend
const LEGEND_ROW_PX = 19;
const LEGEND_ITEM_PX = 240; // width of a wide legend entry
const LETTER_PX = 6.4; // mean width of a letter at 12 px
export const LEGEND_LINE_PX = 60; // width of the line sample in a legend

/** Return the value of a colour of the style sheet. */
export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

/** Return a text with escaped markup, because plotly.js interprets some markup. */
export function plain(text) {
  return String(text).replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
}

/** Return a text with escaped markup, shortened to the width of a box less `used` px. */
export function fitting(id, text, used) {
  const letters = Math.max(Math.floor((byId(id).clientWidth - used) / LETTER_PX), 8);
  return plain(text.length > letters ? `${text.slice(0, letters - 1)}…` : text);
}

/** Return an axis with a title. */
export function axis(title, more = {}) {
  return {
    title: { text: title, standoff: 6 },
    gridcolor: colour("grid"),
    zerolinecolor: colour("line"),
    automargin: true,
    exponentformat: "none", // map coordinates may be millions of metres
    ...more,
  };
}

/** Return a horizontal axis of the time of day; the number of ticks depends on the width of the box. */
export function timeAxis(id) {
  const ticks = Math.max(Math.floor(byId(id).clientWidth / TIME_TICK_PX), 2);
  return axis("", { type: "date", nticks: ticks, tickangle: 0, ticks: "outside", ticklen: 4 });
}

/** Return the scale of an axis for values from 0: logarithmic if the maximum is far above the median. */
export function scaleOf(values) {
  const positive = values.filter((value) => value > 0).sort((a, b) => a - b);
  const median = positive[Math.floor(positive.length / 2)];
  if (!(positive.at(-1) > LOGARITHMIC_FROM * median)) return { type: "linear", rangemode: "tozero" };
  const ticks = logarithmicTicks(positive[0], positive.at(-1));
  const inFull = (tick) => tick.toLocaleString("en", { maximumSignificantDigits: 1 });
  return { type: "log", tickvals: ticks, ticktext: ticks.map(inFull) };
}

/** Return ticks around two values: 1, 2 and 5 times each power of ten; over a wide range, only the powers. */
function logarithmicTicks(low, high) {
  const first = Math.floor(Math.log10(low));
  const powers = Array.from({ length: Math.ceil(Math.log10(high)) - first + 1 }, (_, number) => first + number);
  const steps = powers.length > MOST_DETAILED_POWERS ? [1] : [1, 2, 5];
  return powers.flatMap((power) => steps.map((step) => Number(`${step}e${power}`)));
}

/** Return a dashed horizontal line over the range of x, which is named in the legend. */
export function limitLine(xs, value, name) {
  return {
    x: [xs[0], xs.at(-1)],
    y: [value, value],
    name,
    mode: "lines",
    line: { color: colour("fail"), width: 1.5, dash: "dash" },
  };
}

/** Draw traces in a box; without values, the text `empty` is shown. */
export function draw(id, traces, layout = {}, empty = "no data yet") {
  const box = byId(id);
  const count = traces.reduce((sum, trace) => sum + (trace.z ?? trace.x).length, 0);
  const { plotHeight = HEIGHT_PX, ...shown } = layout;
  const legendColumns = Math.max(Math.floor(box.clientWidth / LEGEND_ITEM_PX), 1);
  const legendRows = layout.showlegend === false || !count ? 0 : Math.ceil(traces.length / legendColumns);
  box.style.height = `${plotHeight + legendRows * LEGEND_ROW_PX}px`;
  const all = {
    autosize: true,
    margin: { l: 48, r: 16, t: 8, b: 36 },
    font: { color: colour("text"), size: 11, family: "system-ui, sans-serif" },
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    hovermode: "closest",
    dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom", // touch scrolls the page
    legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", maxheight: 1 }, // no scroll bar in the legend
    uirevision: "kept", // keeps the zoom when data change
    ...shown,
  };
  if (!count) {
    const text = { text: plain(empty), showarrow: false, xref: "paper", yref: "paper", x: 0.5, y: 0.5 };
    Object.assign(all, { annotations: [{ ...text, font: { color: colour("muted"), size: 13 } }], shapes: [] });
    Object.assign(all, { xaxis: { visible: false }, yaxis: { visible: false }, margin: { l: 8, r: 8, t: 8, b: 8 } });
  }
  box.dataset.values = String(count);
  Plotly.react(box, count ? traces : [], all, CONFIG);
}

