"""The distribution function beside its quantiles."""

import numpy as np
import pytest
from scipy import stats

from sfr_loc_map.metrics.statistics.quantiles import student_quantile, student_share


def test_the_share_is_the_inverse_of_the_quantile() -> None:
    for freedom in (1.5, 4.0, 30.0):
        assert student_share(student_quantile(0.975, freedom), freedom) == pytest.approx(0.975)
        np.testing.assert_allclose(student_share(-1.3, freedom), stats.t.cdf(-1.3, freedom))
