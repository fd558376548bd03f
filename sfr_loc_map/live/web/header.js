// The header: the verdict with its age or end, and the state of localisation, nodes and connection.

import { byId, clockTime, dateTime, setPill, setText } from "./dom.js";

const NO_HEADLINE = { icon: "–", style: "open", word: "waiting", age: "", text: "" };
const STATES = {
  lost: { style: "fail", icon: "✖" },
  degraded: { style: "open", icon: "!" },
  "": { style: "open", icon: "?" }, // unknown
};
const WORKING = { style: "pass", icon: "✔" };
const UNKNOWN = { style: "stale", icon: "○" };
const WAITING = { style: "open", icon: "…" };
const ENDED = { style: "stale", icon: "■" };
const count = (nodes) => (nodes.length === 1 ? "1 node" : `${nodes.length} nodes`);
const shortName = (node) => node.name.replace("_node", "");

/** Show the header. Without a connection, the state of the run is unknown. */
export function showHeader(run, connection) {
  const isCut = connection.lostMs > 0 && !run.ended;
  const problem = run.live?.problems.at(-1) ?? "";
  setText(byId("title"), run.title);
  showHeadline(isCut ? headlineWithoutConnection(run, connection) : (run.live?.headline ?? NO_HEADLINE));
  setPill(byId("state"), isCut ? { ...UNKNOWN, text: "unknown" } : localisationPill(run));
  setPill(byId("nodes-pill"), isCut ? { ...UNKNOWN, text: "nodes unknown" } : nodesPill(run));
  setPill(byId("connection"), connectionPill(run, connection, isCut));
  byId("bookmark").hidden = run.ended;
  byId("report").hidden = !run.live?.has_report;
  byId("notice").hidden = !problem;
  setText(byId("notice"), problem);
  document.title = [byId("verdict").textContent.trim(), run.title, "sfr live"].filter(Boolean).join(" · ");
  document.body.classList.toggle("cut", isCut);
}

function showHeadline({ icon, style, word, age, text }) {
  setPill(byId("verdict"), { style, icon, text: word });
  setText(byId("age"), age);
  setText(byId("overall"), text);
}

/** Return the last headline with its present age. */
function headlineWithoutConnection(run, connection) {
  const verdict = run.score?.overall.state ?? "waiting";
  const lostForS = (Date.now() - connection.lostMs) / 1000;
  const isAgeKnown = Number.isFinite(run.live?.age_s);
  const age = isAgeKnown ? `${(run.live.age_s + lostForS).toFixed(0)} s old` : "";
  const { text } = run.live?.headline ?? NO_HEADLINE;
  return { ...UNKNOWN, word: verdict, age, text: `no connection since ${clockTime(connection.lostMs / 1000)}. ${text}` };
}

function localisationPill(run) {
  if (!run.localisation) return noPosePill(run);
  const { state, text, stale, age_s: age } = run.localisation;
  if (run.ended) return { ...ENDED, style: state === "lost" ? "fail" : "stale", text: `last: ${text}` };
  if (stale) return { ...UNKNOWN, text: `stale: no pose for ${age.toFixed(1)} s` };
  return { ...(STATES[state] ?? WORKING), text };
}

function noPosePill(run) {
  if (run.ended) return { ...ENDED, text: "no pose" };
  const compiling = run.live?.nodes.find((node) => node.values.activity === "compiling");
  if (compiling) return { ...WAITING, text: `${shortName(compiling)} ${compiling.message}` };
  return { ...WAITING, text: "no pose yet" };
}

function nodesPill(run) {
  const nodes = run.live?.nodes ?? [];
  const stale = nodes.filter((node) => node.stale);
  const silent = stale.filter((node) => node.age_s !== null); // others have not reported yet
  const failed = nodes.filter((node) => node.level === "error" && !node.stale);
  const warned = nodes.filter((node) => node.level === "warning");
  const names = (some) => some.map(shortName).join(", ");
  if (!nodes.length) return { ...WAITING, text: run.ended ? "no node" : "no node yet" };
  if (run.ended) return { ...ENDED, text: `${count(nodes)} ended` };
  if (failed.length) return { ...STATES.lost, text: `${names(failed)}: error`, title: failed[0].message };
  if (silent.length) {
    const areGone = silent.every((node) => node.in_graph === false);
    return { ...UNKNOWN, text: `${names(silent)}: ${areGone ? "gone" : "silent"}` };
  }
  if (stale.length) return { ...WAITING, text: `${names(stale)}: not heard yet` };
  if (warned.length) return { ...STATES.degraded, text: `${names(warned)}: warning`, title: warned[0].message };
  return { ...WORKING, text: count(nodes) };
}

function connectionPill(run, connection, isCut) {
  if (run.live?.aborted) return { style: "fail", icon: "■", text: `aborted ${dateTime(run.live.aborted.at)}` };
  if (run.ended) return { style: "open", icon: "■", text: `ended ${dateTime(run.live.ended_at)}` };
  if (isCut) return { style: "fail", icon: "✖", text: `no connection since ${clockTime(connection.lostMs / 1000)}` };
  if (connection.isHeard) return { style: "pass", icon: "●", text: "connected" };
  return { ...WAITING, text: "connecting" };
}
