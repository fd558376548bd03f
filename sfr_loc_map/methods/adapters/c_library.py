"""Adapter for shared libraries with the interface of `sfr_candidate.h`.

The adapter checks sizes, guard bytes behind the output buffers, status and count. The caller checks the values.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.rotation import matrix_from_quat
from sfr_loc_map.geometry.stereo import CAMERA, StereoRig
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.methods.point_bounds import check_points

if TYPE_CHECKING:
    from sfr_loc_map.methods.child.loop import Answer, Order, Setup

ABI = 2
STATES = (TrackingState.INITIALISING, TrackingState.TRACKING, TrackingState.DEGRADED, TrackingState.LOST)
"""States by their number in the header."""
MARK = np.full(64, 0xA5, np.uint8)  #: Guard bytes behind each output buffer.
MESSAGE_SIZE = 512
# the structs of the header, which have no padding
RIG = np.dtype([
    ("size", "u4"), ("width", "i4"), ("height", "i4"), ("reserved", "i4"),
    ("fx", "f8"), ("fy", "f8"), ("cx", "f8"), ("cy", "f8"), ("baseline_m", "f8"),
    ("T_rb_left", "f8", 12), ("T_navsb_left", "f8", 12),
])  # fmt: skip
POSE = np.dtype([
    ("size", "u4"), ("reserved", "u4"), ("stamp_ns", "i8"), ("position_m", "f8", 3), ("quat_xyzw", "f8", 4),
])  # fmt: skip
PAIR = np.dtype([("size", "u4"), ("index", "i4"), ("stamp_ns", "i8"), ("left", np.uintp), ("right", np.uintp)])
POINT = np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("sigma", "f4"), ("u", "u2"), ("v", "u2")])
MAP_POINT = np.dtype([*POINT.descr, ("pair", "u2"), ("reserved", "u2")])

Image = NDArray[np.uint8]
Pointer, Size = ctypes.c_void_p, ctypes.c_size_t
# candidate, pairs, pair_count, T_lm_navsb, points, capacity, count, fused
OF_SET = (Pointer, Pointer, Size, Pointer, Pointer, Size, Pointer, Pointer)  #: Arguments of `sfr_candidate_map_pairs`.
# candidate, pair, T_lm_navsb, points, capacity, count
OF_PAIR = (Pointer, Pointer, Pointer, Pointer, Size, Pointer)  #: Arguments of `sfr_candidate_map`.


def room_for(dtype: np.dtype[Any], count: int = 1) -> tuple[NDArray[Any], Image]:
    """Return a zeroed output buffer and the guard bytes behind it."""
    room = np.concatenate((np.zeros(count * dtype.itemsize, np.uint8), MARK))
    return room[: -len(MARK)].view(dtype), room[-len(MARK) :]


class Library:
    """A loaded library whose version was checked, with its candidate."""

    def __init__(self, setup: Setup) -> None:
        """Load the library and create the candidate; SystemExit with one line if this fails."""
        try:
            self.functions = ctypes.CDLL(setup["target"])
        except OSError as error:
            raise SystemExit(f"cannot load the library: {error}") from error
        self.abi = self.function("abi", ctypes.c_uint32)()
        if not 1 <= self.abi <= ABI:
            raise SystemExit(
                f"the library was built for version {self.abi} of sfr_candidate.h: 1 to {ABI} is required; rebuild "
                "the library"
            )
        stated = self.function("version", ctypes.c_char_p)()
        self.version = "not stated" if stated is None else stated.decode("utf-8", "replace")
        self.function("destroy", None, Pointer)  # required but never called, because the process exits
        create = self.function("create", Pointer, Pointer, ctypes.c_char_p, ctypes.c_char_p, Size)
        message, rig = ctypes.create_string_buffer(MESSAGE_SIZE), np.zeros(1, RIG)
        rig["size"] = RIG.itemsize
        camera = StereoRig(**setup["camera"])
        for name in CAMERA:
            rig[name] = getattr(camera, name)
        rig["T_rb_left"] = setup["T_rb_left"][:12]
        rig["T_navsb_left"] = camera.T_sb_left.matrix[:3].ravel()
        self.candidate = create(rig.ctypes.data, setup["config"].encode(), message, MESSAGE_SIZE)
        if not self.candidate:
            raise SystemExit("sfr_candidate_create: " + (message.value.decode("utf-8", "replace") or "no reason given"))

    def function(self, name: str, result: Any, *arguments: Any) -> Any:  # noqa: ANN401 - types of C
        """Return a function of the library."""
        try:
            found = getattr(self.functions, f"sfr_candidate_{name}")
        except AttributeError as error:
            raise SystemExit(f"the library has no function sfr_candidate_{name}: see sfr_candidate.h") from error
        found.restype, found.argtypes = result, arguments
        return found


class LibraryLocaliser(Library):
    """`sfr_candidate_process`."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._process = self.function("process", ctypes.c_int32, Pointer, ctypes.c_int64, *[Pointer] * 5)
        self._start = np.reshape(np.asarray(setup["T_ds_rb"], np.float64), (4, 4))
        self._turn = np.kron(np.eye(2), self._start[:3, :3])

    def prepare(self, left: Image, right: Image, order: Order) -> Callable[[], Any]:
        """Return the call."""
        (pose, pose_mark), (covariance, mark) = room_for(POSE), room_for(np.dtype("f8"), 36)
        pose["size"], covariance[:], status = POSE.itemsize, np.nan, np.full(1, -1, np.int32)
        written = (left, right, pose, covariance, status)
        places = [array.ctypes.data for array in written]
        stamp_ns, candidate, process = order["pairs"][0]["stamp_ns"], self.candidate, self._process
        return lambda: (process(candidate, stamp_ns, *places), *written, pose_mark, mark)

    def report(self, answer: Any, order: Order) -> Answer:  # noqa: ANN401 - whatever the call from `prepare` returns
        """Return pose, covariance and state; ValueError if the candidate failed or wrote beyond a buffer."""
        failed, _, _, (pose,), covariance, (status,), *marks = answer
        if failed:
            raise ValueError(f"sfr_candidate_process returned {failed}: 0 is required")
        if any((mark != MARK).any() for mark in marks):
            raise ValueError("the library wrote beyond the pose or the covariance")
        if not 0 <= status < len(STATES):
            raise ValueError(f"status is {status}: 0 to {len(STATES) - 1} is required")
        state, stamp_ns = STATES[status], int(pose["stamp_ns"])
        if state is TrackingState.LOST:
            return {"stamp_ns": stamp_ns, "state": state.value, "T_ds_rb": None}
        quat = pose["quat_xyzw"]
        length = float(np.linalg.norm(quat))
        if np.isfinite(length) and abs(length - 1.0) >= 1e-2:
            raise ValueError(f"the quaternion has the length {length:g}: 1 is required")
        T_start_rb = np.eye(4)
        T_start_rb[:3, :3] = matrix_from_quat(quat) if np.isfinite(length) else np.nan
        T_start_rb[:3, 3] = pose["position_m"]
        stated = covariance.reshape(6, 6)
        known = None if np.isnan(stated).all() else (self._turn @ stated @ self._turn.T).ravel().tolist()
        T_ds_rb = (self._start @ T_start_rb).ravel().tolist()
        return {"stamp_ns": stamp_ns, "state": state.value, "T_ds_rb": T_ds_rb, "covariance": known}


