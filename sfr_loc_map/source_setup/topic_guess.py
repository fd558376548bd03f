"""Inference of the suite's names for the topics of a recording from their types, names, frames and image sizes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from os.path import commonprefix
from typing import NamedTuple

from sfr_loc_map.io.bag.bag import Bag, Topic
from sfr_loc_map.io.images.codec import claimed_size
from sfr_loc_map.io.truth.messages import TRUTH_TYPES
from sfr_loc_map.io.truth.names import NO_TRUTH, TRUTH_WORDS, plain_name, words
from sfr_loc_map.message_types import CAMERA_INFO, COMPRESSED, FIX, IMAGE, JOINTS, POINT, POINTS, POSE
from sfr_loc_map.topics import JOINTS as JOINTS_TOPIC
from sfr_loc_map.topics import NAV_POSE, TRUE_POINTS

IMAGES = (IMAGE, COMPRESSED)
FEWEST = 0.5  #: Smallest ratio between the numbers of left and right images.
WIDE, TALL = 1.95, 0.95  #: An image may contain both sides if its width / height is above `WIDE` or below `TALL`.
SENSOR_SHAPES = (1.0, 2448 / 2048, 5 / 4, 4 / 3, 3 / 2, 752 / 480, 8 / 5, 16 / 9)
"""Width / height of common sensors. An image contains both sides if its halves have such a shape."""
SHAPE_TOLERANCE = 0.02
"""Maximum relative difference between the shape of a half and a shape in `SENSOR_SHAPES`. The half of an image of a ZED
camera, 672 x 376, differs by 0.005 from the nearest shape. The half of a cropped KITTI image, 620 x 376, differs by
0.03."""

_CAMERA = "(?:cam|camera|fisheye|image|img|eye|ir|mono|sensor)?"
SIDE_WORDS = words(rf"(?:{_CAMERA}|infra(?:red_?)?)(left|right|[lr]|(?<=infra)[12]|(?<=infrared_)[12]){_CAMERA}")
NUMBERS = words(rf"{_CAMERA}(0?[012])")
RIGHT_OF = {"left": "right", "l": "r", "0": "1", "1": "2", "00": "01", "01": "02"}
"""The side word or number of the right camera by that of the left camera."""
NO_IMAGE = words("(?:compressed_)?depth(?!_cam)", "disparity", "confidence", "mask", "segmentation", "debug", "zstd")
GREY = words("gr[ae]y", "mono")
COLOUR = words("colou?r", "rgb8?", "bgr8?")
STEREO = words("stereo")
OF_NAV = "(?:nav|pan|pantilt|ptu|mast|head)_?(?:cams?|camera)?"
LOC, NAV = words("loc(?:cam)?", "front"), words(OF_NAV)
OTHERS = {
    NAV_POSE: (POSE, words(rf"{OF_NAV}[/_]pose")),
    JOINTS_TOPIC: (JOINTS, words("joints?")),
    TRUE_POINTS: (POINTS, words("ground_?truth")),
}
EMITTER = "RealSense: the emitter must be off because its pattern moves with the rover; P[3] of infra2 may be missing"


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
    looked_at = [
        Topic(name, name, kind) for name, kind in bag.topics.items() if kind in (IMAGE, COMPRESSED, CAMERA_INFO)
    ]
    frames, sizes = {}, {}
    for name, message in bag.first(looked_at).items():
        frames[name] = str(message.header.frame_id)
        if bag.topics[name] != COMPRESSED:
            sizes[name] = (int(message.width), int(message.height))
        elif size := claimed_size(bytes(message.data)):
            sizes[name] = size
    return [
        SeenTopic(n, kind, bag.counts[n], frames.get(n, ""), sizes.get(n, (0, 0))) for n, kind in bag.topics.items()
    ]


@dataclass(frozen=True, slots=True)
class Guess:
    """The recorded topic for each topic name of the suite, with the reason for each choice."""

    topics: dict[str, str]
    reasons: dict[str, str]
    layout: str = ""  #: `side_by_side` or `top_bottom`, if the images of loc/left contain both sides.
    truth: str = ""  #: Topic; empty if there is none or the choice is ambiguous.
    truth_reason: str = ""
    remarks: tuple[str, ...] = ()


class _Basis(IntEnum):
    """Property that distinguishes the left from the right image of a pair, the most reliable first."""

    SIDE_WORD = 0
    FRAME = 1
    NUMBER = 2

    @property
    def text(self) -> str:
        return ("side word", "side word of the frame", "number")[self]


class _ImageOrder(NamedTuple):
    """Sort key of images; the smallest is preferred."""

    is_raw: bool
    is_compressed: bool
    negative_pixels: int
    colour: int  # 0: grey, 1: not stated, 2: colour
    name: str

    @property
    def without_name(self) -> tuple[bool | int, ...]:
        return self[:-1]


def _order_of(image: SeenTopic) -> _ImageOrder:
    text, (width, height) = plain_name(image.name), image.size
    colour = 0 if GREY.search(text) else 2 if COLOUR.search(text) else 1
    return _ImageOrder(_kind(image) == "image_raw", image.msgtype == COMPRESSED, -width * height, colour, image.name)


class _Rig(NamedTuple):
    left: SeenTopic
    right: SeenTopic
    basis: _Basis
    prefix: str  # text before the side word
    word: str  # side word of the left image

    def has(self, pattern: re.Pattern[str]) -> bool:
        texts = (self.left.name, self.left.frame, self.right.name, self.right.frame)
        return any(pattern.search(plain_name(text)) for text in texts)

    def preference(self) -> tuple[bool | int, ...]:
        """Return the sort key of rigs. The smallest is preferred; rigs with equal keys are ambiguous."""
        image = _order_of(self.left)
        of_names = (self.basis is _Basis.NUMBER, not self.has(LOC), image.is_raw, image.is_compressed)
        return (*of_names, not self.has(STEREO), image.negative_pixels, image.colour)


@dataclass(slots=True)
class _Choices:
    """The recorded topics chosen so far for topic names of the suite, with the reason for each choice."""

    found: dict[str, tuple[str, str]] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)

    def take(self, name: str, topics: Sequence[SeenTopic], reason: str) -> None:
        """Choose the topic if only one is possible; a remark reports several."""
        if len(topics) == 1:
            self.found[name] = topics[0].name, reason
        else:
            self.report_ambiguous(name, topics)

    def report_ambiguous(self, name: str, topics: Sequence[SeenTopic]) -> None:
        """Add a remark if several topics are possible."""
        if len(topics) > 1:
            names = ", ".join(topic.name for topic in topics)
            self.remarks.append(
                f"{name}: several topics are possible ({names}), so none is chosen: choose one by --remap "
                "FOUND:=EXPECTED"
            )


def guess_topics(seen: Sequence[SeenTopic]) -> Guess:
    """Return the inferred topics; if counts are known, topics without a message are ignored."""
    seen = sorted([topic for topic in seen if topic.count] or seen, key=lambda topic: topic.name)
    images = [topic for topic in seen if topic.msgtype in IMAGES and not NO_IMAGE.search(plain_name(topic.name))]
    images.sort(key=_order_of)
    pairs = sorted(_pairs(images), key=lambda rig: (rig.basis, _order_of(rig.left)), reverse=True)
    rigs = list({rig.prefix: rig for rig in pairs}.values())  # of several pairs with one prefix, the last is the best

    choices = _Choices()
    loc, nav = _by_task(rigs)
    _choose_rig(choices, "loc", loc, seen)
    _choose_rig(choices, "nav", nav, seen)
    layout = "" if rigs else _choose_double_image(choices, images)
    _choose_others(choices, seen)
    truths = _truths(seen)
    how = "likely" if truths and truths[0].msgtype == FIX else "sure"
    choices.take("truth", truths, f"its type and name; {how}")

    truth, truth_reason = choices.found.pop("truth", ("", ""))
    topics = {name: topic for name, (topic, _) in choices.found.items()}
    reasons = {name: reason for name, (_, reason) in choices.found.items()}
    return Guess(topics, reasons, layout, truth, truth_reason, tuple(choices.remarks))


def _by_task(rigs: Sequence[_Rig]) -> tuple[list[_Rig], list[_Rig]]:
    """Return the possible rigs of localisation and of mapping."""
    nav = [rig for rig in rigs if rig.has(NAV) and not rig.prefix.endswith("/loc/")]
    loc = [rig for rig in rigs if rig not in nav]
    if not loc and not any(rig.prefix.endswith("/nav/") for rig in nav):
        return nav, []
    return loc, nav


def _choose_rig(choices: _Choices, task: str, rigs: Sequence[_Rig], seen: Sequence[SeenTopic]) -> None:
    """Choose the images and camera_info of a task: those with the names of the suite, else the preferred rig."""
    own = [rig for rig in rigs if rig.prefix.endswith(f"/{task}/")]
    ranked = sorted(own or rigs, key=_Rig.preference)
    best = [rig for rig in ranked if rig.preference() == ranked[0].preference()]
    if len(best) != 1:
        choices.report_ambiguous(task, [rig.left for rig in best])
        return
    left, right, basis, _, word = best[0]
    if len(ranked) > 1:
        others = ", ".join(rig.left.name for rig in ranked[1:])
        choices.remarks.append(f"{task}: {left.name} is chosen, not {others}")
    if "infra" in left.name.lower():
        choices.remarks.append(EMITTER)
    how = "sure" if basis is not _Basis.NUMBER and len(ranked) == 1 else "likely"
    for side, image in (("left", left), ("right", right)):
        reason = f"{basis.text} {word}/{RIGHT_OF[word]}, frame {image.frame or 'unknown'}; {how}"
        choices.take(f"{task}/{side}/{_kind(image)}", [image], reason)
        info = _infos(best[0], image, seen)
        choices.take(f"{task}/{side}/camera_info", info, f"nearest to {image.name}; {how}")


def _choose_double_image(choices: _Choices, images: Sequence[SeenTopic]) -> str:
    """Choose the topic whose images contain both sides, and return the layout; empty if there is no single topic."""
    double = [image for image in images if image.size[1] > 0 and not TALL <= image.size[0] / image.size[1] <= WIDE]
    double = [image for image in double if _order_of(image).without_name == _order_of(double[0]).without_name]
    if len(double) != 1:
        choices.report_ambiguous("loc/left/", double)
        return ""
    width, height = double[0].size
    if not _has_halves(width, height):
        choices.remarks.append(
            f"loc/left: images of '{double[0].name}' are {width} x {height}, but halves of this size are unusual: if "
            "they contain both sides, give the topic and calibration.stereo_layout"
        )
        return ""
    choices.take(f"loc/left/{_kind(double[0])}", double, "its shape is that of two images; likely")
    return "side_by_side" if width > height else "top_bottom"


def _has_halves(width: int, height: int) -> bool:
    """Return whether an image divides into two equal halves with the shape of a sensor."""
    is_wide = width > height
    divided = width if is_wide else height
    shape = width / 2 / height if is_wide else width / (height / 2)
    return divided % 2 == 0 and any(abs(shape / sensor - 1.0) <= SHAPE_TOLERANCE for sensor in SENSOR_SHAPES)


def _choose_others(choices: _Choices, seen: Sequence[SeenTopic]) -> None:
    """Choose the topics other than images; pose and joints only if mapping images were chosen."""
    has_nav = any(name.startswith("nav/left/") for name in choices.found)
    for name, (msgtype, pattern) in OTHERS.items():
        named = [topic for topic in seen if topic.msgtype == msgtype and pattern.search(plain_name(topic.name))]
        named = [topic for topic in named if topic.name.count("/") == min(t.name.count("/") for t in named)]
        if msgtype == POINTS or has_nav:
            choices.take(name, named, "its type and name; likely")


def _kind(topic: SeenTopic) -> str:
    return "image_rect" if re.search("(?<![a-z0-9])rect", plain_name(topic.name)) else "image_raw"


# ---- pairs of images


class _Candidate(NamedTuple):
    """A left image, and the required name or frame of its right image; sorted by the first four fields."""

    basis: _Basis
    replaces_all: bool  # whether all occurrences of the side word are replaced
    left_text: str
    right_text: str
    left: SeenTopic
    prefix: str  # text before the side word
    word: str  # side word of the left image


def _pairs(images: Sequence[SeenTopic]) -> Iterator[_Rig]:
    """Yield pairs of images. The candidates are tried in order, and each image belongs to at most one pair."""
    by_text = dict[tuple[str, str], SeenTopic]()
    candidates: list[_Candidate] = []
    for image in images:
        for _, text in _texts(image):
            by_text.setdefault((text, image.msgtype), image)
        candidates += _candidates(image)
    used: set[SeenTopic] = set()
    for candidate in sorted(candidates, key=lambda candidate: candidate[:4]):
        left = candidate.left
        right = by_text.get((candidate.right_text, left.msgtype), left)
        if right != left and not used & {left, right} and _can_be_pair(left, right):
            used |= {left, right}
            yield _Rig(left, right, candidate.basis, candidate.prefix, candidate.word)


def _texts(image: SeenTopic) -> list[tuple[_Basis, str]]:
    """Return the texts that may state the side of an image: its name if it has a side word, else its frame and name.

    The last part of the name is appended to the frame, so that several topics of one camera differ.
    """
    name = plain_name(image.name)
    if SIDE_WORDS.search(name):
        return [(_Basis.SIDE_WORD, name)]
    return [(_Basis.FRAME, f"{plain_name(image.frame)}/{name.rpartition('/')[2]}"), (_Basis.NUMBER, name)]


def _candidates(image: SeenTopic) -> Iterator[_Candidate]:
    """Yield the candidates for the right image of an image that may be a left image.

    The side word is replaced in one place (`/stereo/left/image_left` and `/stereo/left/image_right` are a pair), or
    everywhere (`/left/image_left` and `/right/image_right` are a pair).
    """
    for basis, text in _texts(image):
        found = [*(NUMBERS if basis is _Basis.NUMBER else SIDE_WORDS).finditer(text)]
        matches = found if basis is _Basis.NUMBER else found[-1:]  # earlier words describe the location of the camera
        for match in matches:
            word = match[1]
            if word in RIGHT_OF:
                prefix = f"/{text[: match.start(1)]}"
                equal = [other for other in found if other[1] == word]
                yield _Candidate(basis, False, text, _replaced(text, [match], RIGHT_OF[word]), image, prefix, word)
                yield _Candidate(basis, True, text, _replaced(text, equal, RIGHT_OF[word]), image, prefix, word)


def _replaced(text: str, matches: Sequence[re.Match[str]], word: str) -> str:
    """Return a text with another word in place of the first group of these matches."""
    for match in reversed(matches):
        start, end = match.span(1)
        text = text[:start] + word + text[end:]
    return text


def _can_be_pair(left: SeenTopic, right: SeenTopic) -> bool:
    """Return whether two topics have similar numbers of messages and, if both are known, equal image sizes."""
    few, many = sorted((left.count, right.count))
    sizes = {left.size, right.size} - {(0, 0)}
    return few >= FEWEST * many and len(sizes) < 2


def _infos(rig: _Rig, image: SeenTopic, seen: Sequence[SeenTopic]) -> list[SeenTopic]:
    """Return the camera_info of an image of a rig; empty if none belongs to the image.

    The name of the chosen camera_info shares as many initial words with the name of the image as possible, and more
    words than the image of the other side shares. If there is no such camera_info, one in the folder of the image with
    the same side word is chosen. A camera_info whose last side word is that of the other side is never chosen.
    """
    own_word, other, other_word = rig.word, rig.right, RIGHT_OF[rig.word]
    if image == rig.right:
        own_word, other, other_word = other_word, rig.left, own_word
    pattern = NUMBERS if rig.basis is _Basis.NUMBER else SIDE_WORDS

    def shared(topic: SeenTopic) -> int:
        return len(commonprefix([re.split("[/_]", plain_name(each.name)) for each in (topic, image)]))  # noqa: RUF071 - words

    def last_word(topic: SeenTopic) -> str:
        return next((str(match[1]) for match in reversed([*pattern.finditer(plain_name(topic.name))])), "")

    infos = [topic for topic in seen if topic.msgtype == CAMERA_INFO and last_word(topic) != other_word]
    infos = [topic for topic in infos if topic.size in ((0, 0), image.size) or image.size == (0, 0)]
    near = [topic for topic in infos if shared(topic) > shared(other)]
    folder = image.name.rpartition("/")[0]
    beside = [topic for topic in infos if last_word(topic) == own_word and topic.name.rpartition("/")[0] == folder]
    return sorted(near or beside, key=lambda info: (-shared(info), _kind(info) != _kind(image), len(info.name)))[:1]


def _truths(seen: Sequence[SeenTopic]) -> list[SeenTopic]:
    """Return the topics that match the most reliable of TRUTH_WORDS; if all are of one body, those of the best type."""
    able = [topic for topic in seen if topic.msgtype in TRUTH_TYPES and not NO_TRUTH.search(plain_name(topic.name))]
    ranks = ([t for t in able if pattern.search(f"{plain_name(t.name)} {t.msgtype}")] for pattern in TRUTH_WORDS)
    best = next(filter(None, ranks), [])
    best = [topic for topic in best if topic.msgtype != POINT] or best  # poses have more information
    if len({topic.name.rpartition("/")[0] for topic in best}) != 1:
        return best
    order = list(TRUTH_TYPES)
    kind = min((topic.msgtype for topic in best), key=order.index)
    return [topic for topic in best if topic.msgtype == kind]
