// Definition of each panel and of the terms of the tables, shown by its "?" button.

const TERMS = {
  events: "Events over time: states of localisation, nodes that were silent, failed or compiling, missed limits, jumps of the stamps, and the end of an aborted run.",
  limits: "Each limit as a bar: the judged value as a fraction of the limit (vertical line), with its 95 % interval. Missed limits come first, then the others by decreasing fraction.",
  path: "Estimate and ground truth from above, in the frame of the truth. Errors and the 3 sigma ellipse of the last pose are enlarged by the factors in the legend.",
  cameras: "Images of the chosen rig, reduced for the screen. Tracks lead from the newest keyframe to this image: blue to yellow by residual, outliers violet, features not found as crosses. A red frame indicates that localisation is lost.",
  errors: "Position error at the end of each sub-trajectory of the first condition, re-based at its start, as scored by the monitor. The scale is logarithmic if the maximum is far above the median.",
  map: "The mapper's elevation grid from above, or cell means of its cloud, in LM. Error: mean distance of the cell's points to the truth. Hazard: the largest terrain criterion as a percentage of its limit. Cells without colour are unknown.",
  calls: "Time of each processing call, latency of its images (transport), time from their receipt to the result, and peak memory of the node.",
  nodes: "Health that each node reports once a second. Stale: no report for at least 1.5 s.",
  drops: "Messages that were lost or dropped since the node was configured, by cause.",
  lifecycle: "State of the managed node: unconfigured, inactive, active or finalized.",
  figures: "Errors of the estimate over sub-trajectories, re-based at the start of each sub-trajectory, with their limits. The texts are those of the report.",
};

/** Add the definitions of the terms of the tables, which are those of the report. */
export function addTerms(terms) {
  Object.assign(TERMS, terms);
}

/** Return whether a term has a definition. */
export function isDefined(term) {
  return Object.hasOwn(TERMS, term);
}

/** Return a "?" button that shows the definition of a term. */
export function helpButton(term) {
  const button = document.createElement("button");
  button.className = "help";
  button.dataset.term = term;
  dressHelp(button);
  return button;
}

/** Give each "?" button of the page its sign, name and action. */
export function dressAllHelp() {
  for (const button of document.querySelectorAll("button.help")) dressHelp(button);
  document.addEventListener("keydown", (event) => event.key === "Escape" && hideTip());
  document.addEventListener("click", (event) => event.target.closest("button.help") || hideTip());
  window.addEventListener("scroll", hideTip, { passive: true });
}

function dressHelp(button) {
  if (button.dataset.dressed) return;
  button.dataset.dressed = "yes";
  button.type = "button";
  button.textContent = "?";
  button.setAttribute("aria-label", `What is ${button.dataset.term.replace("_", " ")}?`);
  button.addEventListener("click", () => showTip(button));
  button.addEventListener("mouseenter", () => showTip(button));
  button.addEventListener("mouseleave", hideTip);
  button.addEventListener("blur", hideTip);
}

function showTip(button) {
  const tip = document.getElementById("tip"), box = button.getBoundingClientRect();
  tip.textContent = TERMS[button.dataset.term] ?? "";
  tip.hidden = false;
  const left = Math.min(Math.max(box.left - 20, 8), innerWidth - tip.offsetWidth - 8);
  const below = box.bottom + 6 + tip.offsetHeight < innerHeight;
  tip.style.left = `${Math.max(left, 8)}px`;
  tip.style.top = `${below ? box.bottom + 6 : box.top - tip.offsetHeight - 6}px`;
  button.setAttribute("aria-describedby", "tip");
}

function hideTip() {
  document.getElementById("tip").hidden = true;
}
