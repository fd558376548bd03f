// Small helpers; every text goes through textContent, so that no name can become markup.

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
