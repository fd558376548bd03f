"""Proposal of an `sfr.yaml` for a recording: each value with its reason, and the values that cannot be inferred."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from sfr_loc_map.configuration.parameters import build, flatten
from sfr_loc_map.configuration.sections import NOTHING_GIVEN, Configuration, Key
from sfr_loc_map.configuration.yaml_file import yaml_text
from sfr_loc_map.errors import ConfigError, SfrError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.io.bag.bag import Bag, Topic
from sfr_loc_map.io.bag.files import is_bag
from sfr_loc_map.io.bag.poses import read_frame_tree
from sfr_loc_map.io.calibration.calibration_file import CalibrationError
from sfr_loc_map.io.layouts.bag_cameras import image_name
from sfr_loc_map.io.layouts.bag_source import BagLocSequence
from sfr_loc_map.io.registry import format_of, open_source, read_truth
from sfr_loc_map.io.sequence import LocSequence, SourceFormat
from sfr_loc_map.io.source_config import CalibrationConfig, SourceConfig, SyncConfig
from sfr_loc_map.io.source_settings import FILE_SETTINGS, copied
from sfr_loc_map.io.truth.names import is_tracker
from sfr_loc_map.io.truth.of_bag import could_be_truth
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_types import CAMERA_INFO, COMPRESSED, IMAGE
from sfr_loc_map.metrics.config import SPACING_FRAMES
from sfr_loc_map.source_setup.seen_topics import seen_topics
from sfr_loc_map.source_setup.topic_guess import guess_topics
from sfr_loc_map.stamp_pairing import MAX_TOLERANCE_S, below_half_period, nearest_stamps
from sfr_loc_map.suite_names import SIDES, Task
from sfr_loc_map.topics import COMPRESSED_END, TRUE_POSES

SHORT_M = 12.0  #: Shorter drives, m, have too few sub-trajectories of 5 m, so 1 m is proposed.
FEWEST_STAMPS = 3  #: Minimum number of left, and of right, stamps from which an offset is inferred.
RIGS = tuple(task.rig for task in Task)
STEADY = 0.1  #: Largest variation of a constant offset of the right stamps, as a fraction of the period.


class Value(NamedTuple):
    """An inferred value of an `sfr.yaml`."""

    key: Key
    value: object
    reason: str


class TruthComponents(NamedTuple):
    """Components of a pose that the ground truth has."""

    has_attitude: bool = True
    has_height: bool = True
    has_tilt: bool = True  #: Whether the poses have roll and pitch.


@dataclass(frozen=True, slots=True)
class Findings:
    """What one step of the examination infers."""

    values: tuple[Value, ...] = ()
    missing: tuple[str, ...] = ()  #: Values that only the owner can add.
    remarks: tuple[str, ...] = ()
    truth: TruthComponents | None = None  #: Components of the ground truth; None if they are unknown.


@dataclass(frozen=True, slots=True)
class Proposal:
    """Sections of an `sfr.yaml` with the reason for each value, the values that only the owner can add, and remarks."""

    source: Path
    configuration: Configuration  #: The sections with all values, and the path of the `sfr.yaml`, if it is known.
    reasons: Mapping[Key, str] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    truth: TruthComponents | None = None  #: Components of the ground truth; None without ground truth.

    def adding(self, findings: Findings) -> Proposal:
        """Return the proposal with the findings of a step; values that it already contains are kept.

        A value outside of the range of its parameter is reported as missing.
        """
        sections = copied(self.sections)
        reasons = dict(self.reasons)
        refused: list[str] = []
        for key, value, reason in findings.values:
            if key.value_in(sections) is not None:
                continue
            if problem := _problem_of(key, value):
                refused.append(f"{problem} ({reason})")
                continue
            key.put(value, sections)
            reasons[key] = reason
        return replace(
            self,
            configuration=replace(self.configuration, sections=sections),
            reasons=reasons,
            missing=(*self.missing, *findings.missing, *refused),
            remarks=(*self.remarks, *findings.remarks),
            truth=findings.truth or self.truth,
        )

    @property
    def sections(self) -> Mapping[str, Any]:
        """The sections with all values."""
        return self.configuration.sections

    @property
    def config(self) -> SourceConfig:
        """How the source is read with the proposal."""
        return SourceConfig.of(self.configuration)

    def text(self) -> str:
        """Return the proposal as `sfr.yaml`, each value with its reason."""
        lines = [f"# How every command and node reads '{self.source}': docs/configuration.md."]
        lines += [f"# MISSING: {text}" for text in self.missing] + [f"# {text}" for text in self.remarks]
        for section, values in self.sections.items():
            if not isinstance(values, Mapping):
                lines.append(f"{section}: {yaml_text(values)}  # {self.reasons.get(Key(section), 'given')}")
            elif values:
                lines.append(f"{section}:")
                for name, value in values.items():
                    reason = self.reasons.get(Key(section, name), "given")
                    lines.append(f"  {name}: {yaml_text(value)}  # {reason}")
        return "\n".join(lines) + "\n"


def _problem_of(key: Key, value: object) -> str:
    """Return why the parameter with a key cannot have a value; empty for a valid value or a key of no parameter."""
    config_type = get_type_hints(SourceConfig).get(key.section)
    if not isinstance(config_type, type) or not is_dataclass(config_type):
        return ""
    try:
        build(config_type, {key.name: value}, origin=key.section)
    except ConfigError as error:
        return str(error)
    return ""


def propose_config(source: Path, given: Configuration, before: Configuration = NOTHING_GIVEN) -> Proposal:
    """Examine a source and propose its configuration; the given values are kept.

    Each step reads the source as the findings of the earlier steps configure it. The reason for a given value is "as
    before" if `before` has the same value. Files in or below the folder of `given` are named relative to this folder.
    InputError if the source, the given calibration or the given truth is invalid or corrupt.
    """
    proposal = _given(source, given, before)
    recorded = Bag(source) if format_of(source) is SourceFormat.BAG else None
    if recorded is not None:
        proposal = _with_topics_and_stamps(proposal, recorded)
    try:
        loc = _opened_drive(source, proposal.config)
    except CalibrationError:
        raise
    except SfrError as error:  # if values are missing, they are the cause, and the error is not reported
        _check_given_truth(source, given, proposal.config)
        return proposal if proposal.missing else proposal.adding(Findings(missing=(str(error),)))
    if loc is None:
        _check_given_truth(source, given, proposal.config)
        return proposal
    proposal = proposal.adding(_extrinsics(loc, proposal.config))
    try:
        truth = loc.ground_truth
    except SfrError as error:
        _check_given_truth(source, given, proposal.config)
        return proposal.adding(Findings(missing=(str(error),)))
    if truth is None and recorded is not None:
        text = f"no truth: a score requires --set truth.source=TOPIC or FILE{could_be_truth(recorded)}"
        return proposal.adding(Findings(remarks=(text,)))
    return proposal if truth is None or len(truth) < 2 else _with_truth(proposal, truth, loc.stamps_ns)


def _check_given_truth(source: Path, given: Configuration, config: SourceConfig) -> None:
    """Raise the error of a given truth that is invalid or corrupt, also if the images of the source cannot be read."""
    truth = given.section("truth")
    if truth.get("source") or (truth.get("frame") and is_bag(source)):
        read_truth(source, config)


def _with_topics_and_stamps(proposal: Proposal, recorded: Bag) -> Proposal:
    """Return a proposal with the topics, stamps and calibration that a bag requires to be opened."""
    proposal = proposal.adding(_topics(recorded, proposal.config))
    renamed = recorded.renamed(proposal.config.remap)
    proposal = proposal.adding(_origin_of_stamps(renamed))
    bag = renamed.stamped_by(proposal.config.sync.stamps)
    proposal = proposal.adding(_calibration(bag, proposal.config.calibration))
    return proposal.adding(_sync(bag, proposal.config.sync))


def _with_truth(proposal: Proposal, truth: Truth, stamps_ns: Sequence[int]) -> Proposal:
    """Return a proposal with the components of a ground truth, and a condition for the pairs with these stamps."""
    components = TruthComponents(truth.has_attitude, truth.has_height, truth.has_tilt)
    proposal = proposal.adding(Findings(truth=components))
    if "lever_arm_m" not in proposal.configuration.section("truth"):
        proposal = proposal.adding(_lever_arm(truth, proposal.config))
    if "conditions" not in proposal.sections:
        proposal = proposal.adding(_condition(stamps_ns, truth))
    return proposal


def _given(source: Path, given: Configuration, before: Configuration) -> Proposal:
    """Return the proposal with the given values alone."""
    sections = copied(given.sections)
    sections.setdefault("topics", {})
    keys = map(Key.parse, flatten(before.sections))
    reasons = {key: "as before" for key in keys if key.value_in(sections) == key.value_in(before.sections)}
    if given.path is not None:
        folder = given.folder.resolve()
        for key in FILE_SETTINGS:
            file = Path(str(key.value_in(sections) or ""))
            if file.is_relative_to(folder):
                key.put(str(file.relative_to(folder)), sections)
    return Proposal(source, replace(given, sections=sections), reasons)


def _topics(bag: Bag, given: SourceConfig) -> Findings:
    """Propose the topics of images, calibration and truth that the bag has under other names."""
    guess = guess_topics(seen_topics(bag))
    values: list[Value] = []
    for plain, topic in guess.topics.items():
        is_compressed = bag.topics.get(topic) == COMPRESSED and not plain.endswith(COMPRESSED_END)
        name = f"{plain}{COMPRESSED_END}" if is_compressed else plain
        if not bag.matches(name) and topic not in given.remap:
            reason = guess.reasons.get(plain.removesuffix(COMPRESSED_END), "by its name and type")
            values.append(Value(Key("topics", name), topic, reason))
    if guess.layout:
        values.append(
            Value(Key("calibration", "stereo_layout"), guess.layout, "by the width and height of its images; likely")
        )
    if guess.truth and not bag.matches(TRUE_POSES) and not given.truth.source and not given.truth.frame:
        values.append(Value(Key("truth", "source"), guess.truth, guess.truth_reason))
    return Findings(tuple(values), remarks=tuple(guess.remarks))


def _origin_of_stamps(bag: Bag) -> Findings:
    """Propose the times of recording if the header stamps of all images are 0."""
    topics = [topic for rig in RIGS for topic in _image_topics(bag, rig)]
    count = 0
    for _, stamp_ns, _ in bag.stream(topics):
        if stamp_ns:
            return Findings()
        count += 1
    if count < 2:
        return Findings()
    return Findings((Value(Key("sync", "stamps"), "record", "all stamps of the headers are 0; sure"),))


def _calibration(bag: Bag, given: CalibrationConfig) -> Findings:
    """Propose the baseline from /tf_static if camera_info has none; report a calibration that is missing.

    Two frames at one position have no baseline.
    """
    infos = [bag.find(f"loc/{side}/camera_info", CAMERA_INFO) for side in SIDES]
    messages = bag.first([topic for topic in infos if topic is not None])
    if image_name(bag, "loc") is None or given.file:
        return Findings()
    if len(messages) < len(SIDES):
        text = "no camera_info: give --calibration FILE (Kalibr, OpenCV, ROS, COLMAP or rig.json)"
        return Findings(missing=(text,))
    left, right = (messages[f"loc/{side}/camera_info"] for side in SIDES)
    if right.p[3] != 0 or left.p[3] != 0 or given.baseline_m:
        return Findings()
    joined = read_frame_tree(bag).find(left.header.frame_id.strip("/"), right.header.frame_id.strip("/"))
    if joined is None or not joined.translation.any():
        return Findings(missing=("P[3] of the right camera_info is 0: give --set calibration.baseline_m=METRES",))
    baseline = float(round(np.linalg.norm(joined.translation), 9))
    reason = "P[3] is 0; from /tf_static, left to right frame; sure"
    return Findings((Value(Key("calibration", "baseline_m"), baseline, reason),))


def _image_topics(bag: Bag, rig: str) -> list[Topic]:
    """Return the topics of the images of a rig, left first; empty without images."""
    image = image_name(bag, rig)
    if image is None:
        return []
    topics = [bag.find(f"{rig}/{side}/{image}", IMAGE, COMPRESSED) for side in SIDES]
    return [topic for topic in topics if topic is not None]


def _sync(bag: Bag, given: SyncConfig) -> Findings:
    """Propose an offset or a tolerance of stamps if the stamps of the drive's left and right images differ."""
    topics = _image_topics(bag, "loc")
    stamps: dict[str, list[int]] = {topic.name: [] for topic in topics}
    for topic, stamp_ns, _ in bag.stream(topics):
        stamps[topic.name].append(stamp_ns)
    if len(stamps) < len(SIDES) or min(map(len, stamps.values())) < FEWEST_STAMPS:
        return Findings()
    left_ns, right_ns = (np.array(side, np.int64) for side in stamps.values())
    right_ns = right_ns + round(given.right_offset_s * NS_PER_S)
    found = _offset_or_tolerance(left_ns, right_ns, given.stamp_tolerance_ns)
    return Findings(tuple(Value(Key("sync", name), value, reason) for name, value, reason in found))


