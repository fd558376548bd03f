"""The topics of a recording, with the frame and the image size of their first messages."""

from __future__ import annotations

import re
from dataclasses import dataclass

from sfr_loc_map.io.bag.bag import Bag, Topic
from sfr_loc_map.io.image_codec import claimed_size
from sfr_loc_map.io.truth.names import snake_case
from sfr_loc_map.message_types import CAMERA_INFO, COMPRESSED, IMAGE


@dataclass(frozen=True, slots=True)
class SeenTopic:
    """A topic of a recording: name, type, number of messages, frame of the first message, and image size, px."""

    name: str
    msgtype: str
    count: int = 0
    frame: str = ""
    size: tuple[int, int] = (0, 0)


def seen_topics(bag: Bag) -> list[SeenTopic]:
    """Return the topics of a bag: type, number of messages, and frame and size of the first message."""
    with_size = [
        Topic(name, name, kind) for name, kind in bag.topics.items() if kind in (IMAGE, COMPRESSED, CAMERA_INFO)
    ]
    frames, sizes = {}, {}
    for name, message in bag.first(with_size).items():
        frames[name] = str(message.header.frame_id)
        if bag.topics[name] != COMPRESSED:
            sizes[name] = (int(message.width), int(message.height))
        elif size := claimed_size(bytes(message.data)):
            sizes[name] = size
    return [
        SeenTopic(n, kind, bag.counts[n], frames.get(n, ""), sizes.get(n, (0, 0))) for n, kind in bag.topics.items()
    ]


def image_kind(topic: SeenTopic) -> str:
    """Return the last part of the suite's name for an image: `image_rect` or `image_raw`."""
    return "image_rect" if re.search("(?<![a-z0-9])rect", snake_case(topic.name)) else "image_raw"
