"""Which messages and pairs of a source are played between two positions, and which message completes a pair.

A position is the time after the first message of a rig, s.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

from sfr_loc_map.io.layouts.bag_source import BagLocSequence, BagNavSequence
from sfr_loc_map.io.message_stream import Message, messages_of
from sfr_loc_map.io.sequence import LocSequence, NavSequence, Source
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.suite_names import SIDES
from sfr_loc_map.topics import COMPRESSED_END, NAV_POSE, RECTIFIED, TRUE_POINTS


def pair_of_message(source: Source) -> dict[tuple[str, int], tuple[str, int]]:
    """Return the rig (`loc` or `nav`) and the stamp of the pair that contains a message, by its topic and stamp.

    The messages are the images and mapping poses, paired as in the source. Topics of compressed images are named
    without `/compressed`.
    """
    pair_of = {}
    for rig, sequence in (("loc", source.loc), ("nav", source.nav)):
        if sequence is None:
            continue
        pairs: Mapping[int, Mapping[str, int]]
        if source.recorded is not None and isinstance(sequence, BagLocSequence | BagNavSequence):
            pairs = sequence.index.pairs
        else:
            topics = [f"{rig}/{side}/{RECTIFIED}" for side in SIDES]
            topics += [NAV_POSE] if sequence is source.nav else []
            pairs = {stamp_ns: dict.fromkeys(topics, stamp_ns) for stamp_ns in sequence.stamps_ns}
        for pair_ns, messages in pairs.items():
            for topic, stamp_ns in messages.items():
                if topic != TRUE_POINTS:
                    pair_of[topic.removesuffix(COMPRESSED_END), stamp_ns] = (rig, pair_ns)
    return pair_of


class PairTracker:
    """Reports when all messages of a stereo pair, including a required pose, have been published."""

    def __init__(self, pair_of: Mapping[tuple[str, int], tuple[str, int]]) -> None:
        """Start before the first message; `pair_of` is the result of `pair_of_message`."""
        self._pair_of = pair_of
        self._missing = Counter(pair_of.values())  # unpublished messages of each pair

    def add(self, message: Message) -> tuple[str, int] | None:
        """Add a published message; return rig and stamp of the completed pair, or None."""
        pair = self._pair_of.get((message.topic.removesuffix(COMPRESSED_END), message.stamp_ns))
        if pair is None:
            return None
        self._missing[pair] -= 1
        return None if self._missing[pair] else pair


def between(messages: Iterator[Message], begin_s: float, end_s: float) -> Iterator[Message]:
    """Yield the messages between two positions. The first camera_info of each camera is always kept."""
    first: dict[str, int] = {}
    infos: set[str] = set()
    for message in messages:
        position_s = (message.stamp_ns - first.setdefault(message.rig, message.stamp_ns)) / NS_PER_S
        is_first_info = message.topic.endswith("camera_info") and message.topic not in infos
        if is_first_info:
            infos.add(message.topic)
        if is_first_info or begin_s <= position_s <= end_s:
            yield message


def pairs_between(source: Source, begin_s: float, end_s: float) -> int:
    """Return the number of pairs of a source between two positions, as in `between`."""
    count = 0
    for sequence in (source.loc, source.nav):
        if sequence is None or not len(sequence):
            continue
        begin_ns = begin_of(source, sequence)
        count += sum(begin_s <= (stamp_ns - begin_ns) / NS_PER_S <= end_s for stamp_ns in sequence.stamps_ns)
    return count


def end_of(source: Source) -> float:
    """Return the position of the last pair of a source: time after the first message of its rig, s."""
    sequences = [each for each in (source.loc, source.nav) if each is not None and len(each)]
    return max([0.0, *((each.stamps_ns[-1] - begin_of(source, each)) / NS_PER_S for each in sequences)])


def begin_of(source: Source, sequence: LocSequence | NavSequence) -> int:
    """Return the stamp, ns, of the first message of a rig in `messages_of`. Positions count from this stamp."""
    if source.recorded is not None:
        rig = "loc" if sequence is source.loc else "nav"
        return next(message.stamp_ns for message in messages_of(source) if message.rig == rig)
    first_ns = int(sequence.stamps_ns[0])
    truth = source.truth if sequence is source.loc else None
    return first_ns if truth is None else min(first_ns, int(truth.stamps_ns[0]))
