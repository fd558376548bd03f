"""Stereo pairs whose images are files: those of all layouts but bags."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.calibration.rectification import StereoRectifier
from sfr_loc_map.io.image_codec import SampleDepth, read_samples
from sfr_loc_map.io.layouts.stamp_pairs import stereo_pairs, without_partner
from sfr_loc_map.io.source_config import SourceConfig, SyncConfig
from sfr_loc_map.io.stamps.stamp_checks import check_stamp_order
from sfr_loc_map.io.truth.read import truth_of_data_set
from sfr_loc_map.io.truth.recorded import RecordedTruth
from sfr_loc_map.suffixes import suffix_of
from sfr_loc_map.suite_names import IMAGE_ENDINGS

_log = logging.getLogger(__name__)
NAMED_FILES = 3  #: Maximum number of missing files in a message.


@dataclass(frozen=True, slots=True)
class ImagePair:
    """The files of one pair; a mapping pair also has a pose and may have a file of true points."""

    stamp_ns: int
    left: Path
    right: Path
    T_lm_navsb: Transform | None = None
    truth: Path | None = None


def paired_files(
    left: Mapping[int, Path], right: Mapping[int, Path], sync: SyncConfig, where: str
) -> tuple[list[ImagePair], tuple[int, ...]]:
    """Return the pairs of left and right images by their stamps, ns, and the stamps of left images without a partner.

    InputError if there is no pair; warnings report images without a partner.
    """
    left_ns = sorted(left)
    right_of = stereo_pairs(left_ns, sorted(right), sync, where)
    pairs = [ImagePair(stamp_ns, left[stamp_ns], right[right_ns]) for stamp_ns, right_ns in right_of.items()]
    return pairs, without_partner(left_ns, right_of)


def complete_pairs(entries: Sequence[ImagePair], name: str) -> tuple[list[ImagePair], tuple[int, ...]]:
    """Return the pairs that have both images, and the stamps of the other pairs.

    Warnings report the other pairs, and images in the same folders that the list `name` does not contain.
    """
    check_stamp_order([entry.stamp_ns for entry in entries], name, strict=True)
    if same := next((entry for entry in entries if entry.left == entry.right), None):
        raise InputError(f"{name} lists '{same.left}' as the left and the right image of one pair:", "two are required")
    files = [file for entry in entries for file in (entry.left, entry.right)]
    missing = [file for file in files if not file.is_file()]
    if not missing:
        _report_unlisted(files, name)
        return list(entries), ()
    absent = set(missing)
    incomplete_ns = {entry.stamp_ns for entry in entries if entry.left in absent or entry.right in absent}
    complete = [entry for entry in entries if entry.stamp_ns not in incomplete_ns]
    rest = f" and {len(missing) - NAMED_FILES} more" if len(missing) > NAMED_FILES else ""
    shown = f"{', '.join(map(str, missing[:NAMED_FILES]))}{rest}"
    if not complete:
        raise InputError(f"{name} lists missing images: {shown};", "restore them")
    _log.warning("%s: %d of %d pairs skipped, missing images: %s", name, len(incomplete_ns), len(entries), shown)
    _report_unlisted(files, name)
    return complete, tuple(sorted(incomplete_ns))


def _report_unlisted(files: Sequence[Path], name: str) -> None:
    """Report the other images in the folders of image files that `name` lists; hidden files are ignored."""
    listed = set(files)
    beside = sorted(file for folder in {file.parent for file in files} if folder.is_dir() for file in folder.iterdir())
    images = [file for file in beside if suffix_of(file) in IMAGE_ENDINGS and not file.name.startswith(".")]
    if unlisted := [file for file in images if file not in listed]:
        _log.warning("%s: unlisted images ignored: %d, the first: %s", name, len(unlisted), unlisted[0])


def check_size(image: GreyImage, rig: StereoRig, name: str) -> None:
    """Raise InputError if an image does not have the size of the rig's images."""
    if fault := rig.fault_of_size(image):
        raise InputError(f"{name} {fault}")


def read_pair(entry: ImagePair, rig: StereoRig, depth: SampleDepth) -> StereoPair:
    """Read the images of a pair."""
    left, right = depth.grey(read_samples(entry.left), read_samples(entry.right))
    for path, image in ((entry.left, left), (entry.right, right)):
        check_size(image, rig, f"image '{path}' (stamp {entry.stamp_ns})")
    return StereoPair(entry.stamp_ns, left, right)


@dataclass(frozen=True, slots=True, eq=False)
class ImageFiles:
    """Pairs of image files."""

    rig: StereoRig  #: Rig of the rectified images.
    entries: Sequence[ImagePair]  #: The files, in the order of stamps; `read_pair` requires the rig's size.
    missing_ns: Sequence[int]  #: Stamps of pairs that are listed but have no images, or whose right image is missing.

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Stamps of the pairs, ns, in ascending order."""
        return tuple(entry.stamp_ns for entry in self.entries)

    def sample_depth(self) -> SampleDepth:
        """Return a new detector of the bit depth, for one pass through the images."""
        return SampleDepth(_log.warning, str(self.entries[0].left.parent.parent) if self.entries else "")

    def __len__(self) -> int:
        return len(self.entries)


@dataclass(frozen=True, slots=True, eq=False)
class ImageFileSequence(ImageFiles):
    """A drive of image files (`sequence.LocSequence`)."""

    ground_truth: Truth | None = None  #: True poses of RB in DS, or None.
    rectifier: StereoRectifier | None = None  #: Rectifies the images; None if the files are rectified.

    def pairs(self) -> Iterator[StereoPair]:
        """Yield the pairs, with one pair in memory at a time."""
        depth = self.sample_depth()
        for entry in self.entries:
            pair = read_pair(entry, self.rig, depth)
            if self.rectifier is not None:
                pair = StereoPair(pair.stamp_ns, *self.rectifier.rectify(pair.left, pair.right))
            yield pair

    def configured(self, path: Path, config: SourceConfig, recorded: RecordedTruth | None) -> ImageFileSequence:
        """Return the drive of the source `path` with the extrinsics and the truth of the configuration.

        Without extrinsics in the configuration, the extrinsics of the files are kept. `recorded` is the truth in the
        files.
        """
        T_rb_sb = config.extrinsics.transform() or self.rig.T_rb_sb
        truth = truth_of_data_set(path, recorded, config.truth)
        return replace(self, rig=replace(self.rig, T_rb_sb=T_rb_sb), ground_truth=truth)
