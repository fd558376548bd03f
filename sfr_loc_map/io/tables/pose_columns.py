"""The columns of stamps, positions and attitudes in a text table, with their units."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import partial

from sfr_loc_map.io.tables.length_units import METRES
from sfr_loc_map.io.tables.stamps import TIMES, UTC_UNIT, parse_decimal, parse_nanoseconds, parse_seconds, parse_utc
from sfr_loc_map.message_stamps import NS_PER_S

STAMP, SECONDS, NANOSECONDS, FRAME = "t", "sec", "nsec", "frame"
POSITION = ("x", "y", "z")
QUATERNION = ("qx", "qy", "qz", "qw")
SCALAR_FIRST = ("qw", "qx", "qy", "qz")
MATRIX = tuple(f"m{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3, 4))
LAST_ROW = ("m41", "m42", "m43", "m44")  #: Column names of the last row of a 4 x 4 matrix, whose values are 0, 0, 0, 1.
DOWN = "down"  #: A height that is positive downwards; z is its negative.
COVARIANCES = {
    "Pr": ("attitude", ("11", "12", "13", "22", "23", "33")),
    "Pt": ("position", ("11", "12", "13", "22", "23", "33")),
}
"""Covariance columns of OpenVINS: upper triangles in rad^2 and m^2 (docs.openvins.com, "Filesystem format")."""
COVARIANCE_KEYS = tuple(f"{prefix}{index}" for prefix, (_, indices) in COVARIANCES.items() for index in indices)
CSV_HEADER = "stamp_ns,rbOriginPos_m_Ds_x,rbOriginPos_m_Ds_y,rbOriginPos_m_Ds_z," + ",".join(
    f"att_q_DsToRb_{i}" for i in (1, 2, 3, 4)
)
"""Header of the csv of the suite."""
KITTI_COLUMNS = 12  #: Number of columns of a pose of KITTI: a 3 x 4 matrix.


class TrajectoryFormat(StrEnum):
    """The formats of trajectory files."""

    CSV = "csv"
    TUM = "tum"
    KITTI = "kitti"
    EUROC = "euroc"
    COLUMNS = "columns"
    MATRIX = "matrix"


_ORDERS = (
    (TrajectoryFormat.CSV, (STAMP, *POSITION, *QUATERNION), (",", ";", "\t")),
    (TrajectoryFormat.EUROC, (STAMP, *POSITION, *SCALAR_FIRST), (",",)),
    (TrajectoryFormat.TUM, (STAMP, *POSITION, *QUATERNION), (None, "\t")),
)
"""First columns and separators of the formats without matrices."""


@dataclass(frozen=True, slots=True)
class PoseColumns:
    """The columns that are read, and their content."""

    name: str  #: Name of the layout in messages.
    separator: str | None  #: None: spaces.
    index_of: Mapping[str, int]  #: Column of each key, from 0.
    units: Mapping[str, str]  #: Unit of each key, if the header or `--columns` gives a unit.
    width: int  #: Number of columns.
    skip: int = 0  #: Number of lines before the first row.
    by_header: bool = False  #: Whether a header, `--columns` or `truth.columns` names the columns.
    ignored: tuple[str, ...] = ()  #: Names of columns that are not read.
    inferred: str = ""  #: Unit of the stamps if it was inferred from their magnitude.
    states_time_unit: bool = False  #: Whether the header or `--columns` states the unit of the stamps.
    is_conjugated: bool = False  #: Whether the quaternions are `att_q_DsToRb`, the conjugates of those in ROS messages.

    def __contains__(self, key: str) -> bool:
        return key in self.index_of

    @property
    def format(self) -> TrajectoryFormat:
        """The format with these columns, with or without a header; COLUMNS if the format has no name of its own."""
        if self.is_matrix:
            return TrajectoryFormat.KITTI if self.stamp_key is None else TrajectoryFormat.MATRIX
        for known, order, separators in _ORDERS:
            if known is TrajectoryFormat.EUROC and self.units.get(STAMP, "ns") != "ns":
                continue
            if self.is_conjugated != (known is TrajectoryFormat.CSV):
                continue
            if self.separator in separators and all(self.index_of.get(key) == k for k, key in enumerate(order)):
                return known
        return TrajectoryFormat.COLUMNS

    @property
    def allows_more(self) -> bool:
        """Whether rows may have more columns than those that are read, as those with a header or without some columns.

        Rows of the csv of the suite have exactly the columns of its header.
        """
        if self.format is TrajectoryFormat.CSV and not self.ignored:
            return False
        read = [*(() if self.stamp_key is None else (self.stamp_key,)), *self.value_keys]
        return self.by_header or [self.index_of[key] for key in read] != list(range(self.width))

    @property
    def position_keys(self) -> tuple[str, ...]:
        """The three columns of the position."""
        return POSITION if "z" in self.index_of else ("x", "y", DOWN)

    @property
    def is_matrix(self) -> bool:
        """Whether the poses are 3 x 4 matrices."""
        return MATRIX[0] in self.index_of

    @property
    def stamp_key(self) -> str | None:
        """The column of the stamp or of the frame number; None if lines have neither."""
        return next((key for key in (STAMP, SECONDS, FRAME) if key in self.index_of), None)

    @property
    def has_covariance(self) -> bool:
        """Whether the columns contain a complete covariance."""
        return all(key in self.index_of for key in COVARIANCE_KEYS)

    @property
    def value_keys(self) -> list[str]:
        """The columns of numbers other than the stamp."""
        attitude = tuple(key for key in QUATERNION if key in self.index_of)
        pose = MATRIX if self.is_matrix else (*self.position_keys, *attitude)
        fraction = (NANOSECONDS,) if NANOSECONDS in self.index_of else ()
        covariances = COVARIANCE_KEYS if self.has_covariance else ()
        return [*pose, *fraction, *covariances]

    @property
    def fraction_ns(self) -> int:
        """Unit of the column `nsec`, ns."""
        return TIMES[self.units.get(NANOSECONDS, "ns")]

    @property
    def scales(self) -> list[float]:
        """Factors that convert the columns of the position to metres."""
        return [METRES[self.units.get(key, "")] * (-1.0 if key == DOWN else 1.0) for key in self.position_keys]

    @property
    def length_units(self) -> tuple[str, ...]:
        """The units of the columns of the position, without repetition, if one of them is not the metre."""
        units = tuple(dict.fromkeys(self.units.get(key) or "m" for key in self.position_keys))
        return () if units == ("m",) else units

    @property
    def small_unit(self) -> str:
        """A unit below a metre that a column of the position has; empty if there is none."""
        units = (self.units.get(key, "") for key in self.position_keys)
        return next((unit for unit in units if METRES[unit] < 1.0), "")

    def stamp_parser(self) -> Callable[[str], int]:
        """Return the function that converts the text of a stamp to nanoseconds."""
        key = SECONDS if self.stamp_key == SECONDS else STAMP
        unit = self.units.get(key, "s")
        if unit == UTC_UNIT:
            return parse_utc
        unit_ns = TIMES[unit]
        if unit_ns == NS_PER_S:
            return parse_seconds
        return parse_nanoseconds if unit_ns == 1 else partial(parse_decimal, unit_ns=unit_ns)
