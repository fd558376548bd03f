"""The part `map` of the score."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from sfr_loc_map.metrics.modes import CloudKind
from sfr_loc_map.metrics.records.json_records import Inline
from sfr_loc_map.metrics.records.statistic_records import Interval, SampleStatistic


@dataclass(frozen=True, slots=True, kw_only=True)
class DisparityStatistic:
    """The disparity errors that the depth errors amount to, `f b / Z - f b / Z_true`, px.

    Attributes:
        mean: With its sign.
        sigma: With Bessel's correction.
        p50_abs: Median of the absolute values.
        p95_abs: 95th percentile of the absolute values.
    """

    mean: float | None
    sigma: float | None
    p50_abs: float | None
    p95_abs: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SigmaNees:
    """Whether the sigma of map points is honest: squares of (error along the ray / sigma), one point of each block.

    Attributes:
        count: Points n.
        mean: `sum (e_i / sigma_i)^2 / n`.
        median: Of the squares: the bulk, without the gross errors.
        expected: Mean of an honest sigma.
        expected_median: Median of chi-square with one degree of freedom.
        interval95: 2.5 % and 97.5 % points of chi-square with n degrees of freedom, over n.
    """

    count: int
    mean: float
    median: float
    expected: float
    expected_median: float
    interval95: Interval


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeScore:
    """The point errors whose true range lies in [from_m, to_m).

    Attributes:
        from_m: Nearest true range.
        to_m: Farthest true range, itself not included.
        coverage: As in `MapScore`, of this range.
        point_error_m: As in `PointErrorScore`.
        disparity_error_px: As in `PointErrorScore`.
    """

    from_m: float
    to_m: float
    coverage: float | None
    point_error_m: Annotated[SampleStatistic, Inline()]
    disparity_error_px: DisparityStatistic


@dataclass(frozen=True, slots=True, kw_only=True)
class PairScore:
    """The points of one pair.

    Attributes:
        pair: Number of the pair.
        coverage: As in `MapScore`, of this pair.
        point_error_m: As in `PointErrorScore`.
    """

    pair: int
    coverage: float | None
    point_error_m: SampleStatistic


@dataclass(frozen=True, slots=True, kw_only=True)
class PointErrorScore:
    """The errors of points against the surface that their pixels see [4.3.4].

    Attributes:
        points_without_truth: Points whose pixel has no truth (sky): not counted below.
        point_error_m: `|truth - estimate|` of every point whose pixel has a truth [4.3.4].
        disparity_error_px: The same as an error of the disparity.
        sigma_nees: Consistency of the points' sigma, None where there are fewer than two.
        by_range: By range of the truth from the left optical centre.
        by_pair: By pair.
    """

    points_without_truth: int
    point_error_m: SampleStatistic
    disparity_error_px: DisparityStatistic
    sigma_nees: SigmaNees | None
    by_range: tuple[RangeScore, ...]
    by_pair: tuple[PairScore, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapScore:
    """The errors and the coverage of a cloud.

    Attributes:
        pairs: Mapping pairs of the truth.
        points: Points of the cloud.
        cloud: Whether it is fused; None where the points' pixels are not known.
        coverage: Single pairs: of the left pixels whose truth lies in the scored range the share that has a point.
            Fused: the share of those true points with a point nearer than two pixel footprints, `2 Z / f`.
        coverage_range_m: Scored range [low, high).
        nearest_only: Whether the points' pixels are not known, so that only the nearest true points can be compared.
        errors: Errors against the surface that the pixels see; None where they are not known.
        nearest_distance_m: Distance to the nearest true point, which reads low; None where pixels are known.
    """

    pairs: int
    points: int
    cloud: CloudKind | None = None
    coverage: float | None
    coverage_range_m: tuple[float, float]
    nearest_only: bool
    errors: Annotated[PointErrorScore | None, Inline()] = None
    nearest_distance_m: SampleStatistic | None = None
