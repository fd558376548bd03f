// The header: the verdict with its age or end, and the state of localisation, nodes and connection.

import { byId, clockTime, dateTime, setPill, setText } from "./dom.js";

const NO_HEADLINE = { icon: "–", style: "open", word: "waiting", age: "", text: "" };
const shortName = (node) => node.name.replace("_node", "");

/** Show the header. `connection` has isOpen, lostMs (0 while it is open) and nowMs. */
export function showHeader(run, connection) {
  const isCut = !connection.isOpen && connection.lostMs > 0 && !run.ended;
  setText(byId("title"), run.title);
  showVerdict(run, isCut, connection);
  showState(run, isCut);
  showNodesPill(run, isCut);
  showConnection(run, isCut, connection);
  byId("bookmark").hidden = run.ended;
  byId("report").hidden = !run.nodes?.has_report;
  const problem = run.nodes?.problems.at(-1) ?? "";
  byId("notice").hidden = !problem;
  setText(byId("notice"), problem);
  document.body.classList.toggle("cut", isCut);
}

/** Show the headline of the server; without a connection, the last verdict with its age. */
function showVerdict(run, isCut, connection) {
  const pill = byId("verdict");
  const { icon, style, word, age, text } = run.nodes?.headline ?? NO_HEADLINE;
  if (isCut) {
    const verdict = run.report?.overall.state ?? "waiting";
    const seconds = ageWithoutConnection(run.nodes, connection);
    setPill(pill, "stale", "○", seconds === null ? verdict : `${verdict}, ${seconds.toFixed(0)} s old`);
  } else {
    setPill(pill, style, icon, word);
  }
  setText(byId("age"), isCut ? "" : age);
  setText(byId("overall"), isCut ? `no connection since ${clockTime(connection.lostMs / 1000)}. ${text}` : text);
  document.title = [pill.textContent.trim(), run.title, "sfr live"].filter(Boolean).join(" · ");
}

function ageWithoutConnection(nodes, connection) {
  if (!Number.isFinite(nodes?.age_s)) return null;
  return nodes.age_s + (connection.nowMs - connection.lostMs) / 1000;
}

function showState(run, isCut) {
  const pill = byId("state");
  const { nodes, lastPose } = run;
  const { state, text } = run.localisation;
  const compiling = nodes?.nodes.find((node) => node.values.activity === "compiling");
  const localisation = nodes?.nodes.find((node) => node.name === "localisation_node");
  const age = nodes?.topics["localisation/odometry"]?.age_s ?? 0;
  if (isCut) setPill(pill, "stale", "○", "unknown");
  else if (!lastPose && compiling) setPill(pill, "open", "…", `${shortName(compiling)} ${compiling.message}`);
  else if (!lastPose) setPill(pill, "open", "…", run.ended ? "no pose" : "no pose yet");
  else if (run.ended) setPill(pill, lastPose.lost ? "fail" : "stale", "■", `last: ${text}`);
  else if (nodes?.stale || localisation?.stale) setPill(pill, "stale", "○", `stale: no pose for ${age.toFixed(1)} s`);
  else if (lastPose.lost) setPill(pill, "fail", "✖", text);
  else if (state === "degraded") setPill(pill, "open", "!", text);
  else setPill(pill, "pass", "✔", text);
}

function showNodesPill(run, isCut) {
  const pill = byId("nodes-pill");
  const all = run.nodes?.nodes ?? [];
  const names = (nodes) => nodes.map(shortName).join(", ");
  const stale = all.filter((node) => node.stale);
  const failed = all.filter((node) => node.level === "error" && !node.stale);
  const warned = all.filter((node) => node.level === "warning");
  const areGone = stale.every((node) => node.in_graph === false);
  if (!all.length) setPill(pill, "open", "…", run.ended ? "no node" : "no node yet");
  else if (isCut) setPill(pill, "stale", "○", "nodes unknown");
  else if (run.ended) setPill(pill, "stale", "■", `${all.length} nodes ended`);
  else if (failed.length) setPill(pill, "fail", "✖", `${names(failed)}: error`, failed[0].message);
  else if (stale.length) setPill(pill, "stale", "○", `${names(stale)}: ${areGone ? "gone" : "silent"}`);
  else if (warned.length) setPill(pill, "open", "!", `${names(warned)}: warning`, warned[0].message);
  else setPill(pill, "pass", "✔", `${all.length} nodes`);
}

function showConnection(run, isCut, connection) {
  const pill = byId("connection");
  if (run.nodes?.aborted) setPill(pill, "fail", "■", `aborted ${dateTime(run.nodes.aborted.at)}`);
  else if (run.ended) setPill(pill, "open", "■", `ended ${dateTime(run.nodes.ended_at)}`);
  else if (isCut) setPill(pill, "fail", "✖", `no connection since ${clockTime(connection.lostMs / 1000)}`);
  else if (connection.isOpen) setPill(pill, "pass", "●", "connected");
  else setPill(pill, "open", "…", "connecting");
}
