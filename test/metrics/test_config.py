"""Settings and conditions that are constructed without a file are checked as those of a file."""

from collections.abc import Callable

import pytest

from sfr_loc_map.errors import ConfigError, MetricsError
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import AlignedErrorConfig, AssociationConfig, MapScoreConfig, TrajectoryScoreConfig
from sfr_loc_map.metrics.conventions.pose_convention import PoseConvention


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: TrajectoryScoreConfig(spacing=-1), "'spacing' is -1"),
        (lambda: TrajectoryScoreConfig(spacing=0), "'spacing' is 0"),
        (lambda: TrajectoryScoreConfig(rebase="yaw_aligned"), "'rebase' is 'yaw_aligned': one of pose"),
        (lambda: TrajectoryScoreConfig(conditions=("distance=5", "foo")), "'conditions': 'foo' is not a condition"),
        (lambda: TrajectoryScoreConfig(conditions=("distance=-5",)), "'distance=-5' is not a condition"),
        (lambda: AlignedErrorConfig(rpe_delta="foo"), "'rpe_delta': 'foo' is not a condition"),
        (lambda: AssociationConfig(truth="nearest"), "'truth' is 'nearest'"),
        (lambda: AssociationConfig(tolerance_s=-1.0), "'tolerance_s' is -1"),
        (lambda: AlignedErrorConfig(align="yaw"), "'align' is 'yaw'"),
        (lambda: AlignedErrorConfig(max_difference=float("nan")), "'max_difference' is nan"),
        (lambda: MapScoreConfig(scored_to_m=-1.0), "'scored_to_m' is -1"),
        (lambda: MapScoreConfig(range_edges_m=(0.0, -4.0)), "'range_edges_m' is -4"),
        (lambda: PoseConvention(frame="camera"), "'frame' is 'camera'"),
        (lambda: PoseConvention(metres_per_unit=0.0), "'metres_per_unit' is 0"),
    ],
)
def test_a_setting_out_of_range_is_refused(make: Callable[[], object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        make()


@pytest.mark.parametrize("text", ["distance=5,distance=10", "distance=5,time=10,time=20"])
def test_components_of_the_same_kind_are_refused(text: str) -> None:
    with pytest.raises(MetricsError, match=f"'{text}' has the same kind of condition twice"):
        Condition.parse(text)


def test_conditions_with_the_same_components_are_equal() -> None:
    made = Condition.parse("time=10,distance=5")
    assert made == Condition.parse("distance=5,time=10")
    assert made.setting == "distance=5,time=10"


@pytest.mark.parametrize("number", ["", "0", "-1", "nan", "inf", "1e400", "1_0", "\u0665", "0x5", "5 5", "5 km"])
def test_a_condition_requires_a_positive_decimal_number(number: str) -> None:
    with pytest.raises(MetricsError, match="is not a condition"):
        Condition.parse(f"distance={number}")


@pytest.mark.parametrize("text", ["distance=5", " distance = 5 ", "distance=5 m", "distance=+5.0m", "distance=.5e1"])
def test_a_condition_may_have_a_unit_and_spaces(text: str) -> None:
    assert Condition.parse(text).setting == "distance=5"
