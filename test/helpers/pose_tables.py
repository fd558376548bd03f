"""A curved path, and tables of its poses in the formats of other programs."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.rotation import quat_normalised
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.message_stamps import NS_PER_S

COUNT = 60


def drive() -> Trajectory:
    """Return a curve of 12 m with roll, pitch and yaw, at 2 Hz."""
    s = np.linspace(0.0, 12.0, COUNT)
    quats = quat_normalised(np.column_stack((0.05 * np.sin(s), 0.1 * np.cos(s), np.sin(0.15 * s), np.cos(0.15 * s))))
    stamps = 1_700_000_000 * NS_PER_S + np.arange(COUNT, dtype=np.int64) * 500_000_000
    return Trajectory(stamps, np.column_stack((s, 2.0 * np.sin(0.4 * s), 0.1 * s)), quats)


def rows(*columns: object, separator: str = ",", header: str = "") -> str:
    """Return a table of columns, each a list of texts or an array of numbers."""
    texts = []
    for column in columns:
        if isinstance(column, np.ndarray):
            texts += [list(map(repr, part)) for part in np.atleast_2d(column.T).tolist()]
        else:
            texts.append([str(cell) for cell in column])  # type: ignore[attr-defined]
    lines = [separator.join(cells) for cells in zip(*texts, strict=True)]
    return "\n".join([header, *lines] if header else lines) + "\n"


def seconds(poses: Trajectory) -> list[str]:
    """Return the stamps as seconds with nine decimals."""
    return [f"{stamp // NS_PER_S}.{stamp % NS_PER_S:09d}" for stamp in poses.stamps_ns.tolist()]
