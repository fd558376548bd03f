// Elements and texts. Every text is set by textContent, so that no name can become markup.

export const byId = (id) => document.getElementById(id);

/** Return an element with a class of the style sheet, a text and children. */
export function element(tag, { className = "", text = "" } = {}, ...children) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text !== "") made.textContent = text;
  made.append(...children);
  return made;
}

/** Set a text only if it differs, so that screen readers do not repeat it. */
export function setText(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

/** Set the style, the sign and the text of a pill, and the title that is shown while the pointer is on it. */
export function setPill(pill, { style, icon, text, title = "" }) {
  pill.className = `pill ${style}`;
  setText(pill.querySelector(".icon"), icon);
  setText(pill.querySelector("b"), text);
  pill.title = title;
}

/** Return a number with three significant digits. */
export function short(value) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size >= 1000 && size < 1e6) return String(Math.round(value));
  if (size > 0 && (size >= 1e6 || size < 0.001)) return value.toExponential(1);
  return String(Number(value.toPrecision(3)));
}

/** Return coordinates in metres with two decimals; a small negative value has no sign. */
export function position(metres) {
  return `${metres.map((value) => (Math.round(value * 100) / 100 + 0).toFixed(2)).join(", ")} m`;
}

/** Return a length in mm below 0.1 m, otherwise in m. */
export function length(metres) {
  return Math.abs(metres) < 0.1 ? `${short(metres * 1000)} mm` : `${short(metres)} m`;
}

/** Return the local time, with milliseconds, of seconds since 1970, in the format of plotly.js. */
export function localTime(seconds) {
  const offset = 60 * new Date(seconds * 1000).getTimezoneOffset();
  return new Date((seconds - offset) * 1000).toISOString().slice(0, 23).replace("T", " ");
}

/** Return date and local time, such as `2026-11-27 20:41:03`. */
export const dateTime = (seconds) => localTime(seconds).slice(0, 19);

/** Return the local time of day, such as `20:41:03`. */
export const clockTime = (seconds) => localTime(seconds).slice(11, 19);
