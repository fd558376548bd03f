"""Settings of the score."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from sfr_loc_map.config import build, param
from sfr_loc_map.errors import ConfigError


@dataclass(frozen=True, slots=True)
class AssociationConfig:
    """How estimates find their truth; see `metrics.trajectory.association`."""

    truth: str = param(
        "auto",
        doc="Truth of an estimate: of the same stamp (match), between two true poses (interpolate), or whichever the "
        "first stamps suit (auto).",
        choices=("auto", "match", "interpolate"),
    )
    tolerance_s: float = param(1e-6, unit="s", doc="Stamps this close are the same.", low=0.0, high=1.0)
    max_gap_s: float = param(1.0, unit="s", doc="Longest gap of the truth that is interpolated.", low=0.0, high=3600.0)


@dataclass(frozen=True, slots=True)
class TrajectoryScoreConfig:
    """Settings of the trajectory score."""

    conditions: tuple[str, ...] = param(
        ("distance=5",), doc="Ends of a sub-trajectory: distance=METRES, time=SECONDS or frames=NUMBER, each scored."
    )
    spacing: int = param(
        10, unit="frames", doc="Frames from one start of a sub-trajectory to the next.", low=1, high=1_000_000
    )
    rebase: str = param(
        "pose",
        doc="What is taken from the estimate at the start: its whole pose, or its position only.",
        choices=("pose", "position"),
    )
    association: AssociationConfig = field(default_factory=AssociationConfig)


@dataclass(frozen=True, slots=True)
class AlignedErrorConfig:
    """Settings of the errors that are given beside the specification's; see `metrics.trajectory.aligned_error`."""

    align: str = param(
        "se3",
        doc="Alignment of the estimate with the truth: none, by the first pose, or by least squares of the positions.",
        choices=("none", "origin", "se3", "sim3"),
    )
    max_difference_s: float = param(
        0.01, unit="s", doc="Longest difference of stamps that belong together.", low=0.0, high=3600.0
    )
    rpe_delta: str = param("frames=1", doc="Length of a relative error: frames=NUMBER or distance=METRES.")


@dataclass(frozen=True, slots=True)
class MapScoreConfig:
    """Settings of the map score."""

    scored_from_m: float = param(0.0, unit="m", doc="Nearest truth that counts for coverage.", low=0.0, high=1e6)
    scored_to_m: float = param(10.0, unit="m", doc="Farthest truth that counts for coverage.", low=0.1, high=1e6)
    range_edges_m: tuple[float, ...] = param(
        (0.0, 4.0, 10.0, 20.0, 40.0), unit="m", doc="Edges of the range bins.", low=0.0, high=1e6
    )


@dataclass(frozen=True, slots=True)
class ScoreConfig:
    """Settings of the whole score."""

    trajectory: TrajectoryScoreConfig = field(default_factory=TrajectoryScoreConfig)
    map: MapScoreConfig = field(default_factory=MapScoreConfig)


def score_config(conditions: Sequence[str] | None, settings: Mapping[str, object]) -> ScoreConfig:
    """Return the settings of a score from options.

    Args:
        conditions: Ends of a sub-trajectory; the default where there are none.
        settings: Other values by dotted name.

    Raises:
        ConfigError: If one is not valid.
    """
    named = {"trajectory.conditions": tuple(conditions)} if conditions else {}
    return build(ScoreConfig, {**settings, **named}, origin="options")


def aligned_error_config(align: str | None, settings: Mapping[str, object]) -> AlignedErrorConfig | None:
    """Return the settings of APE and RPE, None where no alignment is named.

    Args:
        align: Alignment, None for no such errors.
        settings: Other values by name; None for the default.

    Raises:
        ConfigError: If one is not valid, or is given without an alignment.
    """
    given = {name: value for name, value in settings.items() if value is not None}
    if align is None and given:
        raise ConfigError(f"{', '.join(given)}: of APE and RPE, which --align none|origin|se3|sim3 asks for")
    return None if align is None else build(AlignedErrorConfig, {"align": align, **given}, origin="options")
