"""The words of the score's settings and results, each set of them an enumeration."""

from __future__ import annotations

from enum import StrEnum


class AssociationMode(StrEnum):
    """How an estimate finds its truth; see `metrics.trajectory.association`."""

    AUTO = "auto"
    MATCH = "match"
    INTERPOLATE = "interpolate"


class Rebase(StrEnum):
    """What is taken from the estimate at the start of a sub-trajectory: its whole pose, or its position only."""

    POSE = "pose"
    POSITION = "position"


class CallKind(StrEnum):
    """What a call of a processing API did: one pair localised, one pair mapped, or the pairs of a set fused."""

    LOCALISATION = "localisation"
    MAPPING = "mapping"
    FUSION = "fusion"


class MappingState(StrEnum):
    """The result of a call of the mapper: one pair mapped, or the pairs of a set fused."""

    MAPPED = "mapped"
    FUSED = "fused"


class CloudKind(StrEnum):
    """Whether a cloud holds the points of every pair, or each surface point once."""

    SINGLE_PAIRS = "single pairs"
    FUSED = "fused"


class VerdictState(StrEnum):
    """The verdict on a limit."""

    PASS = "pass"
    FAIL = "fail"
    NOT_ENOUGH_DATA = "not enough data"
