"""A drive whose images are files listed in advance: what the readers of foreign data sets share."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import read_table
from sfr_loc_map.io.image_codec import read_grey
from sfr_loc_map.io.text_numbers import parse_number, parse_stamp_ns

_log = logging.getLogger(__name__)
NAMED_FILES = 3
"""Missing files that a message names."""


class PairOfFiles(Protocol):
    """The two files of a pair."""

    @property
    def left(self) -> Path:
        """Left image."""
        ...

    @property
    def right(self) -> Path:
        """Right image."""
        ...


E = TypeVar("E", bound=PairOfFiles)


def whole_pairs(entries: Sequence[E], name: str) -> tuple[list[E], int]:
    """Return the pairs both images of which are there, and how many are not; warn of those in one line.

    Args:
        entries: At least one pair.
        name: What lists them, for messages.

    Raises:
        InputError: If none is left.
    """
    missing = [file for entry in entries for file in (entry.left, entry.right) if not file.is_file()]
    if not missing:
        return list(entries), 0
    gone = set(missing)
    whole = [entry for entry in entries if entry.left not in gone and entry.right not in gone]
    rest = f" and {len(missing) - NAMED_FILES} more" if len(missing) > NAMED_FILES else ""
    files = f"{', '.join(map(str, missing[:NAMED_FILES]))}{rest}"
    if not whole:
        raise InputError(f"{name} names images that are not there: {files}; restore them")
    left_out = len(entries) - len(whole)
    _log.warning("%s: %d of %d pairs left out, images are not there: %s", name, left_out, len(entries), files)
    return whole, left_out


@dataclass(frozen=True, slots=True)
class ImagePair:
    """The files of one pair."""

    stamp_ns: int
    left: Path
    right: Path


@dataclass(frozen=True, slots=True, eq=False)
class ImageFileSequence:
    """A drive of image files.

    Attributes:
        rig: Rig of the images after `rectify`.
        ground_truth: True poses of RB in DS, or None.
        entries: The files, in the order of stamps.
        size: Width and height that the files must have, pixels.
        rectify: Makes the rectified images of those read: left, right.
    """

    rig: StereoRig
    ground_truth: Trajectory | None
    entries: Sequence[ImagePair]
    size: tuple[int, int]
    rectify: Callable[[GreyImage, GreyImage], tuple[GreyImage, GreyImage]]

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Stamps of the pairs, in their order."""
        return tuple(entry.stamp_ns for entry in self.entries)

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self.entries)

    def pairs(self) -> Iterator[StereoPair]:
        """Yield the pairs, one in memory at a time.

        Raises:
            InputError: If an image is missing, broken or of another size.
        """
        for entry in self.entries:
            left, right = (self._read(path) for path in (entry.left, entry.right))
            yield StereoPair(entry.stamp_ns, *self.rectify(left, right))

    def _read(self, path: Path) -> GreyImage:
        image = read_grey(path)
        if image.shape != self.size[::-1]:
            found, wanted = f"{image.shape[1]} x {image.shape[0]}", f"{self.size[0]} x {self.size[1]}"
            raise InputError(f"image '{path}' is {found}: all images of the drive must be {wanted}")
        return image


def stamped_files(folder: Path, prefix: str, suffix: str) -> dict[int, Path]:
    """Return the files of a folder that are named by their stamps, in the order of these.

    Args:
        folder: The folder.
        prefix: What stands before the nanoseconds.
        suffix: What stands behind them; files that begin or end otherwise are passed over.

    Raises:
        InputError: If a name has no whole nanoseconds, two have the same, or there is none.
    """
    files: dict[int, Path] = {}
    for file in folder.iterdir():
        if file.name.startswith(prefix) and file.name.endswith(suffix):
            text = file.name[len(prefix) : len(file.name) - len(suffix)]
            try:
                stamp = parse_stamp_ns(text)
            except ValueError as error:
                raise InputError(f"image '{file}' is not named by whole nanoseconds: rename or remove it") from error
            if stamp in files:
                raise InputError(f"images '{files[stamp]}' and '{file}' have one stamp: remove one")
            files[stamp] = file
    if not files:
        raise InputError(f"'{folder}' has no image {prefix}STAMP{suffix}")
    return dict(sorted(files.items()))


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file that are not empty and no comment (`#`).

    Raises:
        InputError: If it is missing or no text.
    """
    try:
        lines = read_table(path).decode("utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"cannot read '{path}': {reason}; the data set needs it") from error
    return [line for line in lines if line.strip() and not line.lstrip().startswith("#")]


def numbers_of(words: Sequence[str], count: int, where: str) -> list[float]:
    """Return `count` finite numbers.

    Raises:
        InputError: If there are more or fewer, or one is no finite number.
    """
    try:
        values = [parse_number(word) for word in words]
    except ValueError as error:
        raise InputError(f"{where}: {error}; correct the file") from error
    if len(values) != count:
        raise InputError(f"{where}: {count} finite numbers are needed, found '{' '.join(words)[:60]}'")
    return values
