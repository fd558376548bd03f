"""The interface of a source, which is independent of its format."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.source_config import DEFAULT_SOURCE, SourceConfig
from sfr_loc_map.suffixes import suffix_of
from sfr_loc_map.suite_names import IMAGE_ENDINGS

EXTRINSICS_ROUNDING = 1e-9
"""Largest difference between elements of equal extrinsics, m or without unit: the rounding of a written quaternion."""


class LocSequence(Protocol):
    """Stereo pairs for localisation, read as a stream in the order of their stamps."""

    @property
    def stamps_ns(self) -> Sequence[int]:
        """Stamps of the pairs, ns; they are known without decoding images."""

    @property
    def rig(self) -> StereoRig:
        """Rig of the localisation cameras, with `T_rb_sb` if the source has it."""

    @property
    def missing_ns(self) -> Sequence[int]:
        """Ascending stamps of pairs that are listed but have no images, or whose left image has no right image."""

    @property
    def ground_truth(self) -> Truth | None:
        """True poses of RB in DS, or None."""

    def __len__(self) -> int:
        """Return the number of pairs."""

    def pairs(self) -> Iterator[StereoPair]:
        """Yield the pairs as a stream; each call starts from the first pair."""


class NavSequence(Protocol):
    """Stereo pairs for mapping with their poses in LM, read as a stream."""

    @property
    def stamps_ns(self) -> Sequence[int]:
        """Stamps of the pairs, ns; they are known without decoding images."""

    @property
    def rig(self) -> StereoRig:
        """Rig of the navigation cameras."""

    @property
    def missing_ns(self) -> Sequence[int]:
        """Ascending stamps of pairs that are listed but have no images or no pose."""

    def __len__(self) -> int:
        """Return the number of pairs."""

    def pairs(self) -> Iterator[PosedStereoPair]:
        """Yield the pairs, with truth if the source has it; each call starts from the first pair."""


class RecordedBag(NamedTuple):
    """A bag whose messages are played as recorded."""

    path: Path
    topics: Mapping[str, str]  #: Name in the bag by name in the suite (`SourceConfig.topics`).


@dataclass(frozen=True, slots=True)
class Source:
    """An opened data set folder, bag or sequence. `loc` or `nav` is None if the source does not contain it."""

    path: Path
    format: str  #: Name of the format for users; that of a bag states whether its messages are used as recorded.
    loc: LocSequence | None  #: The drive.
    nav: NavSequence | None  #: The mapping pairs.
    config: SourceConfig = DEFAULT_SOURCE  #: Configuration that the source is read with.
    truth_files: tuple[Path, ...] = ()  #: Files with the truth besides `path` and `config.truth.file`, by the layout.
    calibration: str = ""  #: Origin of the calibration of the drive, if it is not part of the layout.
    own_extrinsics: Transform | None = None
    """Pose of the drive's rig on the rover in the source itself, which `config` may replace; None if unknown."""
    recorded: RecordedBag | None = None  #: The bag, if its messages are used as recorded; None for all other sources.

    @property
    def missing_loc_ns(self) -> tuple[int, ...]:
        """`LocSequence.missing_ns`; empty without a drive."""
        return () if self.loc is None else tuple(self.loc.missing_ns)

    @property
    def missing_nav_ns(self) -> tuple[int, ...]:
        """`NavSequence.missing_ns`; empty without mapping pairs."""
        return () if self.nav is None else tuple(self.nav.missing_ns)

    @property
    def skipped_pairs(self) -> int:
        """Number of pairs that are skipped (`LocSequence.missing_ns`, `NavSequence.missing_ns`)."""
        return len(self.missing_loc_ns) + len(self.missing_nav_ns)

    def expected_loc_ns(self) -> IntArray:
        """Return the ascending stamps of the localisation pairs that the source lists, with and without images."""
        return _listed_ns(self.loc)

    def expected_nav_ns(self) -> IntArray:
        """Return the ascending stamps of the mapping pairs that the source lists, with and without images."""
        return _listed_ns(self.nav)

    @property
    def changed_reading(self) -> dict[str, object]:
        """The settings of `SourceConfig.changed_reading`, without extrinsics that equal those of the source itself.

        Extrinsics are not used without a drive.
        """
        settings = self.config.changed_reading
        given = self.config.extrinsics.transform()
        if given is None:
            return settings
        own = given if self.loc is None else self.own_extrinsics
        if own is None or not np.allclose(own.matrix, given.matrix, rtol=0.0, atol=EXTRINSICS_ROUNDING):
            return settings
        return {name: value for name, value in settings.items() if not name.startswith("extrinsics.")}

    def truth_paths(self) -> tuple[Path, ...]:
        """Return every path that may hold the truth. A method under test has no access to these paths.

        The paths are the source itself, the targets of its symbolic links except images, its truth files, and the
        file or bag that the configuration names.
        """
        inside = self.path.rglob("*") if self.path.is_dir() else ()
        links = [path for path in inside if path.is_symlink() and suffix_of(path) not in IMAGE_ENDINGS]
        configured = () if self.config.truth.file is None else (self.config.truth.file,)
        return tuple(path.resolve() for path in (self.path, *links, *self.truth_files, *configured))

    @property
    def truth(self) -> Truth | None:
        """True poses of RB in DS; None without truth."""
        truth_of_drive = None if self.loc is None else self.loc.ground_truth
        return truth_of_drive if truth_of_drive is not None and len(truth_of_drive) else None

    def pairs(self) -> Iterator[StereoPair | PosedStereoPair]:
        """Yield the pairs of the drive as grey images. Without a drive, yield the mapping pairs with their poses."""
        sequence = self._sequence
        return iter(()) if sequence is None else sequence.pairs()

    __iter__ = pairs

    def __len__(self) -> int:
        return 0 if self._sequence is None else len(self._sequence)

    @property
    def _sequence(self) -> LocSequence | NavSequence | None:
        """The drive, or the mapping pairs if there is no drive."""
        return self.nav if self.loc is None else self.loc


def _listed_ns(sequence: LocSequence | NavSequence | None) -> IntArray:
    """Return the ascending stamps of all pairs that a sequence lists, with and without images; empty for None."""
    stamps_ns = () if sequence is None else (*sequence.stamps_ns, *sequence.missing_ns)
    return np.unique(np.array(stamps_ns, np.int64))


def drive_of(source: Source) -> LocSequence:
    """Return the localisation pairs of a source."""
    if source.loc is None or not len(source.loc):
        raise InputError(f"'{source.path}' has no drive (localisation pairs):", "give a source that has one")
    return source.loc


def without_truth(path: Path) -> InputError:
    """Return the error of a source without true poses."""
    return InputError(
        f"'{path}' has no true poses (groundtruth.csv, ground_truth/odometry):",
        "give a source with truth, or name the truth by truth.source in sfr.yaml",
    )


def panorama_of(source: Source) -> NavSequence:
    """Return the mapping pairs of a source."""
    if source.nav is None or not len(source.nav):
        raise InputError(f"'{source.path}' has no mapping pairs:", "give a source that has them")
    return source.nav