def _offset_or_tolerance(left_ns: IntArray, right_ns: IntArray, tolerance_ns: int) -> Iterator[tuple[str, float, str]]:
    """Yield the setting of `sync` that pairs left and right stamps, with its value and reason; at most one.

    A difference within the tolerance requires no setting. No setting is proposed for a difference of half a period,
    because a right image is then equally near to two left images. A constant smaller difference is an offset of the
    right stamps. A varying difference requires a larger tolerance.
    """
    period_ns = float(min(np.median(np.diff(side)) for side in (left_ns, right_ns)))
    difference_ns = right_ns[nearest_stamps(left_ns, right_ns)[0]] - left_ns
    typical_ns = float(np.median(difference_ns))
    spread_ns = float(np.percentile(np.abs(difference_ns - typical_ns), 95))
    largest_ns = abs(typical_ns) + spread_ns
    if largest_ns <= below_half_period(tolerance_ns, [int(period_ns)]) or 2 * largest_ns >= period_ns:
        return
    if spread_ns < STEADY * period_ns:
        late = f"{abs(typical_ns) / NS_PER_S:.4g} s {'late' if typical_ns > 0.0 else 'early'}"
        text = f"right stamps are {late}, within {spread_ns / NS_PER_S:.2g} s, modulo the period"
        yield "right_offset_s", round(-typical_ns / NS_PER_S, 6), text
    else:
        largest_s = largest_ns / NS_PER_S
        tolerance_s = max(largest_s, min(1.5 * largest_s, MAX_TOLERANCE_S))
        yield "stamp_tolerance_s", round(tolerance_s, 4), f"stamps vary by {spread_ns / NS_PER_S:.2g} s"


