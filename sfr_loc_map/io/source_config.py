"""How a source is read: the sections of `sfr.yaml` before `localisation` (docs/configuration.md).

`source_settings` finds the configuration of a source, and changes it by the options of a command.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import get_type_hints

from sfr_loc_map.configuration.parameters import changed, param
from sfr_loc_map.configuration.sections import SECTIONS, Configuration
from sfr_loc_map.errors import ConfigError, GeometryError
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.source_format import is_bag
from sfr_loc_map.io.truth.config import TruthConfig
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.stamp_pairing import MAX_TOLERANCE_S, STAMP_TOLERANCE_S


@dataclass(frozen=True, slots=True)
class FramesConfig:
    """The frames of a rover and the joints of its head [3.2.6]."""

    base: str = param(
        "", doc="Frame of the rover; empty: the first of rb, base_link, base_footprint, base, body, chassis."
    )
    pan_joint: str = param("", doc="Pan joint of the head, positive to the left; empty: the joint named '*pan*'.")
    tilt_joint: str = param("", doc="Tilt joint of the head, positive down; empty: the joint named '*tilt*'.")
    head_to_navsb_m: tuple[float, float, float] = param(
        (0.0, 0.0, 0.0), unit="m", doc="Position of NAVSB in the head that the joints move.", low=-10.0, high=10.0
    )
    head_to_navsb_quat_xyzw: tuple[float, float, float, float] = param(
        (0.0, 0.0, 0.0, 0.0),
        doc="Orientation of NAVSB in the head; 0, 0, 0, 1: that of the head. All zero: not given.",
        low=-1.01,
        high=1.01,
    )

    def head_transform(self, origin: str = "frames") -> Transform | None:
        """Return `T_head_navsb`, None if it is not given; `origin` begins error messages."""
        names = "head_to_navsb_m", "head_to_navsb_quat_xyzw"
        return _optional_transform(self.head_to_navsb_m, self.head_to_navsb_quat_xyzw, names, origin)


@dataclass(frozen=True, slots=True)
class CalibrationConfig:
    """The calibration of the localisation cameras, if the source has none, and the layout of their images."""

    file: str = param("", doc="Calibration by Kalibr, OpenCV, ROS or COLMAP, or a rig.json; empty: that of the source.")
    baseline_m: float = param(
        0.0, unit="m", doc="Baseline, if P[3] of camera_info is 0; 0: the baseline is given by P.", low=0.0, high=100.0
    )
    stereo_layout: str = param(
        "",
        doc="Layout of a joint image, left first, on loc/left/image_rect or image_raw; empty: separate images.",
        choices=("", "side_by_side", "top_bottom"),
    )


@dataclass(frozen=True, slots=True)
class ExtrinsicsConfig:
    """Pose of the localisation stereo rig on the rover."""

    translation_m: tuple[float, float, float] = param(
        (0.0, 0.0, 0.0), unit="m", doc="Origin of LOCSB in RB: x, y, z.", low=-100.0, high=100.0
    )
    quat_xyzw: tuple[float, float, float, float] = param(
        (0.0, 0.0, 0.0, 0.0),
        doc="Orientation of LOCSB in RB: x, y, z, w; converts components in LOCSB to RB. All zero: not given. The "
        "extrinsics are then read from /tf_static: the pose of LOCSB, or of the frame that the left camera_info "
        "names, in the frame of the rover. A node has the parameters locsb_frame and rb_frame for these frames and "
        "requires tf2_msgs. For a recording the frame of the rover is frames.base.",
        low=-10.0,
        high=10.0,
    )

    def transform(self, origin: str = "extrinsics") -> Transform | None:
        """Return `T_rb_locsb`, None if it is not given; `origin` begins error messages."""
        return _optional_transform(self.translation_m, self.quat_xyzw, ("translation_m", "quat_xyzw"), origin)


def _optional_transform(
    translation_m: Sequence[float], quat_xyzw: Sequence[float], names: tuple[str, str], origin: str
) -> Transform | None:
    """Return a transform of two parameters; None if both are zero, which means that they are not given.

    ConfigError if only the translation is given, because no rotation is assumed, or if the quaternion is no rotation.
    """
    if not any(quat_xyzw):
        if any(translation_m):
            raise ConfigError(f"{origin}: {names[0]} is given but {names[1]} is not: give both")
        return None
    try:
        return Transform.from_quat(translation_m, quat_xyzw)
    except GeometryError as error:
        raise ConfigError(f"{origin}: {names[1]}: {error}") from error


@dataclass(frozen=True, slots=True)
class SyncConfig:
    """How left and right images are paired by their stamps."""

    stamp_tolerance_s: float = param(
        STAMP_TOLERANCE_S,
        unit="s",
        doc="Largest difference between the stamps of left and right, always below half a period. 0: equal stamps.",
        low=0.0,
        high=MAX_TOLERANCE_S,
    )
    stamps: str = param(
        "header",
        doc="Stamps of the messages of a bag: those of the headers, or the times of recording.",
        choices=("header", "record"),
    )
    right_offset_s: float = param(
        0.0, unit="s", doc="Offset added to the stamps of the right images.", low=-1e4, high=1e4
    )

    @property
    def stamp_tolerance_ns(self) -> int:
        """The tolerance in nanoseconds."""
        return round(self.stamp_tolerance_s * NS_PER_S)


@dataclass(frozen=True, slots=True)
class SourceConfig:
    """How a source is read; missing values are taken from the topics and files of the source."""

    topics: Mapping[str, str] = field(default_factory=dict)  #: Name in the bag by name in the suite.
    frames: FramesConfig = field(default_factory=FramesConfig)
    calibration: CalibrationConfig = CalibrationConfig()
    extrinsics: ExtrinsicsConfig = ExtrinsicsConfig()
    sync: SyncConfig = SyncConfig()
    truth: TruthConfig = field(default_factory=TruthConfig)
    #: The complete configuration, whose other sections configure the processing and the judgement. The sections are not
    #: compared, because equal values can be written in several forms.
    configuration: Configuration = field(default_factory=Configuration, compare=False)

    @property
    def changes_messages(self) -> bool:
        """Whether calibration, pairing or truth are configured, so that those of a bag are not its messages.

        Names of topics, frames and extrinsics do not change the content of a message.
        """
        as_recorded = CalibrationConfig(), SyncConfig(), TruthConfig()
        return (self.calibration, self.sync, self.truth) != as_recorded

    @property
    def changed_reading(self) -> dict[str, object]:
        """The settings that select, pair or interpret the messages of a source, if they differ from the defaults.

        The keys are dotted names. Settings of the ground truth are not included.
        """
        sections = ("frames", "calibration", "extrinsics", "sync")
        settings: dict[str, object] = {f"topics.{name}": topic for name, topic in self.topics.items()}
        for name in sections:
            settings |= changed(getattr(self, name), f"{name}.")
        return settings

    @property
    def topics_and_truth(self) -> dict[str, str]:
        """The `topics`, and the topic of `truth.source` as ground_truth/odometry."""
        truth = {"ground_truth/odometry": self.truth.topic} if self.truth.topic else {}
        return {**self.topics, **truth}

    @classmethod
    def of(cls, given: Configuration) -> SourceConfig:
        """Build the configuration from its sections, with absolute names of files. Raises ConfigError."""
        topics = _checked_topics(given.section("topics"), given.origin)
        types = get_type_hints(cls)
        sections = [item.name for item in fields(cls) if item.name in SECTIONS and item.name != "topics"]
        parts = {name: given.build(types[name], name) for name in sections}
        config = cls(topics, **parts, configuration=given)
        config.extrinsics.transform(f"{given.origin}, extrinsics")  # reports invalid values with the name of the file
        config.frames.head_transform(f"{given.origin}, frames")
        return replace(
            config,
            truth=replace(config.truth, source=file_or_topic(config.truth.source, given.folder)),
            calibration=replace(config.calibration, file=file_in(config.calibration.file, given.folder)),
        )


def _checked_topics(topics: Mapping[str, object], origin: str) -> dict[str, str]:
    """Return the section `topics` without a slash at the beginning or end of the names in the suite.

    Raises ConfigError if a value is not the name of a topic, or if a name of the suite has two topics. Two names of the
    suite with one topic are also refused, because a message is read under one name only.
    """
    checked: dict[str, str] = {}
    name_of: dict[str, str] = {}
    for given_name, topic in topics.items():
        name = given_name.strip("/")
        if not isinstance(topic, str) or not topic:
            raise ConfigError(f"{origin}: topics.{name}: the name of a topic of the source is required")
        if name in checked:
            raise ConfigError(f"{origin}: 'topics.{name}' is given twice: give it once")
        checked[name] = topic
        other = name_of.setdefault(topic.strip("/"), name)
        if other != name:
            raise ConfigError(
                f"{origin}: topics.{other} and topics.{name} are both '{topic}': a topic is read under one name; omit "
                "one of them, and use a second configuration for the other task"
            )
    return checked


DEFAULT_SOURCE = SourceConfig()  #: The source is read by its own topics and files.


def file_in(name: str, folder: Path) -> str:
    """Return the absolute path of a file whose name is relative to a folder; empty for an empty name.

    Links to folders are resolved, but not links to files, because the ending of a name states the format.
    """
    path = folder / name
    return str(path.parent.resolve() / path.name) if name else ""


def file_or_topic(name: str, folder: Path) -> str:
    """Return the absolute path of the file or bag that `truth.source` names in a folder, or the name of its topic.

    A name with a dot is that of a file, also of a missing one, because names of ROS topics contain no dots.
    """
    file = folder / name
    return file_in(name, folder) if "." in name or file.is_file() or is_bag(file) else name
