"""Injected faults of file systems: full, read-only, small /dev/shm; each in a mount namespace of its own."""

from __future__ import annotations

import subprocess
from pathlib import Path

from sfr_loc_map.errors import NodeError
from sfr_loc_map.fault_injection.fault import Fault, Outcome
from sfr_loc_map.fault_injection.harness import LOCALISATION, MONITOR, Harness
from sfr_loc_map.nodes.diagnostics import Level

DISK_MB = 8
SHM_MB = 64


def mount_disk(folder: Path) -> None:
    """Put a small file system where the nodes write."""
    _mount("-t", "tmpfs", "-o", f"size={DISK_MB}m", "tmpfs", str(folder))


def mount_shm(folder: Path) -> None:
    """Put a small file system at /dev/shm, as in a container."""
    _mount("-t", "tmpfs", "-o", f"size={SHM_MB}m", "tmpfs", "/dev/shm")


def full_disk(harness: Harness, outcome: Outcome) -> None:
    """Fill the file system of logs, saved pose and report; then free space."""
    filler = harness.folder / "filler"
    _fill(filler)
    _work_without_disk(harness, outcome)
    filler.unlink()
    _check_recovered(harness, outcome)


def read_only(harness: Harness, outcome: Outcome) -> None:
    """Make the file system of logs, saved pose and report read-only, then writable."""
    # open files prevent a remount of the file system: a bind mount of the folder is made read-only instead
    _mount("--bind", str(harness.folder), str(harness.folder))
    _mount("-o", "remount,ro,bind", str(harness.folder))
    _work_without_disk(harness, outcome)
    subprocess.run(["umount", str(harness.folder)], check=False, capture_output=True)
    _check_recovered(harness, outcome)


def small_shm(harness: Harness, outcome: Outcome) -> None:
    """Drive, map and score with the /dev/shm of a container: the segments do not fit, Fast DDS uses UDP."""
    first = harness.rover.next_stamp()
    with harness.rover.driving(10.0):
        harness.wait_poses(20)
    harness.settle()
    harness.map()
    pairs = harness.pairs_since(first)
    outcome.observed.append(f"{pairs} (160 x 120), one map made")
    outcome.lost = pairs.lost
    outcome.expect(not pairs.missing, f"{pairs.missing} pairs are missing")


def _work_without_disk(harness: Harness, outcome: Outcome) -> None:
    before = len(harness.received.odometry)
    harness.localise(5)
    localised = len(harness.received.odometry) - before
    answer = harness.call("monitor_node/save")
    outcome.expect(not answer.success, "saving was reported as a success")
    reported = lambda: "resume_file" in harness.received.health[LOCALISATION].message  # noqa: E731
    try:
        harness.wait_until(reported, "warning about resume_file", 5.0)
    except NodeError as error:
        outcome.expect(False, str(error))
    reason = answer.message.split(": ", 1)[-1].split(";")[0]
    outcome.observed.append(f"{localised} of 5 pairs localised; ~/save answered '{reason}'")
    outcome.observed.append("health of localisation and monitor WARN")
    harness.wait_until(lambda: harness.received.health[MONITOR].level is Level.WARN, "warning of the monitor")


def _check_recovered(harness: Harness, outcome: Outcome) -> None:
    stamps = harness.localise(2)
    answer = harness.call("monitor_node/save")
    outcome.expect(answer.success, f"saving failed with free space: {answer.message}")
    text = harness.saved_pose.read_text(encoding="utf-8")
    outcome.expect(str(stamps[-1]) in text, "the saved pose is not the last one")
    parts = [path.name for path in harness.folder.iterdir() if path.name.endswith(".part")]
    outcome.expect(not parts, f"partial files are left: {', '.join(parts)}")
    outcome.observed.append("with free space both were written, no partial file was left")


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
        "the file system of logs, saved pose and report is full; later space is freed",
        "odometry continues, health WARN, saving fails with a reason, no partial file; recovers with free space",
        full_disk,
        own_mounts=True,
        prepare=mount_disk,
    ),
    Fault(
        "read-only",
        "the same file system becomes read-only; later it is writable again",
        "as with a full disk",
        read_only,
        own_mounts=True,
        prepare=mount_disk,
    ),
    Fault(
        "small-shm",
        f"/dev/shm of {SHM_MB} MB, the default of containers",
        "nodes start and work over UDP; small images are delivered",
        small_shm,
        own_mounts=True,
        prepare=mount_shm,
    ),
)
