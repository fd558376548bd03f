// The limits as bars.

import { byId } from "./dom.js";
import { axis, colour, draw, fitting, plain } from "./plots.js";

const PLOT = "limits-plot";
const SHARE_SHOWN = 1.5; // end of the axis, as a fraction of the limit
const TICKS = { tickvals: [0, 0.5, 1], ticktext: ["0", "50 %", "limit"] };
const ROW_PX = 54;
const AXIS_PX = 34;
const MARGIN_PX = 16; // left and right of the labels

/** Show each limit as a bar: the judged value as a fraction of the limit, with its 95 % interval; worst first. */
export function showLimits(run) {
  const limits = run.score?.limits ?? [];
  const layout = {
    plotHeight: Math.max(limits.length, 2) * ROW_PX + AXIS_PX,
    margin: { l: 8, r: 8, t: 8, b: 26 },
    xaxis: axis("", { ...TICKS, range: [0, SHARE_SHOWN], fixedrange: true }),
    yaxis: { visible: false, range: [limits.length - 0.7, -0.8], fixedrange: true },
    shapes: [lineAtLimit()],
    annotations: limits.flatMap(labelsOf),
    showlegend: false,
  };
  draw(PLOT, limits.length ? [bars(limits)] : [], layout, whyEmpty(run));
  const texts = limits.map((limit) => `${limit.state}: ${limit.text}`);
  byId(PLOT).setAttribute("aria-label", texts.join("; ") || "no limits");
}

function whyEmpty(run) {
  return run.score ? "No limits were given, so there is no verdict." : run.missing("no score was received");
}

function bars(limits) {
  const shares = limits.map(shownShare);
  return {
    type: "bar",
    orientation: "h",
    x: shares,
    y: limits.map((_, row) => row),
    width: 0.16,
    marker: { color: limits.map((limit) => colour(limit.style)) },
    error_x: {
      type: "data",
      symmetric: false,
      array: limits.map(lengthAbove),
      arrayminus: limits.map(lengthBelow),
      color: colour("text"),
      thickness: 1.5,
      width: 4,
    },
    hovertext: limits.map(hoverText),
    hoverinfo: "text",
  };
}

function shownShare(limit) {
  return Math.min(limit.share ?? 0, SHARE_SHOWN);
}

/** Return the length of the 95 % interval above the value, within the axis; 0 without an interval. */
function lengthAbove(limit) {
  if (limit.high === null) return 0;
  return Math.max(Math.min(limit.high, SHARE_SHOWN) - shownShare(limit), 0);
}

function lengthBelow(limit) {
  if (limit.low === null) return 0;
  return Math.max(shownShare(limit) - limit.low, 0);
}

function hoverText(limit) {
  return plain(limit.interval ? `${limit.text}; 95 % interval ${limit.interval}` : limit.text);
}

/** Return the two lines of text above a bar: name and figures. */
function labelsOf(limit, row) {
  const margin = limit.margin ? `, margin ${limit.margin}` : "";
  return [
    label(row, 28, `${limit.icon} ${limit.name}`, colour(limit.style)),
    label(row, 13, `${limit.value}, limit ${limit.limit}${margin}`, colour("text")),
  ];
}

function label(row, yshift, text, fill) {
  const font = { color: fill, size: 12 };
  const shown = fitting(PLOT, text, MARGIN_PX);
  return { x: 0, xanchor: "left", y: row, yshift, text: shown, showarrow: false, bgcolor: colour("card"), font };
}

function lineAtLimit() {
  const line = { color: colour("text"), width: 2 };
  return { type: "line", x0: 1, x1: 1, y0: 0, y1: 1, yref: "paper", layer: "below", line };
}
