"""True poses from whatever recorded them: topics of a bag, a pair of frames on /tf, files; docs/formats.md, "Truth".

A tracker follows a body of its own, a prism or an antenna, on a clock of its own: `TruthConfig.applied` is the one
place where poses of that body become poses of RB. Positions without attitude stay those of the body, and the score
takes the estimate there.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sfr_loc_map.config import changed, param
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.rotation import quat_conjugate, quat_multiply, quat_rotate
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import LOST_VARIANCE, NS_PER_S, refusing
from sfr_loc_map.io.bag.files import is_bag
from sfr_loc_map.io.bag.frames import chain_above, chain_poses, pose_row, read_frames, trajectory_of
from sfr_loc_map.io.bag.topic_guess import is_own
from sfr_loc_map.io.bag.true_poses import TruePoses
from sfr_loc_map.io.pose_checks import has_constant_attitude, has_constant_height, has_no_tilt, possible_poses, rows_of
from sfr_loc_map.io.tables.text_table import check_order
from sfr_loc_map.io.tables.trajectory_file import CONFIGURED, read_trajectory_file
from sfr_loc_map.message_types import FIX, ODOMETRY, PATH, POINT, POSE, POSE_WITH_COVARIANCE, TRANSFORM
from sfr_loc_map.topics import TRUE_POSES

if TYPE_CHECKING:
    from sfr_loc_map.io.bag.bag import Bag, Topic

_log = logging.getLogger(__name__)
NO_LEVER = (0.0, 0.0, 0.0)
NO_TURN = (0.0, 0.0, 0.0, 1.0)
PLACE_SETTINGS = ("truth.source", "truth.frame")  #: Where the truth is to be found.


@dataclass(frozen=True, slots=True)
class TrackedBody:
    """What the poses of a truth are of, and how good they are."""

    lever_arm_m: tuple[float, ...] = param(
        NO_LEVER, unit="m", doc="Position of the tracked body (prism, antenna, marker) in RB.", low=-100.0, high=100.0
    )
    lever_quat_xyzw: tuple[float, ...] = param(
        NO_TURN, doc="Orientation of the tracked body in RB, as in ROS messages.", low=-1.01, high=1.01
    )
    clock_offset_s: float = param(
        0.0, unit="s", doc="Offset that is added to the stamps of the truth.", low=-4e9, high=4e9
    )
    sigma_m: float = param(
        0.0,
        unit="m",
        doc="Standard deviation of a true position along each axis. 0: from the messages, otherwise exact.",
        low=0.0,
        high=1000.0,
    )
    sigma_deg: float = param(
        0.0, unit="deg", doc="Standard deviation of a true attitude about each axis, like sigma_m.", low=0.0, high=180.0
    )
    attitude: str = param(
        "auto", doc="Whether the truth has attitudes: inferred (auto), yes or no.", choices=("auto", "yes", "no")
    )
    unknown: str = param(
        "auto",
        doc="Unknown components of the truth: none, the height, roll and pitch (tilt), or both (planar). auto: "
        "components that its variances mark as unknown, or that never change along its path.",
        choices=("auto", "none", "height", "tilt", "planar"),
    )

    def __post_init__(self) -> None:
        if len(self.lever_arm_m) != 3 or len(self.lever_quat_xyzw) != 4:
            raise ConfigError("truth.lever_arm_m is x, y, z and truth.lever_quat_xyzw x, y, z, w")
        if abs(float(np.linalg.norm(self.lever_quat_xyzw)) - 1.0) > 1e-2:
            raise ConfigError(f"truth.lever_quat_xyzw is {self.lever_quat_xyzw}: a unit quaternion is required")

    @property
    def has_lever(self) -> bool:
        """Whether the tracked body has a pose in RB of its own."""
        return (self.lever_arm_m, self.lever_quat_xyzw) != (NO_LEVER, NO_TURN)

    def applied(self, poses: Trajectory, variances: FloatArray | None = None, read_from: str = "") -> Truth:
        """Return poses of the tracked body as the truth of RB; `variances`: `(N, 6)`, NaN or 0 where not known.

        The poses are as recorded: those of a `Truth` would be moved a second time.
        """
        assert not isinstance(poses, Truth)
        if variances is None:
            variances = np.full((len(poses), 6), np.nan)
        kept, poses = possible_truth(poses, read_from, self.attitude, self.unknown, variances)
        variances = variances[kept]
        known = (variances[:, 3:] < LOST_VARIANCE).any(axis=1) & (variances[:, 3:] >= 0.0).all(axis=1)
        told = poses.has_attitude and bool(known.any() or np.isnan(variances[:, 3:]).any())
        has_attitude = {"yes": True, "no": False}.get(self.attitude, told)
        if has_attitude and not poses.has_attitude:
            raise InputError(f"truth {read_from} has no attitudes: set truth.attitude to auto or no")
        positions, quats = poses.positions, poses.quats_xyzw if has_attitude else np.zeros((len(poses), 4))
        lever = np.array(self.lever_arm_m)
        if has_attitude and self.has_lever:
            quats = quat_multiply(quats, quat_conjugate(np.array(self.lever_quat_xyzw)))
            positions, lever = positions - quat_rotate(quats, lever), np.zeros(3)
        sigmas = [sigma_of(variances[:, :3]), np.degrees(sigma_of(variances[:, 3:])) if has_attitude else 0.0]
        return Truth(
            poses.stamps_ns + round(self.clock_offset_s * NS_PER_S),
            positions,
            quats,
            sigma_m=self.sigma_m or sigmas[0],
            sigma_deg=self.sigma_deg or float(sigmas[1]),
            lever_arm_m=tuple(lever.tolist()),
            has_height=getattr(poses, "has_height", True),
            has_tilt=getattr(poses, "has_tilt", True) or not has_attitude,
            read_from=read_from,
            declared=self.declared,
        )

    @property
    def declared(self) -> tuple[str, ...]:
        """The settings `truth.NAME=VALUE` that change poses; where the truth is to be found is none of them."""
        values = changed(self, "truth.").items()
        return tuple(f"{name}={value}" for name, value in values if name not in PLACE_SETTINGS)


def possible_truth(
    poses: Trajectory,
    read_from: str,
    attitude: str = "auto",
    unknown: str = "auto",
    variances: FloatArray | None = None,
) -> tuple[Mask, Trajectory]:
    """Return which poses of a truth can be true, and these poses; what is wrong with the others is reported.

    An attitude that never changes along a path that turns is invalid. Positions alone are then kept, unless `attitude`
    is yes. If height or tilt is unknown, the poses are a `Truth` that says so.
    """
    if not len(poses):
        return np.zeros(0, np.bool_), poses
    kept, findings = possible_poses(poses)
    without_height = np.zeros(len(poses), np.bool_) if variances is None else variances[:, 2] >= LOST_VARIANCE
    if 0.0 < without_height.mean() <= 0.5:
        kept &= ~without_height
        findings = (*findings, f"{int(without_height.sum())} of {len(poses)} positions have no height: ignored")
    poses = poses if kept.all() else rows_of(poses, kept)
    if attitude == "auto" and has_constant_attitude(poses):
        poses = replace(poses, quats_xyzw=np.zeros_like(poses.quats_xyzw))
        same = "all poses have the same attitude although the path turns: positions alone are used"
        findings = (*findings, f"{same} (truth.attitude=yes keeps the attitudes)")
    has_height, has_tilt = unknown in ("none", "tilt"), unknown in ("none", "height")
    if unknown == "auto":
        no_height, no_tilt = marked_as_unknown(variances[kept]) if variances is not None else (False, False)
        has_height = not no_height and not has_constant_height(poses)
        has_tilt = not poses.has_attitude or not (no_tilt or has_no_tilt(poses))
        names = [name for name, is_known in (("height", has_height), ("roll and pitch", has_tilt)) if not is_known]
        if names:
            text = f"unknown are {', '.join(names)} (constant along a path that turns, or marked by variances)"
            findings = (*findings, f"{text}: they are not judged; set truth.unknown=none to judge them")
    for text in findings:
        _log.warning(f"truth {read_from}: {text}")
    if not (has_height and has_tilt):
        values = poses.stamps_ns, poses.positions, poses.quats_xyzw
        poses = Truth(*values, has_height=has_height, has_tilt=has_tilt)
    return kept, poses


def marked_as_unknown(variances: FloatArray) -> tuple[bool, bool]:
    """Return whether variances `(N, 6)` mark the height, and roll and pitch, as unknown.

    Unknown components have the variance of a lost pose or a negative variance. Tools that estimate poses on a plane
    send zeros for z, roll and pitch beside positive variances of x, y and yaw.
    """
    if not len(variances):
        return False, False
    is_lost = (variances >= LOST_VARIANCE) | (variances < 0.0)
    is_planar = bool((variances[:, 2:5] == 0.0).all() and (variances[:, [0, 1, 5]] > 0.0).all())
    return is_planar or bool(is_lost[:, 2].mean() > 0.5), is_planar or bool(is_lost[:, 3:5].all())


RB_ITSELF = TrackedBody()  #: The truth is of RB, as exact as its messages say.


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TrackedPoses(Trajectory):
    """Poses of a tracked body as a source has them, with the place of the body that the source states."""

    T_rb_body: Transform = field(default_factory=Transform.identity)
    read_from: str = ""  #: File that the poses were read from.


@dataclass(frozen=True, slots=True)
class LiveTruth(TrackedBody):
    """What the truth of a graph is of, and whether it is on /tf."""

    frame: str = param(
        "",
        doc="Frame whose poses on /tf are the truth, as PARENT:CHILD; in a recording also as CHILD (in the root of its "
        "tree). Empty: the truth is a topic or file.",
    )


@dataclass(frozen=True, slots=True)
class TruthConfig(LiveTruth):
    """Where the truth is and what it is of."""

    source: str = param("", doc="Topic of the bag, or file, with the truth; empty: as the source has it.")
    stamps: str = param(
        "header",
        doc="Stamps of the messages of a bag: of their headers, or the times of recording.",
        choices=("header", "record"),
    )
    columns: str = param(
        "",
        doc="Columns of a text table where its header does not say: NAME=HEADER[UNIT] with commas between, of t, x, y, "
        "z, qx, qy, qz, qw (sec and nsec in place of t), or NAME[UNIT] in the order of the columns, _ for others.",
    )

    def at(self, T_rb_body: Transform) -> TruthConfig:
        """Return the configuration with the place of the body that a source states, unless it has one of its own."""
        if self.has_lever:
            return self
        lever_arm_m, lever_quat_xyzw = (tuple(part.tolist()) for part in (T_rb_body.translation, T_rb_body.quat_xyzw))
        return replace(self, lever_arm_m=lever_arm_m, lever_quat_xyzw=lever_quat_xyzw)


def sigma_of(variances: FloatArray) -> float:
    """Return the standard deviation along an axis of messages with variances `(N, 3)`, their median; 0: not known."""
    known = variances[(variances > 0.0).all(axis=1) & (variances < LOST_VARIANCE).all(axis=1)]
    return float(np.sqrt(np.median(known.mean(axis=1)))) if len(known) else 0.0


def resolve_truth(
    place: Path,
    own: Callable[[], Trajectory | None],
    config: TruthConfig = TruthConfig(),
    remap: Mapping[str, str] | None = None,
) -> Trajectory | None:
    """Return the truth of a source of any format: what the configuration names, else its own; None without either.

    `own` reads the true poses that the source itself has, None if it has none. A `Truth` was read by the configuration
    already, as that of a bag is.
    """
    if config.source:
        return truth_of_file(place, config, remap)
    poses = own()
    if poses is None or isinstance(poses, Truth):
        return poses
    if isinstance(poses, TrackedPoses):
        return config.at(poses.T_rb_body).applied(poses, read_from=poses.read_from)
    if config != TruthConfig():
        return config.applied(poses, read_from=str(place))
    return possible_truth(poses, f"of '{place}'")[1]


def truth_of_file(place: Path, config: TruthConfig = TruthConfig(), remap: Mapping[str, str] | None = None) -> Truth:
    """Read the truth of a bag or a file of poses, or of the topic, bag or file that the configuration names.

    InputError, in one line, if there is none.
    """
    side = "truth"
    if is_bag(place):
        from sfr_loc_map.io.bag.bag import Bag

        bag = Bag(place, remap)
        if not config.source or bag.matches(config.source.strip("/")):
            return truth_of_bag(bag, config)
    if config.source:
        file = Path(config.source)
        if not file.exists():
            raise InputError(f"truth '{file}' is neither a file nor a topic of '{place}': give one of both")
        if is_bag(file):
            return truth_of_file(file, replace(config, source=""))
        place, side = file, CONFIGURED
    loaded = read_trajectory_file(place, config.columns, side)
    return config.applied(loaded.trajectory, read_from=loaded.text)


def truth_of_bag(bag: Bag, config: TruthConfig = TruthConfig()) -> Truth:
    """Read the truth of an opened bag; InputError if it has none."""
    if config.frame:
        return config.applied(_tf_poses(bag, config.frame), None, f"{bag.path}, frame {config.frame} on /tf")
    if config.stamps == "record":
        bag = bag.by_record()
    topic = bag.find(config.source.strip("/") or TRUE_POSES, *TRUTH_TYPES)
    if topic is None:
        text = f"bag '{bag.path}' has no true poses on '{TRUE_POSES}'"
        raise InputError(f"{text}: name their topic by --set truth.source=TOPIC{could_be_truth(bag)}")
    with refusing(f"'{topic.bag_name}' of bag '{bag.path}'", "record it again"):
        poses, variances = TRUTH_TYPES[topic.msgtype](bag, topic)
    if not len(poses):
        raise InputError(f"'{topic.bag_name}' of bag '{bag.path}' has no true pose: record it again")
    if len(poses) > 1 and not poses.stamps_ns.any():
        raise InputError(
            f"'{topic.bag_name}' of bag '{bag.path}': all stamps of its headers are 0: --set truth.stamps=record takes "
            "the times of recording"
        )
    check_order(poses.stamps_ns, f"'{topic.bag_name}' of bag '{bag.path}'", strict=False)
    kind = topic.msgtype.rpartition("/")[2]
    return config.applied(poses, variances, f"{bag.path}, {topic.bag_name} ({kind}), {len(poses)} poses")


def could_be_truth(bag: Bag) -> str:
    """Name the topics whose type is one of true poses, without those of what the rover thinks; the end of a message."""
    found = sorted(name for name, kind in bag.topics.items() if kind in TRUTH_TYPES and not is_own(name))
    return f"; these could be: {', '.join(found)}" if found else ""


# ---- messages

Poses = tuple[Trajectory, FloatArray | None]


def _with_covariances(bag: Bag, topic: Topic) -> Poses:
    from sfr_loc_map.io.bag.bag import read_odometry

    poses, covariances = read_odometry(bag, topic)
    return poses, np.diagonal(covariances, axis1=1, axis2=2)


def _last_path(bag: Bag, topic: Topic) -> Poses:
    """Return the poses of the last message: each holds those of the messages before."""
    last = None
    for _, _, raw in bag.stream([topic]):
        last = raw
    poses = [] if last is None else bag.deserialise(topic, last).poses
    rows = [pose_row(item, item.pose) for item in poses]
    if rows and not rows[-1][0] > rows[0][0]:
        raise ValueError("the poses of the path have no stamps of their own")
    return trajectory_of(rows), None


def _single_poses(bag: Bag, topic: Topic) -> Poses:
    """Return the poses or positions of messages that have one each."""
    reader = TruePoses(topic.msgtype)
    found = [row for _, _, message in bag.messages([topic]) for row in reader.rows(message)]
    if reader.invalid:
        text = f"{reader.invalid} fixes at 0, 0 or without numbers are ignored, {len(found)} are used"
        _log.warning(f"truth '{topic.bag_name}' of bag '{bag.path}': {text}")
    variances = np.reshape([variance for _, _, variance in found], (-1, 6))
    return trajectory_of([(stamp_ns, pose) for stamp_ns, pose, _ in found]), variances


TRUTH_TYPES: dict[str, Callable[[Bag, Topic], Poses]] = {
    ODOMETRY: _with_covariances,
    POSE_WITH_COVARIANCE: _with_covariances,
    POSE: _single_poses,
    TRANSFORM: _single_poses,
    POINT: _single_poses,
    PATH: _last_path,
    FIX: _single_poses,
}
"""Types of topics that truth is read from, and how."""


# ---- /tf


def _tf_poses(bag: Bag, frame: str) -> Trajectory:
    """Return the poses of a frame in the root of its tree, or in a parent (`PARENT:CHILD`), of /tf and /tf_static."""
    parent, _, child = (name.strip("/") for name in frame.rpartition(":"))
    frames = read_frames(bag, child, parent)
    with refusing(f"/tf of bag '{bag.path}'", "choose one by truth.frame=PARENT:CHILD"):
        chain = chain_above(frames, child, parent)
    moving = [name for name in chain if not frames[name].is_static]
    if not moving or (parent and frames[chain[-1]].parent != parent):
        known = ", ".join(sorted(f"{item.parent}:{name}" for name, item in frames.items())) or "none"
        raise InputError(f"bag '{bag.path}' has no moving transform '{frame}' on /tf: it has {known}")
    with refusing(f"/tf of bag '{bag.path}'", "record it again"):
        for name in moving:
            check_order(frames[name].poses.stamps_ns, f"/tf of bag '{bag.path}', '{name}'", strict=False)
        return chain_poses(frames, chain, max(moving, key=lambda name: len(frames[name].rows)))
