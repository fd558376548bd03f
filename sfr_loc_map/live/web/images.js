// The images of both cameras. The server has drawn the feature tracks on the left image.

import { byId, element, setText } from "./dom.js";

const slots = new Map();

/** Show the images of the chosen rig, or why an image is missing. A red frame indicates that tracking is lost. */
export function showImages(run) {
  const rig = byId("rig").value;
  for (const side of ["left", "right"]) {
    const topic = `${rig}/${side}`;
    const image = run.images.get(topic);
    const problem = run.nodes?.image_problems[topic] ?? "";
    const lost = rig === "loc" && !run.ended && run.lastPose?.lost ? run.localisation.text : "";
    showState(slotOf(side), { problem: problem || (image ? "" : "no image yet"), lost });
    showImage(slotOf(side), image, topic);
  }
}

function slotOf(side) {
  if (!slots.has(side)) slots.set(side, makeSlot());
  return slots.get(side);
}

function makeSlot() {
  const image = element("img");
  image.hidden = true;
  const badge = element("span", "badge");
  const reason = element("p", "reason");
  const caption = element("figcaption", "note");
  const frame = element("div", "frame", "", image, badge, reason);
  byId("images").append(element("figure", "", "", frame, caption));
  return { image, badge, reason, caption, frame, shown: null };
}

function showState(slot, { problem, lost }) {
  slot.frame.classList.toggle("lost", Boolean(lost));
  slot.badge.hidden = !lost;
  setText(slot.badge, lost.toUpperCase());
  slot.reason.hidden = !problem;
  setText(slot.reason, problem);
}

function showImage(slot, image, topic) {
  if (image === slot.shown && topic === slot.topic) return;
  Object.assign(slot, { shown: image, topic });
  slot.image.hidden = !image;
  setText(slot.caption, image ? captionOf(image) : topic);
  if (!image) return;
  const url = URL.createObjectURL(image.blob);
  slot.image.onload = slot.image.onerror = () => URL.revokeObjectURL(url);
  slot.image.alt = `${topic}, stamp ${image.stamp_ns}`;
  slot.image.src = url;
}

function captionOf(image) {
  const size = image.size.join(" × ");
  const full = image.full_size.join(" × ");
  const tracks = image.tracks ? `, ${image.tracks} tracks` : "";
  return `${image.topic}: ${size === full ? size : `${size} of ${full}`} px${tracks}, stamp ${image.stamp_ns}`;
}
