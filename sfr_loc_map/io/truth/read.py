"""The truth of a source: the topic, bag or pose file that its configuration names, else the source's own truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.io.bag.files import is_bag
from sfr_loc_map.io.tables.trajectory_file import CONFIGURED_OPTION, TRUTH_OPTION, read_trajectory_file
from sfr_loc_map.io.truth.config import AS_THE_SOURCE_HAS_IT, TrackedPoses, TruthConfig
from sfr_loc_map.io.truth.pose_checks import possible_truth


def resolve_truth(
    place: Path,
    own: Callable[[], Trajectory | None],
    config: TruthConfig = AS_THE_SOURCE_HAS_IT,
    remap: Mapping[str, str] | None = None,
) -> Trajectory | None:
    """Return the truth of a source: the truth that the configuration names, else the source's own; None without either.

    `own` reads the true poses of the source itself, or returns None. A `Truth` from `own` is returned unchanged,
    because the configuration was already applied.
    """
    if config.source:
        return truth_of_file(place, config, remap)
    poses = own()
    if poses is None or isinstance(poses, Truth):
        return poses
    if isinstance(poses, TrackedPoses):
        return config.at(poses.T_rb_body).applied(poses, read_from=poses.read_from)
    if config != AS_THE_SOURCE_HAS_IT:
        return config.applied(poses, read_from=str(place))
    return possible_truth(poses, f"of '{place}'").trajectory


def truth_of_file(
    place: Path, config: TruthConfig = AS_THE_SOURCE_HAS_IT, remap: Mapping[str, str] | None = None
) -> Truth:
    """Read the truth of a bag or a file of poses, or of the topic, bag or file that the configuration names.

    InputError if there is no truth.
    """
    option = TRUTH_OPTION
    if is_bag(place):
        from sfr_loc_map.io.bag.bag import Bag  # rosbags is imported only for bags
        from sfr_loc_map.io.truth.of_bag import truth_of_bag

        bag = Bag(place, remap)
        if not config.source or bag.matches(config.source.strip("/")):
            return truth_of_bag(bag, config)
    if config.source:
        file = Path(config.source)
        if not file.exists():
            raise InputError(f"truth '{file}' is neither a file nor a topic of '{place}': give a file or a topic")
        if is_bag(file):
            return truth_of_file(file, replace(config, source=""))
        place, option = file, CONFIGURED_OPTION
    loaded = read_trajectory_file(place, config.columns, option)
    return config.applied(loaded.trajectory, read_from=loaded.text)
