"""The parts `ape` and `rpe` of the score: errors as other tools give them, beside the figures of the specification."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from sfr_loc_map.metrics.condition import Condition
from sfr_loc_map.metrics.records.json_records import Inline


class Alignment(StrEnum):
    """How the estimate is aligned with the truth before it is compared."""

    NONE = "none"
    ORIGIN = "origin"
    """By the first pose: `T_gt(0) inv(T_est(0))`."""
    SE3 = "se3"
    """By the rotation and translation of least squares of the positions (Umeyama 1991)."""
    SIM3 = "sim3"
    """The same with a scale."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorStatistics:
    """What is said of single errors e_i that are never negative.

    Attributes:
        rmse: `sqrt(sum e_i^2 / n)`.
        mean: `sum e_i / n`.
        median: Interpolated between the two in the middle.
        std: `sqrt(sum (e_i - mean)^2 / n)`: over n, not n - 1.
        min: Smallest.
        max: Largest.
    """

    rmse: float | None
    mean: float | None
    median: float | None
    std: float | None
    min: float | None
    max: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignmentTransform:
    """What was applied to the estimate: `p -> scale R p + t`.

    Attributes:
        scale: Factor of the positions, 1 except for sim3.
        quat_xyzw: Rotation R, scalar last.
        translation_m: t.
    """

    scale: float
    quat_xyzw: tuple[float, ...]
    translation_m: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignedError:
    """One error of a trajectory as other tools give it.

    Attributes:
        description: Metric, alignment and association in one line.
        alignment: How the estimate was aligned.
        association: How poses of estimate and truth were paired.
        max_difference_s: Longest difference of the stamps of a pair.
        delta: From one pose of a relative error to the other; None of an absolute error.
        count: Number of errors n.
        unit: Unit of the errors beside it: `m`.
        translation: Of the positions, m.
        rotation_deg: Of the attitudes, deg.
        transform: The alignment; None for `none`.
    """

    description: str
    alignment: Alignment
    association: str
    max_difference_s: float
    delta: Condition | None = None
    count: int
    unit: str
    translation: Annotated[ErrorStatistics, Inline()]
    rotation_deg: ErrorStatistics
    transform: AlignmentTransform | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignedErrors:
    """Both.

    Attributes:
        ape: Absolute pose error (APE; of positions ATE): estimate against truth after the alignment.
        rpe: Relative pose error (RPE): motion of the estimate against that of the truth.
    """

    ape: AlignedError
    rpe: AlignedError
