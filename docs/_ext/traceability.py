"""Write docs/traceability.md: each clause of the source document, where it is implemented, verified and reported.

This module states what a clause requires and where it is implemented. The tests are found by their marker
`@pytest.mark.clause("4.2.1")`, so that the list stays up to date. `make traceability` writes the page.
"""

from __future__ import annotations

import ast
import textwrap
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "traceability.md"
REPOSITORY = "../"
NOT_SOFTWARE, PARTLY = "no software", " (part of the clause is not tested)"


@dataclass(frozen=True)
class Clause:
    """A numbered clause.

    Attributes:
        number: As in the document.
        title: Its heading.
        asks: Requirement of the clause.
        modules: Modules below `sfr_loc_map/` that implement the clause; empty without a requirement for the software.
        report: Where a report shows the result.
        note: Reason for no requirement, or what the document does not define, the decision, and its reason.
        reading: Interpretation of the clause, in a phrase.
        untested: Part of the requirement that no test verifies; empty if the tests verify all of it.
    """

    number: str
    title: str
    asks: str = ""
    modules: tuple[str, ...] = ()
    report: str = ""
    note: str = ""
    reading: str = "literal"
    untested: str = ""


CLAUSES = (
    Clause("1.1", "Purpose", note="The clause states the purpose of the document."),
    Clause("1.2", "Scope", note="The clause names the review that the document supports."),
    Clause(
        "1.3",
        "Terminology",
        "Localisation estimates the trajectory of the rover from a sequence of stereo pairs. Mapping makes one point "
        "cloud from up to three stereo pairs.",
        ("localisation/localiser.py", "mapping/mapper.py", "nodes/localisation_node.py", "nodes/mapping_node.py"),
        "every table; a score has the subjects `trajectory` and `map`",
        'The definition contains "up to 3". The mapping API therefore takes up to three pairs and returns one cloud.',
        "one mapping call per set of pairs",
    ),
    Clause(
        "2.1",
        "Applicable documents",
        note="A list of documents, which were not available. Requirements that only these documents contain are not "
        "traced.",
    ),
    Clause("2.2", "Reference documents", note="The list is empty."),
    Clause("2.3", "Acronyms and abbreviations", note="A list. The terms of the suite are in the glossary."),
    Clause(
        "3.1.1",
        "Quaternions",
        "Quaternions have four elements, scalar last: q1 i + q2 j + q3 k + q4.",
        ("geometry/rotation.py",),
        "not shown; all files and topics are scalar last",
        "Estimates with scalar-first quaternions are reported, and are judged only after a conversion.",
    ),
    Clause(
        "3.1.2",
        "Naming conventions",
        "`rbOriginPos_m_Ds` is the position of the origin of RB in DS. `att_q_DsToRb` converts components in DS to "
        "components in RB.",
        ("geometry/transform.py", "geometry/trajectory.py", "io/tables/trajectory_file.py"),
        "columns of `estimate.csv` and `groundtruth.csv`",
        "`att_q_DsToRb` and the orientation in a ROS message are conjugates. One module converts between them.",
        "rotation of components, not of the vector",
    ),
    Clause(
        "3.2.1",
        "Rover Body (RB)",
        "x is forward, y left, z up. The ground plane is at z = -540 mm when the rover is deployed on flat ground.",
        ("simulation/rover.py",),
        "not shown; RB is the frame of all poses",
        "The document marks its definitions as TBC. The data set determines the origin; the simulator uses 540 mm.",
        "origin of the data set",
        "Whether the origin is the centre of the four hold-down mechanisms, because the geometry of a real rover is "
        "not available.",
    ),
    Clause(
        "3.2.2",
        "Deployable Mast Assembly (DMA)",
        "The base of the mast is at x = 0.451 m, y = 0.317 m in RB, with the axes of RB.",
        ("simulation/rover.py",),
        "not shown",
        "The document does not give the height of the base, which the suite does not require.",
        "as given, with an undefined height",
    ),
    Clause(
        "3.2.3",
        "Stereo Bench (SB)",
        "The origin is midway between the optical centres after distortion correction. y points to the left camera, x "
        "along the left optical axis normal to y, z up.",
        ("geometry/stereo.py",),
        "not shown",
        "Cameras are rectified, so that both optical axes are parallel and x is along them.",
        "frame of the rectified cameras",
    ),
    Clause(
        "3.2.4",
        "LOCSB",
        "The stereo bench frame of the localisation cameras.",
        ("geometry/stereo.py", "nodes/localisation/extrinsics.py"),
        "parameter `T_rb_locsb`, in the provenance",
        "The document does not give the pose of this frame in RB. The pose is part of the data set.",
        "as 3.2.3; pose from the data set",
    ),
    Clause(
        "3.2.5",
        "NAVSB",
        "The stereo bench frame of the navigation cameras.",
        ("mapping/mapper.py", "simulation/rover.py"),
        "`nav/pose`, poses in `pairs.csv`",
        "Each pair has the pose of NAVSB in LM, as 3.2.6 requires.",
        "as 3.2.3; pose with each pair",
    ),
    Clause(
        "3.2.6",
        "Navigation cameras: pan and tilt",
        "Pan is about z of RB through (0.451, 0.317) m. The tilt axis, through (0.451, 0.594) m (x, z), turns with the "
        "pan.",
        ("simulation/rover.py",),
        "not shown",
        "The clause is for reference only, because the data sets contain the pose of NAVSB in LM. The simulator uses "
        "these axes.",
        "reference only; mast of the simulator",
    ),
    Clause(
        "3.2.7.1",
        "Dynamics Simulation frame (DS)",
        "The origin is at the centre of the terrain, with z up, x east along the grid, and y north.",
        ("simulation/terrain.py", "geometry/trajectory.py"),
        "axes of the trajectory figures",
        "The simulator uses this frame. For all other sources, DS is the frame of their ground truth.",
        "frame of the ground truth",
        "The origin and the north direction of a simulated terrain, and the axes of the ground truth of other sources.",
    ),
    Clause(
        "3.2.7.2",
        "Local Map frame (LM)",
        "The frame in which the terrain around the rover is perceived.",
        ("mapping/pair_view.py", "simulation/world.py"),
        "axes of the map figures",
        "The document does not define the axes. In this suite z is up.",
        "frame of the mapping truth, z up",
    ),
    Clause(
        "4.1.1",
        "Sub-trajectories",
        "A sub-trajectory starts at frame N and ends when the condition is met. Further sub-trajectories start at "
        "later frames, for which a spacing of 10 frames is recommended. Mean, sigma and mean + 3 sigma are computed "
        "over all sub-trajectories.",
        ("metrics/formulas.py", "metrics/conditions.py", "metrics/completeness/drive.py"),
        "table of figures: condition and n; what was scored: spacing of the starts; what of the drive is judged",
        'The text "the conditions associated with the requirement" allows several conditions, which must then hold '
        "together. Frames are true poses that have an estimate, or images with `--frames images`. Starts continue to "
        "the end of the trajectory, so that the complete drive is judged. Missing parts are reported as figures, and "
        "an estimate of a part is incomplete.",
        "several conditions; the complete drive",
    ),
    Clause(
        "4.1.2",
        "Error over a sub-trajectory",
        "The error that the estimate already has at the start does not count.",
        ("metrics/formulas.py", "metrics/config.py"),
        "the note 're-based by ...' below the figures, and the verdicts of the interpretations side by side",
        'The document does not define how the error is "taken into account". `pose` is the default, because a heading '
        "error that exists at N is part of the error at the start. `displacement` follows 4.1.1 and 4.2.3.1 literally. "
        "`position` removes the position error at N, but not the attitude error at N. All three interpretations are "
        "computed, and a verdict that depends on the interpretation is reported.",
        "pose by default; displacement, position",
    ),
    Clause(
        "4.1.3",
        "Standard deviation",
        "The standard deviation has Bessel's correction.",
        ("metrics/formulas.py",),
        "every column sigma",
    ),
    Clause(
        "4.2.1",
        "Timing performance, localisation",
        "Wall-clock seconds on the target from the call of the API to its return, measured by the mechanism of the "
        "development kit of the target.",
        (
            "metrics/calls/call_meter.py",
            "metrics/calls/call_score.py",
            "calls/call_record.py",
            "metrics/figures/records.py",
        ),
        "table of times per call, with the name of the clock; calls on a target in a separate table",
        "A time of the host is never reported as a time of the target. Times that were measured on a target are "
        "imported (the folder of a harness, `--target-timing`), assigned to the estimates by their stamps, and keep "
        "the name of their clock.",
        "clock of the target's harness",
        "A run on a GR740, and the clock of its development kit. The harness is run on the host and in a big-endian "
        "emulator.",
    ),
    Clause(
        "4.2.2",
        "RAM consumption, localisation",
        "The supplier proposes a method.",
        ("metrics/calls/call_meter.py", "metrics/calls/call_score.py"),
        "table of peak memory, with the name of the method",
        "The proposed method is the kernel's high-water mark, which is reset before each call (metrics.md, Time and "
        "memory). On a target, the method is a painted stack and a count of the heap. An unknown value is empty, "
        "never 0.",
        "peak of resident memory in the call",
        "Memory on a GR740. Known allocations on the host verify the method.",
    ),
    Clause(
        "4.2.3.1",
        "3D position error",
        "The error is the vector of the estimated minus the actual displacement of the RB origin in DS, m. The mean is "
        "the norm of the mean vector. Sigma is the norm of the standard deviations of the axes.",
        ("metrics/formulas.py", "metrics/trajectory/trajectory_errors.py"),
        "row position error over a condition",
        "The literal interpretation is `displacement`: displacements in DS without a rotation. With `pose`, the "
        "attitude error at N is removed from the estimated displacement before the comparison (4.1.2).",
        "pose by default; displacement is literal",
    ),
    Clause(
        "4.2.3.2",
        "Attitude error",
        "The error is the unsigned angle of the shortest rotation between both attitudes, deg, with its mean and "
        "standard deviation.",
        ("metrics/formulas.py", "metrics/trajectory/trajectory_errors.py"),
        "row attitude error over a condition",
        "The change of attitude from N to N+x counts (4.1.1). `pose` and `displacement` give the same error, and "
        "`position` compares the attitudes directly. The angle is computed by atan2 from the vector part and the "
        "scalar part, because the scalar part alone is inaccurate near 0.",
        "change since N; atan2 instead of acos",
    ),
    Clause(
        "4.2.3.3",
        "Heading error",
        "The heading is atan2 of the RB x-axis in DS. The error is signed, deg, and the figure is abs(mean) + 3 sigma.",
        ("metrics/formulas.py", "metrics/trajectory/trajectory_errors.py"),
        "row heading error over a condition",
        "`displacement` compares the changes of heading, `pose` the heading after re-basing, and `position` the "
        "heading itself. Differences are wrapped to (-180, 180] degrees.",
        "pose by default; displacement is literal",
    ),
    Clause(
        "4.3.1",
        "Timing performance, mapping",
        "As 4.2.1.",
        ("metrics/calls/call_meter.py", "metrics/calls/call_score.py", "calls/call_record.py"),
        "table of times per call: mapping_call; mapping and fusion are its stages",
        "The call takes up to three pairs and returns one cloud (1.3). The time of the call is the time for the set.",
        "one call per set of pairs",
        "As for 4.2.1: a run on a GR740.",
    ),
    Clause(
        "4.3.2",
        "RAM consumption, mapping",
        "As 4.2.2.",
        ("metrics/calls/call_meter.py", "metrics/calls/call_score.py"),
        "table of peak memory: mapping_call",
        "As for 4.3.1, the call takes the complete set of pairs.",
        "one call per set of pairs",
        "As for 4.2.2: a run on a GR740.",
    ),
    Clause("4.3.3", "Mapping accuracy performance", note="The clause is a heading of 4.3.4."),
    Clause(
        "4.3.4",
        "Error in the output point cloud",
        "For each point, the error is the norm of the difference of its estimated and its actual position, m.",
        ("metrics/map/point_errors.py", "metrics/map/map_score.py"),
        "row map: point error; error over the images, over range and in space",
        'The text requires an error "for each point". The nearest true point is therefore not used, because the '
        "distance to it is smaller than the error. The actual position is the truth of the pixel that the point names. "
        "Points whose pixel has no truth (sky) are counted, and their fraction can be limited.",
        "truth of the point's own pixel",
    ),
)


