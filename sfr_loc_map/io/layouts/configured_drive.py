"""The drive of a layout of image files, with the extrinsics and the truth of the configuration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.io.images.files import ImageFileSequence, ImagePair, Rectify
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.truth.read import truth_of_data_set
from sfr_loc_map.io.truth.recorded import RecordedTruth


def configured_drive(
    path: Path,
    config: SourceConfig,
    rig: StereoRig,
    pairs: Sequence[ImagePair],
    recorded: RecordedTruth | None,
    rectify: Rectify | None = None,
) -> ImageFileSequence:
    """Return the drive of the source `path`; rig and recorded truth are those of its files."""
    T_rb_sb = config.extrinsics.transform()
    if T_rb_sb is not None:
        rig = replace(rig, T_rb_sb=T_rb_sb)
    return ImageFileSequence(rig, pairs, truth_of_data_set(path, recorded, config.truth), rectify)
