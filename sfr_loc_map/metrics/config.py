"""Settings of the score, and the enumerations of settings and results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from sfr_loc_map.configuration.parameters import build, check_parameters, param
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.conditions import Condition, ConditionKind
from sfr_loc_map.suite_names import Task

SPACING_FRAMES = 10  #: Frames from one start of a sub-trajectory to the next, as the specification recommends [4.1.1].


class AssociationMode(StrEnum):
    """How estimates are associated with the truth; see `metrics.frames.association`."""

    AUTO = "auto"
    MATCH = "match"
    INTERPOLATE = "interpolate"


class Reading(StrEnum):
    """How the error from before the start of a sub-trajectory is removed; see `metrics.formulas`."""

    POSE = "pose"  #: The estimate is re-based at the start by its complete pose.
    DISPLACEMENT = "displacement"  #: Literal reading: compares displacements and changes of attitude.
    POSITION = "position"  #: The estimate is re-based at the start by its position only.
    YAW_ALIGNED = "yaw_aligned"  #: `position` after a fit of yaw and translation, if the truth has no attitudes.
    #: `position` after a fit of the complete rotation and translation, if the estimate has a tilted z-axis.
    ROTATION_ALIGNED = "rotation_aligned"

    @property
    def is_fit(self) -> bool:
        """Whether the estimate was aligned with a truth without attitudes."""
        return self in (Reading.YAW_ALIGNED, Reading.ROTATION_ALIGNED)


class CallKind(StrEnum):
    """Kind of a call of a processing API.

    `localisation` localises a pair. `mapping_call` maps a set of pairs, in the stages `mapping` and `fusion`.
    """

    LOCALISATION = "localisation"
    MAPPING_CALL = "mapping_call"
    MAPPING = "mapping"
    FUSION = "fusion"

    @property
    def words(self) -> str:
        """The displayed name."""
        return self.replace("_", " ")

    @property
    def task(self) -> Task:
        """The task that the call is made for."""
        return Task.LOCALISATION if self is CallKind.LOCALISATION else Task.MAPPING


class MappingState(StrEnum):
    """The result of a mapper call for a set of pairs, or of its stages: mapping a pair, and fusing all pairs."""

    MAPPED = "mapped"
    FUSED = "fused"
    MAPPED_SET = "mapped_set"


class CloudKind(StrEnum):
    """Whether a cloud contains the points of every pair, or each surface point once."""

    SINGLE_PAIRS = "single pairs"
    FUSED = "fused"


class VerdictState(StrEnum):
    """The verdict on a limit."""

    PASS = "pass"
    FAIL = "fail"
    NOT_ENOUGH_DATA = "not enough data"
    INCOMPLETE = "incomplete"  #: A part of the expected data is missing or cannot be judged.
    NOT_JUDGED = "not judged"  #: Estimate and truth contradict each other.

    @property
    def rank(self) -> int:
        """The rank of the verdict, 0 for the worst. Verdicts are combined and listed in this order."""
        return WORST_FIRST.index(self)


WORST_FIRST = (
    VerdictState.FAIL,
    VerdictState.NOT_JUDGED,
    VerdictState.INCOMPLETE,
    VerdictState.NOT_ENOUGH_DATA,
    VerdictState.PASS,
)
"""Verdicts from the worst to the best."""


def worst_of(states: Iterable[VerdictState]) -> VerdictState | None:
    """Return the worst verdict, None without a verdict."""
    return min(states, key=lambda state: state.rank, default=None)


def _check_conditions(texts: Iterable[str]) -> None:
    """Raise MetricsError unless every text is a condition."""
    for text in texts:
        Condition.parse(text)


def _check_rpe_delta(text: str) -> None:
    """Raise MetricsError or ConfigError unless a text is one number of frames or metres."""
    first, *others = Condition.parse(text).components
    if others or first.kind not in (ConditionKind.FRAMES, ConditionKind.DISTANCE):
        raise ConfigError(f"'{text}' is not a length: frames=NUMBER or distance=METRES is required")


@dataclass(frozen=True, slots=True)
class AssociationConfig:
    """Settings of the association of estimates with the truth; see `metrics.frames.association`."""

    truth: str = param(
        "auto",
        doc="Truth of an estimate: the pose with the same stamp (match), interpolated between two true poses "
        "(interpolate), or chosen by the first stamps (auto).",
        choices=("auto", "match", "interpolate"),
    )
    tolerance_s: float = param(
        1e-6, unit="s", doc="Largest difference between stamps that are considered equal.", low=0.0, high=1.0
    )
    max_gap_s: float = param(1.0, unit="s", doc="Longest gap of the truth that is interpolated.", low=0.0, high=3600.0)

    def __post_init__(self) -> None:
        """Check the settings; ConfigError if a value is invalid."""
        check_parameters(self)


@dataclass(frozen=True, slots=True)
class TrajectoryScoreConfig:
    """Settings of the trajectory score."""

    conditions: tuple[str, ...] = param(
        ("distance=5",),
        doc="Conditions that end a sub-trajectory, such as distance=METRES, time=SECONDS or frames=NUMBER.",
        check=_check_conditions,
    )
    spacing: int = param(
        SPACING_FRAMES, unit="frames", doc="Number of frames from one start to the next.", low=1, high=1_000_000
    )
    rebase: str = param(
        "pose",
        doc="Removal of the error from before the start: re-basing by the complete pose, differences of displacements "
        "and of changes of attitude (the literal reading of the specification), or re-basing by the position only.",
        choices=("pose", "displacement", "position"),
    )
    partial: bool = param(
        False, doc="Judge an incomplete estimate like a complete one, and report this as a deviation."
    )
    association: AssociationConfig = field(default_factory=AssociationConfig)

    def __post_init__(self) -> None:
        """Check the settings; ConfigError if a value is invalid."""
        check_parameters(self)


@dataclass(frozen=True, slots=True)
class AlignedErrorConfig:
    """Settings of APE and RPE, which the specification does not define; see `metrics.trajectory.aligned_error`."""

    align: str = param(
        "se3",
        doc="Alignment of the estimate with the truth: none, by the first pose, or by least squares of the positions.",
        choices=("none", "origin", "se3", "sim3"),
    )
    max_difference: float = param(
        0.01, unit="s", doc="Largest difference between the stamps of paired poses.", low=0.0, high=3600.0
    )
    rpe_delta: str = param(
        "frames=1", doc="Length of a relative error: frames=NUMBER or distance=METRES.", check=_check_rpe_delta
    )

    def __post_init__(self) -> None:
        """Check the settings; ConfigError if a value is invalid."""
        check_parameters(self)


@dataclass(frozen=True, slots=True)
class MapScoreConfig:
    """Settings of the map score."""

    scored_from_m: float = param(0.0, unit="m", doc="Minimum range of true points in the coverage.", low=0.0, high=1e6)
    scored_to_m: float = param(10.0, unit="m", doc="Maximum range of true points in the coverage.", low=0.1, high=1e6)
    range_edges_m: tuple[float, ...] = param(
        (0.0, 4.0, 10.0, 20.0, 40.0), unit="m", doc="Edges of the range bins.", low=0.0, high=1e6
    )

    def __post_init__(self) -> None:
        """Check the settings, that the scored range is not empty and that the edges ascend; ConfigError if not."""
        check_parameters(self)
        if self.scored_from_m >= self.scored_to_m:
            given = f"{self.scored_from_m:g} to {self.scored_to_m:g} m"
            raise ConfigError(f"the scored range {given} is empty: give the minimum, then the maximum")
        edges = [f"{edge:g}" for edge in self.range_edges_m]
        if len(set(edges)) < len(edges) or list(self.range_edges_m) != sorted(self.range_edges_m):
            raise ConfigError(
                f"the edges {', '.join(edges)} m of the range bins do not ascend: give each once, in order"
            )


@dataclass(frozen=True, slots=True)
class ScoreConfig:
    """Settings of the score."""

    trajectory: TrajectoryScoreConfig = field(default_factory=TrajectoryScoreConfig)
    map: MapScoreConfig = field(default_factory=MapScoreConfig)


def score_config(
    conditions: Sequence[str] | None, settings: Mapping[str, object], called: Mapping[str, str] | None = None
) -> ScoreConfig:
    """Return the settings of a score from options: conditions of sub-trajectories, and settings by dotted name.

    `called` has the names of the options by the names of the settings. ConfigError if a value is invalid.
    """
    named = {"trajectory.conditions": tuple(conditions)} if conditions else {}
    return build(ScoreConfig, {**settings, **named}, origin="", called=called)


def aligned_error_config(
    align: str | None, settings: Mapping[str, object], called: Mapping[str, str] | None = None
) -> AlignedErrorConfig | None:
    """Return the settings of APE and RPE, None without an alignment; a value of None selects the default.

    `called` has the names of the options by the names of the settings. ConfigError if a value is invalid.
    """
    names = called or {}
    given = {name: value for name, value in settings.items() if value is not None}
    if align is None and given:
        options = ", ".join(f"'{names.get(name, name)}'" for name in given)
        raise ConfigError(
            f"{options} is a setting of APE and RPE, which require '{names.get('align', 'align')}': give none, origin, "
            f"se3 or sim3, or omit {options}"
        )
    return None if align is None else build(AlignedErrorConfig, {"align": align, **given}, origin="", called=names)
