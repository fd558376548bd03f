"""What the topics of other people's recordings are in the suite, by type, name, frame and size."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from os.path import commonprefix
from typing import NamedTuple

from sfr_loc_map.message_types import (
    CAMERA_INFO,
    COMPRESSED,
    FIX,
    IMAGE,
    JOINTS,
    ODOMETRY,
    PATH,
    POINT,
    POINTS,
    POSE,
    POSE_WITH_COVARIANCE,
    TRANSFORM,
)
from sfr_loc_map.topics import COMPRESSED_END, NAV_POSE, TRUE_POINTS
from sfr_loc_map.topics import JOINTS as JOINTS_TOPIC

IMAGES = (IMAGE, COMPRESSED)
POSES = (POSE_WITH_COVARIANCE, POSE, TRANSFORM)
TRUTHS = (ODOMETRY, *POSES, PATH, POINT, FIX)  #: The best one of a body first.
FEWEST = 0.5  #: Least share of one side's images in those of the other.
WIDE, TALL = 1.95, 0.95  #: Width by height of an image that holds two.


def _words(*words: str) -> re.Pattern[str]:
    return re.compile(rf"(?<![a-z0-9])(?:{'|'.join(words)})(?![a-z0-9])")


_CAMERA = "(?:cam|camera|fisheye|image|img|eye|ir|mono|sensor)?"
SIDE_WORDS = _words(rf"(?:{_CAMERA}|infra(?:red_?)?)(left|right|[lr]|(?<=infra)[12]|(?<=infrared_)[12]){_CAMERA}")
NUMBERS = _words(rf"{_CAMERA}(0?[012])")
RIGHT_OF = {"left": "right", "l": "r", "0": "1", "1": "2", "00": "01", "01": "02"}
BASES = ("side word", "side word of the frame", "number")  #: The surest one first.
NO_IMAGE = _words("(?:compressed_)?depth(?!_cam)", "disparity", "confidence", "mask", "segmentation", "debug", "zstd")
GREY, COLOUR, STEREO = _words("gr[ae]y", "mono"), _words("colou?r", "rgb8?", "bgr8?"), _words("stereo")
OF_NAV = "(?:nav|pan|pantilt|ptu|mast|head)_?(?:cams?|camera)?"
LOC, NAV = _words("loc(?:cam)?", "front"), _words(OF_NAV)
TRACKERS = _words(
    *("mocap", "motion_?capture", "opti_?track", "vicon", "vrpn", "qualisys", "leica", "prism", "total_?station")
)
TRUTH_WORDS = (
    re.compile("ground_truth/odometry "),
    _words("ground_?truth", "gt", "truth"),
    TRACKERS,
    _words("rtk"),
    re.compile("fix .*/NavSatFix"),
)  #: By rank, for the name and the type.
NO_TRUTH = _words("estimated?", "fused", "filtered", "origin", "set_?point", "slam", "vi?o")
OWN = _words("wheels?", "encoders?", "odom(?:etry)?", "visual", "zed_node", "goal", "initial_?pose")
"""Of topics with what the rover itself thinks or is told; those of TRUTH_WORDS apart."""
OTHERS = {
    NAV_POSE: (POSE, _words(rf"{OF_NAV}[/_]pose")),
    JOINTS_TOPIC: (JOINTS, _words("joints?")),
    TRUE_POINTS: (POINTS, _words("ground_?truth")),
}
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
    place: str  # what comes before the side
    word: str  # of the left side

    def has(self, words: re.Pattern[str]) -> bool:
        return any(words.search(_text(text)) for topic in self[:2] for text in (topic.name, topic.frame))

    def preference(self) -> tuple[bool | int, ...]:
        return self.rank == 2, not self.has(LOC), *_order(self.left)[:2], not self.has(STEREO), *_order(self.left)[2:-1]


def guess_topics(seen: Sequence[SeenTopic]) -> Guess:
    """Return what the topics are; where counts are known, topics without a message are omitted."""
    seen = sorted([topic for topic in seen if topic.count] or seen, key=lambda topic: topic.name)
    found: dict[str, tuple[str, str]] = {}
    remarks: list[str] = []

    def take(name: str, topics: Sequence[SeenTopic], reason: str) -> None:
        if len(topics) > 1:
            remarks.append(f"{name}: {', '.join(topic.name for topic in topics)} could be it; none is taken")
        elif topics:
            found[name] = topics[0].name, reason

    images = [topic for topic in seen if topic.msgtype in IMAGES and not NO_IMAGE.search(_text(topic.name))]
    images.sort(key=_order)
    rigs = {rig.place: rig for rig in sorted(_pairs(images), key=lambda r: (r.rank, _order(r.left)), reverse=True)}
    nav = [rig for rig in rigs.values() if rig.has(NAV) and not rig.place.endswith("/loc/")]
    loc = [rig for rig in rigs.values() if rig not in nav]
    if not loc and not any(rig.place.endswith("/nav/") for rig in nav):
        loc, nav = nav, []
    for task, of_task in (("loc", loc), ("nav", nav)):
        own = [rig for rig in of_task if rig.place.endswith(f"/{task}/")]  # the names of the suite
        ranked = sorted(own or of_task, key=_Rig.preference)
        best = [rig for rig in ranked if rig.preference() == ranked[0].preference()]
        if len(best) != 1:
            take(task, [rig.left for rig in best], "")
            continue
        left, right, rank, _, word = best[0]
        if len(ranked) > 1:
            remarks.append(f"{task}: {left.name} is taken, not {', '.join(rig.left.name for rig in ranked[1:])}")
        if "infra" in left.name.lower():
            remarks.append(EMITTER)
        how = "sure" if rank < 2 and len(ranked) == 1 else "likely"
        for side, image, other in (("left", left, right), ("right", right, left)):
            basis = f"{BASES[rank]} {word}/{RIGHT_OF[word]}, frame {image.frame or 'unknown'}; {how}"
            take(f"{task}/{side}/{_kind(image)}", [image], basis)
            take(f"{task}/{side}/camera_info", _infos(image, other, seen), f"nearest to {image.name}; {how}")
    double = [t for t in images if not rigs and t.size[1] > 0 and not TALL <= t.size[0] / t.size[1] <= WIDE]
    double = [image for image in double if _order(image)[:-1] == _order(double[0])[:-1]]
    layout = "" if len(double) != 1 else "side_by_side" if double[0].size[0] > double[0].size[1] else "top_bottom"
    take(f"loc/left/{_kind(double[0]) if layout else ''}", double, "its shape is that of two images; likely")
    for name, (msgtype, words) in OTHERS.items():
        named = [topic for topic in seen if topic.msgtype == msgtype and words.search(_text(topic.name))]
        named = [topic for topic in named if topic.name.count("/") == min(t.name.count("/") for t in named)]
        if msgtype == POINTS or "nav/left/" in " ".join(found):
            take(name, named, "its type and name; likely")
    truths = _truths(seen)
    take("truth", truths, f"its type and name; {'likely' if truths and truths[0].msgtype == FIX else 'sure'}")
    truth, truth_reason = found.pop("truth", ("", ""))
    topics, reasons = ({name: pair[k] for name, pair in found.items()} for k in (0, 1))
    return Guess(topics, reasons, layout, truth, truth_reason, tuple(remarks))


def is_tracker(name: str) -> bool:
    """Return whether a topic, frame or file is named after a system that tracks a body of its own."""
    return TRACKERS.search(_text(name)) is not None


def is_own(name: str) -> bool:
    """Return whether a topic is named after what the rover itself thinks, as wheel odometry: no truth."""
    text = _text(name)
    told = any(words.search(text) for words in TRUTH_WORDS)
    return NO_TRUTH.search(text) is not None or (OWN.search(text) is not None and not told)


def _text(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower().removesuffix(COMPRESSED_END)


def _kind(topic: SeenTopic) -> str:
    return "image_rect" if re.search("(?<![a-z0-9])rect", _text(topic.name)) else "image_raw"


def _order(image: SeenTopic) -> tuple[bool, bool, int, int, str]:
    text, (width, height) = _text(image.name), image.size
    colour = 0 if GREY.search(text) else 2 if COLOUR.search(text) else 1
    return _kind(image) == "image_raw", image.msgtype != IMAGES[0], -width * height, colour, image.name


def _pairs(images: Sequence[SeenTopic]) -> Iterator[_Rig]:
    options, by_text = [], dict[tuple[str, str], SeenTopic]()
    for image in images:
        name = _text(image.name)
        framed = f"{_text(image.frame)}/{name.rpartition('/')[2]}"
        texts = ((name, SIDE_WORDS), (framed, SIDE_WORDS), (name, NUMBERS))
        for rank, (text, words) in enumerate(texts[: 1 if SIDE_WORDS.search(name) else 3]):
            by_text.setdefault((text, image.msgtype), image)
            for match in [*words.finditer(text)][-1 if words is SIDE_WORDS else 0 :]:
                (start, end), word, right = match.span(1), match[1], RIGHT_OF.get(match[1], "?")
                for k, target in enumerate((text[:start] + right + text[end:], text.replace(word, right))):
                    options.append((rank, k, text, target, image, f"/{text[:start]}", word))
    used: set[SeenTopic] = set()
    for rank, _, _, target, left, place, word in sorted(options, key=lambda option: option[:4]):
        other = by_text.get((target, left.msgtype), left)
        few, many = sorted((left.count, other.count))
        sizes = {left.size, other.size} - {(0, 0)}
        if other != left and not used & {left, other} and few >= FEWEST * many and len(sizes) < 2:
            used |= {left, other}
            yield _Rig(left, other, rank, place, word)


def _infos(image: SeenTopic, other: SeenTopic, seen: Sequence[SeenTopic]) -> list[SeenTopic]:
    def shared(one: SeenTopic) -> int:
        return len(commonprefix([re.split("[/_]", _text(topic.name)) for topic in (one, image)]))  # noqa: RUF071 - words

    infos = [topic for topic in seen if topic.msgtype == CAMERA_INFO and shared(topic) > shared(other)]
    infos = [topic for topic in infos if topic.size in ((0, 0), image.size) or image.size == (0, 0)]
    return sorted(infos, key=lambda info: (-shared(info), _kind(info) != _kind(image), len(info.name)))[:1]


def _truths(seen: Sequence[SeenTopic]) -> list[SeenTopic]:
    able = [topic for topic in seen if topic.msgtype in TRUTHS and not NO_TRUTH.search(_text(topic.name))]
    ranks = ([t for t in able if words.search(f"{_text(t.name)} {t.msgtype}")] for words in TRUTH_WORDS)
    best = next(filter(None, ranks), [])
    best = [topic for topic in best if topic.msgtype != POINT] or best  # poses say more than a point
    of_one_body = len({topic.name.rpartition("/")[0] for topic in best}) == 1
    kind = min((topic.msgtype for topic in best), key=TRUTHS.index, default="")
    return [topic for topic in best if topic.msgtype == kind or not of_one_body]
