"""Proposal of an `sfr.yaml` for a recording: each value with its reason, and the values that cannot be inferred."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.config import flatten
from sfr_loc_map.config_yaml import yaml_text
from sfr_loc_map.errors import SfrError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.bag.bag import Bag
from sfr_loc_map.io.bag.poses import read_frame_tree
from sfr_loc_map.io.calibration.calibration_file import CalibrationError
from sfr_loc_map.io.layouts.bag_rig import image_name
from sfr_loc_map.io.layouts.bag_source import BagLocSequence
from sfr_loc_map.io.registry import format_of, open_source
from sfr_loc_map.io.sequence import LocSequence, SourceFormat
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.source_settings import FILE_SETTINGS
from sfr_loc_map.io.truth.names import is_tracker
from sfr_loc_map.io.truth.of_bag import could_be_truth
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_types import CAMERA_INFO, COMPRESSED, IMAGE
from sfr_loc_map.metrics.config import SPACING_FRAMES
from sfr_loc_map.source_setup.topic_guess import guess_topics, seen_topics
from sfr_loc_map.stamp_pairing import below_half_period, nearest_stamps
from sfr_loc_map.suite_names import SIDES
from sfr_loc_map.topics import COMPRESSED_END, TRUE_POSES

SHORT_M = 12.0  #: Shorter drives, m, have too few sub-trajectories of 5 m, so 1 m is proposed.
FEWEST_STAMPS = 3  #: Smallest number of stamps of a side from which an offset is inferred.
STEADY = 0.1  #: Largest variation of a constant offset of the right stamps, as a fraction of the period.


@dataclass(slots=True)
class Proposal:
    """Sections of an `sfr.yaml` with the reason for each value, the values that only the owner can add, and remarks."""

    source: Path
    sections: dict[str, Any]
    path: Path | None = None  #: Path of the `sfr.yaml`; file names are relative to its folder.
    reasons: dict[str, str] = field(default_factory=dict)  #: By `section.name`.
    missing: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    has_attitude: bool | None = None  #: Whether the truth has attitudes; None without truth.
    has_height: bool = True  #: Whether the truth has heights.
    has_tilt: bool = True  #: Whether the truth has roll and pitch.

    def set(self, section: str, name: str, value: object, reason: str) -> None:
        """Propose a value, unless the user has given it."""
        if name not in self.sections.setdefault(section, {}):
            self.sections[section][name] = value
            self.reasons[f"{section}.{name}"] = reason

    @property
    def config(self) -> SourceConfig:
        """The proposal as a configuration."""
        return SourceConfig.of(self.sections, self.path)

    def text(self) -> str:
        """Return the proposal as `sfr.yaml`, each value with its reason."""
        lines = [f"# How every command and node reads '{self.source}': docs/configuration.md."]
        lines += [f"# MISSING: {text}" for text in self.missing] + [f"# {text}" for text in self.remarks]
        for section, values in self.sections.items():
            if not isinstance(values, Mapping):
                lines.append(f"{section}: {yaml_text(values)}  # {self.reasons.get(section, 'given')}")
            elif values:
                lines.append(f"{section}:")
                for name, value in values.items():
                    reason = self.reasons.get(f"{section}.{name}", "given")
                    lines.append(f"  {name}: {yaml_text(value)}  # {reason}")
        return "\n".join(lines) + "\n"


def propose_config(
    source: Path, given: Mapping[str, Any], path: Path | None = None, before: Mapping[str, Any] | None = None
) -> Proposal:
    """Examine a source and propose its configuration; the values in the sections of `given` are kept.

    The reason for a given value is "as before" if `before` has the same value. Files in or below the folder of `path`
    are named relative to this folder. InputError if the source or the given calibration is invalid or corrupt.
    """
    proposal = _given(source, given, path, before or {})
    recorded = Bag(source) if format_of(source) is SourceFormat.BAG else None
    if recorded is not None:
        _topics(proposal, recorded)
        config = proposal.config
        bag = recorded.renamed(config.remap).stamped_by(config.sync.stamps)
        _calibration(proposal, bag)
        _sync(proposal, bag)
    loc = _opened_drive(proposal)
    if loc is not None:
        _extrinsics(proposal, loc)
        _truth(proposal, loc, recorded)
    return proposal


def _given(source: Path, given: Mapping[str, Any], path: Path | None, before: Mapping[str, Any]) -> Proposal:
    """Return the proposal with the given values alone."""
    sections = {name: dict(value) if isinstance(value, Mapping) else value for name, value in given.items()}
    sections.setdefault("topics", {})
    values = flatten(sections)
    reasons = {name: "as before" for name, value in flatten(before).items() if values.get(name) == value}
    if path is not None:
        folder = path.parent.resolve()
        for key in FILE_SETTINGS:
            section, _, name = key.partition(".")
            place = sections.get(section, {}) if name else sections
            file = Path(str(place.get(name or section, "")))
            if file.is_relative_to(folder):
                place[name or section] = str(file.relative_to(folder))
    return Proposal(source, sections, path, reasons)


def _topics(proposal: Proposal, bag: Bag) -> None:
    """Propose the topics of images, calibration and truth that the bag has under other names."""
    guess = guess_topics(seen_topics(bag))
    for name, topic in guess.topics.items():
        if bag.topics.get(topic) == COMPRESSED and not name.endswith(COMPRESSED_END):
            name += COMPRESSED_END
        if not bag.matches(name) and topic not in proposal.sections["topics"].values():
            plain = name.removesuffix(COMPRESSED_END)
            proposal.set("topics", name, topic, guess.reasons.get(plain, "by its name and type"))
    if guess.layout:
        proposal.set("calibration", "stereo_layout", guess.layout, "by the width and height of its images; sure")
    truth = proposal.sections.get("truth", {})
    if guess.truth and not bag.matches(TRUE_POSES) and not {"source", "frame"} & truth.keys():
        proposal.set("truth", "source", guess.truth, guess.truth_reason)
    proposal.remarks += guess.remarks


def _calibration(proposal: Proposal, bag: Bag) -> None:
    """Propose the baseline from /tf_static if camera_info has none; a missing calibration is added to the missing."""
    infos = [bag.find(f"loc/{side}/camera_info", CAMERA_INFO) for side in SIDES]
    messages = bag.first([topic for topic in infos if topic is not None])
    given = proposal.sections.get("calibration", {})
    if image_name(bag, "loc") is None or "file" in given:
        return
    if len(messages) < len(SIDES):
        proposal.missing.append("no camera_info: give --calibration FILE (Kalibr, OpenCV, ROS, COLMAP or rig.json)")
        return
    left, right = (messages[f"loc/{side}/camera_info"] for side in SIDES)
    if right.p[3] == 0 and left.p[3] == 0 and not given.get("baseline_m"):
        joined = read_frame_tree(bag).find(left.header.frame_id.strip("/"), right.header.frame_id.strip("/"))
        if joined is None:
            proposal.missing.append("P[3] of the right camera_info is 0: give --set calibration.baseline_m=METRES")
        else:
            baseline = float(round(np.linalg.norm(joined.translation), 9))
            proposal.set("calibration", "baseline_m", baseline, "P[3] is 0; from /tf_static, left to right frame; sure")


def _sync(proposal: Proposal, bag: Bag) -> None:
    """Propose an offset or a tolerance of stamps if the stamps of left and right differ."""
    image = image_name(bag, "loc")
    if image is None:
        return
    stamps: dict[str, list[int]] = {}
    images = [bag.find(f"loc/{side}/{image}", IMAGE, COMPRESSED) for side in SIDES]
    topics = [topic for topic in images if topic is not None]
    for topic, stamp_ns, _ in bag.stream(topics):
        stamps.setdefault(topic.name, []).append(stamp_ns)
    if len(stamps) == len(SIDES) and min(map(len, stamps.values())) >= FEWEST_STAMPS:
        left_ns, right_ns = (np.array(stamps[topic.name], np.int64) for topic in topics)
        sync = proposal.config.sync
        right_ns = right_ns + round(sync.right_offset_s * NS_PER_S)
        for name, value, reason in _offset_or_tolerance(left_ns, right_ns, sync.stamp_tolerance_ns):
            proposal.set("sync", name, value, reason)


def _offset_or_tolerance(left_ns: IntArray, right_ns: IntArray, tolerance_ns: int) -> Iterator[tuple[str, float, str]]:
    """Yield the setting of `sync` that pairs left and right stamps, with its value and reason; at most one.

    A difference within the tolerance requires no setting. A constant difference is an offset of the right stamps. A
    varying difference requires a larger tolerance, which must stay below half a period; otherwise no setting is
    proposed.
    """
    period_ns = float(min(np.median(np.diff(side)) for side in (left_ns, right_ns)))
    difference_ns = right_ns[nearest_stamps(left_ns, right_ns)[0]] - left_ns
    typical_ns = float(np.median(difference_ns))
    spread_ns = float(np.percentile(np.abs(difference_ns - typical_ns), 95))
    largest_ns = abs(typical_ns) + spread_ns
    if largest_ns <= below_half_period(tolerance_ns, [int(period_ns)]):
        return
    if spread_ns < STEADY * period_ns:
        late = f"{abs(typical_ns) / NS_PER_S:.4g} s {'late' if typical_ns > 0.0 else 'early'}"
        text = f"right stamps are {late}, within {spread_ns / NS_PER_S:.2g} s, modulo the period"
        yield "right_offset_s", round(-typical_ns / NS_PER_S, 6), text
    elif 2 * largest_ns < period_ns:
        tolerance_s = round(1.5 * largest_ns / NS_PER_S, 4)
        yield "stamp_tolerance_s", tolerance_s, f"stamps vary by {spread_ns / NS_PER_S:.2g} s"


def _opened_drive(proposal: Proposal) -> LocSequence | None:
    """Open the source as proposed; without a drive, return None and add the reason to the missing values."""
    try:
        return open_source(proposal.source, proposal.config).loc
    except CalibrationError:
        raise
    except SfrError as error:
        if not proposal.missing:  # otherwise the missing value is the cause
            proposal.missing.append(str(error))
        return None


def _extrinsics(proposal: Proposal, loc: LocSequence) -> None:
    """Propose the extrinsics that the bag has, because some nodes cannot read /tf_static."""
    T_rb_sb = loc.rig.T_rb_sb
    if T_rb_sb is None:
        proposal.missing.append(
            "no extrinsics of the cameras on the rover: give --set 'extrinsics.translation_m=[X, Y, Z]' "
            "--set 'extrinsics.quat_xyzw=[X, Y, Z, W]' (LOCSB in RB)"
        )
        return
    if "extrinsics" in proposal.sections:
        return
    mount = loc.mount if isinstance(loc, BagLocSequence) else None
    if mount is None:
        proposal.remarks.append("extrinsics are those of the source (rig.json or the calibration)")
        return
    reason = f"from {mount.text}; {'unsure' if mount.other_bases else 'sure'}"
    proposal.set("extrinsics", "translation_m", T_rb_sb.translation.tolist(), reason)
    proposal.set("extrinsics", "quat_xyzw", T_rb_sb.quat_xyzw.tolist(), reason)
    if mount.other_bases:
        proposal.remarks.append(f"extrinsics are from {mount.text}: --set frames.base=NAME")


def _truth(proposal: Proposal, loc: LocSequence, recorded: Bag | None) -> None:
    """Add the known components of the truth, remarks about a missing truth or lever arm, and a condition."""
    truth = loc.ground_truth
    if truth is None and recorded is not None:
        text = f"no truth: a score requires --set truth.source=TOPIC or FILE{could_be_truth(recorded)}"
        proposal.remarks.append(text)
    if truth is None or len(truth) < 2:
        return
    given = proposal.sections.get("truth", {})
    name = str(given.get("source") or given.get("frame") or "of the source")
    proposal.has_attitude = truth.has_attitude
    proposal.has_height, proposal.has_tilt = getattr(truth, "has_height", True), getattr(truth, "has_tilt", True)
    if "lever_arm_m" not in given and (is_tracker(name) or not proposal.has_attitude):
        text = f"the truth {name} is assumed to track RB (lever arm 0): give --set 'truth.lever_arm_m=[X, Y, Z]'"
        proposal.remarks.append(text)
    if "conditions" not in proposal.sections:
        _conditions(proposal, loc.stamps_ns, truth)


def _conditions(proposal: Proposal, stamps_ns: Sequence[int], truth: Trajectory) -> None:
    """Propose a condition with at least two sub-trajectories in the drive."""
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(truth.positions, axis=0), axis=1)))
    left_m = along_m[-1] - np.interp(stamps_ns, truth.stamps_ns, along_m)[::SPACING_FRAMES]
    metres, pairs = 5 if along_m[-1] >= SHORT_M else 1, len(stamps_ns)
    proposal.reasons["conditions"] = f"the true path is {along_m[-1]:.1f} m long"
    proposal.sections["conditions"] = [f"distance={metres}"]
    if np.sum(left_m >= metres) < 2:
        proposal.sections["conditions"] = [f"frames={max(1, min(SPACING_FRAMES, pairs - SPACING_FRAMES - 1))}"]
        if pairs < SPACING_FRAMES + 2:
            proposal.remarks.append(f"{pairs} pairs are too few for a verdict: {SPACING_FRAMES + 2} are required")
