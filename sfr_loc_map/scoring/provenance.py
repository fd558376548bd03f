"""Provenance of a score: files with their hashes, settings, and facts of the host."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import numpy as np
from msgspec.structs import replace as struct_replace
from numpy.typing import NDArray

from sfr_loc_map import __version__
from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory, Truth, as_truth
from sfr_loc_map.hashes import hash_arrays, hash_path
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.metrics.completeness.expected_items import inputs_completeness
from sfr_loc_map.metrics.figures.records import InputFile, Provenance
from sfr_loc_map.metrics.judging.judge import with_verdicts
from sfr_loc_map.metrics.judging.limited import fault_of_inputs
from sfr_loc_map.metrics.judging.limits_file import load_limits
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.package_commit import package_commit
from sfr_loc_map.scoring.input_files import ReadFile, read_files
from sfr_loc_map.scoring.inputs import IN_MEMORY, Run

LIMITS = "limits"  #: Role of the limits file among the inputs.


def provenance_of(run: Run) -> Provenance:
    """Return the provenance of a run; the record of a ground truth also has the hash of its values (`data_sha256`).

    InputError if a file was changed or replaced since it was read.
    """
    origin = run.origin
    data: dict[str, str] = {}
    if run.drive is not None:
        data["truth"] = hash_of_truth(run.drive.truth)
    if run.cloud is not None:
        data["map_truth"] = hash_arrays(truth.points for truth in run.cloud.truths)
    sha256s = {file: file.sha256() for file in dict.fromkeys(origin.files.values())}  # one bag may have several roles
    found = {role: _input_file(file, sha256s[file], data.get(role)) for role, file in origin.files.items()}
    if "truth" in found:
        found["truth"] = _with_declared(found["truth"], origin.truth_settings)
        if run.drive is not None and isinstance(run.drive.truth, Truth):
            found["truth"] = struct_replace(found["truth"], read_from=run.drive.truth.read_from or None)
    if (sha256 := _images_sha256(run)) is not None:
        truth = origin.files.get("truth")
        found["images"] = InputFile(path=IN_MEMORY if truth is None else str(truth.named), sha256=sha256)
    for role, sha256 in origin.in_memory.items():
        found[role] = InputFile(path=IN_MEMORY, sha256=sha256, data_sha256=data.get(role))
    return provenance_with(found, origin.command, origin.settings)


def provenance_with(inputs: Mapping[str, InputFile], command: str | None, settings: Mapping[str, object]) -> Provenance:
    """Return inputs, command and settings with the version, the host and the present time."""
    return Provenance(
        version=__version__,
        commit=package_commit().commit,
        command=command,
        inputs=dict(inputs),
        configuration=dict(settings),
        host=host_facts(),
        time=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _input_file(file: ReadFile, sha256: str, data_sha256: str | None) -> InputFile:
    path = file.path
    return InputFile(path=str(path), resolved=str(path.resolve()), sha256=sha256, data_sha256=data_sha256)


def _with_declared(truth: InputFile, settings: Mapping[str, object]) -> InputFile:
    """Return the record of a ground truth with the hash of its content and of the settings that change the truth."""
    if not settings:
        return truth
    declared = msgspec.json.encode({"sha256": truth.sha256, **settings}, order="sorted")
    return struct_replace(truth, declared_sha256=hashlib.sha256(declared).hexdigest())


def hash_of_truth(truth: Trajectory) -> str:
    """Return the SHA-256 of the poses of a ground truth, of their sigmas and of the lever arm."""
    known = as_truth(truth)
    stated = np.array((known.sigma_m, known.sigma_deg, *known.lever_arm_m))
    return hash_arrays((truth.stamps_ns, truth.positions, truth.quats_xyzw, stated))


# ---- the inputs of a stored score


def limits_not_seen(score: Score, origin: str) -> str | None:
    """Return why the limits of a score could not be compared with their file; None if they were, or without limits.

    Raise InputError if the file has the recorded hash but its limits differ from those of the score.
    """
    rules = score.rules
    if rules is None or not rules.limits:
        return None
    file = None if score.provenance is None else score.provenance.inputs.get(LIMITS)
    if file is None:
        return f"{origin} names no limits file: its limits were not compared"
    path = Path(file.path)
    if not path.is_file():
        return f"the limits file '{file.path}' of {origin} is missing: its limits were not compared"
    if hash_path(path) == file.sha256 and not contains_limits(path, rules):
        raise InputError(
            f"{origin} contradicts itself: its limits differ from those in its limits file '{file.path}'; score "
            "the estimate again"
        )
    return None


def contains_limits(path: Path, rules: Limits) -> bool:
    """Return whether a limits file contains the limits of a score, in any layout."""
    return struct_replace(load_limits(path), partial=rules.partial) == rules


def changed_inputs(score: Score) -> tuple[list[InputFile], int]:
    """Return the inputs of a stored score that were changed since, and the number of inputs that still exist.

    Files that can be read are compared with their hashes. Folders, such as data sets and bags, are not, because results
    may be written into them. A limits file is unchanged if it contains the limits of the score.
    """
    inputs = {} if score.provenance is None else score.provenance.inputs
    changed: list[InputFile] = []
    present = 0
    for role, file in inputs.items():
        path = None if file.resolved is None else Path(file.resolved)
        if path is None or not _is_readable_file(path):
            continue
        present += 1
        if hash_path(path) == file.sha256:
            continue
        if role == LIMITS and _still_contains_limits(path, score.active_rules):
            continue
        changed.append(file)
    return changed, present


def _is_readable_file(path: Path) -> bool:
    """Return whether a path is a file that this user may read."""
    with suppress(OSError):  # of a folder that may not be searched
        return path.is_file() and os.access(path, os.R_OK)
    return False


def _still_contains_limits(path: Path, rules: Limits) -> bool:
    """Return whether a limits file is valid and contains the limits of a score."""
    with suppress(SfrError):
        return contains_limits(path, rules)
    return False


def with_changed_inputs(score: Score, origin: str, *, is_judged: bool) -> Score:
    """Return a stored score with a caveat for each changed input; if `is_judged`, a changed input prevents a pass.

    `origin` is the file of the score. A comparison with a later score, of an estimate at the same path, is not judged.
    """
    changed, present = changed_inputs(score)
    for file in changed:
        score = score.with_caveat(f"'{file.path}', an input of {origin}, was changed since the score was made")
    if not changed or not is_judged or not score.active_rules.limits:
        return score
    rows = tuple(inputs_completeness(len(changed), present))
    keys = [row.keys for row in rows]
    other_rows = tuple(row for row in score.figures if row.keys not in keys)
    return with_verdicts(struct_replace(score, figures=(*other_rows, *rows)))


def host_facts() -> dict[str, str]:
    """Return the facts of this host: machine, system, Python, kernel and, if known, processor, load and governor."""
    found = {"machine": platform.machine(), "system": platform.system(), "python": platform.python_version()}
    found["kernel"] = platform.release()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        found["processor"] = names[0] if names else "unknown"
    with suppress(OSError):
        found["load"] = f"{os.getloadavg()[0]:.2f} of {os.cpu_count()} processors"
    with suppress(OSError):
        governor = Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
        found["governor"] = governor.read_text(encoding="utf-8").strip()
    return found


def _images_sha256(run: Run) -> str | None:
    """Return the hash of the images that an estimate must cover; None if they are unknown."""
    drive = run.drive
    return None if drive is None or drive.image_stamps_ns is None else hash_of_images(drive.image_stamps_ns, drive.rig)


def hash_of_images(stamps_ns: IntArray, rig: StereoRig | None) -> str:
    """Return the SHA-256 of the stamps of images and of their rig, if it is known; pixels are not hashed."""
    values: list[NDArray[np.generic]] = [stamps_ns]
    if rig is not None:
        values.append(np.array([rig.width, rig.height, rig.fx, rig.fy, rig.cx, rig.cy, rig.baseline_m]))
        if rig.T_rb_sb is not None:
            values += [rig.T_rb_sb.rotation, rig.T_rb_sb.translation]
    return hash_arrays(values)


def data_set_of(source: Source) -> dict[str, InputFile]:
    """Return the inputs of a source that a score states, by role; limits can name their hashes."""
    has_truth = source.loc is not None and source.loc.ground_truth is not None
    files = read_files(
        {
            "truth": source.path if has_truth else None,
            "truth_file": source.config.truth.file,
            "map_truth": None if source.nav is None else source.path,
        }
    )
    sha256s = {path: hash_path(path) for path in {file.path for file in files.values()}}
    found = {role: InputFile(path=str(file.named), sha256=sha256s[file.path]) for role, file in files.items()}
    if "truth" in found:
        found["truth"] = _with_declared(found["truth"], source.config.truth.changed_content)
    if source.loc is not None:
        sha256 = hash_of_images(source.expected_loc_ns(), source.loc.rig)
        found["images"] = InputFile(path=str(source.path), sha256=sha256)
    return found


def provenance_of_source(
    source: Source, estimates: Mapping[str, Path], command: str, settings: Mapping[str, object]
) -> Provenance:
    """Return the provenance of a check of a source and of other estimates of its drive, by name.

    The inputs are those that a score of the source has, so that a report can compare them, and the complete source.
    """
    inputs = data_set_of(source)
    files = {"source": source.path, "configuration": source.config.configuration.path}
    files |= {f"estimate {name}": path for name, path in estimates.items()}
    for role, path in files.items():
        if path is not None:
            inputs[role] = InputFile(path=str(path), resolved=str(path.resolve()), sha256=hash_path(path))
    return provenance_with(inputs, command, settings)


def check_data_set(source: Source, limits: Limits | None) -> None:
    """Raise InputError if limits name another data set by its hashes, before the source is run."""
    if limits is None or not limits.data_set_sha256:
        return
    fault = fault_of_inputs(limits.data_set_sha256, data_set_of(source))
    if fault is not None:
        raise InputError(fault)
