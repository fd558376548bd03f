// Images of both cameras, with feature tracks where localisation publishes them, and whether it is lost.

import { byId, element, setText } from "./dom.js";

const TRACKS = "localisation/debug_image";
const slots = new Map();

/** Show the images of a moment. */
export function showImages(moment, rig, wantsTracks) {
  const lost = moment.rowCount > 0 && moment.rows[moment.rowCount - 1].lost;
  const node = moment.nodes?.nodes.find((item) => item.name === "localisation_node");
  const tracks = wantsTracks && rig === "loc" && moment.images.has(TRACKS);
  for (const side of ["left", "right"]) {
    const topic = side === "left" && tracks ? TRACKS : `${rig}/${side}`;
    show(slotOf(side), moment.images.get(topic), topic, rig === "loc" && lost ? node?.state || "lost" : "");
  }
}

function slotOf(side) {
  if (!slots.has(side)) {
    const image = element("img"), badge = element("span", "badge"), caption = element("figcaption", "note");
    const box = element("div", "frame", "", image, badge);
    const slot = { side, image, badge, caption, box, stamp: "", url: "" };
    byId("images").append(element("figure", "", "", box, caption));
    slots.set(side, slot);
  }
  return slots.get(side);
}

function show(slot, found, topic, lost) {
  slot.box.classList.toggle("lost", Boolean(lost));
  slot.badge.hidden = !lost;
  setText(slot.badge, lost ? lost.toUpperCase() : "");
  if (!found) {
    slot.image.hidden = true;
    setText(slot.caption, `${slot.side}: no image yet`);
    return;
  }
  const key = `${topic} ${found.stamp_ns}`;
  if (key === slot.stamp) return;
  slot.stamp = key;
  if (slot.url) URL.revokeObjectURL(slot.url);
  slot.url = URL.createObjectURL(found.blob);
  slot.image.hidden = false;
  slot.image.src = slot.url;
  slot.image.alt = `${slot.side} image of stamp ${found.stamp_ns}`;
  const size = found.size.join(" × "), full = found.full_size.join(" × ");
  setText(slot.caption, `${slot.side}${topic === TRACKS ? " with tracks" : ""}: ${full === size ? size : `${size} of ${full}`} pixels, stamp ${found.stamp_ns}`);
}