def _opened_drive(source: Path, config: SourceConfig) -> LocSequence | None:
    """Open a source and read the stamps and poses of its pairs; return its drive.

    Raises the error of an unreadable source.
    """
    opened = open_source(source, config)
    for pairs in (opened.loc, opened.nav):
        if pairs is not None:
            len(pairs)  # those of a bag are read on first use
    return opened.loc


def _extrinsics(loc: LocSequence, given: SourceConfig) -> Findings:
    """Propose the extrinsics that the bag has, because some nodes cannot read /tf_static."""
    T_rb_sb = loc.rig.T_rb_sb
    if T_rb_sb is None:
        text = (
            "no extrinsics of the cameras on the rover: give --set 'extrinsics.translation_m=[X, Y, Z]' "
            "--set 'extrinsics.quat_xyzw=[X, Y, Z, W]' (LOCSB in RB)"
        )
        return Findings(missing=(text,))
    if given.extrinsics.transform() is not None:
        return Findings()
    mount = loc.mount if isinstance(loc, BagLocSequence) else None
    if mount is None:
        return Findings(remarks=("extrinsics are those of the source (rig.json or the calibration)",))
    reason = f"from {mount.text}; {'unsure' if mount.other_bases else 'sure'}"
    values = (
        Value(Key("extrinsics", "translation_m"), T_rb_sb.translation.tolist(), reason),
        Value(Key("extrinsics", "quat_xyzw"), T_rb_sb.quat_xyzw.tolist(), reason),
    )
    remark = f"extrinsics are from {mount.text}: if RB is another frame, give --set frames.base=NAME"
    return Findings(values, remarks=(remark,) if mount.other_bases else ())


