"""Looks at a bag."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.bag import COMPRESSED, Bag, Topic
from sfr_loc_map.io.bag_poses import read_static_transform
from sfr_loc_map.io.bag_sequence import LOCSB_FRAME, RB_FRAME
from sfr_loc_map.pipeline.doctor.observation import EXPECTED, PICTURES_KEPT, Observation, SeenTopic


def observe_bag(path: Path, remap: Mapping[str, str], *, place_given: bool) -> Observation:
    """Look at a bag: all stamps, a few messages.

    Args:
        path: Folder of the bag, or one storage file.
        remap: New names by the names in the bag.
        place_given: Whether a parameter file says where the stereo bench is.
    """
    subject = f"bag '{path}'"
    try:
        bag = Bag(path, remap)
    except InputError as error:
        return Observation(subject, live=False, broken=str(error))
    names: dict[str, list[str]] = {name: bag.matches(name) for name in EXPECTED}
    topics = {n: SeenTopic(f[0], (bag.topics[f[0]],)) for n, f in names.items() if len(f) == 1}
    right = {n: t for n, t in topics.items() if t.types[0] in _allowed(n)}
    stamps: dict[str, list[int]] = {name: [] for name in right}
    messages: dict[str, list[Any]] = {name: [] for name in right}
    broken = ""
    try:
        for topic, stamp_ns, raw in bag.stream([Topic(n, t.found, t.types[0]) for n, t in right.items()]):
            stamps[topic.name].append(stamp_ns)
            if len(messages[topic.name]) < PICTURES_KEPT:
                messages[topic.name].append(bag.deserialise(topic, raw))
        place = read_static_transform(bag, RB_FRAME, LOCSB_FRAME) is not None
    except InputError as error:
        broken, place = str(error), False
    for name, seen in right.items():
        values = np.array(stamps[name], np.int64)
        topics[name] = SeenTopic(seen.found, seen.types, stamps_ns=values, messages=tuple(messages[name]))
    return Observation(
        subject,
        live=False,
        topics=topics,
        ambiguous={name: tuple(found) for name, found in names.items() if len(found) > 1},
        others={name: (kind,) for name, kind in bag.topics.items()},
        place_given=place_given,
        place_in_frames=place,
        broken=broken,
        unfinished=bag.unfinished,
    )


def _allowed(name: str) -> tuple[str, ...]:
    return (*EXPECTED[name], COMPRESSED) if name.endswith("image_rect") else EXPECTED[name]
