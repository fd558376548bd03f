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
from sfr_loc_map.source_setup.image_pairs import NAV, OF_NAV, RIGHT_OF, Basis, Rig, info_of, order_of, pairs_of
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


@dataclass(slots=True)
class Guess:
    """The recorded topic for each topic name of the suite, with the reason for each choice."""

    topics: dict[str, str] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    layout: str = ""  #: `side_by_side` or `top_bottom`, if the images of loc/left contain both sides.
    truth: str = ""  #: Topic; empty if there is none or the choice is ambiguous.
    truth_reason: str = ""
    remarks: list[str] = field(default_factory=list)

    def choose(self, name: str, topic: SeenTopic, reason: str) -> None:
        """Choose a topic for a name of the suite."""
        self.topics[name] = topic.name
        self.reasons[name] = reason

    def only_of(self, name: str, topics: Sequence[SeenTopic]) -> SeenTopic | None:
        """Return the topic if only one is possible; a remark reports several."""
        if len(topics) == 1:
            return topics[0]
        if topics:
            names = ", ".join(topic.name for topic in topics)
            self.remarks.append(
                f"{name}: several topics are possible ({names}), so none is chosen: choose one by --remap "
                "FOUND:=EXPECTED"
            )
        return None


def guess_topics(seen: Sequence[SeenTopic]) -> Guess:
    """Return the inferred topics; if counts are known, topics without a message are ignored."""
    seen = sorted([topic for topic in seen if topic.count] or seen, key=lambda topic: topic.name)
    images = [topic for topic in seen if topic.msgtype in IMAGES and not NO_IMAGE.search(snake_case(topic.name))]
    images.sort(key=order_of)
    best_rig: dict[str, Rig] = {}
    for rig in sorted(pairs_of(images), key=lambda rig: (rig.basis, order_of(rig.left))):
        best_rig.setdefault(rig.prefix, rig)

    guess = Guess()
    loc, nav = _by_task(list(best_rig.values()))
    _choose_rig(guess, "loc", loc, seen)
    _choose_rig(guess, "nav", nav, seen)
    if not best_rig:
        _choose_double_image(guess, images)
    _choose_others(guess, seen)
    truth = guess.only_of("truth", _truths_of(seen))
    if truth is not None:
        guess.truth = truth.name
        guess.truth_reason = f"its type and name; {'likely' if truth.msgtype == FIX else 'sure'}"
    return guess


def _by_task(rigs: Sequence[Rig]) -> tuple[list[Rig], list[Rig]]:
    """Return the possible rigs of localisation and of mapping."""
    nav = [rig for rig in rigs if rig.has(NAV) and not rig.prefix.endswith("/loc/")]
    loc = [rig for rig in rigs if rig not in nav]
    if not loc and not any(rig.prefix.endswith("/nav/") for rig in nav):
        return nav, []
    return loc, nav


def _choose_rig(guess: Guess, task: str, rigs: Sequence[Rig], seen: Sequence[SeenTopic]) -> None:
    """Choose the images and camera_info of a task: those with the names of the suite, else the preferred rig."""
    own = [rig for rig in rigs if rig.prefix.endswith(f"/{task}/")]
    ranked = sorted(own or rigs, key=Rig.preference)
    best = [rig for rig in ranked if rig.preference() == ranked[0].preference()]
    if guess.only_of(task, [rig.left for rig in best]) is None:
        return
    left, right, basis, _, word = best[0]
    if len(ranked) > 1:
        others = ", ".join(rig.left.name for rig in ranked[1:])
        guess.remarks.append(f"{task}: {left.name} is chosen, not {others}")
    if "infra" in left.name.lower():
        guess.remarks.append(EMITTER)
    certainty = "sure" if basis is not Basis.NUMBER and len(ranked) == 1 else "likely"
    for side, image in (("left", left), ("right", right)):
        reason = f"{basis.text} {word}/{RIGHT_OF[word]}, frame {image.frame or 'unknown'}; {certainty}"
        guess.choose(f"{task}/{side}/{image_kind(image)}", image, reason)
        info = info_of(best[0], image, seen)
        if info is not None:
            guess.choose(f"{task}/{side}/camera_info", info, f"nearest to {image.name}; {certainty}")


def _choose_double_image(guess: Guess, images: Sequence[SeenTopic]) -> None:
    """Choose the topic whose images contain both sides, and their layout, if there is a single such topic."""
    double = [image for image in images if _may_be_joint(*image.size)]
    double = [image for image in double if order_of(image).without_name == order_of(double[0]).without_name]
    image = guess.only_of("loc/left/", double)
    if image is None:
        return
    width, height = image.size
    if not _has_halves(width, height):
        guess.remarks.append(
            f"loc/left: images of '{image.name}' are {width} x {height}, but halves of this size are unusual: if "
            "they contain both sides, give the topic and calibration.stereo_layout"
        )
        return
    guess.choose(f"loc/left/{image_kind(image)}", image, "its shape is that of two images; likely")
    guess.layout = "side_by_side" if width > height else "top_bottom"


def _choose_others(guess: Guess, seen: Sequence[SeenTopic]) -> None:
    """Choose the topics other than images; pose and joints only if mapping images were chosen."""
    has_nav = any(name.startswith("nav/left/") for name in guess.topics)
    for name, (msgtype, pattern) in OTHERS.items():
        if msgtype != POINTS and not has_nav:
            continue
        named = [topic for topic in seen if topic.msgtype == msgtype and pattern.search(snake_case(topic.name))]
        named = [topic for topic in named if topic.name.count("/") == min(t.name.count("/") for t in named)]
        topic = guess.only_of(name, named)
        if topic is not None:
            guess.choose(name, topic, "its type and name; likely")


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


# ---- ground truth


def _truths_of(seen: Sequence[SeenTopic]) -> list[SeenTopic]:
    """Return the topics that match the most reliable of TRUTH_WORDS; if all are of one body, those of the best type."""
    able = [topic for topic in seen if topic.msgtype in TRUTH_TYPES and not NO_TRUTH.search(snake_case(topic.name))]
    ranks = ([t for t in able if pattern.search(f"{snake_case(t.name)} {t.msgtype}")] for pattern in TRUTH_WORDS)
    best = next(filter(None, ranks), [])
    best = [topic for topic in best if topic.msgtype != POINT] or best  # poses have more information
    if len({topic.name.rpartition("/")[0] for topic in best}) != 1:
        return best
    kind = min((topic.msgtype for topic in best), key=TRUTH_TYPES.index)
    return [topic for topic in best if topic.msgtype == kind]
