// The images of both cameras of a rig. The server has drawn the feature tracks on the left image.

import { byId, element, setText } from "./dom.js";

const slots = new Map(); // elements of an image and its texts, by side

/** Show the images of the chosen rig, or why an image is missing. A red frame indicates that tracking is lost. */
export function showCameras(run) {
  const rig = byId("rig").value;
  for (const side of ["left", "right"]) {
    const topic = `${rig}/${side}`;
    const image = run.images.get(topic);
    const problem = problemOf(run, topic);
    const isLost = rig === "loc" && !run.ended && run.localisation?.state === "lost";
    showState(slotOf(side), { problem, lost: isLost ? run.localisation.text : "" });
    showImage(slotOf(side), image, topic);
  }
}

/** Return why no image, or no newer image, is shown; empty for the last image after the end of the run. */
function problemOf(run, topic) {
  const problem = run.ended ? "" : run.live?.image_problems[topic];
  return problem || (run.images.has(topic) ? "" : run.missing("no image was received"));
}

function slotOf(side) {
  if (!slots.has(side)) slots.set(side, makeSlot());
  return slots.get(side);
}

function makeSlot() {
  const image = element("img");
  const badge = element("span", { className: "badge" });
  const reason = element("p", { className: "reason" });
  const caption = element("figcaption", { className: "note" });
  const frame = element("div", { className: "frame" }, image, badge, reason);
  image.hidden = true;
  byId("images").append(element("figure", {}, frame, caption));
  return { image, badge, reason, caption, frame, shown: null, topic: null };
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
