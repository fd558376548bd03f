import pytest
from scipy import stats

from sfr_loc_map.metrics.statistics.quantiles import chi2_quantile, student_quantile


def test_values_of_printed_tables() -> None:
    """Abramowitz and Stegun, tables 26.8 and 26.10."""
    assert chi2_quantile(0.95, 1) == pytest.approx(3.84146, abs=5e-6)
    assert chi2_quantile(0.975, 6) == pytest.approx(14.4494, abs=5e-5)
    assert student_quantile(0.975, 10) == pytest.approx(2.228, abs=5e-4)
    assert student_quantile(0.975, 1) == pytest.approx(12.706, abs=5e-4)


@pytest.mark.parametrize("share", [0.025, 0.5, 0.975])
@pytest.mark.parametrize("freedom", [1.0, 2.5, 3.0, 300.0, 1e6])
def test_the_same_bits_as_the_library(share: float, freedom: float) -> None:
    assert chi2_quantile(share, freedom) == stats.chi2.ppf(share, freedom)
    assert student_quantile(share, freedom) == stats.t.ppf(share, freedom)
