"""The columns of stamps, positions and attitudes in a text table, and the format that they have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.io.stamps.stamp_text import TIMES, StampParser
from sfr_loc_map.io.stamps.time_units import UnitOrigin
from sfr_loc_map.io.tables.length_units import METRES
from sfr_loc_map.io.tables.text_table import RowForm

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


_ORDERS = {
    TrajectoryFormat.CSV: ((STAMP, *POSITION, *QUATERNION), (",", ";", "\t")),
    TrajectoryFormat.EUROC: ((STAMP, *POSITION, *SCALAR_FIRST), (",",)),
    TrajectoryFormat.TUM: ((STAMP, *POSITION, *QUATERNION), (None, "\t")),
}
"""First columns and separators of the formats without matrices."""


@dataclass(frozen=True, slots=True)
class PoseColumns:
    """The columns of a table that are read as poses, as the user, a header or a layout states them.

    `column_detection` refuses columns that are incomplete or have unsupported units, and adds the unit of the stamps.
    """

    name: str  #: Name of the columns in messages.
    separator: str | None  #: Separator of the cells; None: spaces.
    skip: int  #: Number of lines before the first row.
    width: int  #: Number of columns.
    index_of: Mapping[str, int]  #: Column of each key, from 0.
    units: Mapping[str, str]  #: Unit of each key that has one.
    are_named: bool  #: Whether a header or the user names the columns; otherwise they are those of a layout.
    ignored: tuple[str, ...] = ()  #: Names of columns that are not read.
    is_conjugated: bool = False  #: Whether the quaternions are `att_q_DsToRb`, the conjugates of those in ROS messages.
    unit_origin: UnitOrigin | None = None  #: Origin of the unit of the column `t`; None without this column.

    def __contains__(self, key: str) -> bool:
        return key in self.index_of

    def has_order_of(self, known: TrajectoryFormat) -> bool:
        """Return whether separator, first columns and quaternion convention are those of a format without matrices.

        Units are not compared.
        """
        order, separators = _ORDERS[known]
        if self.is_conjugated != (known is TrajectoryFormat.CSV) or self.separator not in separators:
            return False
        return all(self.index_of.get(key) == index for index, key in enumerate(order))

    @property
    def is_matrix(self) -> bool:
        """Whether the poses are 3 x 4 matrices."""
        return MATRIX[0] in self.index_of

    @property
    def position_keys(self) -> tuple[str, ...]:
        """The three columns of the position."""
        return POSITION if "z" in self.index_of else ("x", "y", DOWN)

    @property
    def stamp_key(self) -> str | None:
        """The column of the stamp, or of its whole seconds; None if the rows have no stamps."""
        return next((key for key in (STAMP, SECONDS) if key in self.index_of), None)

    @property
    def has_covariance(self) -> bool:
        """Whether the columns contain a complete covariance."""
        return all(key in self.index_of for key in COVARIANCE_KEYS)

    @property
    def value_keys(self) -> tuple[str, ...]:
        """The columns that are read as numbers: all but the stamp."""
        frame = (FRAME,) if FRAME in self.index_of and self.stamp_key is None else ()
        attitude = tuple(key for key in QUATERNION if key in self.index_of)
        pose = MATRIX if self.is_matrix else (*self.position_keys, *attitude)
        fraction = (NANOSECONDS,) if NANOSECONDS in self.index_of else ()
        covariances = COVARIANCE_KEYS if self.has_covariance else ()
        return (*frame, *pose, *fraction, *covariances)

    @property
    def format(self) -> TrajectoryFormat:
        """The format with these columns, with or without a header; COLUMNS if the format has no name of its own."""
        if self.is_matrix:
            is_kitti = self.stamp_key is None and FRAME not in self
            return TrajectoryFormat.KITTI if is_kitti else TrajectoryFormat.MATRIX
        known = next((known for known in _ORDERS if self.has_order_of(known)), TrajectoryFormat.COLUMNS)
        is_other_unit = known is TrajectoryFormat.EUROC and self.units[STAMP] != "ns"
        return TrajectoryFormat.COLUMNS if is_other_unit else known

    @property
    def row_form(self) -> RowForm:
        """The cells that are read from each row: the stamp, if there is one, and the numbers of `value_keys`."""
        keys = self.value_keys if self.stamp_key is None else (self.stamp_key, *self.value_keys)
        columns = [self.index_of[key] for key in keys]
        return RowForm(
            self.name,
            columns,
            None if self.stamp_key is None else StampParser.of(self.units.get(self.stamp_key, "s")),
            self.separator,
            self._allows_more(columns),
            self._small_unit,
        )

    def _allows_more(self, columns: list[int]) -> bool:
        """Return whether rows may have more columns than those that are read.

        Named columns may be followed by others, and so may those of a layout of which some columns are not read. Rows
        of the csv of the suite have exactly the columns of its header.
        """
        if self.format is TrajectoryFormat.CSV and not self.ignored:
            return False
        return self.are_named or columns != list(range(self.width))

    @property
    def fraction_ns(self) -> int:
        """Unit of the column `nsec`, ns."""
        return TIMES[self.units.get(NANOSECONDS, "ns")]

    @property
    def scales(self) -> list[float]:
        """Factors that convert the columns of the position to metres."""
        keys = self.position_keys
        return [METRES[self.units.get(key, "")] * (-1.0 if key == DOWN else 1.0) for key in keys]

    @property
    def length_units(self) -> tuple[str, ...]:
        """The units of the columns of the position, without repetition, if one of them is not the metre."""
        units = tuple(dict.fromkeys(self.units.get(key) or "m" for key in self.position_keys))
        return () if units == ("m",) else units

    @property
    def _small_unit(self) -> str:
        """A unit below a metre that a column of the position has; empty if there is none."""
        return next((unit for unit in self.length_units if METRES[unit] < 1.0), "")
