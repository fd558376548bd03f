"""True poses from the messages of a topic, live or in a bag."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from sfr_loc_map import message_types
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE
from sfr_loc_map.io.bag.frames import pose_row
from sfr_loc_map.io.truth.geodesy import enu_m
from sfr_loc_map.message_stamps import NS_PER_S, jumped_back, stamp_of
from sfr_loc_map.topics import TRUE_POSES

TRUTH_TYPES = (
    message_types.ODOMETRY,
    message_types.POSE_WITH_COVARIANCE,
    message_types.POSE,
    message_types.TRANSFORM,
    message_types.PATH,
    message_types.POINT,
    message_types.FIX,
)
"""Types of messages with true poses; if one body has several types, the first in this order is preferred."""
NO_FIX = -1  #: `NavSatStatus.STATUS_NO_FIX`.
UNKNOWN = (np.nan,) * 6
Place = tuple[float, float, float]  #: Latitude, longitude, deg, and height, m.
TrueRow = tuple[int, tuple[float, ...], tuple[float, ...]]
"""Stamp (ns); position (m) and quaternion (x, y, z, w; zeros without an attitude); variances (m^2, rad^2; NaN:
unknown)."""


class TruthReader:
    """Converts the messages of a topic to true poses.

    The variance in z of a fix without altitude is that of an unknown component.
    """

    def __init__(self, msgtype: str, where: str = TRUE_POSES) -> None:
        """Read messages of a type in `TRUTH_TYPES`; positions of fixes are east, north, up from the first fix.

        `where` names the topic in errors.
        """
        self._msgtype = msgtype
        self._where = where
        self._origin: Place | None = None
        self._path_end_ns: int | None = None

    def set_origin(self, fix: Any) -> None:  # noqa: ANN401 - a NavSatFix of any library
        """Make a fix the origin of the positions, which is the first fix otherwise."""
        self._origin = _place_of(fix, 0.0)

    def rows(self, message: Any) -> list[TrueRow]:  # noqa: ANN401 - a message of any library
        """Return the true poses of a message: one pose, the new poses of a path, or none for an invalid fix."""
        match self._msgtype:
            case message_types.PATH:
                return list(self._path(message))
            case message_types.FIX:
                return list(self._fix(message))
            case message_types.POINT:
                point = message.point
                return [(stamp_of(message), (point.x, point.y, point.z, 0.0, 0.0, 0.0, 0.0), UNKNOWN)]
            case message_types.ODOMETRY | message_types.POSE_WITH_COVARIANCE:
                stamp_ns, pose = pose_row(message, message.pose.pose)
                variances = np.asarray(message.pose.covariance, np.float64)[::7]
                return [(stamp_ns, pose, tuple(variances.tolist()))]
            case message_types.POSE:
                return [(*pose_row(message, message.pose), UNKNOWN)]
            case _:
                return [(*pose_row(message, message.transform), UNKNOWN)]

    def _path(self, message: Any) -> Iterator[TrueRow]:  # noqa: ANN401
        """Yield the poses after the end of the previous path, because each path repeats the earlier poses.

        A path that ends at least 1 s before the end of the previous path belongs to a new run.
        """
        if not message.poses:
            return
        first_ns, last_ns = stamp_of(message.poses[0]), stamp_of(message.poses[-1])
        if len(message.poses) > 1 and not last_ns > first_ns:
            found = "all poses of a path have the same stamp" if last_ns == first_ns else "a path ends before it begins"
            raise InputError(f"{self._where}: {found}:", "give each pose its own stamp, in increasing order")
        known_ns = self._path_end_ns
        if known_ns is not None and jumped_back(known_ns, last_ns):
            known_ns = None
        for item in message.poses:
            if known_ns is None or stamp_of(item) > known_ns:
                stamp_ns, pose = pose_row(item, item.pose)
                yield stamp_ns, pose, UNKNOWN
        self._path_end_ns = last_ns if known_ns is None else max(known_ns, last_ns)

    def _fix(self, message: Any) -> Iterator[TrueRow]:  # noqa: ANN401
        """Yield the position of a fix, if the message has one."""
        if message.status.status == NO_FIX or is_placeholder(message):
            return
        has_height = bool(np.isfinite(message.altitude))
        place = _place_of(message, 0.0 if self._origin is None else self._origin[2])
        self._origin = self._origin or place
        known = np.nan if message.position_covariance_type == 0 else 1.0
        variances = known * np.asarray(message.position_covariance, np.float64)[[0, 4, 8]]
        if not has_height:
            variances[2] = LOST_VARIANCE
        position = enu_m(np.array([self._origin, place], np.float64))[1]
        pose = (*position.tolist(), 0.0, 0.0, 0.0, 0.0)
        yield stamp_of(message), pose, (*variances.tolist(), np.nan, np.nan, np.nan)


def _place_of(fix: Any, height_m: float) -> Place:  # noqa: ANN401 - a NavSatFix of any library
    """Return the place of a fix; `height_m` is the height if the fix has no altitude."""
    return fix.latitude, fix.longitude, fix.altitude if np.isfinite(fix.altitude) else height_m


def first_pose_ns(raw: bytes) -> int | None:
    """Return the stamp of the first pose of a serialised path, ns (CDR, XTypes 1.3, 7.4); None if it has no pose.

    A truncated message counts as a path without a pose.
    """
    order = "<" if raw[1:2] and raw[1] & 1 else ">"
    try:
        (name_length,) = struct.unpack_from(f"{order}I", raw, 12)
        end_of_name = 16 + name_length
        count, seconds, nanoseconds = struct.unpack_from(f"{order}IiI", raw, end_of_name + -end_of_name % 4)
    except struct.error:
        return None
    return int(seconds) * NS_PER_S + int(nanoseconds) if count else None


def is_placeholder(message: Any) -> bool:  # noqa: ANN401 - a message of any library
    """Return whether a NavSatFix states a fix, but has no position: some receivers send 0, 0 or NaN.

    Status -2 (unknown) counts as a fix, because some drivers never set the status.
    """
    latitude, longitude = message.latitude, message.longitude
    is_place = abs(latitude) <= 90.0 and abs(longitude) <= 360.0 and (latitude, longitude) != (0.0, 0.0)
    return message.status.status != NO_FIX and not is_place
