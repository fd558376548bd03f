"""Write docs/traceability.md: each clause of the source document, where it is implemented, verified and reported.

What a clause asks and where it is implemented stands here; the tests are found by their marker
`@pytest.mark.clause("4.2.1")`, so that the list cannot go stale. `make traceability` writes the page.
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
        asks: What it asks, in short words.
        modules: Where it is implemented, below `sfr_loc_map/`; empty where it asks nothing of the software.
        report: Where a report shows it.
        note: Why it asks nothing, or what the document leaves open and what was decided, and why.
        reading: How it is read, in a phrase.
        untested: What of it no test shows; empty where the tests show all that it asks.
    """

    number: str
    title: str
    asks: str = ""
    modules: tuple[str, ...] = ()
    report: str = ""
    note: str = ""
    reading: str = "to the letter"
    untested: str = ""


CLAUSES = (
    Clause("1.1", "Purpose", note="Says what the document is for."),
    Clause("1.2", "Scope", note="Names the review that the document supports."),
    Clause(
        "1.3",
        "Terminology",
        "Localisation takes a sequence of stereo pairs and gives the trajectory of the rover; mapping takes up to "
        "three stereo pairs and gives a point cloud.",
        ("localisation/localiser.py", "mapping/mapper.py", "nodes/localisation_node.py", "nodes/mapping_node.py"),
        "all: a score has a part `trajectory` and a part `map`",
        'The mapping API takes up to three pairs and returns one cloud: "up to 3" stands in the definition.',
        "mapping of a set is one call",
    ),
    Clause(
        "2.1",
        "Applicable documents",
        note="A list. The applicable documents were not available: requirements that stand only there are not traced.",
    ),
    Clause("2.2", "Reference documents", note="An empty list."),
    Clause("2.3", "Acronyms and abbreviations", note="A list; the words of the suite are in the glossary."),
    Clause(
        "3.1.1",
        "Quaternions",
        "Four elements, scalar last: q1 i + q2 j + q3 k + q4.",
        ("geometry/rotation.py", "geometry/rotation.py"),
        "not shown; all files and topics are scalar last",
        "Estimates with scalar-first quaternions are reported, and are not judged until they are converted.",
    ),
    Clause(
        "3.1.2",
        "Naming conventions",
        "`rbOriginPos_m_Ds` is the position of the origin of RB in DS; `att_q_DsToRb` turns components in DS into "
        "components in RB.",
        ("geometry/transform.py", "geometry/trajectory.py", "io/tables/trajectory_file.py"),
        "columns of `estimate.csv` and `groundtruth.csv`",
        "It is the conjugate of the orientation in a ROS message; both are converted in one place.",
        "components are turned, not the vector",
    ),
    Clause(
        "3.2.1",
        "Rover Body (RB)",
        "x forward, y left, z up; the ground plane is at z = -540 mm when deployed on flat ground.",
        ("simulation/rover.py",),
        "not shown; it is the frame of all poses",
        "The document calls its definitions TBC. The origin is what the data set says; the simulator uses 540 mm.",
        "origin as the data set has it",
        "That the origin is the centre of the four hold-down mechanisms: a rover's geometry, which is not here.",
    ),
    Clause(
        "3.2.2",
        "Deployable Mast Assembly (DMA)",
        "Base of the mast at x = 0.451 m, y = 0.317 m in RB, axes as RB.",
        ("simulation/rover.py",),
        "not shown",
        "The height is not given in the document and not needed.",
        "as given; height left open",
    ),
    Clause(
        "3.2.3",
        "Stereo Bench (SB)",
        "Origin midway between the optical centres after distortion correction; y to the left camera, x along the left "
        "optical axis normal to y, z up.",
        ("geometry/stereo.py",),
        "not shown",
        "Cameras are rectified, so that both optical axes are parallel and x is along them.",
        "of the rectified cameras",
    ),
    Clause(
        "3.2.4",
        "LOCSB",
        "The stereo bench frame of the localisation cameras.",
        ("geometry/stereo.py", "nodes/input/extrinsics.py"),
        "parameter `T_rb_locsb`, in the provenance",
        "Its pose in RB is the data set's: the document gives none.",
        "as 3.2.3; pose from the data set",
    ),
    Clause(
        "3.2.5",
        "NAVSB",
        "The stereo bench frame of the navigation cameras.",
        ("mapping/mapper.py", "simulation/rover.py"),
        "`nav/pose`, poses in `pairs.csv`",
        "Its pose in LM comes with each pair, as 3.2.6 says.",
        "as 3.2.3; pose with each pair",
    ),
    Clause(
        "3.2.6",
        "Navigation cameras: pan and tilt",
        "Pan about z of RB through (0.451, 0.317) m; tilt axis through (0.451, 0.594) m (x, z), carried by pan.",
        ("simulation/rover.py",),
        "not shown",
        "For reference only, says the document: the data sets hold the pose of NAVSB in LM. The simulator uses it.",
        "reference only; the simulator's mast",
    ),
    Clause(
        "3.2.7.1",
        "Dynamics Simulation frame (DS)",
        "Origin at the centre of the terrain, z up, x east along the grid, y north.",
        ("simulation/terrain.py", "geometry/trajectory.py"),
        "axes of the trajectory figures",
        "The simulator makes its worlds so; of other sources DS is the frame of their truth.",
        "frame of the truth",
        "The origin and the north of a simulated terrain; that the truth of another source has its axes so.",
    ),
    Clause(
        "3.2.7.2",
        "Local Map frame (LM)",
        "The frame in which the terrain around the rover is perceived.",
        ("mapping/reprojection.py", "simulation/world.py"),
        "axes of the map figures",
        "The document leaves its axes open; here z is up.",
        "frame of the mapping truth, z up",
    ),
    Clause(
        "4.1.1",
        "Sub-trajectories",
        "Start at frame N, end when the condition is met; repeat from the next start; a spacing of 10 frames is "
        "recommended; mean, sigma and mean + 3 sigma over all.",
        ("metrics/formulas.py", "metrics/config.py", "metrics/completeness.py"),
        "table of figures: condition and n; What was scored: spacing of the starts; what of the drive is judged",
        '"The conditions associated with the requirement": several may have to hold at once. Frames are true poses '
        "that have an estimate, or images with `--frames images`. Starts go to the end of the trajectory, so that the "
        "whole drive is judged: what is missing is a figure, and a part is incomplete.",
        "several conditions; the whole drive",
    ),
    Clause(
        "4.1.2",
        "Error over a sub-trajectory",
        "The error that the estimate already has at the start does not count.",
        ("metrics/formulas.py", "metrics/config.py"),
        "note below the figures: re-based by; readings side by side",
        '"Taken into account" is not said how. `pose` is the default, since an error of heading from before N is error '
        "from before N. `displacement` is the letter of 4.1.1 and 4.2.3.1. `position` removes only the "
        "position error at N and leaves the attitude error at N in. "
        "All three are computed, and a verdict that depends on the reading is named.",
        "pose by default; displacement, position",
    ),
    Clause("4.1.3", "Standard deviation", "With Bessel's correction.", ("metrics/formulas.py",), "every column sigma"),
    Clause(
        "4.2.1",
        "Timing performance, localisation",
        "Wall-clock seconds on the target from the call of the API to its return, by the mechanism of its kit.",
        ("metrics/call_meter.py", "metrics/calls.py", "runs/calls.py", "metrics/records.py"),
        "table of times per call, under the clock's name; calls on a target in a table of their own",
        "A host time is never one of the target: times measured there are read in (a harness's folder, "
        "`--target-timing`), belong to the estimates of their stamps, and keep the name of their clock.",
        "the clock of the target's harness",
        "A run on a GR740, and the clock of its kit: the harness is run on the host and, big-endian, in an emulator.",
    ),
    Clause(
        "4.2.2",
        "RAM consumption, localisation",
        "The supplier proposes a method.",
        ("metrics/call_meter.py", "metrics/calls.py"),
        "table of peak memory, with the method named",
        "Proposed: the kernel's high-water mark, reset before each call (metrics.md, Time and memory); on "
        "a target painted pages of the stack and a count of the heap. What is not known is empty, never 0.",
        "peak of resident memory in the call",
        "Memory on a GR740; the method is shown by known allocations on the host.",
    ),
    Clause(
        "4.2.3.1",
        "3D position error",
        "Vector of estimated less actual displacement of the RB origin in DS, m. Mean: norm of the mean vector. Sigma: "
        "norm of the standard deviations of the axes.",
        ("metrics/formulas.py", "metrics/trajectory_errors.py"),
        "row position error over ...",
        "The letter is `displacement`: displacements in DS, not turned. With `pose` the estimated displacement is "
        "turned by the attitude error at N before it is compared (4.1.2).",
        "pose by default; letter: displacement",
    ),
    Clause(
        "4.2.3.2",
        "Attitude error",
        "Angle of the shortest rotation between both attitudes, deg, unsigned; mean and standard deviation of it.",
        ("metrics/formulas.py", "metrics/trajectory_errors.py"),
        "row attitude error over ...",
        "From N to N+x the change of attitude counts (4.1.1); `pose` and `displacement` agree in it, `position` "
        "compares attitudes as they are. The scalar part alone loses digits near 0: the vector part is "
        "used with it.",
        "change since N; atan2 in place of acos",
    ),
    Clause(
        "4.2.3.3",
        "Heading error",
        "atan2 of the RB x-axis in DS, deg, signed; abs(mean) + 3 sigma.",
        ("metrics/formulas.py", "metrics/trajectory_errors.py"),
        "row heading error over ...",
        "`displacement` takes the difference of the heading changes, `pose` the heading after re-basing, `position` "
        "the heading as it is; differences are wrapped to (-180, 180] degrees.",
        "pose by default; letter: displacement",
    ),
    Clause(
        "4.3.1",
        "Timing performance, mapping",
        "As 4.2.1.",
        ("metrics/call_meter.py", "metrics/calls.py", "runs/calls.py"),
        "table of times per call: mapping_call; mapping and fusion are its stages",
        "The call takes up to three pairs and returns one cloud (1.3): its time is that of the set.",
        "one call per set of pairs",
        "As 4.2.1: no run on a GR740.",
    ),
    Clause(
        "4.3.2",
        "RAM consumption, mapping",
        "As 4.2.2.",
        ("metrics/call_meter.py", "metrics/calls.py"),
        "table of peak memory: mapping_call",
        "As 4.3.1: of the call that takes the set.",
        "one call per set of pairs",
        "As 4.2.2: no run on a GR740.",
    ),
    Clause("4.3.3", "Mapping accuracy performance", note="A heading; what it asks stands in 4.3.4."),
    Clause(
        "4.3.4",
        "Error in the output point cloud",
        "For each point the norm of its position less the actual one, m.",
        ("metrics/cloud_error.py",),
        "row map: point error; error over the images, over range and in space",
        '"For each point": no nearest neighbour, which reads low. The actual position is the truth of the very pixel '
        "that the point names; points whose pixel has none (sky) are counted, and limited.",
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
            'Each numbered clause of "Clarification of performance metrics for SFR Breadboarding": what it asks, where '
            "it is implemented, how it is read and why, which tests verify it and which part no test covers, and where "
            "the report shows it. The page is made by "
            "`docs/_ext/traceability.py` (`make traceability`) from the markers of the tests; a test keeps it true."
        ),
        "",
        "| clause | title | reading | tests |",
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
        return _wrapped(f"Asks nothing of the software. {clause.note}")
    lines = [*_wrapped(f"**Asks:** {clause.asks}"), "", *_wrapped(f"**Read:** {clause.reading}. {clause.note}"), ""]
    lines += ["Implemented in:", ""]
    lines += [f"- [{module}]({REPOSITORY}sfr_loc_map/{module})" for module in clause.modules]
    lines += ["", "Verified by:", ""]
    for test in tests:
        path, _, name = test.partition("::")
        lines += [f"- [{path}]({REPOSITORY}{path}):", f"  `{name}`"]
    if clause.untested:
        lines += ["", *_wrapped(f"**No test shows:** {clause.untested}")]
    return [*lines, "", *_wrapped(f"**In the report:** {clause.report}.")]


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 116, break_long_words=False, break_on_hyphens=False)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
