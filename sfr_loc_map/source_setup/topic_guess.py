"""Inference of the suite's names for the topics of a recording from their types, names, frames and image sizes.

`seen_topics` looks at the topics of a bag, and `image_pairs` forms pairs of left and right images. This module chooses
among the pairs, the images that contain both sides, and the topics of the ground truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from sfr_loc_map.io.truth.messages import TRUTH_TYPES
from sfr_loc_map.io.truth.names import NO_TRUTH, TRUTH_WORDS, snake_case, words
from sfr_loc_map.message_types import COMPRESSED, FIX, IMAGE, JOINTS, POINT, POINTS, POSE
from sfr_loc_map.source_setup.image_pairs import NAV, OF_NAV, RIGHT_OF, Basis, Rig, infos_of, order_of, pairs_of
from sfr_loc_map.source_setup.seen_topics import SeenTopic, image_kind
from sfr_loc_map.topics import JOINTS as JOINTS_TOPIC
from sfr_loc_map.topics import NAV_POSE, TRUE_POINTS

IMAGES = (IMAGE, COMPRESSED)
NO_IMAGE = words("(?:compressed_)?depth(?!_cam)", "disparity", "confidence", "mask", "segmentation", "debug", "zstd")
OTHERS = {
    NAV_POSE: (POSE, words(rf"{OF_NAV}[/_]pose")),
    JOINTS_TOPIC: (JOINTS, words("joints?")),
    TRUE_POINTS: (POINTS, words("ground_?truth")),
}
WIDE, TALL = 1.95, 0.95  #: An image may contain both sides if its width / height is above `WIDE` or below `TALL`.
SENSOR_SHAPES = (1.0, 2448 / 2048, 5 / 4, 4 / 3, 3 / 2, 752 / 480, 8 / 5, 16 / 9)
"""Width / height of common sensors. An image contains both sides if its halves have such a shape."""
SHAPE_TOLERANCE = 0.02
"""Maximum relative difference between the shape of a half and a shape in `SENSOR_SHAPES`. The half of an image of a ZED
camera, 672 x 376, differs by 0.005 from the nearest shape. The half of a cropped KITTI image, 620 x 376, differs by
0.03."""
EMITTER = "RealSense: the emitter must be off because its pattern moves with the rover; P[3] of infra2 may be missing"


@dataclass(frozen=True, slots=True)
class Guess:
    """The recorded topic for each topic name of the suite, with the reason for each choice."""

    topics: dict[str, str]
    reasons: dict[str, str]
    layout: str = ""  #: `side_by_side` or `top_bottom`, if the images of loc/left contain both sides.
    truth: str = ""  #: Topic; empty if there is none or the choice is ambiguous.
    truth_reason: str = ""
    remarks: tuple[str, ...] = ()


@dataclass(slots=True)
class _Choices:
    """The recorded topics chosen so far for topic names of the suite, with the reason for each choice."""

    chosen: dict[str, tuple[str, str]] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)

    def take(self, name: str, topics: Sequence[SeenTopic], reason: str) -> None:
        """Choose the topic if only one is possible; a remark reports several."""
        if len(topics) == 1:
            self.chosen[name] = topics[0].name, reason
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
    images = [topic for topic in seen if topic.msgtype in IMAGES and not NO_IMAGE.search(snake_case(topic.name))]
    images.sort(key=order_of)
    pairs = sorted(pairs_of(images), key=lambda rig: (rig.basis, order_of(rig.left)), reverse=True)
    rigs = list({rig.prefix: rig for rig in pairs}.values())  # of several pairs with one prefix, the last is the best

    choices = _Choices()
    loc, nav = _by_task(rigs)
    _choose_rig(choices, "loc", loc, seen)
    _choose_rig(choices, "nav", nav, seen)
    layout = "" if rigs else _choose_double_image(choices, images)
    _choose_others(choices, seen)
    truths = _truths_of(seen)
    certainty = "likely" if truths and truths[0].msgtype == FIX else "sure"
    choices.take("truth", truths, f"its type and name; {certainty}")

    truth, truth_reason = choices.chosen.pop("truth", ("", ""))
    topics = {name: topic for name, (topic, _) in choices.chosen.items()}
    reasons = {name: reason for name, (_, reason) in choices.chosen.items()}
    return Guess(topics, reasons, layout, truth, truth_reason, tuple(choices.remarks))


def _by_task(rigs: Sequence[Rig]) -> tuple[list[Rig], list[Rig]]:
    """Return the possible rigs of localisation and of mapping."""
    nav = [rig for rig in rigs if rig.has(NAV) and not rig.prefix.endswith("/loc/")]
    loc = [rig for rig in rigs if rig not in nav]
    if not loc and not any(rig.prefix.endswith("/nav/") for rig in nav):
        return nav, []
    return loc, nav


def _choose_rig(choices: _Choices, task: str, rigs: Sequence[Rig], seen: Sequence[SeenTopic]) -> None:
    """Choose the images and camera_info of a task: those with the names of the suite, else the preferred rig."""
    own = [rig for rig in rigs if rig.prefix.endswith(f"/{task}/")]
    ranked = sorted(own or rigs, key=Rig.preference)
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
    certainty = "sure" if basis is not Basis.NUMBER and len(ranked) == 1 else "likely"
    for side, image in (("left", left), ("right", right)):
        reason = f"{basis.text} {word}/{RIGHT_OF[word]}, frame {image.frame or 'unknown'}; {certainty}"
        choices.take(f"{task}/{side}/{image_kind(image)}", [image], reason)
        info = infos_of(best[0], image, seen)
        choices.take(f"{task}/{side}/camera_info", info, f"nearest to {image.name}; {certainty}")


def _choose_double_image(choices: _Choices, images: Sequence[SeenTopic]) -> str:
    """Choose the topic whose images contain both sides, and return the layout; empty if there is no single topic."""
    double = [image for image in images if _may_be_joint(*image.size)]
    double = [image for image in double if order_of(image).without_name == order_of(double[0]).without_name]
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
    choices.take(f"loc/left/{image_kind(double[0])}", double, "its shape is that of two images; likely")
    return _layout_of(width, height)


def _choose_others(choices: _Choices, seen: Sequence[SeenTopic]) -> None:
    """Choose the topics other than images; pose and joints only if mapping images were chosen."""
    has_nav = any(name.startswith("nav/left/") for name in choices.chosen)
    for name, (msgtype, pattern) in OTHERS.items():
        named = [topic for topic in seen if topic.msgtype == msgtype and pattern.search(snake_case(topic.name))]
        named = [topic for topic in named if topic.name.count("/") == min(t.name.count("/") for t in named)]
        if msgtype == POINTS or has_nav:
            choices.take(name, named, "its type and name; likely")


# ---- images that contain both sides


def _may_be_joint(width: int, height: int) -> bool:
    """Return whether an image is so wide or so tall that it may contain both sides; False for an unknown size."""
    return height > 0 and not TALL <= width / height <= WIDE


def _has_halves(width: int, height: int) -> bool:
    """Return whether an image divides into two equal halves with the shape of a sensor."""
    is_wide = width > height
    divided = width if is_wide else height
    shape = width / 2 / height if is_wide else width / (height / 2)
    return divided % 2 == 0 and any(abs(shape / sensor - 1.0) <= SHAPE_TOLERANCE for sensor in SENSOR_SHAPES)


def _layout_of(width: int, height: int) -> str:
    """Return the value of `calibration.stereo_layout` for a joint image of this size."""
    return "side_by_side" if width > height else "top_bottom"


# ---- ground truth


def _truths_of(seen: Sequence[SeenTopic]) -> list[SeenTopic]:
    """Return the topics that match the most reliable of TRUTH_WORDS; if all are of one body, those of the best type."""
    able = [topic for topic in seen if topic.msgtype in TRUTH_TYPES and not NO_TRUTH.search(snake_case(topic.name))]
    ranks = ([t for t in able if pattern.search(f"{snake_case(t.name)} {t.msgtype}")] for pattern in TRUTH_WORDS)
    best = next(filter(None, ranks), [])
    best = [topic for topic in best if topic.msgtype != POINT] or best  # poses have more information
    if len({topic.name.rpartition("/")[0] for topic in best}) != 1:
        return best
    order = list(TRUTH_TYPES)
    kind = min((topic.msgtype for topic in best), key=order.index)
    return [topic for topic in best if topic.msgtype == kind]
