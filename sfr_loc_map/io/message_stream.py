"""A source as a stream of serialised messages in the order of their publication.

The messages of a bag that is played as recorded are passed on unchanged. Other sources give the messages that
`BagWriter` writes, without /tf_static. Camera_info and true points precede the images, because subscribers need both
first.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.io.bag.bag import Bag
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.message_types import CAMERA_INFO, COMPRESSED, IMAGE, ODOMETRY, POINTS, POSE
from sfr_loc_map.suite_names import SIDES
from sfr_loc_map.topics import COMPRESSED_END, NAV_POSE, RECTIFIED, TRUE_POINTS, TRUE_POSES


@dataclass(frozen=True, slots=True)
class Message:
    """A message to be published: relative topic name in the suite, type, header stamp, and serialised data (CDR)."""

    topic: str
    msgtype: str
    stamp_ns: int
    raw: bytes

    @property
    def rig(self) -> str:
        """Stereo rig whose clock stamps the message: `loc` or `nav`."""
        return "nav" if self.topic.startswith("nav/") or self.topic == TRUE_POINTS else "loc"


def topics_of(source: Source) -> dict[str, str]:
    """Return the types of the topics on which `messages_of` may yield messages, by relative name.

    The topics of camera_info come first. A topic of a recorded bag may have no message, and mapping pairs of other
    sources may have no true points.
    """
    rigs = [rig for rig, sequence in (("loc", source.loc), ("nav", source.nav)) if sequence is not None]
    cameras = [f"{rig}/{side}" for rig in rigs for side in SIDES]
    topics = {f"{camera}/camera_info": CAMERA_INFO for camera in cameras}
    topics |= {f"{camera}/{RECTIFIED}": IMAGE for camera in cameras}
    recorded = source.recorded
    if source.loc is not None and (recorded is not None or source.loc.ground_truth is not None):
        topics[TRUE_POSES] = ODOMETRY
    if source.nav is not None:
        topics |= {NAV_POSE: POSE, TRUE_POINTS: POINTS}
    if recorded is None:
        return topics
    bag = Bag(*recorded)
    recorded_topics = [bag.find(name, *((IMAGE, COMPRESSED) if kind == IMAGE else ())) for name, kind in topics.items()]
    return {topic.name: topic.msgtype for topic in recorded_topics if topic is not None}


def messages_of(source: Source) -> Iterator[Message]:
    """Yield the messages of a source. Those of a recorded bag begin with the first camera_info of each camera."""
    if source.recorded is not None:
        bag = Bag(*source.recorded)
        names = [name.removesuffix(COMPRESSED_END) for name in topics_of(source)]
        infos = {name for name in names if name.endswith("camera_info")}
        for raw in bag.raw_messages(sorted(infos)):
            if raw[0] in infos:
                infos.remove(raw[0])
                yield Message(*raw)
            if not infos:
                break
        for raw in bag.raw_messages(names):
            yield Message(*raw)
        return
    if (loc := source.loc) is not None:
        truth = loc.ground_truth or Truth.empty()
        rows = zip(truth.stamps_ns.tolist(), truth.positions, truth.quats_xyzw, strict=True)
        poses = ((row[0], [_message(TRUE_POSES, row[0], bag_messages.odometry(*row))]) for row in rows)
        pairs = ((pair.stamp_ns, _pair_messages("loc", loc.rig, pair)) for pair in loc.pairs())
        for _, messages in heapq.merge(poses, pairs, key=itemgetter(0)):
            yield from messages
    if (nav := source.nav) is not None:
        for item in nav.pairs():
            stamp_ns = item.pair.stamp_ns
            yield _message(NAV_POSE, stamp_ns, bag_messages.pose(stamp_ns, item.T_lm_navsb))
            if item.truth is not None:
                yield _message(TRUE_POINTS, stamp_ns, bag_messages.points(stamp_ns, item.truth, None))
            yield from _pair_messages("nav", nav.rig, item.pair)


def _pair_messages(name: str, rig: StereoRig, pair: StereoPair) -> Iterator[Message]:
    stamp_ns = pair.stamp_ns
    for side in SIDES:
        info = bag_messages.camera_info(stamp_ns, rig, name, side)
        yield _message(f"{name}/{side}/camera_info", stamp_ns, info)
    for side in SIDES:
        image = bag_messages.image(stamp_ns, getattr(pair, side), name, side)
        yield _message(f"{name}/{side}/{RECTIFIED}", stamp_ns, image)


def _message(topic: str, stamp_ns: int, message: Any) -> Message:  # noqa: ANN401 - types of rosbags
    raw = bytes(TYPESTORE.serialize_cdr(message, message.__msgtype__))
    return Message(topic, message.__msgtype__, stamp_ns, raw)
