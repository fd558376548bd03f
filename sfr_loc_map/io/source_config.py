"""How a source is read: the sections of `sfr.yaml` before `localisation` (docs/configuration.md).

`source_config` returns the configuration of a source, which is the file beside it by default. `with_settings` applies
the options of a command.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_type_hints

from sfr_loc_map.configuration.parameters import changed, flatten, is_empty, param, suggestion
from sfr_loc_map.configuration.sections import SECTIONS, Configuration, Key, check_form, check_one_name
from sfr_loc_map.errors import ConfigError, GeometryError, SfrError, naming_key
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import parent_of
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

    file: str = param(
        "",
        doc="Calibration by Kalibr, OpenCV, ROS, COLMAP, EuRoC or ORB-SLAM, or a rig.json; empty: that of the source.",
    )
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

    ConfigError if a translation is given without a rotation, or if the quaternion is not a rotation.
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

    A name with a dot is the name of a file, even if the file is missing, because ROS topic names contain no dots.
    """
    file = folder / name
    return file_in(name, folder) if "." in name or file.is_file() or is_bag(file) else name


# ---- the file beside a source, and changes by the options of a command

NAME = "sfr.yaml"
_REMAP_FORM = "{FOUND: EXPECTED}"  #: Form of a remapping in messages.
FILE_SETTINGS: Mapping[Key, Callable[[str, Path], str]] = {
    Key("calibration", "file"): file_in,
    Key("truth", "source"): file_or_topic,
    Key("limits"): file_in,
}
"""The settings that name files. Each has the function `(name, folder)` that makes the name an absolute path."""


def config_beside(source: Path) -> Path | None:
    """Return the `sfr.yaml` in the folder of a source or in its parent folder.

    None if there is no such file, or if the source is not a bag and the file belongs to a bag beside it.
    """
    folders = (source, parent_of(source)) if source.is_dir() else (parent_of(source),)
    found = next((folder / NAME for folder in folders if (folder / NAME).is_file()), None)
    if found is not None and found.parent != source and not is_bag(source) and _is_of_bag(found):
        return None  # the file belongs to a bag beside the source
    return found


def _is_of_bag(path: Path) -> bool:
    """Return whether a configuration names topics, which only bags have."""
    try:
        config = SourceConfig.of(Configuration.read(path))
    except SfrError:
        return False  # reported when the configuration is read
    return bool(config.topics) or bool(config.truth.topic)


def with_settings(
    given: Configuration,
    values: Mapping[str, Any],
    calibration: Path | None = None,
    remap: Mapping[str, str] | None = None,
) -> Configuration:
    """Return a configuration with changed values.

    The values have the names `SECTION.KEY` or `SECTION`. A mapping changes the values that it contains, and keeps the
    other values of its section or group. `remap` is applied before the settings.

    File names in `values` and `calibration` are relative to the working directory. ConfigError if a section is unknown,
    if a value does not have the form of its section, or if two settings give a key different values.
    """
    sections = copied(given.sections)
    if remap:
        sections["topics"] = _renamed_topics(given.section("topics"), remap)
    settings = [*values.items()]
    if calibration is not None:
        settings.append(("calibration.file", str(calibration)))
    check_one_name(values, "settings")
    given_before: dict[Key, object] = {}
    for name, value in settings:
        with naming_key(f"setting '{name}'"):
            flat = flatten({name: value}, keeps_empty=True)
        for dotted, item in flat.items():
            key = Key.parse(dotted)
            if key.section not in SECTIONS:
                raise ConfigError(f"setting '{dotted}': no section '{key.section}'{suggestion(key.section, SECTIONS)}")
            check_form(key, item, f"setting '{dotted}'")
            before = given_before.setdefault(key, item)
            if before != item:
                raise ConfigError(f"setting '{dotted}' is {item!r:.40}, but another is {before!r:.40}: omit one")
            if key.name or not is_empty(item):
                key.put(_in_working_directory(key, item), sections)
    return replace(given, sections=sections, is_changed=given.is_changed or sections != given.sections)


def copied(sections: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of sections whose mappings can be changed."""
    return {name: dict(value) if isinstance(value, Mapping) else value for name, value in sections.items()}


def _renamed_topics(topics: Mapping[str, Any], remap: Mapping[str, str]) -> dict[str, Any]:
    """Return the section `topics` after the changes of `remap`.

    `topics` maps names in the suite to topics of the bag, and `remap` maps topics of the bag to names in the suite.
    A topic that is remapped, or a name that is given to another topic, loses its entry. ConfigError if `remap` does not
    map names of topics, or gives one name to several topics.
    """
    by_name: dict[str, str] = {}
    for topic, name in remap.items():
        if not isinstance(topic, str) or not isinstance(name, str):
            raise ConfigError(
                f"remap gives {topic!r:.40} the name {name!r:.40}: names of topics are required, {_REMAP_FORM}"
            )
        other = by_name.setdefault(name.strip("/"), topic)
        if other != topic:
            raise ConfigError(
                f"remap gives the name '{name}' to two topics, '{other}' and '{topic}': give it to one, {_REMAP_FORM}"
            )
    remapped = {topic.strip("/") for topic in remap}
    kept = {name: topic for name, topic in topics.items() if str(topic).strip("/") not in remapped}
    return kept | by_name


def _in_working_directory(key: Key, value: Any) -> Any:  # noqa: ANN401 - any value of a setting
    """Return the value of a setting with the absolute paths of the files that it names (`FILE_SETTINGS`)."""
    path_of = FILE_SETTINGS.get(key)
    return value if path_of is None or not isinstance(value, str) else path_of(value, Path())


def check_remap(source: Path, remap: Mapping[str, str]) -> None:
    """Raise ConfigError if `remap` is not a mapping, or if topics of a source without topics are remapped."""
    if not isinstance(remap, Mapping):
        raise ConfigError(f"remap has the type {type(remap).__name__}: names of topics are required, {_REMAP_FORM}")
    if remap and source.exists() and not is_bag(source):
        raise ConfigError(f"remap applies only to topics of a bag, but '{source}' is not a bag: omit it")


def source_config(source: Path, path: Path | None = None, remap: Mapping[str, str] | None = None) -> SourceConfig:
    """Return the configuration in a file, by default the `sfr.yaml` beside the source; `remap` overrides topics."""
    if remap is not None:
        check_remap(source, remap)
    path = path or config_beside(source)
    if path is None and not remap:
        return DEFAULT_SOURCE
    return SourceConfig.of(with_settings(Configuration.read(path), {}, remap=remap))


def with_truth_settings(truth: Path, config: SourceConfig, settings: Mapping[str, Any], columns: str) -> SourceConfig:
    """Return a configuration of a truth that is changed by settings `truth.KEY` and by the columns of a table.

    ConfigError if a setting is not in the section `truth`.
    """
    for name in settings:
        if Key.parse(name).section != "truth":
            raise ConfigError(f"setting '{name}': only settings of the truth apply here: give truth.KEY=VALUE")
    values = dict(settings)
    if columns:
        values["truth.columns"] = columns
    if not truth.is_dir() and not is_bag(truth):
        values = {"truth.source": ""} | values  # the truth itself is the file
    return SourceConfig.of(with_settings(config.configuration, values)) if values else config
