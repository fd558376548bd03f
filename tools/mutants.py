"""Mutation tests of metrics, geometry, scores, suites, methods, localisation, maps and simulation: `make mutants`.

Each mutation is a defect in one place: a sign, n for n - 1, an axis, an order, degrees for radians, a boundary of a
condition, a bound of a range, the pixel of a true point, or an unexpected part. The test modules of `TESTS`, and
those named after the mutated module, run in a copy of the sources. At first they run without a mutation, and the lines
that each of them executes are recorded; a mutation then runs the modules that execute its lines first. A mutation
survives if no test fails. The exit code is 1 if a mutation survives.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import pytest
from coverage import Coverage

ROOT = Path(__file__).resolve().parents[1]
COPIED = (
    "sfr_loc_map",
    "test",
    "pyproject.toml",
    "setup.py",
    "setup.cfg",
    "package.xml",
    "README.md",
    "docs",
    "include",
    "sample",
)
TESTS = (
    "test/metrics",
    "test/geometry",
    "test/scoring/test_incomplete_everywhere.py",
    "test/scoring/test_copied_poses.py",
    "test/scoring/test_unjudged_frames.py",
    "test/scoring/test_drive_completeness.py",
    "test/scoring/test_map_completeness.py",
    "test/scoring/test_judged_calls.py",
    "test/scoring/test_calls_of_the_run.py",
    "test/scoring/test_target_calls.py",
    "test/test_host_clock.py",
    "test/scoring/test_data_set.py",
    "test/scoring/test_edited_scores.py",
    "test/scoring/test_verdicts.py",
    "test/scoring/test_score_command.py",
    "test/scoring/test_several_scores.py",
    "test/scoring/test_deviations.py",
    "test/report/test_test_report.py",
    "test/io/test_truth.py",
    "test/localisation/test_findings.py",
    "test/localisation/test_path.py",
    "test/localisation/ground/test_cases.py",
    "test/localisation/uncertainty",
)
"""Tests that run with each mutation."""
OF_METHODS = (
    "test/methods/child/test_loop.py",
    "test/methods/test_call_monitor.py",
    "test/methods/test_method_process.py",
    "test/methods/test_misbehaviour.py",
    "test/methods/test_work_between_calls.py",
)
"""Tests of the calls and measurements of methods; they run with the mutations in `methods`."""
PASSED, FAILED, NO_TESTS = 0, 1, 5  #: Exit codes of pytest.
LIBRARIES = ("hypothesis", "msgspec", "numba", "numpy", "scipy.spatial.transform", "scipy.stats", "yaml")
"""Libraries that are imported once for all mutations."""


class Mutation(NamedTuple):
    """A mutation: file below `sfr_loc_map`, a text that occurs once in it, and the replacement."""

    path: str
    text: str
    instead: str


ANSWERS, STORE = "replay/external/answer_book.py", "suite/store.py"
JUDGE = "metrics/judging/judge.py"
OTHER_FRAMES = "metrics/trajectory/other_frames.py"
COVERAGE = "metrics/map/coverage.py"
INCOMPLETE, OTHER_FORMULAS = "metrics/judging/incomplete.py", "metrics/other_formulas.py"
FORMULAS, SCORE = "metrics/formulas.py", "metrics/trajectory/trajectory_errors.py"
SHORTFALLS = "metrics/completeness/shortfall_kinds.py"
EXPECTED_ITEMS, DRIVE = "metrics/completeness/expected_items.py", "metrics/completeness/drive.py"
GAPS = "metrics/completeness/gaps.py"
CALL_CHECKS, CALL_POSES = "scoring/call_checks.py", "calls/call_poses.py"
DRIVES, JOB = "suite/planning/drive_copies.py", "suite/jobs/job.py"
EXPOSURE, HOLES = "mapping/disparity/exposure.py", "mapping/disparity/hole_filling.py"
FUSION, STEPS = "mapping/multiview/fusion.py", "mapping/terrain/steps.py"
MUTATIONS = (
    # 4.1.1 sub-trajectories
    Mutation(FORMULAS, "np.arange(0, frames, spacing)", "np.arange(1, frames, spacing)"),
    Mutation(FORMULAS, "np.arange(0, frames, spacing)", "np.arange(0, frames, spacing + 1)"),
    Mutation(FORMULAS, "np.cumsum(steps, out=length[1:]", "np.cumsum(steps**2, out=length[1:]"),
    Mutation(FORMULAS, "(distance_m - DISTANCE_TOLERANCE_M)", "(distance_m + DISTANCE_TOLERANCE_M)"),
    Mutation(
        FORMULAS, 'np.searchsorted(length_m, needed, side="left")', 'np.searchsorted(length_m, needed, side="left") + 1'
    ),
    Mutation(FORMULAS, 'since_first[starts] + time_ns, side="left")', 'since_first[starts] + time_ns, side="right")'),
    Mutation(FORMULAS, "return starts + frames", "return starts + frames - 1"),
    Mutation(OTHER_FORMULAS, "np.radians(turn_deg)", "np.radians(0.5 * turn_deg)"),
    Mutation(OTHER_FORMULAS, "np.max(next_frames, axis=0)", "np.min(next_frames, axis=0)"),
    Mutation(OTHER_FORMULAS, "self.travelled[ends] + missing", "self.travelled[ends] + 1.5 * missing"),
    Mutation(SCORE, "ends = np.maximum(ends, formulas.ends_by_time", "ends = np.minimum(ends, formulas.ends_by_time"),
    Mutation(SCORE, "is_met = ends < count", "is_met = ends < count - 1"),
    Mutation(SCORE, "formulas.start_frames(count, spacing)", "formulas.start_frames(count, 10)"),
    Mutation(SCORE, "max(metres / DISTANCES_BASE_M, 1.0)", "max(metres / DISTANCES_BASE_M, 5.0)"),
    # 4.1.2 errors before N are ignored
    Mutation(
        FORMULAS,
        "quat_multiply(true_attitude[starts], quat_conjugate(attitude[starts]))",
        "quat_multiply(attitude[starts], quat_conjugate(true_attitude[starts]))",
    ),
    Mutation(
        FORMULAS,
        "moved = quat_rotate(correction, displacement(position, starts, ends))",
        "moved = displacement(position, starts, ends)",
    ),
    Mutation(
        FORMULAS,
        "turned = quat_multiply(correction, attitude[ends])",
        "turned = quat_multiply(attitude[ends], correction)",
    ),
    Mutation(
        FORMULAS,
        "change = quat_multiply(quat_conjugate(attitude[starts]), attitude[ends])",
        "change = quat_multiply(attitude[ends], quat_conjugate(attitude[starts]))",
    ),
    Mutation(
        FORMULAS,
        "change_of_heading = heading(attitude[ends]) - heading(attitude[starts])",
        "change_of_heading = heading(attitude[ends])",
    ),
    # 4.1.3 standard deviation
    Mutation(FORMULAS, "np.sum(squares, axis=0) / (len(errors) - 1)", "np.sum(squares, axis=0) / len(errors)"),
    Mutation(FORMULAS, "np.square(errors - np.mean(errors, axis=0))", "np.square(errors)"),
    # 4.2.3.1 position
    Mutation(
        FORMULAS, "np.asarray(position[ends] - position[starts])", "np.asarray(position[starts] - position[ends])"
    ),
    Mutation(FORMULAS, "np.asarray(estimated - actual)", "np.asarray(actual - estimated)"),
    Mutation(
        FORMULAS, "float(np.linalg.norm(np.mean(errors, axis=0)))", "float(np.mean(np.linalg.norm(errors, axis=1)))"
    ),
    Mutation(
        FORMULAS,
        "float(np.linalg.norm(standard_deviation(errors)))",
        "float(standard_deviation(np.linalg.norm(errors, axis=1)))",
    ),
    Mutation(FORMULAS, "return abs(mean) + 3.0 * sigma", "return mean + 3.0 * sigma"),
    Mutation(FORMULAS, "return abs(mean) + 3.0 * sigma", "return abs(mean) + 2.0 * sigma"),
    # 4.2.3.2 attitude, 4.2.3.3 heading
    Mutation(FORMULAS, "np.degrees(quat_angle(", "np.asarray(quat_angle("),
    Mutation(FORMULAS, "quat_multiply(quat_conjugate(actual), estimated)", "quat_multiply(actual, estimated)"),
    Mutation(FORMULAS, "2.0 * (x * y + z * w), 1.0", "2.0 * (x * y - z * w), 1.0"),
    Mutation(FORMULAS, "1.0 - 2.0 * (y * y + z * z)", "1.0 - 2.0 * (x * x + z * z)"),
    Mutation(FORMULAS, "error = np.degrees(estimated - actual)", "error = np.degrees(actual - estimated)"),
    Mutation(FORMULAS, "np.ceil((error - 180.0) / 360.0)", "np.floor((error + 180.0) / 360.0)"),
    Mutation(FORMULAS, "error - 360.0 * np.ceil((error - 180.0) / 360.0)", "error"),
    # directions, quantiles
    Mutation(OTHER_FORMULAS, "error[:, 1] * east - error[:, 0] * north", "error[:, 0] * north - error[:, 1] * east"),
    Mutation(FORMULAS, 'float(name[1:].replace("_", "."))', "float(name[1:]) - 1.0"),
    Mutation(FORMULAS, "np.abs(given)", "given"),
    Mutation(
        OTHER_FORMULAS, "return np.asarray(estimated - np.linalg.norm(", "return np.asarray(estimated + np.linalg.norm("
    ),
    # 4.2.1, 4.2.2 calls
    Mutation("metrics/calls/call_score.py", "statistics(known[1:])", "statistics(known)"),
    Mutation("metrics/calls/call_score.py", "int(known.max()) if len(known)", "int(known.min()) if len(known)"),
    Mutation("metrics/calls/calls.py", "MappingState.FUSED: CallKind.FUSION", "MappingState.FUSED: CallKind.MAPPING"),
    Mutation(
        "metrics/calls/call_score.py",
        "calls.peak_bytes > 0.0, calls.peak_bytes, np.nan",
        "calls.peak_bytes >= 0.0, calls.peak_bytes, np.nan",
    ),
    # 4.3.4 map
    Mutation(
        FORMULAS,
        "np.asarray(np.linalg.norm(actual - estimated, axis=1))",
        "np.asarray(np.abs(actual - estimated).max(axis=1))",
    ),
    Mutation(
        "metrics/map/point_errors.py",
        "true = truth.points[cloud.v[index], cloud.u[index]]",
        "true = truth.points[cloud.v[index], np.maximum(cloud.u[index], 1) - 1]",
    ),
    Mutation(
        "metrics/map/map_score.py",
        "error_rows(None, errors, np.full(len(errors.index), True))",
        "error_rows(None, errors, errors.range_m < 40.0)",
    ),
    Mutation(
        "metrics/map/map_score.py",
        "(errors.range_m >= low) & (errors.range_m < high)",
        "(errors.range_m > low) & (errors.range_m <= high)",
    ),
    Mutation(COVERAGE, "& (self.range_m < high_m)", "& (self.range_m <= high_m)"),
    Mutation(COVERAGE, "FOOTPRINTS = 2.0", "FOOTPRINTS = 3.0"),
    Mutation(COVERAGE, "truth.depths_m(truth.points) / truth.rig.fx", "truth.ranges_m() / truth.rig.fx"),
    Mutation(
        "metrics/map/map_score.py", "without_truth=len(cloud) - len(errors.index)", "without_truth=len(errors.index)"
    ),
    # association, completeness, consistency, limits
    Mutation(
        "metrics/frames/association.py",
        'np.argsort(difference[candidates], kind="stable")',
        "np.arange(len(candidates))",
    ),
    Mutation(
        "metrics/frames/association.py",
        "- np.unique(stamps_ns[::-1], return_index=True)[1]",
        "- np.unique(stamps_ns[::-1], return_index=True)[1][::-1]",
    ),
    Mutation(
        "metrics/frames/association.py",
        "truth.positions[before] + share[:, None] * move",
        "truth.positions[before] + move",
    ),
    Mutation(GAPS, "GAP_PERIODS = 5", "GAP_PERIODS = 7"),
    Mutation(SHORTFALLS, "IN_GAPS_MOST = 0.01", "IN_GAPS_MOST = 0.013"),
    Mutation("metrics/frames/association.py", "IMAGE_PERIOD_SHARE = 0.4", "IMAGE_PERIOD_SHARE = 0.15"),
    Mutation("metrics/trajectory/truth_error.py", "[2.0 * of_position] * 3", "[1.0 * of_position] * 3"),
    Mutation("metrics/trajectory/consistency.py", "free_from = end\n", "free_from = start\n"),
    Mutation("metrics/trajectory/consistency.py", "+ start.noise + end.noise", "+ end.noise"),
    Mutation("metrics/score/limits.py", "abs(value) <= limit.limit", "abs(value) <= 1.001 * limit.limit"),
    Mutation("metrics/score/limits.py", "abs(value) <= limit.limit", "value <= limit.limit"),
    Mutation("metrics/score/limits.py", "abs(value) <= limit.limit", "abs(value) < limit.limit"),
    Mutation("metrics/score/limits.py", "value >= limit.limit if", "value <= limit.limit if"),
    Mutation(JUDGE, "incomplete = text_of(shortfalls)", "incomplete = score.incomplete"),
    Mutation(INCOMPLETE, "in (*SCOPES_OF_ALL_LIMITS, required_scope(limit))", "in SCOPES_OF_ALL_LIMITS"),
    Mutation(INCOMPLETE, "in (*SCOPES_OF_ALL_LIMITS, required_scope(limit))", "in (required_scope(limit),)"),
    Mutation(INCOMPLETE, "return self.limit == limit", "return True"),
    Mutation(INCOMPLETE, "if judged is None or not meets(limit, judged):", "if judged is None:"),
    Mutation("geometry/trajectory.py", "level[:, 2] = 0.0", "level[:, 2] *= 1.0"),
    Mutation("metrics/trajectory/truth_error.py", "np.hypot(noise_deg, interpolation_deg)", "np.hypot(noise_deg, 0.0)"),
    Mutation("metrics/trajectory/truth_error.py", "np.hypot(of_noise_m, of_interpolation_m)", "of_noise_m"),
    Mutation(SHORTFALLS, "WITHOUT_TRUTH_MOST = 0.01", "WITHOUT_TRUTH_MOST = 0.1"),
    Mutation("metrics/config.py", "return min(states, key", "return max(states, key"),
    Mutation("metrics/score/limits.py", "count >= self.minimum_count", "count > self.minimum_count"),
    Mutation(
        "metrics/statistics/intervals.py",
        "1.0 - 1.0 / count) / (1.0 - 1.0 / independent",
        "1.0 - 1.0 / independent) / (1.0 - 1.0 / count",
    ),
    Mutation(
        "metrics/statistics/intervals.py", "np.sum(parts.squares + apart, axis=-2)", "np.sum(parts.squares, axis=-2)"
    ),
    Mutation("metrics/statistics/intervals.py", "1.0 - lags / float(block * size)", "1.0 - lags / float(block)"),
    Mutation("metrics/statistics/intervals.py", "share *= 1.0 - 1.0 / independent\n    return", "return"),
    Mutation("metrics/comparison.py", "difference = other - first", "difference = first - other"),
    Mutation("metrics/figures/catalogue.py", 'return kind.clause if part == ON_TARGET else ""', "return kind.clause"),
    Mutation("metrics/figures/catalogue.py", 'CallKind.MAPPING_CALL: "4.3.2"}', 'CallKind.MAPPING: "4.3.2"}'),
    Mutation("report/deviations.py", "item.figure in STAGES or (", "("),
    Mutation("report/deviations.py", "(MethodKind.BUILT_IN, MethodKind.PEER, ", "(MethodKind.PEER, "),
    Mutation(
        "metrics/score/score.py",
        "if row.part in ((reading, POOLED) if is_of_sub_trajectories else (None,)):",
        "if True:",
    ),
    Mutation("metrics/frames/association.py", "is_enough = MATCHES_PER_STAMP *", "is_enough = 1 *"),
    Mutation("metrics/frames/umeyama.py", "np.array([1.0, 1.0, np.sign(", "np.array([1.0, 1.0, abs("),
    # limits and limits files
    Mutation("metrics/score/limits.py", "not 0 <= bound < math.inf", "not 0 <= bound <= math.inf"),
    Mutation("metrics/score/limits.py", '.unit == "1" and bound > 1:', '.unit == "1" and bound > 100:'),
    Mutation("metrics/judging/limits_file.py", "not 1 <= independent < 1e9", "not 0 <= independent < 1e9"),
    Mutation("metrics/score/limits.py", "INDEPENDENT_FOR_VERDICT = 5.0", "INDEPENDENT_FOR_VERDICT = 4.0"),
    Mutation("metrics/judging/limits_file.py", "{**of_all, **entry}", "{**entry, **of_all}"),
    Mutation("metrics/judging/limits_file.py", "minimum_independent=float(independent), ", ""),
    Mutation("metrics/judging/limits_file.py", ", data_set_sha256=hashes", ""),
    Mutation("metrics/judging/limited.py", "    for role in present:", "    for role in present[:1]:"),
    Mutation("metrics/judging/judge.py", "if (fault := fault_of_data_set(ruled)) is not None:", "if False:"),
    Mutation("metrics/score/limits.py", "name: limited.of_target() for", "name: limited for"),
    # completeness of a drive, a map, calls, a live run
    Mutation(DRIVE, "self.has_estimate & self.has_truth", "self.has_estimate"),
    Mutation(DRIVE, "DOUBLED_SHARE = 0.1 ", "DOUBLED_SHARE = 0.6 "),
    Mutation(EXPECTED_ITEMS, "stamps_ns.max() - in_flight_ns", "stamps_ns.max() - 2 * in_flight_ns"),
    Mutation(EXPECTED_ITEMS, "missing = max(expected_pairs - mapped, 0)", "missing = 0"),
    Mutation(EXPECTED_ITEMS, "max(known, default=None)", "min(known, default=None)"),
    Mutation(EXPECTED_ITEMS, "not_finite, points + not_finite)", "not_finite, points)"),
    Mutation(EXPECTED_ITEMS, "np.isfinite(measured)", "~np.isinf(measured)"),
    Mutation(EXPECTED_ITEMS, "counts[~is_of_drive].sum()", "(~is_of_drive).sum()"),
    Mutation(EXPECTED_ITEMS, '"publisher_changes", value=publisher_changes', '"publisher_changes", value=0'),
    Mutation("ros/transport.py", "0 < number <= self._previous", "0 < number < self._previous"),
    Mutation("scoring/results.py", "MAX_UNEVEN = 0.05", "MAX_UNEVEN = 0.2"),
    Mutation("scoring/results.py", "(of_parts - 1.0 / parts, 0.0).sum()", "(of_parts - 1.0 / parts, 0.0).min()"),
    Mutation(EXPECTED_ITEMS, "(counts[is_of_drive] - 1).sum()", "(counts[is_of_drive] - 2).sum()"),
    Mutation(EXPECTED_ITEMS, "repeated_stamps + len(pairs) - len(np.unique(pairs))", "repeated_stamps"),
    Mutation(DRIVE, 'single_run_stamps(placed.truth, "ground truth")', "pass"),
    Mutation("metrics/frames/association.py", "np.lexsort((difference[near], image[near]))", "np.argsort(image[near])"),
    Mutation("metrics/frames/association.py", "return rows[chosen] if len(chosen) else rows", "return rows[chosen]"),
    Mutation(
        "metrics/frames/association.py", "near = np.flatnonzero(difference <= near_ns)", "near = np.arange(len(image))"
    ),
    Mutation(EXPECTED_ITEMS, "share_of(many - judged, many)", "share_of(max(many - len(given), 0), many)"),
    Mutation(EXPECTED_ITEMS, "return min(judged, 1), 1", "return 1, 1"),
    Mutation(EXPECTED_ITEMS, "received, received + dropped)", "received, received)"),
    # calls
    Mutation("metrics/calls/call_score.py", "known <= period_s", "known < period_s"),
    Mutation("metrics/calls/call_score.py", "float(np.mean(known)) / period_s", "float(np.median(known)) / period_s"),
    Mutation("metrics/calls/call_score.py", "float(np.median(apart_s))", "float(np.mean(apart_s))"),
    Mutation(
        "metrics/calls/call_score.py",
        "np.isin(estimate_ns, localised).mean()",
        "np.isin(localised, estimate_ns).mean()",
    ),
    Mutation(FORMULAS, "(returned_ns - called_ns) * 1e-9", "(returned_ns - called_ns) * 0.5e-9"),
    Mutation(FORMULAS, "return peak_bytes - idle_bytes if", "return peak_bytes if"),
    Mutation(FORMULAS, "if peak_bytes >= idle_bytes else None", "if True else None"),
    Mutation("metrics/calls/call_score.py", "if place is not Place.STATED:", "if True:"),
    # verdicts
    Mutation(SHORTFALLS, '"missing", Scope.DRIVE, IMAGES, 0.0', '"missing", Scope.DRIVE, IMAGES, 0.01'),
    Mutation(SHORTFALLS, "IMAGES,\n        0.0,", "IMAGES,\n        0.01,"),
    Mutation(
        SHORTFALLS,
        '"points_not_finite", Scope.MAP, "map points", 0.0',
        '"points_not_finite", Scope.MAP, "map points", 0.5',
    ),
    Mutation(SHORTFALLS, "UNCOVERED_MOST = 0.5", "UNCOVERED_MOST = 0.99"),
    Mutation(
        SHORTFALLS,
        '"calls_doubled",\n        Scope.CALLS,\n        "calls",\n        0.0',
        '"calls_doubled",\n        Scope.CALLS,\n        "calls",\n        0.1',
    ),
    Mutation(INCOMPLETE, "(rules.partial and kind.partial)", "rules.partial"),
    Mutation(INCOMPLETE, "not row.n or row.value is not None", "not row.n or row.value != 0.0"),
    Mutation(
        "metrics/judging/limited.py",
        "not in tasks_of(score):\n        return False",
        "not in tasks_of(score) or True:\n        return False",
    ),
    Mutation(SHORTFALLS, '"estimates",\n        0.0', '"estimates",\n        0.1'),
    # calls belong to the estimate that they produced
    Mutation("scoring/inputs.py", "stats = [beside] if beside.is_file() else []", "stats = []"),
    Mutation(
        "suite/planning/source_inspection.py",
        "(estimate, truth, *ScoreInputs.of(estimate, truth).stats)",
        "(estimate, truth)",
    ),
    # shared memory of other methods
    Mutation("methods/isolation.py", '"urandom", "tty", "dri"', '"urandom", "tty", "shm", "dri"'),
    # answers of an external node: before the question, after the timeout, after a hidden restart
    Mutation(
        ANSWERS,
        "latency_s = answer.received_s - self._sent_s[stamp_ns]",
        "latency_s = max(answer.received_s - self._sent_s[stamp_ns], 0.0)",
    ),
    Mutation(ANSWERS, "latency_s < -EARLY_S", "latency_s < -5.0 * EARLY_S"),
    Mutation(
        ANSWERS, "            return None\n        self.frames = answer.frames", "        self.frames = answer.frames"
    ),
    Mutation(ANSWERS, "math.inf) > self._timeout_s]", "math.inf) > 1e9]"),
    Mutation(ANSWERS, "if self._crash is None:", "if False:"),
    # the clock of the measuring process
    Mutation("host_clock.py", "MOST_S, MOST_SHARE = 0.1, 0.01", "MOST_S, MOST_SHARE = 0.1, 0.02"),
    Mutation("host_clock.py", "            check_passed(self._passed_s, self._kernel_passed_s)\n", ""),
    Mutation("host_clock.py", "abs(passed_s - kernel_passed_s)", "passed_s - kernel_passed_s"),
    Mutation("child_process.py", 'not name.startswith("LD_") or name', "True or name"),
    # a search: a run that fails is not a worst case, but a lost drive is
    Mutation("suite/search/search.py", "if self._store.state(job) is JobState.FAILED]:", "if False]:"),
    Mutation("suite/search/search.py", "jobs), key=badness_of)", "jobs), key=lambda ratio: ratio or 0.0)"),
    # copies of a drive count as one drive
    Mutation(DRIVES, "MAX_BREAK_S = 10.0", "MAX_BREAK_S = 100.0"),
    Mutation(DRIVES, "MAX_BREAK_S = 10.0", "MAX_BREAK_S = 1.0"),
    Mutation(DRIVES, "if not begins_late or break_s >", "if break_s >"),
    Mutation(DRIVES, "speed_m_s * break_s + SAME_M", "speed_m_s * MAX_BREAK_S"),
    Mutation(DRIVES, "SAME_M = 0.01", "SAME_M = 0.001"),
    Mutation(DRIVES, "SAME_M = 0.01", "SAME_M = 0.05"),
    Mutation(DRIVES, "SAME_GREY = 8", "SAME_GREY = 1"),
    Mutation(DRIVES, "SAME_STEP = 0.001", "SAME_STEP = 0.05"),
    Mutation(DRIVES, "COMMON_SHARE = 0.5", "COMMON_SHARE = 0.99"),
    Mutation(DRIVES, "path_m = path_m @ truth.pose(0).rotation", "path_m = path_m @ truth.pose(0).rotation.T"),
    Mutation(DRIVES, "source.sha256 < smallest[number].sha256", "source.sha256 > smallest[number].sha256"),
    Mutation("suite/statistics/pooling.py", "size > worst[drive_key][0]", "size < worst[drive_key][0]"),
    Mutation("suite/statistics/group_verdicts.py", "items_under_test(scores))) > 1", "items_under_test(scores))) > 2"),
    # a suite must not hide drives that were run, and its plan must match its files
    Mutation(STORE, "if planned.get(left.work, ", "if not planned.get(left.work, "),
    Mutation(JOB, "return (self.source, self.path), self.source_sha256", "return object(), self.source_sha256"),
    Mutation(JOB, "self.path), self.source_sha256", "self.path), object()"),
    Mutation(STORE, ', *sorted(self.failures.glob("*.json"))):', ",):"),
    Mutation(JOB, "self.fault_seed), self.repeat)", "self.fault_seed))"),
    Mutation(STORE, "hash_path(Path(file.path)) != file.sha256:", "False:"),
    Mutation(STORE, "if content.get(HASH) != hash_of_values(content):", "if False:"),
    # edited scores
    Mutation("scoring/input_files.py", "if _states_of(self.path) != self.states:", "if False:"),
    Mutation(
        "scoring/provenance.py",
        "return struct_replace(load_limits(path), partial=rules.partial) == rules",
        "return True",
    ),
    # inputs besides the poses
    Mutation(
        "scoring/inputs.py", "[*self.stats, *([] if self.target is None else [self.target.calls])]", "[*self.stats]"
    ),
    Mutation("scoring/load_calls.py", "return [*self.here, self.target.calls]", "return []"),
    Mutation("scoring/load_calls.py", "            return self.here\n", "            return []\n"),
    Mutation("scoring/call_checks.py", "SAME_POSITION_M = 0.002", "SAME_POSITION_M = 0.0"),
    Mutation("scoring/load_calls.py", "    check_one_method(here, on_target)\n", ""),
    Mutation("scoring/score_run.py", "finding = fitted_unit(run.convention)", "finding = None"),
    Mutation("metrics/conventions/pose_convention.py", "rtol=0.0, atol=1e-9", "rtol=0.0, atol=1e-3"),
    Mutation(
        DRIVE, "estimates_ns[~is_covered]", "estimates_ns[(estimates_ns < true_ns[0]) | (estimates_ns > true_ns[-1])]"
    ),
    Mutation(DRIVE, "estimates_ns[~is_covered]", "estimates_ns[:0]"),
    # a path without images, a range without pixels, a stationary rover
    Mutation(GAPS, "(true_ns[:1], images_ns[:-1][is_hole], images_ns[-1:])", "(true_ns[:1], )"),
    Mutation(GAPS, "is_hole = steps_ns > max(max_gap_ns, ", "is_hole = steps_ns > max(0, "),
    Mutation(INCOMPLETE, "value is None and kind.text_of_nothing", "value is None and not kind.text_of_nothing"),
    Mutation(INCOMPLETE, "share.value <= most or moving", "share.value <= 1.0 or moving"),
    Mutation(INCOMPLETE, " or not meets(limit, value):\n            count =", ":\n            count ="),
    Mutation(
        "metrics/trajectory/standing.py", "farthest_m > least_by_rate(farthest_m, durations_s)", "farthest_m >= 0.0"
    ),
    Mutation("metrics/trajectory/standing.py", "if not 0 < standing < count:", "if not 0 < standing:"),
    Mutation("report/deviations.py", "used != (usual.scored_from_m", "used == (usual.scored_from_m"),
    # true poses at starts and ends
    Mutation(SHORTFALLS, "COPIES_MOST = 0.1", "COPIES_MOST = 1.0"),
    Mutation(
        "metrics/completeness/copies.py",
        "is_moving = lengths_m > least_by_rate(lengths_m, durations_s)",
        "is_moving = lengths_m >= 0.0",
    ),
    # frames that are in no judged error
    Mutation(SHORTFALLS, "BEYOND = 3.0", "BEYOND = 0.1"),
    Mutation(OTHER_FRAMES, "np.setdiff1d(np.arange(len(placed.frames.stamps_ns)), known)", "known"),
    Mutation(SHORTFALLS, "BEYOND_MOST = 0.02", "BEYOND_MOST = 0.2"),
    Mutation(INCOMPLETE, "value is not None and not meets(limit, value)", "value is not None"),
    Mutation(INCOMPLETE, "is_met and is_of_many and", "is_met and statistic in QUANTILES and"),
    Mutation(OTHER_FRAMES, "np.quantile(known, 1.0 - BEYOND_MOST,", "np.quantile(known, 1.0,"),
    # limits that an estimate without motion meets
    Mutation(
        "report/deviations.py", "least is not None and item.limit >= least", "least is not None and item.limit > least"
    ),
    Mutation("report/deviations.py", "HALF_TURN_DEG = 180.0", "HALF_TURN_DEG = 1800.0"),
    # interpolated poses, copies of true attitudes
    Mutation("metrics/completeness/copies.py", "(changes_m <= rounding_m)", "(changes_m <= 0.0)"),
    Mutation("metrics/completeness/copies.py", "np.count_nonzero(is_interpolated(frames) & ~is_reported)", "0"),
    Mutation("metrics/completeness/copies.py", "np.min(errors_rad, axis=0) <=", "np.min(errors_rad, axis=0) >"),
    Mutation(
        INCOMPLETE, "limit.limited.figure not in self.kind.of_figures", "limit.limited.figure in self.kind.of_figures"
    ),
    Mutation(SHORTFALLS, 'of_figures=("attitude", "heading")', 'of_figures=("heading",)'),
    # a truth that is the output of a run, or whose configuration is not used
    Mutation("scoring/load_drive.py", "if calls.is_file() and not are_of_estimate:", "if not are_of_estimate:"),
    Mutation("scoring/load_drive.py", "true.how.configuration.path is None and beside", "beside"),
    # stored scores whose inputs were changed since
    Mutation("scoring/provenance.py", "if hash_path(path) == file.sha256:", "if not path:"),
    Mutation("scoring/provenance.py", "role == LIMITS and _still_contains", "role == LIMITS or _still_contains"),
    Mutation("scoring/provenance.py", "if not changed or not is_judged or", "if not changed or is_judged or"),
    # repeated poses, copies of true poses
    Mutation("metrics/completeness/copies.py", "NOISES = 5.0", "NOISES = 0.5"),
    Mutation("metrics/frames/motion.py", "MOVING_SHARE = 0.1", "MOVING_SHARE = 0.01"),
    Mutation("metrics/completeness/copies.py", "DRIFT_SHARE = 0.02", "DRIFT_SHARE = 0.01"),
    Mutation("metrics/completeness/copies.py", "DRIFT_SHARE = 0.02", "DRIFT_SHARE = 0.03"),
    Mutation("metrics/completeness/copies.py", "EXACT_SHARE = 1e-5", "EXACT_SHARE = 1e-4"),
    Mutation("metrics/completeness/copies.py", "EXACT_SHARE = 1e-5", "EXACT_SHARE = 1e-6"),
    Mutation("metrics/completeness/copies.py", "ROUNDED_IN_A_ROW = 50", "ROUNDED_IN_A_ROW = 51"),
    Mutation("metrics/completeness/copies.py", "ROUNDED_IN_A_ROW = 50", "ROUNDED_IN_A_ROW = 49"),
    Mutation("metrics/completeness/copies.py", "repeats_pose(frames) & ~is_reported", "repeats_pose(frames)"),
    Mutation(
        "metrics/completeness/copies.py", "frames.true_position[new], axis=1", "frames.true_position[new - 1], axis=1"
    ),
    Mutation("metrics/completeness/copies.py", "max(least_m, float(own_m.min()), 0.5", "max(least_m, 0.5"),
    Mutation("metrics/completeness/copies.py", "float(own_m.min()), 0.5 *", "float(own_m.min()), 1.5 *"),
    Mutation("metrics/completeness/copies.py", "return found.where(is_moving)", "return found"),
    Mutation("metrics/completeness/copies.py", "resolution_of(true_pos) < resolution_m", "False"),
    Mutation("metrics/completeness/copies.py", "is_enough(slice(None))), is_copy)", "True), is_copy)"),
    # the check of a stored score
    Mutation("metrics/stored/file_check.py", "fault_of_counts, fault_of_numbers,", "fault_of_counts,"),
    Mutation("metrics/stored/file_check.py", ", fault_of_data_set)", ")"),
    Mutation("metrics/score/limits.py", "for item in self.limits if item.terms is not None)", "for item in ())"),
    # several scores, several drives
    Mutation("metrics/judging/several_scores.py", "if len(made) < len(scores):", "if not made:"),
    Mutation(
        "metrics/judging/several_scores.py",
        "(item.version, item.commit) for item in made}) > 1",
        "(item.version, item.commit) for item in made}) > 2",
    ),
    Mutation(
        "metrics/judging/several_scores.py",
        "file.data_sha256 or file.sha256 for file in files}) > 1",
        "file.data_sha256 or file.sha256 for file in files}) > 2",
    ),
    Mutation("metrics/calls/call_score.py", "if calls.memory_method is not None:", "if calls.memory_method is None:"),
    Mutation("suite/planning/data_set.py", "if sha256 not in present", "if sha256 in present"),
    Mutation("suite/history/history.py", "key not in jobs and job.label not in planned", "key not in jobs"),
    Mutation("cli/output.py", "path.unlink(missing_ok=True)", "pass"),
    Mutation("report/deviations.py", "if used < usual:", "if used > usual:"),
    Mutation("suite/jobs/job.py", "DriveOrder(self.extension, self.drive_key)", "DriveOrder(0, self.drive_key)"),
    Mutation("suite/planning/looks.py", "min(first.get(drive, new), extensions[name])", "extensions[name]"),
    Mutation("suite/statistics/looks.py", "looks[0][0].limits != present", "looks[0][0].limits == present"),
    Mutation("suite/statistics/looks.py", "(verdict.n or 0) < (item.n or 0)", "(verdict.n or 0) <= (item.n or 0)"),
    Mutation(
        "scoring/results.py", "fromkeys(KINDS_OF[task], measurement)", "fromkeys(KINDS_OF[task][:1], measurement)"
    ),
    Mutation("metrics/figures/catalogue.py", " or place is Place.STATED:", ":"),
    Mutation("metrics/map/map_score.py", "len(xyz) - len(np.unique(xyz, axis=0)),", "0,"),
    Mutation("metrics/map/map_score.py", "len(xyz) - pixels, crowded)", "0, crowded)"),
    Mutation("metrics/map/map_score.py", "len(xyz) - pixels, crowded)", "len(xyz) - pixels, 0)"),
    Mutation("scoring/results.py", "ESTIMATES_OF_PART = 20", "ESTIMATES_OF_PART = 200"),
    Mutation("metrics/judging/several_scores.py", "if len(items) > 1:", "if len(items) > 2:"),
    Mutation(
        "metrics/judging/several_scores.py", "if len(configurations) > len({", "if len(configurations) > 1 + len({"
    ),
    Mutation(
        "metrics/judging/several_scores.py",
        "configurations = {(part, _configuration(score.method)) for score in scores for part in tasks_of(score)}",
        "configurations = {(DRIVE, _configuration(score.method)) for score in scores}",
    ),
    Mutation("metrics/judging/several_scores.py", "if None in items:", "if items == {None, 0}:"),
    Mutation("metrics/judging/several_scores.py", " or value_of(item, score).value is not None", ""),
    Mutation("scoring/call_checks.py", "if len(here) > 1:", "if len(here) > 2:"),
    Mutation("metrics/score/limits.py", "independent >= self.minimum", "independent > self.minimum"),
    Mutation("metrics/score/verdict.py", "<= self.truth_error", "<= 0.1 * self.truth_error"),
    Mutation("metrics/judging/limited.py", "TOTAL: math.sqrt(1.0 + 3.0**2)", "TOTAL: 3.0"),
    Mutation(
        "metrics/stored/file_check.py",
        "expected = mean_plus_3sigma(row.mean, row.sigma)",
        "expected = row.mean_plus_3sigma",
    ),
    Mutation("metrics/stored/file_check.py", "if stored != expected and not _is_near(stored, expected):", "if False:"),
    Mutation(
        "metrics/judging/limited.py",
        "math.inf if row.value is None else row.value\n",
        "0.0 if row.value is None else -row.value\n",
    ),
    Mutation(JUDGE, "if score.fatal_findings:", "if score.fatal_findings and score.rules:"),
    Mutation(JUDGE, "return high95 <= limit.limit if", "return low95 <= limit.limit if"),
    Mutation(JUDGE, "else limit.limit < low95", "else limit.limit < high95"),
    # methods: input and resource use of calls
    Mutation(
        "methods/child/loop.py",
        "seconds = time.perf_counter() - begin",
        "seconds = 0.5 * (time.perf_counter() - begin)",
    ),
    Mutation("methods/child/supervisor.py", "(41, 54, 46, 307, ", "(54, 46, 307, "),
    Mutation("methods/child/supervisor.py", " 307, 29, 64, 68, 240,", " 307, 64, 68, 240,"),
    Mutation("methods/child/supervisor.py", " 250, 188, 189, 190,", " 250, 189, 190,"),
    Mutation("methods/child/supervisor.py", '"x86_64": (90, 91, 268,', '"x86_64": (91,'),
    Mutation("process_tree.py", "SOCKET_BYTES if self._is_supervisor else 0", "0"),
    Mutation("methods/child/loop.py", "np.array(images[: len(", "np.asarray(images[: len("),
    Mutation(
        "methods/child/loop.py",
        'reply = {"number": number, "fault": "raised", "text": raised}',
        'reply = {"number": number}',
    ),
    Mutation("methods/child/loop.py", 'order["call"] == "set" else', 'order["call"] != "set" else'),
    Mutation("methods/child/loop.py", 'images[: len(order["pairs"])]', "images[:1]"),
    Mutation("methods/call_monitor.py", "<= stated_s <= measured_s + allowed_s(measured_s)", "<= stated_s"),
    Mutation("methods/call_monitor.py", "worked_s - allowed_s(worked_s)", "worked_s - allowed_s(measured_s)"),
    Mutation("methods/method_process.py", "MethodCall(measured.usage,", "MethodCall(type(measured.usage)(stated_s),"),
    Mutation("methods/call_monitor.py", "return min(between_s,", "return min(0.0,"),
    Mutation("methods/call_monitor.py", 'self.monitor.memory.check(peak, "had")', "pass"),
    Mutation("methods/supervised_process.py", "if now_s >= check_s:", "if False:"),
    Mutation("methods/method_process.py", 'reply.get("number") != number', "False"),
    Mutation("methods/supervised_process.py", "if now_s > end_s:", "if now_s > end_s and not self._unread:"),
    # calls of the run, and what limits allow
    Mutation(CALL_CHECKS, "apart_ns <= nearness_ns(stamps_ns)", "apart_ns == 0"),
    Mutation(CALL_CHECKS, '_check_same("attitudes", apart_deg', '_check_same("attitudes", 0.0 * apart_deg'),
    Mutation(CALL_CHECKS, "    _check_calls_of_poses(has_call)\n", ""),
    Mutation(CALL_CHECKS, "named[pair.stamp_ns] != {hash_of_pair(pair)}", "False"),
    Mutation(CALL_CHECKS, "made != {hash_of_cloud(cloud)}", "False"),
    Mutation("methods/method_process.py", "(memory, pid, base_bytes,", "(memory, pid, self.idle_bytes,"),
    Mutation(
        CALL_POSES,
        "lost = (states == TrackingState.LOST) | initialises_again(",
        "lost = states == TrackingState.LOST  # (",
    ),
    Mutation("calls/call_files.py", "if len(named) > 1:", "if len(named) > 2:"),
    Mutation(SHORTFALLS, "return math.inf if bound > 0.0 else 0.0", "return bound"),
    Mutation(SHORTFALLS, "return 1.0 - bound", "return bound"),
    Mutation(SHORTFALLS, "not (has_images and each.only_without_images)", "True"),
    Mutation("io/truth/of_bag.py", 'else (f"truth.source={topic.bag_name}",)', "else ()"),
    # geometry
    Mutation("geometry/rotation.py", "aw * bx + ax * bw + ay * bz - az * by", "aw * bx + ax * bw - ay * bz + az * by"),
    Mutation("geometry/rotation.py", "np.abs(quat[..., 3])", "quat[..., 3]"),
    Mutation(
        "geometry/rotation.py",
        "a_xyzw * b_xyzw, axis=1) < 0.0, -1.0, 1.0)",
        "a_xyzw * b_xyzw, axis=1) < 0.0, 1.0, 1.0)",
    ),
    Mutation("geometry/rotation.py", "quat[..., :3] = -quat[..., :3]", "quat[..., 1:3] = -quat[..., 1:3]"),
    Mutation("geometry/transform.py", "-self.rotation.T.dot(self.translation)", "-self.rotation.dot(self.translation)"),
    Mutation(
        "geometry/transform.py",
        "((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0))",
        "((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))",
    ),
    Mutation("geometry/stereo.py", "0.5 * self.baseline_m, 0.0", "-0.5 * self.baseline_m, 0.0"),
    Mutation("geometry/trajectory.py", "poses.positions + quat_rotate(", "poses.positions - quat_rotate("),
    Mutation("metrics/conventions/pose_convention.py", '{"left": 0.5, "right": -0.5}', '{"left": -0.5, "right": 0.5}'),
    Mutation("geometry/extrinsics.py", "Transform(pan @ tilt,", "Transform(tilt @ pan,"),
    # localisation
    Mutation("localisation/findings.py", "inflation |= rule.inflation", "inflation = rule.inflation"),
    Mutation(
        "localisation/ground/evidence.py",
        "self.memory.transfers > 0 and self.memory.may_be_transfer",
        "self.memory.transfers > 0",
    ),
    Mutation(
        "localisation/ground/evidence.py", "self.memory.is_identified and self.two.is_decided", "self.two.is_decided"
    ),
    Mutation("localisation/ground/memory.py", "if self.pairs_left > 1:", "if self.pairs_left > 2:"),
    Mutation(
        "localisation/ground/memory.py",
        "return self if self.is_uncertain else self._in_phase(Phase.LEARNING)",
        "return self._in_phase(Phase.LEARNING)",
    ),
    Mutation("localisation/path.py", "if at_ns <= last_ns:", "if False:"),
    Mutation("localisation/path.py", "(stamp_ns - earlier.stamp_ns) /", "(later.stamp_ns - stamp_ns) /"),
    Mutation(
        "localisation/uncertainty/pose_covariance.py",
        "position - self.turned / self.correlated.radians",
        "position - self.turned",
    ),
    Mutation(
        "localisation/uncertainty/pose_covariance.py",
        "self.of_map(position).covariance + self.this_pair",
        "self.of_map(position).covariance",
    ),
    Mutation("localisation/uncertainty/step_covariance.py", "self.shared_with_next_step + while_kept", "while_kept"),
    Mutation(
        "localisation/uncertainty/step_covariance.py",
        "math.copysign(step.size.metres, step.vector[0])",
        "step.size.metres",
    ),
    Mutation("localisation/frontend/row_search.py", "scores[places - 1 - p]", "scores[p]"),
    Mutation("localisation/frontend/patch_slopes.py", "-pixels.rows[k] * by_x", "pixels.rows[k] * by_x"),
    Mutation("localisation/frontend/feature_detection.py", "mean - np.sqrt(", "mean + np.sqrt("),
    # maps
    Mutation(
        "mapping/mapper.py",
        "warnings=warnings_of_pairs([item.warnings for item in maps]) + fused.warnings",
        "warnings=fused.warnings",
    ),
    Mutation(
        "mapping/pair_view.py",
        "length * depth * depth / scale * sigma_px[i, j]",
        "depth * depth / scale * sigma_px[i, j]",
    ),
    Mutation(EXPOSURE, "(right_high - right_low) / (left_high", "(left_high - left_low) / (left_high"),
    Mutation(
        "mapping/disparity/surfaces.py",
        "surfaces.high[y, u] > disparity[y, x] + SURFACE_JUMP_PX",
        "surfaces.high[y, u] > disparity[y, x]",
    ),
    Mutation(
        "mapping/disparity/refinement/disparity_sigma.py",
        "F(0.125) / np.sqrt(field_information",
        "F(0.25) / np.sqrt(field_information",
    ),
    Mutation(
        "mapping/disparity/refinement/smoothness.py",
        "m1_right[j] - m1[j] - m0_right[j] + m0[j]",
        "m1_right[j] - m1[j] + m0_right[j] - m0[j]",
    ),
    Mutation(
        "mapping/disparity/right_camera/rotation.py",
        "return -px_per_row * rows_below_centre",
        "return px_per_row * rows_below_centre",
    ),
    Mutation(HOLES, "~saturated & has_new_hypotheses & ~after.valid", "has_new_hypotheses & ~after.valid"),
    Mutation(HOLES, "NEARBY_PX) < MAX_DEPTH_RATIO", "NEARBY_PX) < F(100.0) * MAX_DEPTH_RATIO"),
    Mutation(FUSION, "points.xyz + rays * relative_step", "points.xyz - rays * relative_step"),
    Mutation(FUSION, "COMMON_VARIANCE * np.square(sigma) + (1.0", "0.0 * np.square(sigma) + (1.0"),
    Mutation(FUSION, "is_conflict=is_farther & is_preferred", "is_conflict=is_farther"),
    Mutation(FUSION, "AGREE_SIGMAS * difference_sigma)", "-AGREE_SIGMAS * difference_sigma)"),
    Mutation(FUSION, "<= MAX_RANGE_FACTOR * ranges", "<= ranges"),
    Mutation("mapping/multiview/registration.py", "rhs = rhs - weighted.T @ r", "rhs = rhs + weighted.T @ r"),
    Mutation("mapping/multiview/pose_agreement.py", "if index > observer or len(indices)", "if len(indices)"),
    Mutation("mapping/disparity/estimation.py", "px < search.min_disparity_px", "px < 0.5 * search.min_disparity_px"),
    Mutation("mapping/multiview/fixed_content.py", "motion_px > MIN_MOTION_PX", "motion_px < MIN_MOTION_PX"),
    Mutation("mapping/terrain/elevation.py", "z_squared / (x_squared", "x_squared / (x_squared"),
    Mutation(
        "mapping/terrain/elevation.py", "variance_of_points = count / weights", "variance_of_points = 1.0 / weights"
    ),
    Mutation(STEPS, "high - raw.low[i, j] - rise", "high - raw.low[i, j] + rise"),
    Mutation(STEPS, "raw.high[i, j] - low - rise", "raw.high[i, j] - low + rise"),
    Mutation("mapping/terrain/planes.py", "if n < MIN_PLANE_FRACTION * size", "if n < size"),
    Mutation(STEPS, "heights[min(high_rank, last - 1)]", "heights[high_rank]"),
    Mutation("mapping/terrain/planes.py", "cov_xx * cov_yy - cov_xy * cov_xy", "cov_xx * cov_yy"),
    # simulated drives
    Mutation("simulation/drive.py", "grip = 1.0 - min(max(", "grip = 1.0 + min(max("),
    Mutation("simulation/drive.py", "math.copysign(1.0, radius) * angle", "angle"),
    Mutation("simulation/drive.py", "duration_s > LONGEST_S", "duration_s > 100.0 * LONGEST_S"),
    Mutation("simulation/terrain.py", "return -depth * bowl + rim", "return depth * bowl + rim"),
    Mutation("simulation/rocks.py", "bottom * (1 - buried) + top * buried", "top * (1 - buried) + bottom * buried"),
    Mutation("simulation/rocks.py", "found[:, 2] < config.clear_m", "found[:, 2] > config.clear_m"),
    Mutation("simulation/rocks.py", "(1.0 / low - 1.0 / high))", "(1.0 / high - 1.0 / low))"),
    Mutation(
        "simulation/shading.py",
        "level * math.cos(azimuth), level * math.sin(azimuth)",
        "level * math.sin(azimuth), level * math.cos(azimuth)",
    ),
    Mutation("simulation/shading.py", "WALL_SKY + SKY_PER_COSINE * nz", "WALL_SKY - SKY_PER_COSINE * nz"),
    Mutation("simulation/shading.py", "math.exp(-distance / parameters.haze_m)", "math.exp(-distance)"),
    Mutation("simulation/sensor.py", "(0, 0), config.blur_px", "(0, 0), 2.0 * config.blur_px"),
    Mutation("simulation/sensor.py", 'config.gain_mismatch if side == "right" else 0.0', "config.gain_mismatch"),
    Mutation("simulation/tracer.py", "rig.fx * x + rig.cx * depth", "rig.fx * x + 0.5 * (rig.width - 1) * depth"),
    Mutation("simulation/tracer.py", "T_own_ds = T_ds_own.inverse()", "T_own_ds = T_ds_own"),
)


def copied(folder: Path) -> Path:
    """Copy the files that the tests need, and the compiled kernels, to a folder."""
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("*.pyc", ".hypothesis"))
        elif source.exists():
            shutil.copy(source, folder / name)
    return folder


class TestModule(NamedTuple):
    """A test module, its duration, and the lines of the package that it executes, by file below `sfr_loc_map`."""

    path: str
    duration_s: float
    executed: dict[str, frozenset[int]]


def exit_code_of_tests(folder: Path, test_module: str, marks: str, executed_to: Path | None = None) -> int:
    """Return the exit code of pytest in a fork with the libraries loaded; write the executed lines as JSON if asked."""
    child = os.fork()
    if child == 0:
        os.chdir(folder)
        sys.path[:0] = [str(folder), str(folder / "test")]
        os.environ["PYTHONPATH"] = str(folder)  # processes import the copy, too
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 1)
        os.dup2(nothing, 2)
        words = [test_module, "-x", "-q", "-n", "0", "-p", "no:cacheprovider", "-m", marks]
        if executed_to is None:
            os._exit(int(pytest.main(words)))
        coverage = Coverage(data_file=None, source=[str(folder / "sfr_loc_map")])
        with coverage.collect():
            code = int(pytest.main(words))
        data = coverage.get_data()
        executed_to.write_text(json.dumps({file: data.lines(file) for file in data.measured_files()}), encoding="utf-8")
        os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def fails(folder: Path, test_module: str, marks: str) -> bool:
    """Return whether a test of a module fails in a copy of the sources."""
    code = exit_code_of_tests(folder, test_module, marks)
    if code not in (PASSED, FAILED, NO_TESTS):
        raise SystemExit(f"the tests ended with exit code {code}: run pytest {test_module}")
    return code == FAILED


def measured(test_modules: Sequence[str], marks: str) -> list[TestModule]:
    """Run test modules in an unchanged copy of the sources; return their durations and executed lines."""
    found = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = copied(Path(scratch))
        package = folder / "sfr_loc_map"
        executed_to = Path(scratch) / "executed.json"
        for test_module in test_modules:
            begin = time.monotonic()
            if exit_code_of_tests(folder, test_module, marks, executed_to) not in (PASSED, NO_TESTS):
                raise SystemExit(f"a test fails without a mutation: run pytest {test_module}")
            duration_s = time.monotonic() - begin
            lines = json.loads(executed_to.read_text(encoding="utf-8"))
            executed = {str(Path(file).relative_to(package)): frozenset(numbers) for file, numbers in lines.items()}
            found.append(TestModule(test_module, duration_s, executed))
    return found


def nearest_tests(path: str) -> tuple[str, ...]:
    """Return the test modules that are named after a module; these run first, because they most likely fail.

    The tests are in the folder of the module below `test`, or in the folder of a package that contains this folder.
    """
    module = Path(path)
    if module.parts[0] == "methods":
        return OF_METHODS
    packages = module.parents[:-1] or module.parents
    by_folder = (sorted((ROOT / "test" / package).glob(f"test_*{module.stem}*.py")) for package in packages)
    return tuple(str(each.relative_to(ROOT)) for each in next(filter(None, by_folder), []))


def test_modules_of(mutations: Sequence[Mutation]) -> list[str]:
    """Return the test modules that run with any of the mutations."""
    of_all = {str(file.relative_to(ROOT)) for name in TESTS for file in modules_in(ROOT / name)}
    return sorted(of_all.union(*(nearest_tests(item.path) for item in mutations)))


def modules_in(path: Path) -> list[Path]:
    """Return the test modules in a folder, or the module itself."""
    return sorted(path.rglob("test_*.py")) if path.is_dir() else [path]


def mutated_lines(mutation: Mutation) -> range:
    """Return the lines from the begin of the innermost statement with the mutated text to the end of this text."""
    source = (ROOT / "sfr_loc_map" / mutation.path).read_text(encoding="utf-8")
    first = source[: source.index(mutation.text)].count("\n") + 1
    last = first + mutation.text.count("\n")
    statements = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.stmt))
    begins = [node.lineno for node in statements if node.lineno <= first and last <= (node.end_lineno or 0)]
    return range(max(begins, default=first), last + 1)


def in_order(mutation: Mutation, test_modules: Sequence[TestModule]) -> list[str]:
    """Return the test modules for a mutation: first those that execute the mutated lines, nearest and shortest first.

    All other test modules follow, because a test can execute the lines in a process of its own.
    """
    lines = frozenset(mutated_lines(mutation))
    nearest = nearest_tests(mutation.path)

    def rank(item: TestModule) -> tuple[bool, bool, float]:
        is_executed = not lines.isdisjoint(item.executed.get(mutation.path, ()))
        return not is_executed, item.path not in nearest, item.duration_s

    return [item.path for item in sorted(test_modules, key=rank)]


def killer_of(mutation: Mutation, folder: Path, test_modules: Sequence[str], marks: str) -> str | None:
    """Return the first test module that fails with a mutation in a copy of the sources; None if none fails."""
    path = folder / "sfr_loc_map" / mutation.path
    text = path.read_text(encoding="utf-8")
    if text.count(mutation.text) != 1:
        raise SystemExit(f"{mutation.path}: found {text.count(mutation.text)} times, once is required: {mutation.text}")
    path.write_text(text.replace(mutation.text, mutation.instead), encoding="utf-8")
    try:
        return next((each for each in test_modules if fails(folder, each, marks)), None)
    finally:
        path.write_text(text, encoding="utf-8")


def try_all(mutations: Sequence[Mutation], test_modules: Sequence[TestModule], marks: str) -> list[bool]:
    """Return for each mutation whether it is killed, in a separate copy of the sources."""
    killed = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = copied(Path(scratch))
        for mutation in mutations:
            begin = time.monotonic()
            killer = killer_of(mutation, folder, in_order(mutation, test_modules), marks)
            killed.append(killer is not None)
            word = f"killed by {killer}" if killer else "SURVIVED"
            print(f"{time.monotonic() - begin:5.1f} s  {mutation.path}: {mutation.instead}: {word}", flush=True)
    return killed


def main() -> int:
    """Run the tests with each mutation; return 1 if a mutation survives."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("words", nargs="*", help="only mutations whose file or text has one of these words")
    parser.add_argument("--workers", type=int, default=2, help="copies of the sources that are tested concurrently (2)")
    parser.add_argument("--slow", action="store_true", help="also run the slow tests")
    options = parser.parse_args()
    chosen = [
        item
        for item in MUTATIONS
        if not options.words or any(word in f"{item.path} {item.text} {item.instead}" for word in options.words)
    ]
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    sys.dont_write_bytecode = True
    for name in LIBRARIES:
        import_module(name)
    marks = "slow or not slow" if options.slow else "not slow"
    count = options.workers
    paths = test_modules_of(chosen)
    with ProcessPoolExecutor(count, get_context("fork")) as pool:
        shares = [paths[number::count] for number in range(count)]
        test_modules = [each for part in pool.map(partial(measured, marks=marks), shares) for each in part]
        print(f"{len(test_modules)} test modules pass without a mutation", flush=True)
        parts = [chosen[number::count] for number in range(count)]
        trial = partial(try_all, test_modules=test_modules, marks=marks)
        killed = [each for part in pool.map(trial, parts) for each in part]
    print(f"{sum(killed)} of {len(chosen)} mutations killed")
    return 0 if all(killed) else 1


if __name__ == "__main__":
    sys.exit(main())
