"""A folder with two folders of images that are named by their time, and a separate calibration.

left/1700000000123456789.png    right/1700000000123456789.png     or cam0/ and cam1/; any unit of time
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import refusing
from sfr_loc_map.io.calibration.calibration_file import read_calibration
from sfr_loc_map.io.image_codec import read_grey
from sfr_loc_map.io.layouts.image_files import ImageFileSequence, paired_files
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.source_format import SourceFormat, image_folders, images_in
from sfr_loc_map.io.stamps.stamp_checks import check_fractions_are_padded
from sfr_loc_map.io.stamps.stamp_text import TIMES, UNIT_WORDS, parse_decimal
from sfr_loc_map.io.stamps.time_units import EARLIEST_CLOCK_S, inferred_time_unit
from sfr_loc_map.io.tables.numbered_stamps import read_times
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_text import counted

_log = logging.getLogger(__name__)
TIMES_FILE = "times.txt"  #: Name of the file with the times of numbered images, s.
_NUMBERED = re.compile(r"(?P<before>[^0-9]*)(?P<number>[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?P<after>[^0-9]*)", re.ASCII)


def open_image_folder(path: Path, config: SourceConfig) -> Source:
    """Open a folder of images with the calibration that the configuration names."""
    folders = image_folders(path)
    if folders is None:
        raise InputError(f"'{path}' has no folders of left and right images")
    if not config.calibration.file:
        raise InputError(
            f"'{path}' has images in {folders[0].name}/ and {folders[1].name}/ but no calibration:",
            f"sfr init DIR --from "
            f"'{path}' --calibration FILE (Kalibr, OpenCV, ROS, COLMAP, EuRoC, ORB-SLAM or rig.json)",
        )
    (left, unit), (right, _) = (_by_stamp(folder) for folder in folders)
    if unit != "ns":
        _log.warning(f"'{path}': the names of the images are read as stamps in {UNIT_WORDS[TIMES[unit]]}")
    pairs, single_ns = paired_files(left, right, config.sync, f"'{path}'")
    height, width = read_grey(pairs[0].left).shape
    calibration = read_calibration(Path(config.calibration.file), (width, height))
    left_name, right_name = (folder.name for folder in folders)
    calibration.pair.check_images(left_name, right_name, f"Rename the folders in '{path}' to right/ and left/")
    loc = ImageFileSequence(calibration.rig, pairs, single_ns, rectifier=calibration.rectifier)
    loc = loc.configured(path, config, None)
    return Source(
        path,
        SourceFormat.IMAGES,
        loc,
        None,
        config=config,
        own_extrinsics=calibration.rig.T_rb_sb,
        calibration=calibration.pair.text,
    )


def _by_stamp(folder: Path) -> tuple[dict[int, Path], str]:
    """Return the images of a folder by stamp, ns, which the file name states, and the unit of the names.

    The unit is inferred from the magnitude of the numbers. Frame numbers, which consist of digits, have the times in
    `times.txt`, which is beside the folder or in it.
    """
    files = sorted(images_in(folder))
    number_of, wrong = _numbers_in_names(files)
    numbers = sorted(number_of.values(), key=lambda number: (len(number.partition(".")[0]), number))
    check_fractions_are_padded(numbers, f"images of '{folder}'")
    unit = "" if wrong else inferred_time_unit(numbers, is_seconds=False)
    if not unit:
        are_frame_numbers = not wrong and all(number.isdecimal() for number in numbers)
        times = next((file for file in (folder.parent / TIMES_FILE, folder / TIMES_FILE) if file.is_file()), None)
        if times is not None and are_frame_numbers:
            return _by_time(number_of, times), "ns"
        shown = wrong or ", ".join(numbers[:3])
        raise InputError(
            f"images of '{folder}' are named {shown}: stamps in one unit (s, ms, us, ns) are required as names;",
            f"rename them, or write the time of each, s, to '{folder.parent / TIMES_FILE}'"
            if are_frame_numbers
            else "rename them",
        )
    by_stamp: dict[int, Path] = {}
    for file, number in number_of.items():
        with refusing(f"'{file}'", "rename the image"):
            stamp_ns = parse_decimal(number, TIMES[unit])
        if stamp_ns in by_stamp:
            raise InputError(f"'{file}' and '{by_stamp[stamp_ns].name}' have the same stamp:", "remove one of them")
        by_stamp[stamp_ns] = file
    _check_one_unit(by_stamp)
    return by_stamp, unit


def _numbers_in_names(files: Sequence[Path]) -> tuple[dict[Path, str], str]:
    """Return the number in the name of each file, and a name without a number or with different words around it.

    All names may have the same words before and after the number, as in `left_1700000000123456789.png`.
    """
    parts = {file: _NUMBERED.fullmatch(file.stem) for file in files}
    words = {match and (match["before"], match["after"]) for match in parts.values()}
    if len(words) > 1 or None in words:
        wrong = next((file.name for file, match in parts.items() if match is None), files[-1].name)
        return {}, wrong
    return {file: match["number"] for file, match in parts.items() if match is not None}, ""


def _by_time(number_of: Mapping[Path, str], times: Path) -> dict[int, Path]:
    """Return images with consecutive frame numbers by the times in a file, one for each image."""
    files = sorted(number_of, key=lambda file: int(number_of[file]))
    numbers = [int(number_of[file]) for file in files]
    if numbers != list(range(numbers[0], numbers[0] + len(numbers))):
        raise InputError(f"images of '{files[0].parent}' have frame numbers with gaps:", "name them by their stamps")
    stamps_ns = read_times(times)
    if len(stamps_ns) != len(files) or (np.diff(stamps_ns) <= 0).any():
        raise InputError(
            f"'{times}' has {counted(len(stamps_ns), 'time')} for {counted(len(files), 'image')} of "
            f"'{files[0].parent}':",
            "one increasing time, s, is required for each image",
        )
    _log.warning(f"'{files[0].parent}': the stamps of the images are the times in '{times}'")
    return dict(zip(stamps_ns.tolist(), files, strict=True))


def _check_one_unit(by_stamp: Mapping[int, Path]) -> None:
    """Raise InputError if only some stamps are those of a clock, because the names are then in several units."""
    times = sorted(by_stamp)
    if times and times[0] < EARLIEST_CLOCK_S * NS_PER_S <= times[-1]:
        first, last = times[0], times[-1]
        raise InputError(
            f"'{by_stamp[first]}' is read as {first / NS_PER_S:.9g} s (a time since a start), but "
            f"'{by_stamp[last].name}' as {last / NS_PER_S:.0f} s (a time of a clock): names in one unit and of one "
            "clock are required;",
            "rename the images of one of the two kinds",
        )
