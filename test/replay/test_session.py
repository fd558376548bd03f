"""The session of a replay: what holds while a source is played."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from helpers.made_scene import write_folder
from sfr_loc_map import host_clock
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.replay.session import play_and_collect


@pytest.mark.parametrize("slow", ["player", "waits"])
def test_a_clock_that_is_slowed_while_a_source_is_played_measures_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, slow: str
) -> None:
    """The kernel's clock advances by 10 s in a call that takes no time by the clock of the process."""
    seconds = {"kernel": 0.0}
    monkeypatch.setattr(host_clock, "kernel_s", lambda: seconds["kernel"])

    def call_of(part: str) -> None:
        seconds["kernel"] += 10.0 if part == slow else 0.0

    connected = SimpleNamespace(
        player=SimpleNamespace(play=lambda *_: call_of("player")),
        waits=SimpleNamespace(finish=lambda: call_of("waits")),
        collector=SimpleNamespace(received=None),
    )
    options = SimpleNamespace(start=None, offset_s=0.0, duration_s=1.0)
    source = open_source(write_folder(tmp_path / "source", 2, 0))
    with pytest.raises(MetricsError, match="times cannot be measured"):
        play_and_collect(source, options, connected, lambda _: None)  # type: ignore[arg-type]
