"""Topics of a recording that are probably the ground truth, by their types and names."""

from __future__ import annotations

from collections.abc import Sequence

from sfr_loc_map.io.truth.messages import TRUTH_TYPES
from sfr_loc_map.io.truth.names import NO_TRUTH, TRUTH_WORDS, snake_case
from sfr_loc_map.message_types import POINT
from sfr_loc_map.source_setup.seen_topics import SeenTopic


def truths_of(seen: Sequence[SeenTopic]) -> list[SeenTopic]:
    """Return the topics that match the most reliable of TRUTH_WORDS; if all are of one body, those of the best type."""
    able = [topic for topic in seen if topic.msgtype in TRUTH_TYPES and not NO_TRUTH.search(snake_case(topic.name))]
    ranks = ([t for t in able if pattern.search(f"{snake_case(t.name)} {t.msgtype}")] for pattern in TRUTH_WORDS)
    best = next(filter(None, ranks), [])
    best = [topic for topic in best if topic.msgtype != POINT] or best  # poses have more information
    if len({topic.name.rpartition("/")[0] for topic in best}) != 1:
        return best
    order = list(TRUTH_TYPES)
    kind = min((topic.msgtype for topic in best), key=order.index)
    return [topic for topic in best if topic.msgtype == kind]
