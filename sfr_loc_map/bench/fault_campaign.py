"""Our localiser on many drives with random faults: does it ever give a wrong pose without saying so."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import islice

import numpy as np

from sfr_loc_map.bench.figures import JsonObject
from sfr_loc_map.bench.honesty import LIMIT, Honesty, StatedErrors, stated_errors
from sfr_loc_map.bench.results import SCHEMA
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.pipeline.convert import FaultyLoc
from sfr_loc_map.pipeline.offline import localise, start_pose
from sfr_loc_map.simulation.faults import parse_fault, random_faults

CLEAN = "none"
"""Stands for a drive without faults."""


@dataclass(frozen=True, slots=True)
class DrivePlan:
    """One drive of a campaign.

    Attributes:
        source: Name of its source.
        first: First pair of the source.
        pairs: Number of pairs before the faults.
        faults: Texts of `parse_fault` joined by `+`; `none` without faults.
        seed: Seed of the faults, as of `sfr perturb`.
    """

    source: str
    first: int
    pairs: int
    faults: str
    seed: int


@dataclass(frozen=True, slots=True)
class DriveOutcome:
    """A drive of a campaign and what came of it."""

    plan: DrivePlan
    errors: StatedErrors

    def to_json(self) -> JsonObject:
        """Return the JSON object."""
        return asdict(self.plan) | asdict(self.errors) | {"honesty": self.errors.honesty.value}


@dataclass(frozen=True, slots=True)
class FaultCampaign:
    """Outcomes of a campaign.

    Attributes:
        seed: Seed of the plans.
        outcomes: One a drive, in the order of the plans.
    """

    seed: int
    outcomes: Sequence[DriveOutcome]

    @property
    def silent(self) -> list[DriveOutcome]:
        """Drives with a pair beyond the limit that was called tracking."""
        return [outcome for outcome in self.outcomes if outcome.errors.honesty is Honesty.SILENT]

    def to_json(self) -> JsonObject:
        """Return the JSON object; the drives are listed with the largest ratio first."""
        worst = sorted(self.outcomes, key=lambda outcome: -outcome.errors.worst)
        head: JsonObject = {"schema": SCHEMA, "kind": "fault-campaign", "seed": self.seed, "limit": LIMIT}
        groups = {
            name: _summary([outcome for outcome in self.outcomes if (outcome.plan.faults == CLEAN) == clean])
            for name, clean in (("with faults", False), ("clean", True))
        }
        return head | {"entries": groups, "drives": [outcome.to_json() for outcome in worst], "missing": {}}


def plan_drives(sequences: Mapping[str, LocSequence], count: int, seed: int, max_pairs: int) -> list[DrivePlan]:
    """Return the plans of a campaign: each source once without faults, then random faults on random parts of them.

    Args:
        sequences: Drives with their ground truth, by name.
        count: Number of drives with faults.
        seed: The same seed gives the same plans.
        max_pairs: Most pairs of a drive with faults.
    """
    plans = [DrivePlan(name, 0, len(sequence), CLEAN, 0) for name, sequence in sequences.items()]
    names = list(sequences)
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        name = names[number % len(names)]
        pairs = min(len(sequences[name]), max_pairs)
        first = int(rng.integers(0, len(sequences[name]) - pairs + 1))
        plans.append(DrivePlan(name, first, pairs, random_faults(rng, pairs), int(rng.integers(2**31))))
    return plans


def run_campaign(
    sequences: Mapping[str, LocSequence], plans: Sequence[DrivePlan], config: LocalisationConfig
) -> Iterator[DriveOutcome]:
    """Yield the outcome of each plan; one drive is in memory at a time, as its estimates alone."""
    for plan in plans:
        part = DrivePart(sequences[plan.source], plan.first, plan.pairs)
        texts = [] if plan.faults == CLEAN else plan.faults.split("+")
        drive = FaultyLoc(part, [parse_fault(text) for text in texts], plan.seed)
        estimates = [estimate for estimate, _ in localise(drive, config, start_pose(part, "truth"))]
        yield DriveOutcome(plan, stated_errors(estimates, part.ground_truth))


class DrivePart:
    """Consecutive pairs of a drive; a `LocSequence` whose ground truth begins at its first pair."""

    def __init__(self, inner: LocSequence, first: int, pairs: int) -> None:
        """Take so many pairs from the first one on; the drive has ground truth."""
        assert inner.ground_truth is not None
        self._inner, self._range, self._truth = inner, (first, first + pairs), inner.ground_truth
        if first:
            begin = next(self.pairs()).stamp_ns
            kept = self._truth.stamps_ns >= begin
            truth = self._truth
            self._truth = Trajectory(truth.stamps_ns[kept], truth.positions[kept], truth.quats_xyzw[kept])

    @property
    def rig(self) -> StereoRig:
        """Rig of the drive."""
        return self._inner.rig

    @property
    def ground_truth(self) -> Trajectory:
        """Ground truth from the first pair on."""
        return self._truth

    def __len__(self) -> int:
        """Return the number of pairs."""
        return self._range[1] - self._range[0]

    def pairs(self) -> Iterator[StereoPair]:
        """Yield the pairs."""
        return islice(self._inner.pairs(), *self._range)


def _summary(outcomes: Sequence[DriveOutcome]) -> JsonObject:
    counts = Counter(outcome.errors.honesty for outcome in outcomes)
    states = ("tracking", "degraded", "lost")
    return {
        "drives": len(outcomes),
        **{honesty.value: counts[honesty] for honesty in Honesty},
        **{f"{state}_pairs": sum(getattr(outcome.errors, state) for outcome in outcomes) for state in states},
        "worst_ratio": max((outcome.errors.worst for outcome in outcomes), default=None),
    }
