// Images of both cameras with feature tracks and masks drawn on them, and whether localisation is lost.

import { byId, colour, element, setText } from "./dom.js";
import { stateOf } from "./store.js";

const slots = new Map();
const HATCH = 8, LEVELS = 8;

/**
 * Show the images of a moment; with `wantsTracks` those that the newest tracks belong to, while tracks come.
 * `drawn(image)` is called when an image is on its canvas.
 */
export function showImages(moment, rig, wantsTracks, drawn) {
  const lost = moment.rowCount > 0 && moment.rows[moment.rowCount - 1].lost;
  const tracked = wantsTracks && rig === "loc" ? moment.tracked : null;
  for (const side of ["left", "right"]) {
    const found = tracked?.images[side] ?? moment.images.get(`${rig}/${side}`);
    const own = tracked && found && found.stamp_ns === tracked.tracks.stamp_ns ? tracked.tracks : null;
    show(slotOf(side), found, own, rig === "loc" && lost ? stateOf(moment) : "", drawn);
  }
}

function slotOf(side) {
  if (!slots.has(side)) {
    const canvas = element("canvas"), badge = element("span", "badge"), caption = element("figcaption", "note");
    canvas.setAttribute("role", "img");
    canvas.hidden = true;
    const box = element("div", "frame", "", canvas, badge);
    byId("images").append(element("figure", "", "", box, caption));
    slots.set(side, { side, canvas, badge, caption, box, key: "" });
  }
  return slots.get(side);
}

async function show(slot, found, tracks, lost, drawn) {
  slot.box.classList.toggle("lost", Boolean(lost));
  slot.badge.hidden = !lost;
  setText(slot.badge, lost ? lost.toUpperCase() : "");
  const key = found ? `${found.topic} ${found.stamp_ns} ${tracks?.stamp_ns}` : "none";
  if (key === slot.key) return;
  slot.key = key;
  if (!found) {
    slot.canvas.hidden = true;
    setText(slot.caption, `${slot.side}: no image yet`);
    return;
  }
  let bitmap;
  try {
    bitmap = await createImageBitmap(found.blob);
  } catch {
    setText(slot.caption, `${slot.side}: the image of stamp ${found.stamp_ns} is broken`);
    return;
  }
  if (slot.key === key) {
    paint(slot, found, tracks, bitmap);
    drawn(found);
  }
  bitmap.close();
}

function paint(slot, found, tracks, bitmap) {
  const canvas = slot.canvas, context = canvas.getContext("2d");
  if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) [canvas.width, canvas.height] = [bitmap.width, bitmap.height];
  context.drawImage(bitmap, 0, 0);
  const scale = bitmap.width / found.full_size[0], rings = tracks?.masks[slot.side] ?? [];
  const count = tracks && slot.side === "left" ? drawTracks(context, tracks, scale) : 0;
  for (const ring of rings) drawMask(context, ring, scale);
  canvas.hidden = false;
  canvas.dataset.tracks = String(count);
  canvas.dataset.masks = String(rings.length);
  canvas.setAttribute("aria-label", `${slot.side} image of stamp ${found.stamp_ns}`);
  const size = found.size.join(" × "), full = found.full_size.join(" × ");
  const parts = [full === size ? size : `${size} of ${full}`, "pixels, stamp", found.stamp_ns];
  if (count) parts.push(`, ${count} tracks`);
  if (rings.length) parts.push(`, ${rings.length} masked`);
  setText(slot.caption, `${slot.side}: ${parts.join(" ").replaceAll(" ,", ",")}`);
}

/**
 * Draw tracks from the newest keyframe to here: blue to yellow by residual, outliers violet; a cross: not found.
 * One path for each colour: a stroke for each of a thousand tracks would cost more than the image.
 */
function drawTracks(context, { values, count }, scale) {
  const kinds = Array.from({ length: LEVELS + 1 }, () => []), missed = [];
  for (let i = 0; i < count; i++) {
    const [u, v, u0, v0, residual] = values.subarray(5 * i, 5 * i + 5);
    if (Number.isFinite(residual) && Number.isFinite(u)) kinds[Math.min(Math.floor(residual * LEVELS), LEVELS)].push([u * scale, v * scale, u0 * scale, v0 * scale]);
    else if (Number.isFinite(u0)) missed.push([u0 * scale, v0 * scale]);
  }
  context.lineWidth = 1;
  kinds.forEach((tracks, level) => drawLevel(context, tracks, level));
  drawCrosses(context, missed);
  return count;
}

function drawLevel(context, tracks, level) {
  const share = level / (LEVELS - 1), mix = (a, b) => Math.round(a + (b - a) * share);
  context.strokeStyle = context.fillStyle = level === LEVELS ? "#dc3cdc" : `rgb(${mix(60, 255)},${mix(170, 225)},${mix(255, 0)})`;
  context.beginPath();
  for (const [u, v, u0, v0] of tracks) if (Number.isFinite(u0)) context.moveTo(u0, v0), context.lineTo(u, v);
  context.stroke();
  context.beginPath();
  for (const [u, v] of tracks) context.rect(u - 1.5, v - 1.5, 3, 3);
  context.fill();
}

function drawCrosses(context, places) {
  context.strokeStyle = "#969696";
  context.beginPath();
  for (const [u, v] of places) context.moveTo(u - 2, v - 2), context.lineTo(u + 2, v + 2), context.moveTo(u - 2, v + 2), context.lineTo(u + 2, v - 2);
  context.stroke();
}

/** Hatch what is left out. */
function drawMask(context, ring, scale) {
  const us = ring.map(([u]) => u * scale), vs = ring.map(([, v]) => v * scale);
  const [left, right, top, bottom] = [Math.min(...us), Math.max(...us), Math.min(...vs), Math.max(...vs)];
  context.save();
  context.beginPath();
  us.forEach((u, place) => (place ? context.lineTo(u, vs[place]) : context.moveTo(u, vs[place])));
  context.closePath();
  context.strokeStyle = colour("lost");
  context.lineWidth = 1.5;
  context.stroke();
  context.clip();
  context.beginPath();
  for (let u = left - (bottom - top); u < right; u += HATCH) context.moveTo(u, bottom), context.lineTo(u + bottom - top, top);
  context.stroke();
  context.restore();
}
