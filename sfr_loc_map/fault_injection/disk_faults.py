"""Full and read-only file systems, and a small /dev/shm; each row has a mount namespace of its own."""

from __future__ import annotations

import subprocess
from pathlib import Path

from sfr_loc_map.errors import NodeError
from sfr_loc_map.fault_injection.harness import LOCALISATION, MONITOR, Bench
from sfr_loc_map.fault_injection.outcome import Fault, Outcome
from sfr_loc_map.nodes.diagnostics.key_values import Level

DISK_MB = 8
SHM_MB = 64


def mount_disk(folder: Path) -> None:
    """Put a small file system where the nodes write."""
    _mount("-t", "tmpfs", "-o", f"size={DISK_MB}m", "tmpfs", str(folder))


def mount_shm(folder: Path) -> None:
    """Put a small file system at /dev/shm, as containers have it."""
    _mount("-t", "tmpfs", "-o", f"size={SHM_MB}m", "tmpfs", "/dev/shm")


def full_disk(bench: Bench, outcome: Outcome) -> None:
    """Fill the file system that logs, kept pose and report are written to; then make room again."""
    filler = bench.folder / "filler"
    _fill(filler)
    _without_disk(bench, outcome)
    filler.unlink()
    _with_disk_again(bench, outcome)


def read_only(bench: Bench, outcome: Outcome) -> None:
    """Make the file system that is written to read-only, then writable again."""
    # open files keep a file system from becoming read-only: the folder is bound once more, and that is changed
    _mount("--bind", str(bench.folder), str(bench.folder))
    _mount("-o", "remount,ro,bind", str(bench.folder))
    _without_disk(bench, outcome)
    subprocess.run(["umount", str(bench.folder)], check=False, capture_output=True)
    _with_disk_again(bench, outcome)


def small_shm(bench: Bench, outcome: Outcome) -> None:
    """Drive, map and score with what a container gives: the segments do not fit, UDP is left."""
    first = bench.next_stamp()
    with bench.driving(10.0):
        count = len(bench.odometry)
        bench.until(lambda: len(bench.odometry) >= count + 20, "odometry")
    bench.settle()
    bench.map()
    sent = [stamp for stamp in bench.sent if stamp > first]
    missing = sum(stamp not in bench.odometry for stamp in sent)
    outcome.observed.append(f"{len(sent)} pairs of 160 x 120 sent, {len(sent) - missing} localised, one map made")
    outcome.lost = f"{missing} pairs" if missing else "nothing (small pictures)"
    outcome.expect(not missing, f"{missing} pairs are missing")


def _without_disk(bench: Bench, outcome: Outcome) -> None:
    before = len(bench.odometry)
    bench.localise(5)
    answer = bench.call("monitor_node/save")
    outcome.expect(not answer.success, "saving was answered as a success")
    told = lambda: "resume_file" in bench.health[LOCALISATION][2]  # noqa: E731
    try:
        bench.until(told, "warning of the kept pose", 5.0)
    except NodeError as error:
        outcome.expect(False, str(error))
    reason = answer.message.split(": ", 1)[-1].split(";")[0]
    outcome.observed.append(f"{len(bench.odometry) - before} of 5 pairs localised; ~/save answered '{reason}'")
    outcome.observed.append("health of localisation and monitor WARN")
    bench.until(lambda: bench.health[MONITOR][1] is Level.WARN, "warning of the monitor that it cannot save")


def _with_disk_again(bench: Bench, outcome: Outcome) -> None:
    stamps = bench.localise(2)
    answer = bench.call("monitor_node/save")
    outcome.expect(answer.success, f"saving failed with room again: {answer.message}")
    kept = bench.saved_pose.read_text(encoding="utf-8")
    outcome.expect(str(stamps[-1]) in kept, "the kept pose is not the last")
    parts = [path.name for path in bench.folder.iterdir() if path.name.endswith(".part")]
    outcome.expect(not parts, f"left over: {', '.join(parts)}")
    outcome.observed.append("with room again both were written, nothing was left over")


def _fill(path: Path) -> None:
    with path.open("wb", buffering=0) as stream:
        for size in (65_536, 512, 1):
            try:
                while stream.write(bytes(size)) == size:
                    pass
            except OSError:
                continue


def _mount(*arguments: str) -> None:
    done = subprocess.run(["mount", *arguments], capture_output=True, text=True)
    if done.returncode:
        raise NodeError(f"cannot mount: {done.stderr.strip()}")


FAULTS = (
    Fault(
        "full-disk",
        "the file system of logs, kept pose and report is full; later there is room again",
        "odometry goes on, health WARN, saving is refused with a reason, nothing half written; all is well with room",
        full_disk,
        own_mounts=True,
        prepare=mount_disk,
    ),
    Fault(
        "read-only",
        "the same becomes read-only; later it is writable again",
        "as with a full disk",
        read_only,
        own_mounts=True,
        prepare=mount_disk,
    ),
    Fault(
        "small-shm",
        f"/dev/shm of {SHM_MB} MB, what a container has",
        "nodes start and work over UDP; small pictures come through",
        small_shm,
        own_mounts=True,
        prepare=mount_shm,
    ),
)
