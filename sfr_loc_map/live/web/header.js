// The header: the verdict with its age and its end, the state of localisation, nodes, connection.

import { byId, clockTime, setPill, setText } from "./dom.js";
import { stateOf } from "./store.js";

const short = (node) => node.name.replace("_node", "");

/** Show the header of a moment. `now`: the server's time; `lostAt`: since when there is no connection, 0 for there is. */
export function showHeader(moment, store, now, lostAt) {
  const nodes = moment.nodes, aborted = moment.live ? store.nodes?.aborted : null, ended = moment.live && store.ended;
  const cut = moment.live && lostAt > 0 && !ended;
  const reasons = cut ? [`no connection since ${clockTime(lostAt)}`] : (nodes?.stale_reasons ?? []);
  showVerdict(moment, { aborted, ended, reasons, age: ageOf(nodes, now, cut) });
  showState(moment, ended, cut);
  showNodesPill(nodes, ended, cut);
  const pill = byId("connection");
  if (aborted) setPill(pill, "fail", "■", `aborted at ${clockTime(aborted.at)}`);
  else if (ended) setPill(pill, "open", "■", `ended at ${clockTime(store.nodes.ended_at)}`);
  else if (cut) setPill(pill, "fail", "✖", `no connection since ${clockTime(lostAt)}`);
  else setPill(pill, lostAt ? "open" : "pass", lostAt ? "…" : "●", lostAt ? "connecting" : "connected");
  byId("report").hidden = !store.nodes?.has_report;
  const problems = nodes?.problems ?? [], notice = byId("notice");
  notice.hidden = !problems.length;
  setText(notice, problems.at(-1) ?? "");
  document.body.classList.toggle("cut", cut);
}

function ageOf(nodes, now, cut) {
  if (!nodes || nodes.age_s === null || nodes.age_s === undefined) return null;
  return nodes.age_s + (cut ? Math.max(now - nodes.time_s, 0) : 0);
}

function showVerdict(moment, { aborted, ended, reasons, age }) {
  const pill = byId("verdict"), overall = moment.report?.overall, word = overall?.state ?? (moment.kept ? "waiting" : "not kept");
  const worst = moment.report?.limits?.[0], told = [overall?.text ?? (moment.kept ? "No figures yet." : "Figures of moments before the page was loaded are not kept.")];
  if (worst && worst.margin) told.push(`${worst.state === "fail" ? "Worst" : "Least margin"}: ${worst.text}.`);
  if (aborted) {
    setPill(pill, "fail", "■", "aborted");
    told.unshift(`${aborted.by} at ${clockTime(aborted.at)}.`, `Verdict on what there was: ${word}.`);
  } else if (ended) setPill(pill, overall?.style ?? "open", overall?.icon ?? "–", `${word}, ended`);
  else if (reasons.length) {
    setPill(pill, "stale", "○", overall ? `${word}, ${(age ?? 0).toFixed(0)} s old` : word);
    told.unshift(`${reasons.join(", ")}.`);
  } else setPill(pill, overall?.style ?? "open", overall?.icon ?? "–", word);
  setText(byId("overall"), told.join(" ").replaceAll(/≤ ([^ ]+) /g, "≤\u00a0$1\u00a0"));  // a limit stays in one line
  setText(byId("age"), !overall || ended || reasons.length || age === null ? "" : `${Math.max(age, 0).toFixed(0)} s old`);
  const name = byId("title").textContent;
  document.title = [pill.textContent.trim(), name, "sfr live"].filter(Boolean).join(" · ");
}

function showState(moment, ended, cut) {
  const pill = byId("state"), row = moment.rows[moment.rowCount - 1], nodes = moment.nodes;
  const node = nodes?.nodes.find((item) => item.name === "localisation_node"), word = stateOf(moment);
  const compiling = nodes?.nodes.find((item) => item.message.toLowerCase().startsWith("compiling"));
  if (cut) setPill(pill, "stale", "○", "not known");
  else if (!row && compiling) setPill(pill, "open", "…", `${short(compiling)} ${compiling.message}`);
  else if (!row) setPill(pill, "open", "…", "no pose yet");
  else if (ended) setPill(pill, row.lost ? "fail" : "stale", "■", `last: ${word}`);
  else if (nodes?.stale || node?.stale) setPill(pill, "stale", "○", `stale: no pose for ${(nodes.topics["localisation/odometry"]?.age_s ?? 0).toFixed(1)} s`);
  else if (row.lost) setPill(pill, "fail", "✖", word);
  else setPill(pill, word.startsWith("degraded") ? "open" : "pass", word.startsWith("degraded") ? "!" : "✔", word);
}

function showNodesPill(nodes, ended, cut) {
  const pill = byId("nodes-pill"), all = nodes?.nodes ?? [], names = (some) => some.map(short).join(", ");
  const stale = ended ? [] : all.filter((node) => node.stale), bad = all.filter((node) => node.level === "error" && !node.stale);
  const warned = all.filter((node) => node.level === "warning");
  if (!all.length) setPill(pill, "open", "…", "no node yet");
  else if (cut) setPill(pill, "stale", "○", "nodes not known");
  else if (ended) setPill(pill, "stale", "■", `${all.length} nodes ended`);
  else if (bad.length) setPill(pill, "fail", "✖", `${names(bad)}: error`, bad[0].message);
  else if (stale.length) setPill(pill, "stale", "○", `${names(stale)}: ${stale.every((node) => node.in_graph === false) ? "gone" : "silent"}`);
  else if (warned.length) setPill(pill, "open", "!", `${names(warned)}: warning`, warned[0].message);
  else setPill(pill, "pass", "✔", `${all.length} nodes`);
}