class LibraryMapper(Library):
    """`sfr_candidate_map_pairs` if the library has this function, or else `sfr_candidate_map`."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.maps_sets = self.abi > 1 and hasattr(self.functions, "sfr_candidate_map_pairs")
        self._name = "map_pairs" if self.maps_sets else "map"
        self._point = MAP_POINT if self.maps_sets else POINT
        self._map = self.function(self._name, ctypes.c_int32, *(OF_SET if self.maps_sets else OF_PAIR))
        pairs = MAX_PAIRS if self.maps_sets else 1
        pixels = setup["camera"]["width"] * setup["camera"]["height"]
        self._room = np.zeros(pairs * pixels * self._point.itemsize + len(MARK), np.uint8)

    def prepare(self, left: Image, right: Image, order: Order) -> Callable[[], Any]:
        """Return the call."""
        items, height, width = order["pairs"], *left.shape[-2:]
        lefts, rights = left.reshape(-1, height, width), right.reshape(-1, height, width)
        structs = [
            (PAIR.itemsize, item["index"], item["stamp_ns"], lefts[number].ctypes.data, rights[number].ctypes.data)
            for number, item in enumerate(items)
        ]
        size = lefts.size * self._point.itemsize
        points, mark = self._room[:size].view(self._point), self._room[size : size + len(MARK)]
        mark[:] = MARK
        poses = np.concatenate([(item["T_lm_navsb"] or [])[:12] for item in items])
        given, count, fused = (np.array(structs, PAIR), poses), np.zeros(1, np.uintp), np.ones(1, np.int32)
        pairs, T_lm_navsb = (array.ctypes.data for array in given)
        output = (points.ctypes.data, len(points), count.ctypes.data)
        words: tuple[int, ...] = (pairs, T_lm_navsb, *output)
        if self.maps_sets:
            words = (pairs, len(items), T_lm_navsb, *output, fused.ctypes.data)
        candidate, run = self.candidate, self._map
        return lambda: (run(candidate, *words), count, fused, points, mark, lefts, rights, given)

    def report(self, answer: Any, order: Order) -> Answer:  # noqa: ANN401 - whatever the call from `prepare` returns
        """Save the points; ValueError if the candidate failed or wrote beyond the buffer."""
        failed, (count,), (fused,), points, mark, lefts, *_ = answer
        if failed:
            raise ValueError(f"sfr_candidate_{self._name} returned {failed}: 0 is required")
        if (mark != MARK).any():
            raise ValueError(f"the library wrote beyond the end of the buffer of {len(points)} points")
        if count > len(points):
            raise ValueError(f"the library returned {count} points: at most {len(points)} are allowed")
        points = points[: int(count)]
        pair = points["pair"] if self.maps_sets else np.zeros(len(points), np.uint16)
        check_points(points["u"], points["v"], pair, lefts.shape)
        if fused not in (0, 1):
            raise ValueError(f"fused is {fused}: 0 or 1 is required")
        cloud = np.zeros(len(points), PointCloud.dtype())
        for name in POINT.names or ():
            cloud[name] = points[name]
        cloud["intensity"], cloud["pair"] = lefts[pair, points["v"], points["u"]], pair
        np.save(order["output"] + ".cloud.npy", cloud)
        return {"stamp_ns": order["pairs"][-1]["stamp_ns"], "fused": bool(fused)}


def open_method(setup: Setup) -> Library:
    """Return the method of a setup."""
    return LibraryMapper(setup) if setup["task"] == "mapping" else LibraryLocaliser(setup)
