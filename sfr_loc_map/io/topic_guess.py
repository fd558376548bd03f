"""What the topics of other people's recordings are in the suite, by type, name, frame and size."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from os.path import commonprefix
from typing import NamedTuple

from sfr_loc_map.inputs import SIDES

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO, JOINTS, POINTS = (f"sensor_msgs/msg/{kind}" for kind in ("CameraInfo", "JointState", "PointCloud2"))
ODOMETRY, PATH, FIX = "nav_msgs/msg/Odometry", "nav_msgs/msg/Path", "sensor_msgs/msg/NavSatFix"
POSES = tuple(f"geometry_msgs/msg/{kind}Stamped" for kind in ("PoseWithCovariance", "Pose", "Transform"))
TRUTHS = (ODOMETRY, *POSES, PATH, FIX)  #: Types of `io.truth.TRUTH_TYPES`, the best one of a body first.
FEWEST = 0.5  #: Least share of one side's images in those of the other.
WIDE, TALL, TALL_STEREO = 1.95, 0.7, 0.95  #: Width by height of an image that holds two; the last one if named stereo.


def _words(*words: str) -> re.Pattern[str]:
    return re.compile(rf"(?<![a-z0-9])(?:{'|'.join(words)})(?![a-z0-9])")


_CAMERA = "(?:cam|camera|fisheye|image|img|eye|ir|mono|sensor)?"
SIDE_WORDS = _words(rf"{_CAMERA}(left|right){_CAMERA}", "([lr])", "infra(?:red)?_?([12])")
NUMBERS = _words(rf"{_CAMERA}(0?[012])")
RIGHT_OF = {"left": "right", "l": "r", "0": "1", "1": "2", "00": "01", "01": "02"}
BASES = ("side word", "side words", "side word of the frame", "number")  #: The surest one first.
NO_IMAGE = _words("(?:compressed_)?depth", "disparity", "confidence", "mask", "segmentation", "debug", "zstd")
RECTIFIED = re.compile(r"(?<![a-z0-9])rect")
GREY, COLOUR, STEREO = _words("gr[ae]y", "mono"), _words("colou?r", "rgb8?", "bgr8?"), _words("stereo")
LOC, NAV = _words("loc(?:cam)?", "front"), _words("(?:nav|pan|pantilt|ptu|mast|head)_?(?:cams?|camera|sb)?")
TRUTH_WORDS = (
    re.compile("ground_truth/odometry$"),
    _words("ground_?truth", "gt", "truth"),
    _words("mocap", "motion_?capture", "opti_?track", "vicon", "vrpn", "qualisys", "leica", "prism", "total_?station"),
    _words("rtk"),
    _words("fix"),
)  #: By rank; the last one of a NavSatFix alone.
NO_TRUTH = _words("estimated?", "fused", "filtered", "origin", "set_?point", "slam", "vi?o")
OTHERS = (
    ("nav/pose", POSES[1], NAV),
    ("joint_states", JOINTS, _words("joints?")),
    ("ground_truth/points", POINTS, TRUTH_WORDS[1]),
)
EMITTER = (
    "RealSense: the emitter must have been off, for its pattern moves with the rover; P[3] of infra2 may be missing"
)


@dataclass(frozen=True, slots=True)
class SeenTopic:
    """A topic of a recording: name and type, messages, frame of the first one, width and height of images, px."""

    name: str
    msgtype: str
    count: int = 0
    frame: str = ""
    size: tuple[int, int] = (0, 0)


@dataclass(frozen=True, slots=True)
class Guess:
    """Names in the recording by those in the suite; for each what it was inferred from, and how sure.

    `layout`: `side_by_side` or `top_bottom` where the image of loc/left holds both. `truth`: empty for none or unsure.
    """

    topics: dict[str, str]
    reasons: dict[str, str]
    layout: str = ""
    truth: str = ""
    truth_reason: str = ""
    remarks: tuple[str, ...] = ()


class _Rig(NamedTuple):
    images: tuple[SeenTopic, SeenTopic]
    rank: int  # in BASES
    place: str  # what stands before the side
    stems: tuple[str, str]  # what the names of the other topics of a camera begin with

    def has(self, words: re.Pattern[str]) -> bool:
        return any(words.search(_text(text)) for topic in self.images for text in (topic.name, topic.frame))

    def preference(self) -> tuple[bool, ...]:
        return self.rank > 2, not self.has(LOC), *_order(self.images[0])[:2], not self.has(STEREO)


def guess_topics(seen: Sequence[SeenTopic]) -> Guess:
    """Return what the topics are; where counts are known, topics without a message are left out."""
    seen = sorted([topic for topic in seen if topic.count] or seen, key=lambda topic: topic.name)
    found: dict[str, tuple[str, str]] = {}
    remarks: list[str] = []

    def take(name: str, topics: Sequence[SeenTopic], reason: str) -> bool:
        if len(topics) > 1:
            remarks.append(f"{name}: {', '.join(topic.name for topic in topics)} could be it; none is taken")
        elif topics:
            found[name] = topics[0].name, reason
        return len(topics) == 1

    images = [topic for topic in seen if topic.msgtype in IMAGES and not NO_IMAGE.search(_text(topic.name))]
    images.sort(key=_order)
    rigs: dict[str, _Rig] = {}
    for rig in sorted(_pairs(images), key=lambda rig: (rig.rank, _order(rig.images[0]))):
        rigs.setdefault(rig.place, rig)
    nav = [rig for rig in rigs.values() if rig.has(NAV) and not rig.place.endswith("/loc/")]
    loc = [rig for rig in rigs.values() if rig not in nav]
    if not loc and not any(rig.place.endswith("/nav/") for rig in nav):
        loc, nav = nav, []
    for task, of_task in (("loc", loc), ("nav", nav)):
        of_task = [rig for rig in of_task if rig.place.endswith(f"/{task}/")] or of_task  # the suite's own names
        best = [rig for rig in of_task if rig.preference() == min(other.preference() for other in of_task)]
        if not take(task, [rig.images[0] for rig in best], ""):
            continue
        left, _ = found.pop(task)
        if len(of_task) > 1:
            remarks.append(f"{task}: of {', '.join(rig.images[0].name for rig in of_task)} {left} is taken")
        if best[0].place.endswith(("infra", "infrared_")):
            remarks.append(EMITTER)
        how = "sure" if best[0].rank < 2 and len(of_task) == 1 else "likely"
        if best[0].rank < 2 and [word for word, *_ in _sides(SIDE_WORDS, best[0].images[0].frame)][-1:] in (
            ["right"],
            ["r"],
        ):
            how = "unsure: the frame is of the other side"
        for side, image, stem in zip(SIDES, best[0].images, best[0].stems, strict=True):
            basis = f"{BASES[best[0].rank]} {stem.rpartition('/')[2]}, frame {image.frame or 'unknown'}; {how}"
            take(f"{task}/{side}/{_kind(image)}", [image], basis)
            if not take(f"{task}/{side}/camera_info", _infos(image, stem, seen)[:1], f"nearest to {image.name}; {how}"):
                remarks.append(f"{image.name} has no camera_info: a calibration is needed")
    double = [image for image in images if _layout(image) and not rigs]
    double = [image for image in double if _order(image)[:-1] == _order(double[0])[:-1]]
    layout = ""
    if double and take(f"loc/left/{_kind(double[0])}", double, "its shape is that of two images; likely"):
        layout = _layout(double[0])
    for name, msgtype, words in OTHERS:
        named = [topic for topic in seen if topic.msgtype == msgtype and words.search(_text(topic.name))]
        exact = [topic for topic in named if f"/{topic.name}".endswith(f"/{name}")]
        if msgtype == POINTS or "nav/left/" in " ".join(found):
            take(name, exact if len(exact) == 1 else named, "its type and name; likely")
    truths = _truths(seen)
    take("truth", truths, f"its type and name; {'likely' if truths and truths[0].msgtype == FIX else 'sure'}")
    truth, truth_reason = found.pop("truth", ("", ""))
    topics, reasons = ({name: pair[k] for name, pair in found.items()} for k in (0, 1))
    return Guess(topics, reasons, layout, truth, truth_reason, tuple(remarks))


def _text(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower().removesuffix("/compressed")


def _kind(topic: SeenTopic) -> str:
    return "image_rect" if RECTIFIED.search(_text(topic.name)) else "image_raw"


def _order(image: SeenTopic) -> tuple[bool, bool, int, int, str]:
    text, (width, height) = _text(image.name), image.size
    colour = 0 if GREY.search(text) else 2 if COLOUR.search(text) else 1
    return _kind(image) == "image_raw", image.msgtype != IMAGES[0], -width * height, colour, image.name


def _layout(image: SeenTopic) -> str:
    width, height = image.size
    tall = TALL_STEREO if STEREO.search(_text(image.name)) else TALL
    return "" if not height else "side_by_side" if width >= WIDE * height else "top_bottom" * (width <= tall * height)


def _sides(words: re.Pattern[str], text: str) -> list[tuple[str, int, int]]:
    found = ((match, match.lastindex or 0) for match in words.finditer(_text(text)))
    return [(match[group], *match.span(group)) for match, group in found]


def _pairs(images: Sequence[SeenTopic]) -> Iterator[_Rig]:
    options, by_text = [], {}
    for image in images:
        text, sides = _text(image.name), _sides(SIDE_WORDS, image.name)
        framed = f"{_text(image.frame)}/{text.rpartition('/')[2]}"
        tries = [(0, text, sides[-1:]), (1, text, sides)]
        if not sides:
            numbers = [(3, text, [number]) for number in _sides(NUMBERS, text)]
            tries = [(2, framed, _sides(SIDE_WORDS, image.frame)[-1:]), *numbers]
        for rank, whole, places in tries:
            by_text.setdefault((whole, image.msgtype), image)
            if places and all(word in RIGHT_OF for word, *_ in places):
                options.append((rank, places, whole, image))
    used: set[str] = set()
    for rank, places, whole, left in sorted(options, key=lambda option: option[:3]):
        target = whole
        for word, start, end in reversed(places):
            target = target[:start] + RIGHT_OF[word] + target[end:]
        right = by_text.get((target, left.msgtype))
        if right is None or used & {left.name, right.name}:
            continue
        few, many = sorted((left.count, right.count))
        if few >= FEWEST * many and (left.size == right.size or (0, 0) in (left.size, right.size)):
            used |= {left.name, right.name}
            word, start, _ = places[0]
            place, sides = whole[:start], (word, RIGHT_OF[word])
            folders = tuple(f"{topic.name.rpartition('/')[0]}/".lower() for topic in (left, right))
            yield _Rig((left, right), rank, place, folders if rank == 2 else (place + word, place + RIGHT_OF[word]))


def _infos(image: SeenTopic, stem: str, seen: Sequence[SeenTopic]) -> list[SeenTopic]:
    """Return the camera_info of a camera, the one in the namespace of its image first."""
    infos = [topic for topic in seen if topic.msgtype == INFO and _text(topic.name).startswith(stem)]
    infos = [topic for topic in infos if topic.size == image.size or (0, 0) in (topic.size, image.size)]

    def distance(info: SeenTopic) -> tuple[int, bool, int]:
        shared = commonprefix((_text(image.name), _text(info.name)))  # noqa: RUF071 - by characters
        return -len(shared), _kind(info) != _kind(image), len(info.name)

    return sorted(infos, key=distance)


def _truths(seen: Sequence[SeenTopic]) -> list[SeenTopic]:
    """Return the topics that could be the truth with equal right."""
    ranked: dict[int, list[SeenTopic]] = {}
    for topic in seen:
        text = _text(topic.name)
        ranks = [k for k, words in enumerate(TRUTH_WORDS) if words.search(text) and (k < 4 or topic.msgtype == FIX)]
        if ranks and topic.msgtype in TRUTHS and not NO_TRUTH.search(text):
            ranked.setdefault(ranks[0], []).append(topic)
    best = ranked[min(ranked)] if ranked else []
    if len({topic.name.rpartition("/")[0] for topic in best}) > 1:
        return best
    return [topic for topic in best if topic.msgtype == min((t.msgtype for t in best), key=TRUTHS.index)]  # of one body
