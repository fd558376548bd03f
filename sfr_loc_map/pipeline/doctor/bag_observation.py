"""Observes a bag."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.bag import Bag, Topic
from sfr_loc_map.io.bag_poses import read_extrinsics
from sfr_loc_map.io.bag_sequence import LOCSB_FRAME, RB_FRAME
from sfr_loc_map.pipeline.doctor.observation import (
    EXPECTED,
    MESSAGES_KEPT,
    Observation,
    ObservedTopic,
    allowed_types,
)


def observe_bag(path: Path, remap: Mapping[str, str], *, extrinsics_given: bool) -> Observation:
    """Observe a bag: all stamps, a few messages.

    Args:
        path: Folder of the bag, or one storage file.
        remap: New names by the names in the bag.
        extrinsics_given: Whether a parameter file has the extrinsics of the stereo rig.
    """
    subject = f"bag '{path}'"
    try:
        bag = Bag(path, remap)
    except InputError as error:
        return Observation(subject, live=False, broken=str(error))
    names: dict[str, list[str]] = {name: bag.matches(name) for name in EXPECTED}
    topics = {n: ObservedTopic(f[0], (bag.topics[f[0]],)) for n, f in names.items() if len(f) == 1}
    in_tf, broken = False, ""
    collector = _Collector(bag, {n: t for n, t in topics.items() if t.types[0] in allowed_types(n)})
    try:
        collector.read()
        in_tf = read_extrinsics(bag, RB_FRAME, LOCSB_FRAME) is not None
    except InputError as error:
        broken = str(error)
    return Observation(
        subject,
        live=False,
        topics=topics | collector.topics,
        ambiguous={name: tuple(found) for name, found in names.items() if len(found) > 1},
        others={name: (kind,) for name, kind in bag.topics.items()},
        extrinsics_given=extrinsics_given,
        extrinsics_in_tf=in_tf,
        broken=broken,
        unfinished=bag.unfinished,
    )


class _Collector:
    """Collects stamps and first messages of topics; what was read before an error stays."""

    def __init__(self, bag: Bag, topics: Mapping[str, ObservedTopic]) -> None:
        self._bag, self._topics = bag, topics
        self._stamps: dict[str, list[int]] = {name: [] for name in topics}
        self._messages: dict[str, list[Any]] = {name: [] for name in topics}

    def read(self) -> None:
        """Read the bag.

        Raises:
            InputError: If it is broken.
        """
        for topic, stamp_ns, raw in self._bag.stream([Topic(n, t.found, t.types[0]) for n, t in self._topics.items()]):
            self._stamps[topic.name].append(stamp_ns)
            if len(self._messages[topic.name]) < MESSAGES_KEPT:
                self._messages[topic.name].append(self._bag.deserialise(topic, raw))

    @property
    def topics(self) -> dict[str, ObservedTopic]:
        """The topics with what was read."""
        return {
            name: ObservedTopic(
                topic.found,
                topic.types,
                stamps_ns=np.array(self._stamps[name], np.int64),
                messages=tuple(self._messages[name]),
            )
            for name, topic in self._topics.items()
        }
