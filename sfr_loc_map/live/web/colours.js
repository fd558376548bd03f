// Colours of values: viridis (van der Walt and Smith), five of its colours, linear between them.

const STOPS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

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