def verifications() -> dict[str, list[str]]:
    """Return the tests of each clause, `path::name`, by their markers."""
    found: dict[str, list[str]] = {}
    for path in sorted((ROOT / "test").rglob("test_*.py")):
        text = path.read_text(encoding="utf-8")
        if "mark.clause" not in text:
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                for number in _clauses_of(node):
                    found.setdefault(number, []).append(f"{path.relative_to(ROOT)}::{node.name}")
    return found


def _clauses_of(node: ast.FunctionDef) -> list[str]:
    calls = [mark for mark in node.decorator_list if isinstance(mark, ast.Call) and _is_clause(mark.func)]
    return [ast.literal_eval(argument) for call in calls for argument in call.args]


def _is_clause(function: ast.expr) -> bool:
    return isinstance(function, ast.Attribute) and function.attr == "clause"


def page() -> str:
    """Return the page."""
    tests = verifications()
    lines = [
        "# Traceability",
        "",
        *_wrapped(
            'This page lists each numbered clause of "Clarification of performance metrics for SFR Breadboarding", '
            "with its requirement, its interpretation and the reasons, the modules that implement it, the tests that "
            "verify it, the part that no test verifies, and its place in the report. `docs/_ext/traceability.py` "
            "(`make traceability`) writes the page from the markers of the tests. A test checks that the page is up to "
            "date."
        ),
        "",
        "| clause | title | interpretation | tests |",
        "|---|---|---|---|",
        *(
            f"| {clause.number} | {clause.title} | {clause.reading if clause.modules else '-'} | "
            f"{len(tests.get(clause.number, [])) or NOT_SOFTWARE}{PARTLY * bool(clause.untested)} |"
            for clause in CLAUSES
        ),
    ]
    for clause in CLAUSES:
        lines += ["", f"## {clause.number} {clause.title}", "", *_section(clause, tests.get(clause.number, []))]
    return "\n".join(lines) + "\n"


def _section(clause: Clause, tests: list[str]) -> list[str]:
    if not clause.modules:
        return _wrapped(f"No requirement for the software. {clause.note}")
    read = f" ({clause.reading}): {clause.note}" if clause.note else f": {clause.reading}."
    lines = [*_wrapped(f"**Requirement:** {clause.asks}"), "", *_wrapped(f"**Interpretation**{read}"), ""]
    lines += ["Implemented in:", ""]
    lines += [f"- [{module}]({REPOSITORY}sfr_loc_map/{module})" for module in clause.modules]
    lines += ["", "Verified by:", ""]
    for test in tests:
        path, _, name = test.partition("::")
        lines += [f"- [{path}]({REPOSITORY}{path}):", f"  `{name}`"]
    if clause.untested:
        lines += ["", *_wrapped(f"**Not tested:** {clause.untested}")]
    return [*lines, "", *_wrapped(f"**In the report:** {clause.report}.")]


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 116, break_long_words=False, break_on_hyphens=False)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
