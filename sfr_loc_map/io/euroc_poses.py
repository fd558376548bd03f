"""Poses as the EuRoC MAV data sets write them: `data.csv` of a state estimate (Burri et al. 2016).

    #timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], ...

Stamps are nanoseconds, quaternions scalar first; velocities and biases after them are left out. The body S is RB, the
world R is DS.
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.plausibility import plausible_positions, plausible_quats
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.text_numbers import parse_stamp_ns
from sfr_loc_map.io.text_rows import number_rows, rows_of

HEADER = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
COLUMNS = 8


def parse_euroc_poses(data: bytes, name: str) -> Trajectory:
    """Return the poses of a text.

    Args:
        data: The text.
        name: Its name, for messages.

    Raises:
        InputError: If a line is no pose; names the line.
    """
    numbers, lines = number_rows(data, COLUMNS, name, "timestamp [ns], p_x, p_y, p_z, q_w, q_x, q_y, q_z", ",")
    stamps = []
    for row, line in zip(rows_of(data)[0], lines, strict=True):
        word = row.split(b",", 1)[0].decode("utf-8", "replace")
        try:
            stamps.append(parse_stamp_ns(word))
        except ValueError as error:
            raise InputError(f"{name} line {line}: stamp '{word[:40]}' is not whole nanoseconds") from error
    positions, quats = numbers[:, 1:4].copy(), numbers[:, [5, 6, 7, 4]]
    good = plausible_positions(positions) & plausible_quats(quats)
    if not good.all():
        line = lines[int(np.argmin(good))]
        raise InputError(f"{name} line {line}: this is no position and unit quaternion; correct or leave out the line")
    return Trajectory(np.array(stamps, np.int64), positions, quats)


def euroc_text(trajectory: Trajectory) -> str:
    """Return poses as a EuRoC csv; numbers read back to the same bits."""
    numbers = np.hstack((trajectory.positions, trajectory.quats_xyzw[:, [3, 0, 1, 2]])).tolist()
    stamps = trajectory.stamps_ns.tolist()
    rows = [f"{stamp_ns},{','.join(map(repr, row))}" for stamp_ns, row in zip(stamps, numbers, strict=True)]
    return "\n".join([HEADER, *rows]) + "\n"