def _lever_arm(truth: Truth, config: SourceConfig) -> Findings:
    """Remark that the lever arm is assumed to be 0, if the truth is probably that of another body than RB."""
    file = config.truth.file
    name = (file.name if file is not None else config.truth.source) or config.truth.frame or "of the source"
    if truth.has_attitude and not is_tracker(name):
        return Findings()
    text = f"the truth {name} is assumed to track RB (lever arm 0): give --set 'truth.lever_arm_m=[X, Y, Z]'"
    return Findings(remarks=(text,))


def _condition(stamps_ns: Sequence[int], truth: Truth) -> Findings:
    """Propose a condition with at least two sub-trajectories in the drive."""
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(truth.positions, axis=0), axis=1)))
    left_m = along_m[-1] - np.interp(stamps_ns, truth.stamps_ns, along_m)[::SPACING_FRAMES]
    metres, pairs = 5 if along_m[-1] >= SHORT_M else 1, len(stamps_ns)
    reason = f"the true path is {along_m[-1]:.1f} m long"
    if np.sum(left_m >= metres) >= 2:
        return Findings((Value(Key("conditions"), [f"distance={metres}"], reason),))
    frames = max(1, min(SPACING_FRAMES, pairs - SPACING_FRAMES - 1))
    remark = f"too few pairs for a verdict: {pairs} ({SPACING_FRAMES + 2} are required)"
    return Findings(
        (Value(Key("conditions"), [f"frames={frames}"], reason),),
        remarks=(remark,) if pairs < SPACING_FRAMES + 2 else (),
    )
