"""Cause of a failed job by the class of its error."""

import pytest

from sfr_loc_map.errors import InputError, MetricsError, MissingExtraError, NodeError, OutputError, SfrError
from sfr_loc_map.methods.method_call import MethodFailureError
from sfr_loc_map.metrics.figures.records import FindingKind
from sfr_loc_map.suite.jobs.job_outcome import FailureCause


@pytest.mark.parametrize("error", [InputError("cut off"), MetricsError("too short")])
def test_an_error_of_the_source_is_bad_input(error: SfrError) -> None:
    assert FailureCause.of(error) is FailureCause.BAD_INPUT


@pytest.mark.parametrize(
    "error",
    [
        OutputError("no space left on device"),
        MissingExtraError("embreex is not installed"),
        NodeError("no answer"),
        MethodFailureError(FindingKind.CRASHED, "has ended"),
    ],
)
def test_an_error_of_the_worker_is_not_bad_input(error: SfrError) -> None:
    """A search skips the points with bad input for ever, and runs the others again."""
    assert FailureCause.of(error) is FailureCause.FAULT
