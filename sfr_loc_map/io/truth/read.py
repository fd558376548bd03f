"""The truth of a source, from its configuration or from the source itself.

Of several origins, the first in this list has priority:

1. the topic of the bag that `truth.source` names,
2. the file, or another bag, that `truth.source` names,
3. the source itself: `truth.frame` or `ground_truth/odometry` of a bag, the poses in a file, or those of a data set.

Each kind of source has a function that applies this list: `truth_of_bag`, `truth_of_data_set` and `truth_of_file`. The
layouts call the function of their kind, and `registry.read_truth` finds the truth of any path.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.io.source_format import is_bag
from sfr_loc_map.io.tables.pose_columns import TrajectoryFormat
from sfr_loc_map.io.tables.trajectory_file import CONFIGURED_OPTION, TRUTH_OPTION, read_trajectory_file
from sfr_loc_map.io.truth.config import DEFAULT_TRUTH, TruthConfig
from sfr_loc_map.io.truth.conversion import truth_of_rb
from sfr_loc_map.io.truth.recorded import RecordedTruth

if TYPE_CHECKING:
    from sfr_loc_map.io.bag.bag import Bag

_log = logging.getLogger(__name__)


def truth_of_bag(bag: Bag, config: TruthConfig = DEFAULT_TRUTH) -> Truth:
    """Return the truth of an opened bag; InputError if there is no truth."""
    from sfr_loc_map.io.truth.of_bag import recorded_in_bag  # rosbags is imported only for bags

    if not config.source or bag.matches(config.source):
        return truth_of_rb(recorded_in_bag(bag, config), config)
    return _configured_truth(bag.path, config)


def truth_of_data_set(path: Path, own: RecordedTruth | None, config: TruthConfig = DEFAULT_TRUTH) -> Truth | None:
    """Return the truth of a data set whose files have the true poses `own`; None without truth."""
    if config.source:
        return _configured_truth(path, config)
    return None if own is None else truth_of_rb(own, config)


def truth_of_file(path: Path, config: TruthConfig = DEFAULT_TRUTH) -> Truth:
    """Return the truth of a file of poses; InputError if there is no truth.

    If the configuration names a file or a bag, `path` need not contain poses.
    """
    if config.source:
        return _configured_truth(path, config)
    return _poses_of_file(path, config, TRUTH_OPTION)


def _configured_truth(path: Path, config: TruthConfig) -> Truth:
    """Return the truth in the file or bag that the configuration of the source `path` names."""
    file = config.file
    if file is None:
        topic = f"a topic of '{path}'" if is_bag(path) else f"a topic, because '{path}' is not a bag"
        raise InputError(f"truth '{config.source}' is neither a file nor {topic}:", "give a file, or a topic of a bag")
    if is_bag(file):
        from sfr_loc_map.io.bag.bag import Bag  # rosbags is imported only for bags

        return truth_of_bag(Bag(file), replace(config, source=""))
    return _poses_of_file(file, config, CONFIGURED_OPTION)


def _poses_of_file(file: Path, config: TruthConfig, option: str) -> Truth:
    """Return the poses of a file in the order of their stamps; the rows of a file may have any order."""
    loaded = read_trajectory_file(file, config.columns, option)
    poses = loaded.stamped
    if loaded.format is TrajectoryFormat.KITTI and not config.has_lever:
        _log.warning(
            f"the truth '{file}' contains poses of the left camera: set truth.lever_arm_m to the position of the left "
            "camera in the frame of the rover (RB: x forward, y left, z up), m"
        )
    recorded = RecordedTruth(poses, loaded.text)
    return truth_of_rb(recorded.where(np.argsort(poses.stamps_ns, kind="stable")), config)
