// What each figure and panel means, in one sentence. Nothing else on the page explains itself.

export const TERMS = {
  figures: "Errors of the estimate over sub-trajectories, re-based at the start of each, beside the limits that were given; strings are those of the report.",
  figure: "What is judged, and the condition that ends each sub-trajectory it is made of.",
  mean: "Mean over all sub-trajectories (of position the length of the mean vector).",
  sigma: "Standard deviation over all sub-trajectories.",
  "mean + 3 sigma": "Mean plus three standard deviations: what a limit is usually on.",
  "95 % interval": "Range that holds mean + 3 sigma in 95 of 100 repetitions; it needs at least ten independent sub-trajectories or so.",
  limit: "Upper bound that was given for the figure; without a limits file there is none.",
  verdict: "Pass if the figure is within its limit, fail if it is not, not enough data if it is not defined yet.",
  value: "The statistic that is limited, else mean plus three standard deviations.",
  margin: "From the value to the limit; negative where the limit is missed.",
  certain: "Whether the whole 95 % interval lies on one side of the limit.",
  n: "Number of sub-trajectories, map points or calls that the figure is made of.",
  path: "Estimate and truth from above, x to the right and y up, in the frame of the truth; the line between them is the error, enlarged.",
  limits: "Each limit as a bar: the judged value as a share of the limit (the upright line), its 95 % interval as a thin line, the margin that is left; those with the smallest margin first.",
  error: "Error at the end of each sub-trajectory, re-based at its start, which is what is judged; beside it three times the standard deviation by which the covariance grew over it; the upright scale is logarithmic where values are far apart.",
  under_way: "The oldest sub-trajectory that has not reached its condition: its progress and its error now, which no figure counts before its end.",
  cameras: "What the rover sees, reduced for the screen; tracks go from the newest keyframe to this image, blue to yellow by residual, outliers violet, crosses not found; hatched: masked. A red frame: localisation is lost.",
  elevation: "The mapper's elevation grid from above (or means over its cloud), x to the right and y up, in LM; error: mean distance of the cell's points to the truth; hazard: largest share of a limit, percent; cells without colour are not known.",
  cloud: "The mapper's points in three dimensions, thinned for the screen; drag to turn, wheel to zoom.",
  calls: "Each call of localiser and mapper: its time, how its images came to it, and its memory.",
  processing: "Time of the processing call alone, without transport, conversion and queues.",
  transport: "From the publisher's publish call to the receipt of the slowest image of the pair by the node.",
  receive: "From the receipt of the last image to the publication of the result, with the wait in queues.",
  memory: "Largest resident memory of the node's process during the call.",
  nodes: "What each node says of itself each second; stale: it has said nothing for 1.5 s.",
  drops: "Messages that got lost or were left out since the node started, by cause.",
  lag: "Time from the publication of an image to the moment at which the pose of its stamp is on this screen (95 of 100 are faster).",
  thinned: "What this page does not show in full: images and clouds are thinned to a budget, figures never are.",
  lifecycle: "State of the managed node: unconfigured, inactive, active or finalized.",
};

/** Return a "?" button that shows the definition of a term. */
export function helpButton(term) {
  const button = document.createElement("button");
  button.className = "help";
  button.dataset.term = term;
  dressHelp(button);
  return button;
}

/** Give all "?" buttons of the page their sign, name and action. */
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
