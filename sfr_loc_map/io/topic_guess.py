"""What the topics of other people's recordings are in the suite, by type, name, frame and size."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from os.path import commonprefix
from typing import NamedTuple

from sfr_loc_map.inputs import SIDES

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CAMERA_INFO, JOINTS, POINTS = (f"sensor_msgs/msg/{kind}" for kind in ("CameraInfo", "JointState", "PointCloud2"))
POSE, FIX = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/NavSatFix"
TRUTHS = (
    *("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped", POSE),
    *("geometry_msgs/msg/TransformStamped", "nav_msgs/msg/Path", FIX),
)
"""Types of `io.truth.TRUTH_TYPES`, best first where one body has several topics."""
FEWEST = 0.5  #: Least share of one side's images in those of the other.
WIDE, TALL, TALL_STEREO = 1.95, 0.7, 0.95  #: Width by height of an image that holds two; the last one if named stereo.


def _words(*words: str) -> re.Pattern[str]:
    return re.compile(rf"(?<![a-z0-9])(?:{'|'.join(words)})(?![a-z0-9])")


_CAMERA = "(?:cam|camera|fisheye|image|img|eye|ir|mono|sensor)?"
SIDE_WORDS = _words(rf"{_CAMERA}(left|right){_CAMERA}", "([lr])", "infra(?:red)?_?([12])")
SIDE_NUMBERS = _words(rf"{_CAMERA}(0?[012])")
RIGHT_OF = {"left": "right", "l": "r", "0": "1", "1": "2", "00": "01", "01": "02"}
OWN = re.compile(
    r"(|.*/)((?:(?:loc|nav)/(?:left|right)/(?:image_rect|image_raw|camera_info))"
    r"|nav/pose|joint_states|ground_truth/points)(?:/compressed)?"
)
NO_IMAGE = _words(
    "(?:compressed_)?depth", "disparity", "confidence", "mask", "segmentation", "overlay", "debug", "zstd"
)
RECTIFIED = re.compile(r"(?<![a-z0-9])rect")
GREY, COLOUR = _words("gr[ae]y", "mono"), _words("colou?r", "rgb8?", "bgr8?")
SMALL = _words("resized?", "downscaled", "small", "half", "preview", "thumbnail")
OF_MAPPING = _words("(?:nav|pan|pantilt|ptu|mast|head)_?(?:cams?|camera|sb)?")
FIRST, STEREO = _words("loc(?:cam)?", "front"), _words("stereo")
TRUTH_WORDS = (
    _words("ground_?truth", "gt", "truth"),
    _words("mocap", "motion_?capture", "opti_?track", "vicon", "vrpn", "qualisys", "leica", "prism", "total_?station"),
    _words("rtk"),
    _words("fix"),
)
"""By rank."""
NO_TRUTH = _words("estimated?", "fused", "filtered", "origin", "set_?point", "slam", "vi?o")
EMITTER = (
    "RealSense: the emitter must have been off, for its pattern moves with the rover; where P[3] of infra2 is 0, "
    "the baseline is that of /tf_static"
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


class _Mark(NamedTuple):
    rank: int  # 0, 1: words in names; 2: words in frames; 3: numbers in names
    key: str  # without the side
    word: str
    rig: str  # what stands before the side
    stem: str  # what the names of the camera's other topics begin with


class _Pair(NamedTuple):
    left: SeenTopic
    right: SeenTopic
    marks: tuple[_Mark, _Mark]

    def has(self, pattern: re.Pattern[str]) -> bool:
        return any(pattern.search(_text(text)) for topic in self[:2] for text in (topic.name, topic.frame))

    def copies(self, other: _Pair) -> bool:
        """Say whether both are of one rig, whose images are there in colour, grey, smaller or compressed."""
        frames = self.left.frame, self.right.frame
        same = all(frames) and frames[0] != frames[1] and frames == (other.left.frame, other.right.frame)
        return self.marks[0].rig == other.marks[0].rig or (same and _order(self.left)[:-1] != _order(other.left)[:-1])


def guess_topics(seen: Sequence[SeenTopic]) -> Guess:
    """Return what the topics are; where counts are known, topics without a message are left out."""
    seen = sorted([topic for topic in seen if topic.count] or seen, key=lambda topic: topic.name)
    found: dict[str, tuple[str, str]] = {}
    remarks: list[str] = []
    _take_own(seen, found, remarks)
    images = [topic for topic in seen if topic.msgtype in IMAGES and not NO_IMAGE.search(_text(topic.name))]
    foreign = [topic for topic in images if not OWN.fullmatch(topic.name)]
    rigs: list[_Pair] = []
    for pair in sorted(_pairs(foreign), key=lambda pair: (pair.marks[0].rank, _order(pair.left))):
        if not any(pair.copies(rig) for rig in rigs):
            rigs.append(pair)
    mapping = [rig for rig in rigs if rig.has(OF_MAPPING)]
    driving = [rig for rig in rigs if rig not in mapping]
    if not driving and "loc/left/" not in " ".join(found):
        driving, mapping = mapping, []
    for task, candidates in (("loc", driving), ("nav", mapping)):
        if f"{task}/left/" not in " ".join(found):
            _take_rig(task, candidates, seen, found, remarks)
    layout = "" if found or rigs else _take_one_image(foreign, found, remarks)
    if "nav/left/" not in " ".join(found):
        for name in ("nav/pose", "joint_states"):  # of no use without images
            found.pop(name, None)
    elif "nav/pose" not in found:
        poses = [t.name for t in seen if t.msgtype == POSE and OF_MAPPING.search(_text(t.name))]
        _take_only("nav/pose", poses, "named as the mast; likely", found, remarks)
    if "ground_truth/points" not in found:
        clouds = [t.name for t in seen if t.msgtype == POINTS and TRUTH_WORDS[0].search(_text(t.name))]
        _take_only("ground_truth/points", clouds, "named as truth; sure", found, remarks)
    truth, truth_reason = _truth([topic for topic in seen if topic.msgtype in TRUTHS], remarks)
    topics, reasons = ({name: pair[k] for name, pair in found.items()} for k in (0, 1))
    return Guess(topics, reasons, layout, truth, truth_reason, tuple(remarks))


def _text(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower().removesuffix("/compressed")


def _order(topic: SeenTopic) -> tuple[bool, bool, int, bool, int, str]:
    text, (width, height) = _text(topic.name), topic.size
    colour = 0 if GREY.search(text) else 2 if COLOUR.search(text) else 1
    compressed = topic.msgtype != IMAGES[0]
    return not RECTIFIED.search(text), compressed, -width * height, bool(SMALL.search(text)), colour, topic.name


def _take_own(seen: Sequence[SeenTopic], found: dict[str, tuple[str, str]], remarks: list[str]) -> None:
    """Take what has the names of the suite, in the one namespace of the images."""
    kinds = {"camera_info": [CAMERA_INFO], "pose": [POSE], "joint_states": [JOINTS], "points": [POINTS]}
    own = [(match[1], match[2], topic) for topic in seen if (match := OWN.fullmatch(topic.name))]
    own = [item for item in own if item[2].msgtype in kinds.get(item[1].rpartition("/")[2], IMAGES)]
    rooms = sorted({room for room, name, _ in own if "/image_" in name})
    if len(rooms) > 1:
        remarks.append(f"the names of the suite are in several namespaces: {', '.join(rooms)}; choose one")
        return
    for name in dict.fromkeys(name for _, name, _ in own):
        at = [(room, topic) for room, other, topic in own if other == name]
        near = [item for item in at if item[0] in rooms] or at
        if len({room for room, _ in near}) == 1:
            found[name] = min((topic.name for _, topic in near), key=len), "the suite's own name; sure"


def _mark(rank: int, text: str, matches: Sequence[re.Match[str]], stem: str = "") -> _Mark:
    key = text
    for match in reversed(matches):
        start, end = match.span(match.lastindex or 0)
        key = f"{key[:start]}*{key[end:]}"
    before = text[: matches[0].start()]
    return _Mark(rank, key, matches[-1][matches[-1].lastindex or 0], before, stem or before[: before.rfind("/") + 1])


def _marks(topic: SeenTopic) -> Iterator[_Mark]:
    text, frame = _text(topic.name), _text(topic.frame)
    if words := list(SIDE_WORDS.finditer(text)):
        yield _mark(0, text, words[-1:])
        if len({word[word.lastindex or 0] for word in words}) == 1 < len(words):
            yield _mark(1, text, words)
        return
    if words := list(SIDE_WORDS.finditer(frame)):
        folder, _, last = text.rpartition("/")
        yield _mark(2, f"{frame} {last}", words[-1:], f"{folder}/")
    for number in SIDE_NUMBERS.finditer(text):
        yield _mark(3, text, [number], text[: number.end()])


def _pairs(images: Sequence[SeenTopic]) -> Iterator[_Pair]:
    groups: dict[tuple[int, str, str], dict[str, list[tuple[SeenTopic, _Mark]]]] = {}
    for topic in images:
        for mark in _marks(topic):
            group = groups.setdefault((mark.rank, mark.key, topic.msgtype), defaultdict(list))
            group[mark.word].append((topic, mark))
    used: set[str] = set()
    for _, group in sorted(groups.items(), key=lambda item: item[0]):
        for word, other in RIGHT_OF.items():
            lefts, rights = ([item for item in group[w] if item[0].name not in used] for w in (word, other))
            if len(lefts) != 1 or len(rights) != 1:
                continue
            (left, of_left), (right, of_right) = lefts[0], rights[0]
            few, many = sorted((left.count, right.count))
            if few >= FEWEST * many and (left.size == right.size or (0, 0) in (left.size, right.size)):
                used |= {left.name, right.name}
                yield _Pair(left, right, (of_left, of_right))


def _take_rig(
    task: str, rigs: Sequence[_Pair], seen: Sequence[SeenTopic], found: dict[str, tuple[str, str]], remarks: list[str]
) -> None:
    def preference(rig: _Pair) -> tuple[bool, bool, bool]:
        return rig.marks[0].rank > 2, not rig.has(FIRST), not rig.has(STEREO)

    rigs = sorted(rigs, key=preference)
    if len(rigs) > 1:
        tie = preference(rigs[0]) == preference(rigs[1])
        names = ", ".join(rig.left.name for rig in rigs)
        remarks.append(f"{task}: several pairs, {names}; {'none' if tie else 'the first'} is taken")
        rigs = [] if tie else rigs
    for rig in rigs[:1]:
        rank, key, left, *_ = rig.marks[0]
        frame_side = [word[word.lastindex or 0] for word in SIDE_WORDS.finditer(_text(rig.left.frame))][-1:]
        turned = rank < 2 and frame_side and frame_side[0] in ("right", "r", "2")
        sure = (
            "unsure: the frame is of the other side" if turned else "sure" if rank < 2 and len(rigs) == 1 else "likely"
        )
        basis = ("side word", "side words", "side word of the frames", "number")[rank]
        for side, topic, mark in zip(SIDES, rig[:2], rig.marks, strict=True):
            frame = f", frame {topic.frame}" if topic.frame else ""
            kind = "image_rect" if RECTIFIED.search(_text(topic.name)) else "image_raw"
            reason = f"{basis} {left}/{rig.marks[1].word}{frame}; {sure}"
            found[f"{task}/{side}/{kind}"] = topic.name, reason
            if info := _info_of(topic, mark, seen):
                found[f"{task}/{side}/camera_info"] = info, f"nearest to {topic.name}; {sure}"
            else:
                remarks.append(f"{topic.name} has no camera_info: a calibration is needed")
        if "infra" in key:
            remarks.append(EMITTER)


def _info_of(image: SeenTopic, mark: _Mark, seen: Sequence[SeenTopic]) -> str | None:
    """Return the camera_info in the namespace of an image, else the nearest one of the camera (ZED)."""
    text = _text(image.name)

    def fits(topic: SeenTopic) -> bool:
        other = _text(topic.name)
        words = [word[word.lastindex or 0] for word in SIDE_WORDS.finditer(other)]
        right = mark.rank > 1 or words[-1:] == [mark.word]
        sized = topic.size == image.size or (0, 0) in (topic.size, image.size)
        return topic.msgtype == CAMERA_INFO and other.startswith(mark.stem) and right and sized

    def nearness(topic: SeenTopic) -> tuple[int, bool, int, str]:
        other = _text(topic.name)
        shared = commonprefix([text.split("/"), other.split("/")])
        return -len(shared), bool(RECTIFIED.search(other)) != bool(RECTIFIED.search(text)), len(other), other

    return min((topic for topic in seen if fits(topic)), key=nearness, default=SeenTopic("", "")).name or None


def _take_only(
    name: str, topics: Sequence[str], reason: str, found: dict[str, tuple[str, str]], remarks: list[str]
) -> None:
    if len(topics) == 1:
        found[name] = topics[0], reason
    elif topics:
        remarks.append(f"{name}: several topics, {', '.join(topics)}; none is taken")


def _take_one_image(images: Sequence[SeenTopic], found: dict[str, tuple[str, str]], remarks: list[str]) -> str:
    """Take the image that holds both sides, and return how."""
    shaped = []
    for topic in sorted(images, key=_order):
        width, height = topic.size
        tall = TALL_STEREO if STEREO.search(_text(topic.name)) else TALL
        if height and (width >= WIDE * height or width <= tall * height):
            shaped.append(topic)
    best = [topic for topic in shaped if _order(topic)[:-1] == _order(shaped[0])[:-1]]
    kind = "image_rect" if shaped and RECTIFIED.search(_text(shaped[0].name)) else "image_raw"
    width, height = shaped[0].size if shaped else (0, 0)
    reason = f"{width} by {height} px are two images; likely"
    _take_only(f"loc/left/{kind}", [topic.name for topic in best], reason, found, remarks)
    return "" if len(best) != 1 else "side_by_side" if width > height else "top_bottom"


def _truth(candidates: Sequence[SeenTopic], remarks: list[str]) -> tuple[str, str]:
    """Return the topic of the truth and why; empty for none or several bodies."""
    ranks: dict[int, list[SeenTopic]] = defaultdict(list)
    for topic in candidates:
        text = _text(topic.name)
        for rank, words in enumerate(TRUTH_WORDS):
            if words.search(text) and not NO_TRUTH.search(text) and (rank < 3 or topic.msgtype == FIX):
                ranks[-1 if text.endswith("ground_truth/odometry") else rank].append(topic)
                break
    if not ranks:
        return "", ""
    best = sorted(ranks[min(ranks)], key=lambda topic: TRUTHS.index(topic.msgtype))
    bodies = {topic.name.rpartition("/")[0] for topic in best}
    if len(bodies) > 1 or len({topic.msgtype for topic in best}) < len(best):
        remarks.append(f"several topics could be the truth: {', '.join(topic.name for topic in best)}; none is taken")
        return "", ""
    kind = best[0].msgtype.rpartition("/")[2]
    return best[0].name, f"its name, {kind}; {'likely' if best[0].msgtype == FIX else 'sure'}"
