"""Examination of a source in steps, each of which adds to the proposal of its configuration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from sfr_loc_map.configuration.parameters import flatten
from sfr_loc_map.configuration.sections import NOTHING_GIVEN, Configuration, Key
from sfr_loc_map.errors import SfrError
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.io.bag.bag import Bag
from sfr_loc_map.io.calibration.calibration_file import CalibrationError
from sfr_loc_map.io.registry import format_of, open_source, read_truth
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.io.source_config import FILE_SETTINGS, SourceConfig, copied
from sfr_loc_map.io.source_format import SourceFormat, is_bag
from sfr_loc_map.io.truth.of_bag import could_be_truth
from sfr_loc_map.source_setup.bag_findings import with_calibration, with_origin_of_stamps, with_sync, with_topics
from sfr_loc_map.source_setup.drive_findings import with_condition, with_extrinsics, with_lever_arm
from sfr_loc_map.source_setup.proposal import Proposal, TruthComponents


def propose_config(source: Path, given: Configuration, before: Configuration = NOTHING_GIVEN) -> Proposal:
    """Examine a source and propose its configuration; the given values are kept.

    Each step reads the source as the earlier steps configure it. The reason for a given value is "as
    before" if `before` has the same value. Files in or below the folder of `given` are named relative to this folder.
    InputError if the source, the given calibration or the given truth is invalid or corrupt.
    """
    proposal = _given_values(source, given, before)
    recorded = Bag(source) if format_of(source) is SourceFormat.BAG else None
    if recorded is not None:
        proposal = _with_topics_and_stamps(proposal, recorded)
    try:
        loc = _opened_drive(source, proposal.config)
    except CalibrationError:
        raise
    except SfrError as error:  # if values are missing, they are the cause, and the error is not reported
        return _without_drive_or_truth(proposal, given, "" if proposal.missing else str(error))
    if loc is None:
        return _without_drive_or_truth(proposal, given)
    proposal = with_extrinsics(proposal, loc)
    try:
        truth = loc.ground_truth
    except SfrError as error:
        return _without_drive_or_truth(proposal, given, str(error))
    if truth is not None:
        return _with_truth(proposal, truth, loc.stamps_ns)
    return proposal if recorded is None else _with_possible_truth(proposal, recorded)


def _given_values(source: Path, given: Configuration, before: Configuration) -> Proposal:
    """Return a proposal that contains only the given values.

    Files in the folder of the `sfr.yaml` are named relative to this folder.
    """
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


def _with_topics_and_stamps(proposal: Proposal, recorded: Bag) -> Proposal:
    """Return a proposal with the topics, stamps and calibration that a bag requires to be opened."""
    proposal = with_topics(proposal, recorded)
    bag = recorded.renamed(proposal.config.topics)
    proposal = with_origin_of_stamps(proposal, bag)
    bag = bag.stamped_by(proposal.config.sync.stamps)
    proposal = with_calibration(proposal, bag)
    return with_sync(proposal, bag)


def _opened_drive(source: Path, config: SourceConfig) -> LocSequence | None:
    """Open a source and read the stamps and poses of its pairs; return its drive.

    Raises the error of an unreadable source.
    """
    opened = open_source(source, config)
    for pairs in (opened.loc, opened.nav):
        if pairs is not None:
            len(pairs)  # those of a bag are read on first use
    return opened.loc


def _with_truth(proposal: Proposal, truth: Truth, stamps_ns: Sequence[int]) -> Proposal:
    """Return a proposal with the components of a ground truth, and a condition for the pairs with these stamps.

    Nothing is added for a truth of fewer than two poses.
    """
    if len(truth) < 2:
        return proposal
    components = TruthComponents(truth.has_attitude, truth.has_height, truth.has_tilt)
    proposal = proposal.adding(truth=components)
    if "lever_arm_m" not in proposal.configuration.section("truth"):
        proposal = with_lever_arm(proposal, truth)
    if "conditions" not in proposal.sections:
        proposal = with_condition(proposal, stamps_ns, truth)
    return proposal


def _with_possible_truth(proposal: Proposal, recorded: Bag) -> Proposal:
    """Return a proposal with a remark that the truth of a bag is unknown, and with the topics that may be the truth."""
    text = f"no truth: a score requires --set truth.source=TOPIC or FILE{could_be_truth(recorded)}"
    return proposal.adding(remarks=[text])


def _without_drive_or_truth(proposal: Proposal, given: Configuration, problem: str = "") -> Proposal:
    """Return the proposal of a source that has no drive, or whose drive or truth cannot be read, with the problem.

    An empty problem is not added. A truth that the configuration names is read, so that an invalid one is an error.
    """
    truth = given.section("truth")
    if truth.get("source") or (truth.get("frame") and is_bag(proposal.source)):
        read_truth(proposal.source, proposal.config)
    return proposal.adding(missing=[problem]) if problem else proposal
