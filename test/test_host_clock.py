"""The clock of a process is compared with the clock of the kernel; started processes load no foreign library."""

from __future__ import annotations

import pytest

from sfr_loc_map import host_clock
from sfr_loc_map.child_process import child_environment
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.host_clock import CallClock, checked_clock


@pytest.fixture
def clocks(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """Seconds of both clocks, to be changed."""
    seconds = {"process": 5.0, "kernel": 7000.0}
    monkeypatch.setattr(host_clock.time, "monotonic", lambda: seconds["process"])
    monkeypatch.setattr(host_clock, "kernel_s", lambda: seconds["kernel"])
    monkeypatch.setattr(host_clock, "system_call_s", lambda: seconds["kernel"])
    return seconds


@pytest.mark.parametrize(("passed_s", "is_refused"), [(99.0, False), (98.8, True), (101.0, False), (101.2, True)])
def test_clocks_that_differ_by_more_than_a_hundredth_are_refused(
    clocks: dict[str, float], passed_s: float, is_refused: bool
) -> None:
    refused = []
    try:
        with checked_clock():
            clocks["process"] += passed_s
            clocks["kernel"] += 100.0
    except MetricsError as error:
        refused.append(str(error))
    assert bool(refused) is is_refused
    assert all(f"{passed_s:.2f} s passed by the clock of this process and 100.00 s" in text for text in refused)


def test_a_clock_that_is_slow_in_calls_and_corrected_between_them_is_refused(clocks: dict[str, float]) -> None:
    clock = CallClock()

    def call() -> float:
        clock.begin()
        clocks["process"] += 0.09
        clocks["kernel"] += 0.10
        duration_s = clock.end()
        clocks["process"] += 0.01
        return duration_s

    with checked_clock():
        durations_s = [call() for _ in range(10)]  # ten steps of the kernel's clock are allowed
    assert durations_s == pytest.approx([0.09] * 10)
    with pytest.raises(MetricsError):
        [call() for _ in range(10)]


def test_the_clock_of_this_process_is_the_kernel_s() -> None:
    with checked_clock():
        assert host_clock.kernel_s() is not None


def test_what_is_started_loads_no_library_of_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("LD_PRELOAD", "LD_AUDIT", "LD_LIBRARY_PATH"):
        monkeypatch.setenv(name, "/tmp/x")
    assert [name for name in child_environment() if name.startswith("LD_")] == ["LD_LIBRARY_PATH"]
