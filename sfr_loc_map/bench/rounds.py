"""One pass of some peers over the same pairs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from sfr_loc_map.bench.peers import ReferenceMethod
from sfr_loc_map.bench.process import PeerProcess, Pictures
from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.errors import BenchError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig

Progress = Callable[[str], None]


@dataclass(slots=True, eq=False)
class Run:
    """What one peer did in one pass.

    Attributes:
        peer: The peer.
        version: Its version.
        idle_bytes: Resident memory of its process before the first call.
        seconds: Time of each call.
        peaks: Peak of resident memory of each call.
        results: What each call reported, with what `keep` gave.
    """

    peer: ReferenceMethod
    version: str
    idle_bytes: int | None
    seconds: list[float] = field(default_factory=list)
    peaks: list[int | None] = field(default_factory=list)
    results: list[Any] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class Pass:
    """A pass of several peers.

    Attributes:
        runs: Of those that came to the end, by name.
        failed: Why the others did not, by name.
    """

    runs: dict[str, Run] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)


def one_pass(
    peers: Sequence[ReferenceMethod],
    rig: StereoRig,
    pairs: Callable[[], Iterable[StereoPair]],
    setup: Mapping[str, Any],
    keep: Callable[[Run, Mapping[str, Any], Path], Any],
    *,
    rate_scale: float = 1.0,
    progress: Progress = lambda name: None,
) -> Pass:
    """Let all peers process all pairs: those that rest between calls in turn on each pair, the others alone after them.

    Whose turn is first changes from pair to pair. What goes on working between calls gets its pairs no faster than the
    stamps say, and has the machine for itself.

    Args:
        peers: Contestants.
        rig: Rig of the pairs.
        pairs: Yields the pairs anew at each call.
        setup: What every worker is told.
        keep: Makes what is kept of a report; gets the folder of the outputs.
        rate_scale: Factor on the rate of the recording.
        progress: Told the name of a peer after each of its calls.
    """
    done = Pass()
    groups = [[peer for peer in peers if not peer.background], *([peer] for peer in peers if peer.background)]
    for group in groups:
        paced = bool(group) and group[0].background
        _run_group(group, rig, pairs(), setup, keep, done, rate_scale if paced else None, progress)
    return done


def _run_group(
    peers: Sequence[ReferenceMethod],
    rig: StereoRig,
    pairs: Iterable[StereoPair],
    setup: Mapping[str, Any],
    keep: Callable[[Run, Mapping[str, Any], Path], Any],
    done: Pass,
    rate_scale: float | None,
    progress: Progress,
) -> None:
    with TemporaryDirectory(prefix="sfr_bench_") as folder, ExitStack() as stack:
        place = Path(folder)
        pictures = Pictures(place / "pictures", rig)
        going: list[tuple[PeerProcess, Run]] = []
        for peer in peers:
            try:
                process = stack.enter_context(PeerProcess(peer, rig, pictures, setup, place))
            except BenchError as error:
                done.failed[peer.name] = str(error)
                continue
            going.append((process, Run(peer, process.version, process.idle_bytes)))
        first_ns, begin = None, time.monotonic()
        for number, pair in enumerate(pairs):
            pictures.show(pair)
            if first_ns is None:
                first_ns, begin = pair.stamp_ns, time.monotonic()
            since_s = (pair.stamp_ns - first_ns) / NS_PER_S
            if rate_scale is not None:
                time.sleep(max(0.0, begin + since_s / rate_scale - time.monotonic()))
            order = {"stamp_ns": pair.stamp_ns, "since_start_s": since_s / (rate_scale or 1.0)}
            turn = number % max(1, len(going))
            for process, run in [*going[turn:], *going[:turn]]:
                try:
                    answer = process.ask(order | {"output": str(place / f"{run.peer.name}.npy")})
                except BenchError as error:
                    done.failed[run.peer.name] = str(error)
                    going.remove((process, run))
                    continue
                run.seconds.append(answer["seconds"])
                run.peaks.append(answer["peak_bytes"])
                run.results.append(keep(run, answer["result"], place / f"{run.peer.name}.npy"))
                progress(run.peer.name)
        done.runs |= {run.peer.name: run for _, run in going}
