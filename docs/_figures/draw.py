"""Draw the figures of the concept pages and write the table of the worked example: `make figures`.

The numbers are computed by the functions that score a drive.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
mpl.rcParams |= {"svg.hashsalt": "sfr_loc_map", "font.size": 9, "axes.spines.top": False, "axes.spines.right": False}

from matplotlib import pyplot as plt  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from scipy.stats import chi2  # noqa: E402

import sfr_loc_map as sfr  # noqa: E402
from sfr_loc_map.geometry import Transform  # noqa: E402

DOCS = Path(__file__).resolve().parents[1]
IMAGES = DOCS / "images" / "concepts"
TRUE, ESTIMATE, ERROR = "#333333", "#1f6fb4", "#c0392b"
STEP_M, LENGTH_M, DRIFT_DEG_PER_M = 0.1, 12.0, 0.5


def example_drive() -> tuple[sfr.Trajectory, sfr.Trajectory]:
    """Return the truth of a curved drive of 12 m, and an estimate whose heading drifts."""
    along = np.arange(0.0, LENGTH_M + STEP_M / 2, STEP_M)
    heading = 0.6 * np.sin(along / 4.0)
    made = []
    for turn in (heading, heading + np.deg2rad(DRIFT_DEG_PER_M * along + 0.6 * np.sin(along))):
        steps = STEP_M * np.column_stack((np.cos(turn), np.sin(turn), np.zeros(len(turn))))
        positions = np.vstack((np.zeros(3), np.cumsum(steps[:-1], axis=0)))
        quats = np.column_stack((np.zeros((len(turn), 2)), np.sin(turn / 2), np.cos(turn / 2)))
        made.append(sfr.Trajectory((along / STEP_M * 1e8).astype(np.int64), positions, quats))
    return made[0], made[1]


def rebased(truth: sfr.Trajectory, estimate: sfr.Trajectory, start: int) -> sfr.Trajectory:
    """Return the estimate moved onto the truth at a start."""

    def pose(of: sfr.Trajectory, index: int) -> Transform:
        return Transform.from_quat(of.positions[index], of.quats_xyzw[index])

    correction = pose(truth, start) @ pose(estimate, start).inverse()
    moved = [correction @ pose(estimate, i) for i in range(len(estimate.stamps_ns))]
    return sfr.Trajectory(
        estimate.stamps_ns, np.array([t.translation for t in moved]), np.array([t.quat_xyzw for t in moved])
    )


def _save(figure: Figure, name: str) -> None:
    figure.savefig(IMAGES / f"{name}.svg", facecolor="white", metadata={"Date": None, "Creator": None})
    plt.close(figure)


def _path(axes: Axes, positions: np.ndarray, colour: str, label: str, **style: float | str) -> None:
    axes.plot(positions[:, 0], positions[:, 1], color=colour, label=label, **style)
    axes.set_aspect("equal")
    axes.set_xlabel("x of DS, m")


def draw_rebasing() -> None:
    """Draw the drive, one piece of it before re-basing, and the same piece after it."""
    truth, estimate = example_drive()
    start, end = 60, 110
    figure, panels = plt.subplots(1, 3, figsize=(10.5, 2.9), layout="constrained")
    _path(panels[0], truth.positions, TRUE, "truth")
    _path(panels[0], estimate.positions, ESTIMATE, "estimate")
    for number in range(0, len(truth.stamps_ns) - 50, 10):
        panels[0].plot(*truth.positions[number, :2], "o", color=TRUE, ms=3)
    panels[0].set_title("12 m drive, dots: starts of pieces of 5 m")
    panels[0].set_ylabel("y of DS, m")
    for axes, positions, title in (
        (panels[1], estimate.positions, "one piece, as estimated"),
        (panels[2], rebased(truth, estimate, start).positions, "the same, re-based at N"),
    ):
        piece = slice(start, end + 1)
        _path(axes, truth.positions[piece], TRUE, "truth")
        _path(axes, positions[piece], ESTIMATE, "estimate")
        for index, name in ((start, "N"), (end, "N+x")):
            axes.plot(*truth.positions[index, :2], "o", color=TRUE, ms=4)
            axes.annotate(name, truth.positions[index, :2], xytext=(-4, -13), textcoords="offset points")
        axes.annotate(
            "", positions[end, :2], truth.positions[end, :2], arrowprops={"arrowstyle": "->", "color": ERROR, "lw": 1.5}
        )
        error = np.linalg.norm(positions[end] - truth.positions[end])
        axes.set_title(f"{title}: error {error:.2f} m", color=ERROR)
    panels[0].legend(frameon=False, loc="upper left")
    _save(figure, "rebasing")


def example_table() -> str:
    """Return the table of the worked example."""
    truth, estimate = example_drive()
    score = sfr.score(estimate, truth, ["distance=5"])
    end = float(np.linalg.norm(estimate.positions[-1] - truth.positions[-1]))
    rows = ["| figure | mean | sigma | mean + 3 sigma |", "|---|---|---|---|"]
    for name, unit, digits in (("position", "m", 3), ("attitude", "deg", 2), ("heading", "deg", 2)):
        values = [score.number(name, statistic) for statistic in ("mean", "sigma", "mean_plus_3sigma")]
        rows.append(f"| {name}, {unit} | " + " | ".join(f"{value or 0.0:.{digits}f}" for value in values) + " |")
    return "\n".join(
        [
            *rows,
            "",
            f"{score.number('position', 'n')} sub-trajectories of 5 m; "
            f"the error at the end of the drive is {end:.2f} m.",
        ]
    )


def draw_interval() -> None:
    """Draw how sub-trajectories overlap, and blocks of them."""
    figure, axes = plt.subplots(figsize=(8, 3.0), layout="constrained")
    for row, start in enumerate(np.arange(0.0, 15.1, 1.0)):
        colour = ESTIMATE if row % 5 else ERROR
        axes.plot((start, start + 5.0), (row, row), color=colour, lw=2.5, solid_capstyle="butt")
    for first in (0, 5, 10):
        axes.axhspan(first - 0.5, first + 4.5, color="#000000", alpha=0.05 if first != 5 else 0.12)
        axes.text(20.3, first + 2, f"block {first // 5 + 1}", va="center")
    axes.set_xlim(0, 22)
    axes.set_xlabel("distance travelled, m")
    axes.set_ylabel("sub-trajectory")
    axes.set_title("Pieces of 5 m, one start each metre (L = 5): only the red ones share no ground")
    _save(figure, "interval")


def draw_nees() -> None:
    """Draw the mean NEES that a covariance gives, by how wrong it is."""
    wrong = np.linspace(0.5, 2.0, 200)
    figure, axes = plt.subplots(figsize=(7, 3.0), layout="constrained")
    axes.plot(wrong, 6.0 / wrong**2, color=ESTIMATE, label="expected mean NEES, 6 components")
    for count, alpha in ((10, 0.12), (100, 0.3)):
        low, high = (chi2.ppf(p, 6 * count) / count for p in (0.025, 0.975))
        axes.axhspan(low, high, color=TRUE, alpha=alpha, label=f"honest: 95 % interval, n = {count}", lw=0)
    axes.set_yscale("log")
    axes.set_yticks([2, 6, 20], ["2", "6", "20"])
    axes.minorticks_off()
    axes.set_xlabel("stated standard deviation over the true one")
    axes.legend(frameon=False)
    _save(figure, "nees")


def draw_triangulation() -> None:
    """Draw the law of triangulation."""
    depth = np.linspace(1.0, 20.0, 100)
    figure, axes = plt.subplots(figsize=(7, 3.0), layout="constrained")
    for disparity_px, colour in ((0.05, "#88b7dd"), (0.1, ESTIMATE), (0.2, "#0c3a63")):
        axes.plot(depth, 1e3 * depth**2 / 121.0 * disparity_px, color=colour, label=f"{disparity_px} px")
    axes.set_xlabel("depth Z, m")
    axes.set_ylabel("error along the ray, mm")
    axes.set_title("Z² d / (f b) with f b = 121 px m")
    axes.legend(frameon=False, title="error of disparity")
    _save(figure, "triangulation")


def draw_frames() -> None:
    """Draw RB, the stereo rig and the left optical frame from the side."""
    figure, axes = plt.subplots(figsize=(8, 3.4), layout="constrained")
    axes.axhline(-0.54, color="#8d6e4f", lw=3)
    axes.text(-0.9, -0.62, "ground, z = -0.540 m in RB", va="top")
    axes.add_patch(plt.Rectangle((-0.45, -0.12), 0.9, 0.24, fc="#eeeeee", ec="#bbbbbb"))
    for x in (-0.55, 0.0, 0.55):
        axes.add_patch(plt.Circle((x, -0.4), 0.14, fc="#dddddd", ec="#bbbbbb"))
    pitch = np.deg2rad(19.0)
    forward, up = np.array([np.cos(pitch), -np.sin(pitch)]), np.array([np.sin(pitch), np.cos(pitch)])
    for origin, first, second, names in (
        (np.zeros(2), np.array([1.0, 0.0]), np.array([0.0, 1.0]), ("RB", "x", "z")),
        (np.array([0.52, 0.63]), forward, up, ("LOCSB", "x", "z")),
        (np.array([1.55, 0.28]), forward, -up, ("left optical", "z", "y")),
    ):
        for axis, name in ((first, names[1]), (second, names[2])):
            axes.annotate(
                "", origin + 0.32 * axis, origin, arrowprops={"arrowstyle": "->", "lw": 1.6, "color": ESTIMATE}
            )
            axes.text(*(origin + 0.38 * axis), name, color=ESTIMATE, ha="center", va="center")
        axes.plot(*origin, "o", color=TRUE, ms=4)
        axes.text(*(origin + np.array([-0.06, 0.05])), names[0], ha="right", fontweight="bold")
    axes.plot((0.0, 0.52), (0.0, 0.63), ":", color=ERROR)
    axes.text(0.36, 0.32, "T_rb_locsb", color=ERROR)
    axes.set_xlim(-1.0, 2.2)
    axes.set_ylim(-0.75, 1.1)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.text(
        1.0,
        0.9,
        "from the right side of the rover:\ny of RB and LOCSB points away;\nthe left optical frame is drawn apart",
        va="top",
    )
    _save(figure, "frames")


def main() -> None:
    """Draw all figures, and write the table into its page."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    for draw in (draw_rebasing, draw_interval, draw_nees, draw_triangulation, draw_frames):
        draw()
    page = DOCS / "concepts" / "sub_trajectories.md"
    begin, end = "<!-- made by docs/_figures/draw.py -->\n", "<!-- end -->"
    before, _, rest = page.read_text(encoding="utf-8").partition(begin)
    page.write_text(f"{before}{begin}\n{example_table()}\n\n{end}{rest.partition(end)[2]}", encoding="utf-8")


if __name__ == "__main__":
    main()
