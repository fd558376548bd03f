"""A shared library with the interface of `sfr_candidate.h` as a method; needs NumPy alone.

What it returns is checked: sizes, marks behind what it may write, status, count. What the numbers mean is checked by
who gave the order.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

ABI = 1
STATES = ("initialising", "tracking", "degraded", "lost")
MARK = b"\xa5" * 64  #: Behind each thing that a candidate writes.
MESSAGE_SIZE = 512
POINT = np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("sigma", "f4"), ("u", "u2"), ("v", "u2")])
CLOUD = np.dtype([*((name, "f4") for name in ("x", "y", "z", "sigma", "intensity")), ("u", "u2"), ("v", "u2"),
                  ("pair", "u1")])  # fmt: skip
"""Of a point in the file that is read by who gave the order."""
T_NAVSB_LEFT_ROTATION = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))

Image = NDArray[np.uint8]


class RigStruct(ctypes.Structure):
    """`sfr_rig`."""

    _fields_: ClassVar[Any] = [
        ("size", ctypes.c_uint32), ("width", ctypes.c_int32), ("height", ctypes.c_int32), ("reserved", ctypes.c_int32),
        ("fx", ctypes.c_double), ("fy", ctypes.c_double), ("cx", ctypes.c_double), ("cy", ctypes.c_double),
        ("baseline_m", ctypes.c_double), ("T_rb_left", ctypes.c_double * 12), ("T_navsb_left", ctypes.c_double * 12),
    ]  # fmt: skip


class PoseStruct(ctypes.Structure):
    """`sfr_pose` and the mark behind it."""

    _fields_: ClassVar[Any] = [
        ("size", ctypes.c_uint32), ("reserved", ctypes.c_uint32), ("stamp_ns", ctypes.c_int64),
        ("position_m", ctypes.c_double * 3), ("quat_xyzw", ctypes.c_double * 4), ("mark", ctypes.c_char * len(MARK)),
    ]  # fmt: skip


class PairStruct(ctypes.Structure):
    """`sfr_pair`."""

    _fields_: ClassVar[Any] = [
        ("size", ctypes.c_uint32), ("index", ctypes.c_int32), ("stamp_ns", ctypes.c_int64),
        ("left", ctypes.c_void_p), ("right", ctypes.c_void_p),
    ]  # fmt: skip


class Library:
    """A library that was loaded, its version checked, its candidate made."""

    def __init__(self, setup: Mapping[str, Any]) -> None:
        """Load it and make the candidate; end with one line if there is none, or of another interface."""
        path = setup["target"]
        try:
            self.functions = ctypes.CDLL(path)
        except OSError as error:
            raise SystemExit(f"cannot load the library: {error}") from error
        abi = self.function("abi", ctypes.c_uint32)()
        if abi != ABI:
            raise SystemExit(f"built for version {abi} of sfr_candidate.h, this suite has {ABI}: build it again")
        stated = self.function("version", ctypes.c_char_p)()
        self.version = "not stated" if stated is None else stated.decode("utf-8", "replace")
        self._destroy = self.function("destroy", None, ctypes.c_void_p)
        create = self.function(
            "create", ctypes.c_void_p, ctypes.POINTER(RigStruct), ctypes.c_char_p, ctypes.c_char_p, ctypes.c_size_t
        )
        message = ctypes.create_string_buffer(MESSAGE_SIZE)
        self.candidate = create(ctypes.byref(rig_struct(setup)), setup["config"].encode(), message, MESSAGE_SIZE)
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


def rig_struct(setup: Mapping[str, Any]) -> RigStruct:
    """Return the rig of a setup."""
    rig = RigStruct(size=ctypes.sizeof(RigStruct))
    for name in ("width", "height", "fx", "fy", "cx", "cy", "baseline_m"):
        setattr(rig, name, setup[name])
    T_navsb_left = np.column_stack((T_NAVSB_LEFT_ROTATION, (0.0, 0.5 * setup["baseline_m"], 0.0)))
    T_rb_left = np.eye(4) if setup["T_rb_left"] is None else np.reshape(setup["T_rb_left"], (4, 4))
    rig.T_rb_left[:], rig.T_navsb_left[:] = T_rb_left[:3].ravel().tolist(), T_navsb_left.ravel().tolist()
    return rig


class LibraryLocaliser(Library):
    """`sfr_candidate_process`."""

    def __init__(self, setup: Mapping[str, Any]) -> None:
        super().__init__(setup)
        pointer = ctypes.c_void_p
        self._process = self.function(
            "process", ctypes.c_int32, pointer, ctypes.c_int64, pointer, pointer, pointer, pointer, pointer
        )
        self._start = np.reshape(np.asarray(setup["start"], np.float64), (4, 4))
        self._turn = np.kron(np.eye(2), self._start[:3, :3])

    def prepare(self, left: Image, right: Image, order: Mapping[str, Any]) -> Callable[[], Any]:
        """Return the call."""
        pose, status = PoseStruct(size=PoseStruct.mark.offset, mark=MARK), ctypes.c_int32(-1)
        covariance = np.full(36 + len(MARK) // 8, np.nan)
        covariance[36:] = np.frombuffer(MARK)
        places = (left.ctypes.data, right.ctypes.data, ctypes.byref(pose), covariance.ctypes.data, ctypes.byref(status))
        stamp_ns, candidate, process, images = order["stamp_ns"], self.candidate, self._process, (left, right)
        return lambda: (process(candidate, stamp_ns, *places), pose, covariance, status, images)

    def report(self, answer: Any, order: Mapping[str, Any]) -> dict[str, Any]:  # noqa: ANN401 - as of the call
        """Return pose, covariance and state; raise ValueError if the candidate failed, or wrote what it may not."""
        failed, pose, covariance, status, _ = answer
        if failed:
            raise ValueError(f"sfr_candidate_process returned {failed}")
        if bytes(pose)[PoseStruct.mark.offset :] != MARK or covariance[36:].tobytes() != MARK:
            raise ValueError("wrote beyond the pose or the covariance")
        if not 0 <= status.value < len(STATES):
            raise ValueError(f"status is {status.value}: must be 0 to {len(STATES) - 1}")
        about = {"stamp_ns": pose.stamp_ns, "state": STATES[status.value]}
        if about["state"] == "lost":
            return {**about, "T_ds_rb": None}
        quat = np.array(pose.quat_xyzw)
        length = float(np.linalg.norm(quat))
        if not abs(length - 1.0) < 1e-2 and np.isfinite(length):
            raise ValueError(f"the quaternion has length {length:g}: must be 1")
        T_start_rb = np.eye(4)
        T_start_rb[:3, :3], T_start_rb[:3, 3] = _rotation(quat / length), pose.position_m
        stated = covariance[:36].reshape(6, 6)
        known = None if np.isnan(stated).all() else (self._turn @ stated @ self._turn.T).ravel().tolist()
        return {**about, "T_ds_rb": (self._start @ T_start_rb).ravel().tolist(), "covariance": known}


class LibraryMapper(Library):
    """`sfr_candidate_map`."""

    def __init__(self, setup: Mapping[str, Any]) -> None:
        super().__init__(setup)
        pointer, size = ctypes.c_void_p, ctypes.c_size_t
        self._map = self.function("map", ctypes.c_int32, pointer, pointer, pointer, pointer, size, pointer)
        self._capacity = setup["width"] * setup["height"]
        room = np.zeros(self._capacity * POINT.itemsize + len(MARK), np.uint8)
        self._points, self._mark = room[: -len(MARK)].view(POINT), room[-len(MARK) :]

    def prepare(self, left: Image, right: Image, order: Mapping[str, Any]) -> Callable[[], Any]:
        """Return the call."""
        self._mark[:] = np.frombuffer(MARK, np.uint8)
        sides = {"left": left.ctypes.data, "right": right.ctypes.data}
        pair = PairStruct(size=ctypes.sizeof(PairStruct), index=order["index"], stamp_ns=order["stamp_ns"], **sides)
        T_lm_navsb, count = np.array(order["T_lm_navsb"][:12], np.float64), ctypes.c_size_t()
        places = ctypes.byref(pair), T_lm_navsb.ctypes.data, self._points.ctypes.data
        candidate, run, capacity, images = self.candidate, self._map, self._capacity, (left, right, T_lm_navsb)
        return lambda: (run(candidate, *places, capacity, ctypes.byref(count)), count, images)

    def report(self, answer: Any, order: Mapping[str, Any]) -> dict[str, Any]:  # noqa: ANN401 - as of the call
        """Save the points; raise ValueError if the candidate failed, or wrote what it may not."""
        failed, count, (left, _, _) = answer
        if failed:
            raise ValueError(f"sfr_candidate_map returned {failed}")
        if self._mark.tobytes() != MARK or count.value > self._capacity:
            raise ValueError(f"wrote {count.value} points: there is room for {self._capacity}")
        points = self._points[: count.value]
        height, width = left.shape
        if count.value and not (points["u"].max() < width and points["v"].max() < height):
            raise ValueError(f"a point names a pixel outside {width} x {height}")
        cloud = np.zeros(count.value, CLOUD)
        for name in ("x", "y", "z", "sigma", "u", "v"):
            cloud[name] = points[name]
        cloud["intensity"], cloud["pair"] = left[points["v"], points["u"]], order["index"]
        np.save(order["output"] + ".cloud.npy", cloud)
        return {"stamp_ns": order["stamp_ns"]}


def _rotation(quat: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z, w = quat
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + 2.0 * (w * cross + cross @ cross))


def open_method(setup: Mapping[str, Any]) -> Library:
    """Return the method of a setup."""
    return LibraryMapper(setup) if setup["task"] == "mapping" else LibraryLocaliser(setup)
