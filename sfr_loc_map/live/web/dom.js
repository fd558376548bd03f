// Small helpers; every text goes through textContent, so that no name can become markup.
// Colours of values are viridis (van der Walt and Smith): five of its colours, linear between them.

const STOPS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

export const byId = (id) => document.getElementById(id);

/** Return an element with a class, a text and children. */
export function element(tag, className = "", text = "", ...children) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text !== "") made.textContent = text;
  made.append(...children);
  return made;
}

/** Set a text only where it differs, so that screen readers are not told again. */
export function setText(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

/** Set sign, word and style of a pill. */
export function setPill(pill, style, icon, text, title = "") {
  pill.className = `pill ${style}`;
  setText(pill.querySelector(".icon"), icon);
  setText(pill.querySelector("b"), text);
  pill.title = title;
}

/** Return a number with three significant digits, for axes and readings that no table has. */
export function short(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1000 && size < 1e6) return String(Math.round(value));
  return size >= 1e6 || size < 0.001 ? value.toExponential(1) : String(Number(value.toPrecision(3)));
}

/** Return a length in the unit that suits it. */
export function length(metres) {
  if (!Number.isFinite(metres)) return "–";
  return Math.abs(metres) < 0.1 ? `${short(metres * 1000)} mm` : `${short(metres)} m`;
}

/** Return the time of day of seconds since 1970. */
export const clockTime = (seconds) => new Date(seconds * 1000).toLocaleTimeString([], { hour12: false });

/** Return the value of a colour of the style sheet. */
export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

/** Fit a canvas to its box and the screen's pixels; return its context, width and height in CSS pixels. */
export function fitted(canvas) {
  const ratio = Math.min(devicePixelRatio || 1, 2), box = canvas.getBoundingClientRect();
  const width = Math.max(Math.round(box.width), 10), height = Math.max(Math.round(box.height), 10);
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height, ratio };
}

/** Return red, green and blue of a share from 0 to 1. */
export function shade(share) {
  const at = Math.min(Math.max(share, 0), 1) * (STOPS.length - 1), first = Math.min(Math.floor(at), STOPS.length - 2);
  const part = at - first;
  return STOPS[first].map((value, place) => value + (STOPS[first + 1][place] - value) * part);
}

/** Return the values below which so many of 100 lie. */
export function percentiles(values, ...wanted) {
  const sorted = Float32Array.from(values).sort();
  return wanted.map((percent) => sorted[Math.min(Math.floor((percent / 100) * sorted.length), sorted.length - 1)]);
}

/** Draw the scale of the colours with its ends. */
export function drawScale(context, width, height, low, high, textColour, backing) {
  const long = Math.min(140, width / 3), left = width - long - 10, top = height - 24;
  context.fillStyle = backing;
  context.fillRect(left - 6, top - 5, long + 12, 29);
  for (let place = 0; place < long; place++) {
    const [r, g, b] = shade(place / long);
    context.fillStyle = `rgb(${r},${g},${b})`;
    context.fillRect(left + place, top, 1.5, 8);
  }
  context.fillStyle = textColour;
  context.font = "11px system-ui, sans-serif";
  context.textAlign = "left";
  context.fillText(low, left, top + 20);
  context.textAlign = "right";
  context.fillText(high, left + long, top + 20);
}
