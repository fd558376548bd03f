"""Pairs of left and right images among the topics of a recording, and the camera_info of each image."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from enum import IntEnum
from os.path import commonprefix
from typing import NamedTuple

from sfr_loc_map.io.truth.names import snake_case, words
from sfr_loc_map.message_types import CAMERA_INFO, COMPRESSED
from sfr_loc_map.source_setup.seen_topics import SeenTopic, image_kind

FEWEST = 0.5  #: Smallest ratio between the numbers of left and right images.
_CAMERA = "(?:cam|camera|fisheye|image|img|eye|ir|mono|sensor)?"
SIDE_WORDS = words(rf"(?:{_CAMERA}|infra(?:red_?)?)(left|right|[lr]|(?<=infra)[12]|(?<=infrared_)[12]){_CAMERA}")
NUMBERS = words(rf"{_CAMERA}(0?[012])")
RIGHT_OF = {"left": "right", "l": "r", "0": "1", "1": "2", "00": "01", "01": "02"}
"""The side word or number of the right camera by that of the left camera."""
GREY = words("gr[ae]y", "mono")
COLOUR = words("colou?r", "rgb8?", "bgr8?")
STEREO = words("stereo")
OF_NAV = "(?:nav|pan|pantilt|ptu|mast|head)_?(?:cams?|camera)?"
LOC, NAV = words("loc(?:cam)?", "front"), words(OF_NAV)


class Basis(IntEnum):
    """Property that distinguishes the left from the right image of a pair, the most reliable first."""

    SIDE_WORD = 0
    FRAME = 1
    NUMBER = 2

    @property
    def text(self) -> str:
        """The property in words."""
        return ("side word", "side word of the frame", "number")[self]


class ImageOrder(NamedTuple):
    """Sort key of images; the smallest is preferred."""

    is_raw: bool
    is_compressed: bool
    negative_pixels: int
    colour: int  #: 0: grey, 1: not stated, 2: colour.
    name: str

    @property
    def without_name(self) -> tuple[bool | int, ...]:
        """The key without the name; images with equal keys are ambiguous."""
        return self[:-1]


def order_of(image: SeenTopic) -> ImageOrder:
    """Return the sort key of an image."""
    text, (width, height) = snake_case(image.name), image.size
    colour = 0 if GREY.search(text) else 2 if COLOUR.search(text) else 1
    return ImageOrder(
        image_kind(image) == "image_raw", image.msgtype == COMPRESSED, -width * height, colour, image.name
    )


class Rig(NamedTuple):
    """Topics of the left and right images of a pair of cameras."""

    left: SeenTopic
    right: SeenTopic
    basis: Basis
    prefix: str  #: Text before the side word.
    word: str  #: Side word of the left image.

    def has(self, pattern: re.Pattern[str]) -> bool:
        """Return whether a pattern matches the name or the frame of one of the images."""
        texts = (self.left.name, self.left.frame, self.right.name, self.right.frame)
        return any(pattern.search(snake_case(text)) for text in texts)

    def preference(self) -> tuple[bool | int, ...]:
        """Return the sort key of rigs. The smallest is preferred; rigs with equal keys are ambiguous."""
        image = order_of(self.left)
        of_names = (self.basis is Basis.NUMBER, not self.has(LOC), image.is_raw, image.is_compressed)
        return (*of_names, not self.has(STEREO), image.negative_pixels, image.colour)


# ---- pairs of images


class _Candidate(NamedTuple):
    """A left image, and the required name or frame of its right image; sorted by the first four fields."""

    basis: Basis
    replaces_all: bool  # whether all occurrences of the side word are replaced
    left_text: str
    right_text: str
    left: SeenTopic
    prefix: str  # text before the side word
    word: str  # side word of the left image


def pairs_of(images: Sequence[SeenTopic]) -> Iterator[Rig]:
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
        right = by_text.get((candidate.right_text, left.msgtype))
        if right is None or right == left:
            continue
        if not used & {left, right} and _can_be_pair(left, right):
            used |= {left, right}
            yield Rig(left, right, candidate.basis, candidate.prefix, candidate.word)


def _texts(image: SeenTopic) -> list[tuple[Basis, str]]:
    """Return the texts that may state the side of an image: its name if it has a side word, else its frame and name.

    The last part of the name is appended to the frame, so that several topics of one camera differ.
    """
    name = snake_case(image.name)
    if SIDE_WORDS.search(name):
        return [(Basis.SIDE_WORD, name)]
    return [(Basis.FRAME, f"{snake_case(image.frame)}/{name.rpartition('/')[2]}"), (Basis.NUMBER, name)]


def _candidates(image: SeenTopic) -> Iterator[_Candidate]:
    """Yield the candidates for the right image of an image that may be a left image.

    The side word is replaced in one place (`/stereo/left/image_left` and `/stereo/left/image_right` are a pair), or
    everywhere (`/left/image_left` and `/right/image_right` are a pair).
    """
    for basis, text in _texts(image):
        found = [*(NUMBERS if basis is Basis.NUMBER else SIDE_WORDS).finditer(text)]
        matches = found if basis is Basis.NUMBER else found[-1:]  # earlier words describe the location of the camera
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


# ---- camera_info


def info_of(rig: Rig, image: SeenTopic, seen: Sequence[SeenTopic]) -> SeenTopic | None:
    """Return the camera_info of an image of a rig; None if no camera_info belongs to the image.

    The camera_info whose name has the longest common prefix with the name of the image, in words, is chosen. The prefix
    must be longer than the prefix that the image of the other side has in common with this image. If there is no such
    camera_info, one in the folder of the image with the same side word is chosen. A camera_info whose last side word is
    that of the other side is never chosen.
    """
    own_word, other, other_word = rig.word, rig.right, RIGHT_OF[rig.word]
    if image == rig.right:
        own_word, other, other_word = other_word, rig.left, own_word
    pattern = NUMBERS if rig.basis is Basis.NUMBER else SIDE_WORDS

    def shared(topic: SeenTopic) -> int:
        return len(commonprefix([re.split("[/_]", snake_case(each.name)) for each in (topic, image)]))  # noqa: RUF071 - words

    def last_word(topic: SeenTopic) -> str:
        return next((str(match[1]) for match in reversed([*pattern.finditer(snake_case(topic.name))])), "")

    infos = [topic for topic in seen if topic.msgtype == CAMERA_INFO and last_word(topic) != other_word]
    infos = [topic for topic in infos if topic.size in ((0, 0), image.size) or image.size == (0, 0)]
    near = [topic for topic in infos if shared(topic) > shared(other)]
    folder = image.name.rpartition("/")[0]
    beside = [topic for topic in infos if last_word(topic) == own_word and topic.name.rpartition("/")[0] == folder]
    return min(
        near or beside,
        key=lambda info: (-shared(info), image_kind(info) != image_kind(image), len(info.name)),
        default=None,
    )
