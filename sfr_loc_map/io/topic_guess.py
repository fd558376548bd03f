"""What the topics of other people's recordings are in the suite, by type, name, frame and size."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import NamedTuple

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO, JOINTS, POINTS = (f"sensor_msgs/msg/{kind}" for kind in ("CameraInfo", "JointState", "PointCloud2"))
POSES = tuple(f"geometry_msgs/msg/{kind}Stamped" for kind in ("PoseWithCovariance", "Pose", "Transform"))
FIX = "sensor_msgs/msg/NavSatFix"
TRUTHS = (
    "nav_msgs/msg/Odometry",
    *POSES,
    "nav_msgs/msg/Path",
    FIX,
)  #: As `io.truth.TRUTH_TYPES`, the best one of a body first.
FEWEST = 0.5  #: Least share of one side's images in those of the other.
WIDE, TALL, TALL_STEREO = 1.95, 0.7, 0.95  #: Width by height of an image that holds two; the last one if named stereo.


def _words(*words: str) -> re.Pattern[str]:
    return re.compile(rf"(?<![a-z0-9])(?:{'|'.join(words)})(?![a-z0-9])")


_CAMERA = "(?:cam|camera|fisheye|image|img|eye|ir|mono|sensor)?"
SIDE_WORDS = _words(rf"{_CAMERA}(left|right){_CAMERA}", "([lr])", "infra(?:red)?_?([12])")
NUMBERS = _words(rf"{_CAMERA}(0?[012])")
RIGHT_OF = {"left": "right", "l": "r", "0": "1", "1": "2", "00": "01", "01": "02"}
BASES = ("side word", "side word of the frame", "number")  #: The surest one first.
NO_IMAGE = _words("(?:compressed_)?depth(?!_cam)", "disparity", "confidence", "mask", "segmentation", "debug", "zstd")
RECTIFIED = re.compile(r"(?<![a-z0-9])rect")
GREY, COLOUR, STEREO = _words("gr[ae]y", "mono"), _words("colou?r", "rgb8?", "bgr8?"), _words("stereo")
OF_NAV = "(?:nav|pan|pantilt|ptu|mast|head)_?(?:cams?|camera)?"
LOC, NAV = _words("loc(?:cam)?", "front"), _words(OF_NAV)
TRUTH_WORDS = (
    re.compile("ground_truth/odometry "),
    _words("ground_?truth", "gt", "truth"),
    _words("mocap", "motion_?capture", "opti_?track", "vicon", "vrpn", "qualisys", "leica", "prism", "total_?station"),
    *(_words("rtk"), re.compile("fix .*/navsatfix")),
)  #: By rank, for the name and the type.
NO_TRUTH = _words("estimated?", "fused", "filtered", "origin", "set_?point", "slam", "vi?o")
OTHERS = (
    ("nav/pose", POSES[1], _words(rf"{OF_NAV}[/_]pose")),
    ("joint_states", JOINTS, _words("joints?")),
    ("ground_truth/points", POINTS, _words("ground_?truth")),
)
EMITTER = "RealSense: the emitter must be off, for its pattern moves with the rover; P[3] of infra2 may be missing"


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
    """Names in the recording by those in the suite; for each what it was inferred from, and how sure."""

    topics: dict[str, str]
    reasons: dict[str, str]
    layout: str = ""  #: `side_by_side` or `top_bottom`, where the image of loc/left holds both.
    truth: str = ""  #: Topic; empty for none or unsure.
    truth_reason: str = ""
    remarks: tuple[str, ...] = ()


class _Rig(NamedTuple):
    left: SeenTopic
    right: SeenTopic
    rank: int  # in BASES
    place: str  # what stands before the side
    word: str  # of the left side

    def has(self, words: re.Pattern[str]) -> bool:
        return any(words.search(_text(text)) for topic in self[:2] for text in (topic.name, topic.frame))

    def preference(self) -> tuple[bool | int, ...]:
        return self.rank > 2, not self.has(LOC), not self.has(STEREO), *_order(self.left)[:-1]


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
    for rig in sorted(_pairs(images), key=lambda rig: (rig.rank, _order(rig.left))):
        rigs.setdefault(f"/{rig.place}", rig)
    nav = {place: rig for place, rig in rigs.items() if rig.has(NAV) and not place.endswith("/loc/")}
    loc = {place: rig for place, rig in rigs.items() if place not in nav}
    if not loc and not any(place.endswith("/nav/") for place in nav):
        loc, nav = nav, {}
    for task, of_task in (("loc", loc), ("nav", nav)):
        own = [rig for place, rig in of_task.items() if place.endswith(f"/{task}/")]  # the suite's names
        ranked = sorted(own or of_task.values(), key=_Rig.preference)
        best = [rig for rig in ranked if rig.preference() == ranked[0].preference()]
        if not take(task, [rig.left for rig in best], ""):
            continue
        left, right, rank, place, word = best[0]
        if len(ranked) > 1:
            remarks.append(f"{task}: {left.name} is taken, not {', '.join(rig.left.name for rig in ranked[1:])}")
        if "infra" in left.name.lower():
            remarks.append(EMITTER)
        del found[task]
        how = "sure" if rank < 2 and len(ranked) == 1 else "likely"
        for side, image, other in (("left", left, right), ("right", right, left)):
            basis = f"{BASES[rank]} {word}/{RIGHT_OF[word]}, frame {image.frame or 'unknown'}; {how}"
            take(f"{task}/{side}/{_kind(image)}", [image], basis)
            if not take(
                f"{task}/{side}/camera_info", _infos(image, other, seen)[:1], f"nearest to {image.name}; {how}"
            ):
                remarks.append(f"{image.name} has no camera_info: a calibration is needed")
    double = [image for image in images if _layout(image) and not rigs]
    double = [image for image in double if _order(image)[:-1] == _order(double[0])[:-1]]
    kinds = {(_kind(image), _layout(image)) for image in double}
    layout = "".join(
        layout for kind, layout in kinds if take(f"loc/left/{kind}", double, "its shape is of two images; likely")
    )
    for name, msgtype, words in OTHERS:
        named = [topic for topic in seen if topic.msgtype == msgtype and words.search(_text(topic.name))]
        named = [topic for topic in named if topic.name.count("/") == min(t.name.count("/") for t in named)]
        if msgtype == POINTS or "nav/left/" in " ".join(found):
            take(name, named, "its type and name; likely")
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


def _pairs(images: Sequence[SeenTopic]) -> Iterator[_Rig]:
    options, by_text = [], dict[tuple[str, str], SeenTopic]()
    for image in images:
        name = _text(image.name)
        framed = f"{_text(image.frame)}/{name.rpartition('/')[2]}"
        for rank, (text, words) in enumerate(((name, SIDE_WORDS), (framed, SIDE_WORDS), (name, NUMBERS))):
            by_text.setdefault((text, image.msgtype), image)
            sides = [(match[match.lastindex or 0], *match.span(match.lastindex or 0)) for match in words.finditer(text)]
            for k, places in enumerate([sides[-1:], sides] if words is SIDE_WORDS else [[side] for side in sides]):
                if places and all(word in RIGHT_OF for word, *_ in places):
                    options.append((rank, k, places, text, image))
            if sides and rank == 0:
                break
    used: set[SeenTopic] = set()
    for rank, _, places, text, left in sorted(options, key=lambda option: option[:4]):
        target = text
        for word, start, end in reversed(places):
            target = target[:start] + RIGHT_OF[word] + target[end:]
        right = by_text.get((target, left.msgtype), left)
        few, many = sorted((left.count, right.count))
        sized = left.size == right.size or (0, 0) in (left.size, right.size)
        if right != left and not used & {left, right} and few >= FEWEST * many and sized:
            used |= {left, right}
            yield _Rig(left, right, rank, text[: places[0][1]], places[0][0])


def _infos(image: SeenTopic, other: SeenTopic, seen: Sequence[SeenTopic]) -> list[SeenTopic]:
    """Return the camera_info of an image and not of the other side, the one in its namespace first."""

    def shared(one: SeenTopic, two: SeenTopic = image) -> int:
        words = zip(*(re.split("[/_]", _text(topic.name)) for topic in (one, two)), strict=False)
        return len([*takewhile(lambda pair: pair[0] == pair[1], words)])

    infos = [topic for topic in seen if topic.msgtype == INFO and shared(topic) > shared(other)]
    infos = [topic for topic in infos if topic.size == image.size or (0, 0) in (topic.size, image.size)]
    return sorted(infos, key=lambda info: (-shared(info), _kind(info) != _kind(image), len(info.name)))


def _truths(seen: Sequence[SeenTopic]) -> list[SeenTopic]:
    """Return the topics that could be the truth with equal right."""
    texts = {topic: f"{_text(topic.name)} {topic.msgtype.lower()}" for topic in seen if topic.msgtype in TRUTHS}
    texts = {topic: text for topic, text in texts.items() if not NO_TRUTH.search(text)}
    best = next(filter(None, ([t for t in texts if words.search(texts[t])] for words in TRUTH_WORDS)), [])
    if len({topic.name.rpartition("/")[0] for topic in best}) > 1:
        return best
    return [topic for topic in best if topic.msgtype == min((t.msgtype for t in best), key=TRUTHS.index)]  # of one body
