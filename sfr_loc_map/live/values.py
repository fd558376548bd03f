"""The JSON values of a run, which the page, the terminal and `state.json` show.

The server sends `live_values`, `score_values` and `event_values` to a page as messages of the kinds `live`, `score` and
`events` (`messages`). The terminal draws the first two, and `state.json` contains all of them.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from sfr_loc_map.live.headline import headline
from sfr_loc_map.live.node_reports import LOCALISATION_NODE, state_of_pose
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.metrics.score.score import SCHEMA
from sfr_loc_map.topics import ESTIMATE

NO_SCORE: dict[str, Any] = {"schema": SCHEMA, "figures": [], "verdicts": []}  #: Report before the first score.
NO_SCORE_SHOWN: dict[str, Any] = {"overall": None, "tables": [], "limits": [], "errors": None, "warnings": []}
"""Displayed content before the first score."""


def state_json(state: LiveState, now_s: float) -> dict[str, Any]:
    """Return the latest score (`sfr-score/2`) with the state of the run as `live`."""
    with state.lock:
        live = live_values(state, now_s)
        shown = score_values(state)
        live |= {name: shown[name] for name in ("overall", "tables", "limits", "errors")}
        live |= event_values(state)
        content = NO_SCORE if state.score is None else state.score.content
    return content | {"live": live}


def score_values(state: LiveState) -> dict[str, Any]:
    """Return the verdict, tables, limits, errors and warnings of the latest score."""
    with state.lock:
        return NO_SCORE_SHOWN if state.score is None else state.score.plain


def event_values(state: LiveState) -> dict[str, Any]:
    """Return the events of the run, with times of the clock, s."""
    with state.lock:
        return {"events": state.timeline.to_plain()}


def live_values(state: LiveState, now_s: float) -> dict[str, Any]:
    """Return the headline, and the state of nodes, topics and localisation."""
    with state.lock:
        score = state.score
        newest = state.path.newest
        end = state.shown_end
        topics = state.topics.to_plain(now_s)
        age_s = _age_of_verdict_s(state, now_s)
        stale_reasons = _stale_reasons(state, now_s)
        shown = headline(
            None if score is None else score.overall,
            () if score is None else score.bars,
            age_s=age_s,
            stale_reasons=stale_reasons,
            end=end,
        )
        return {
            "schema": "sfr-live/1",
            "time_s": now_s,
            "stale": ESTIMATE in topics and topics[ESTIMATE]["stale"],
            "headline": asdict(shown),
            "age_s": age_s,
            "stale_reasons": stale_reasons,
            "ended": end.is_over,
            "ended_at": end.at_s,
            "aborted": {"by": end.aborted_by, "at": end.aborted_s} if end.aborted_by else None,
            "has_report": bool(end.report_page),
            "report_age_s": None if score is None else round(now_s - score.received_s, 3),
            "nodes": [state.nodes[name].to_plain(now_s) for name in sorted(state.nodes)],
            "topics": topics,
            "localisation": _localisation_values(state, now_s),
            "last_call": {node: call.to_plain() for node, call in state.calls.last_by_node.items()},
            "poses": 0 if newest is None else newest.n + 1,
            "problems": list(state.problems),
            "image_problems": {topic: text for topic, text in state.image_problems.items() if text},
        }


def _age_of_verdict_s(state: LiveState, now_s: float) -> float | None:
    """Return the age of the last score, or of the last pose or call if that is older; None without a score.

    A score is latched, so it may be received without any pose or call.
    """
    if state.score is None:
        return None
    pose = state.topics.by_name.get(ESTIMATE)
    results_s = [state.calls.last_received_s, None if pose is None else pose.received_s]
    last_result_s = max((at_s for at_s in results_s if at_s is not None), default=state.score.received_s)
    return round(now_s - min(state.score.received_s, last_result_s), 3)


def _stale_reasons(state: LiveState, now_s: float) -> list[str]:
    """Return why the displayed data are stale; empty after the end of the run."""
    if state.shown_end.is_over:
        return []
    silent = sorted(state.silent_nodes(now_s).items())
    return [*state.topics.silences(now_s), *(f"{name} silent for {now_s - since_s:.1f} s" for name, since_s in silent)]


def _localisation_values(state: LiveState, now_s: float) -> dict[str, Any] | None:
    """Return the last pose with its state and age; None before the first pose.

    `stale` states whether a newer pose is overdue, or the node has become silent.
    """
    row = state.path.newest
    if row is None:
        return None
    node = state.nodes.get(LOCALISATION_NODE)
    topic = state.topics.by_name.get(ESTIMATE)
    plain = row.to_plain()
    plain |= asdict(state_of_pose(None if node is None else node.call, covariance_is_lost=row.lost))
    is_overdue = topic is not None and topic.is_stale(now_s)
    plain["stale"] = is_overdue or LOCALISATION_NODE in state.silent_nodes(now_s)
    plain["age_s"] = round(max(now_s - (row.received_s if topic is None else topic.received_s), 0.0), 3)
    plain["distance_m"] += state.path.before_m
    return plain
