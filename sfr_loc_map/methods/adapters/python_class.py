"""Adapter for Python classes: `Class(rig, config)` with `process(pair)` for localisers, `map_pairs(pairs)` for mappers.

Instead of `map_pairs`, a mapper may have `process(pair, T_lm_navsb, index)` and `fuse(results)`. `warm_up()`,
`reset(T_ds_rb)`, `version` and `statistics` are optional (docs/candidates.md). The suite's own localiser and mapper use
this adapter, too.
"""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import PoseEstimate
from sfr_loc_map.message_text import alternatives

if TYPE_CHECKING:
    from sfr_loc_map.methods.child.loop import Answer, Order, Pose, Setup


def _transform(numbers: Pose | None) -> Transform:
    assert numbers is not None  # mappers always receive the pose of the cameras
    matrix = np.reshape(np.asarray(numbers, np.float64), (4, 4))
    return Transform(matrix[:3, :3].copy(), matrix[:3, 3].copy())


class PythonClass:
    """The common part of localisers and mappers."""

    calls: tuple[str, ...] = ("process",)  # the class must have one of these

    def __init__(self, setup: Setup) -> None:
        T_rb_sb = None if setup["T_rb_sb"] is None else _transform(setup["T_rb_sb"])
        rig = replace(StereoRig(**setup["camera"]), T_rb_sb=T_rb_sb)
        # `package.module:Name` or `path/to/file.py:Name`
        place, _, name = setup["target"].rpartition(":")
        is_file = place.endswith(".py")
        if is_file:
            sys.path.insert(0, str(Path(place).resolve().parent))
        make: Any = importlib.import_module(Path(place).stem if is_file else place)
        for part in name.split("."):
            make = getattr(make, part)
        self.method: Any = make(rig, setup["config"])
        self.version = _version_of(self.method)
        if not any(map(self.has, self.calls)):
            wanted = alternatives(f"'{name}'" for name in self.calls)
            raise TypeError(f"{setup['target']} has no method {wanted}: see docs/candidates.md")
        if self.has("warm_up"):
            self.method.warm_up()

    def has(self, name: str) -> bool:
        """Whether the class has a method."""
        return callable(getattr(self.method, name, None))


class PythonLocaliser(PythonClass):
    """A localiser that returns a `PoseEstimate`, a `Transform`, a matrix `(4, 4)`, or None if lost."""

    def __init__(self, setup: Setup) -> None:
        """Set the initial pose through `reset`.

        Without `reset`, poses of the method are relative to the initial pose.
        """
        super().__init__(setup)
        start = _transform(setup["T_ds_rb"])
        resets = self.has("reset")
        self._T_ds_start = None if resets else start.matrix
        self._turn = np.eye(6) if resets else np.kron(np.eye(2), start.rotation)
        if resets:
            self.method.reset(start)

    def prepare(self, left: GreyImage, right: GreyImage, order: Order) -> Callable[[], Any]:
        """Return the call."""
        pair = StereoPair(order["pairs"][0]["stamp_ns"], left, right)
        return lambda: self.method.process(pair)

    def report(self, answer: object, order: Order) -> Answer:
        """Return the pose as 16 numbers, None if lost, and the other fields of the estimate."""
        if answer is None:
            return {"T_ds_rb": None}
        report: Answer = {"statistics": _figures(self.method)}
        if isinstance(answer, PoseEstimate):
            report["stamp_ns"] = _stamp(answer.stamp_ns)
            report["state"] = answer.state.value
            report["reason"] = answer.reason_text
            report["statistics"] |= answer.figures
            report["step"] = None if answer.step is None else answer.step.uncertainty.tolist()
            report["covariance"] = None if answer.covariance is None else self._covariance(answer.covariance)
            answer = answer.T_ds_rb
        matrix = answer.matrix if isinstance(answer, Transform) else np.asarray(answer, np.float64)
        if matrix.shape != (4, 4):
            raise TypeError(
                f"the pose is {_described(answer)}: a PoseEstimate, a Transform or a matrix (4, 4) is required"
            )
        matrix = matrix if self._T_ds_start is None else self._T_ds_start @ matrix
        report["T_ds_rb"] = matrix.ravel().tolist()
        return report

    def _covariance(self, stated: object) -> list[float]:
        """Return the covariance of a pose in DS; TypeError for another shape."""
        covariance = np.asarray(stated, np.float64)
        if covariance.shape != (6, 6):
            raise TypeError(f"the covariance is {_described(stated)}: a matrix (6, 6), or None if unknown, is required")
        turned: list[float] = (self._turn @ covariance @ self._turn.T).ravel().tolist()
        return turned


class PythonMapper(PythonClass):
    """A mapper that returns a `PointCloud` or an object with a `cloud`; or, for one pair, a disparity image."""

    calls = ("map_pairs", "process")

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.fuses, self.maps_sets = self.has("fuse"), self.has("map_pairs")
        self._results: list[Any] = []  # of the pairs of the current map, for `fuse`

    def prepare(self, left: GreyImage, right: GreyImage, order: Order) -> Callable[[], Any]:
        """Return the call that maps a set or one pair, or fuses all pairs."""
        if order["call"] == "set":
            pairs = [
                PosedStereoPair(StereoPair(item["stamp_ns"], *images), _transform(item["T_lm_navsb"]))
                for item, *images in zip(order["pairs"], left, right, strict=True)
            ]
            return lambda: self.method.map_pairs(pairs)
        if order["begins_map"]:
            self._results = []
        results = self._results
        if order["call"] == "fuse":
            self._results = []
            return lambda: self.method.fuse(results)
        (ordered,) = order["pairs"]
        pair, T_lm_navsb = StereoPair(ordered["stamp_ns"], left, right), _transform(ordered["T_lm_navsb"])

        def map_pair() -> Any:  # noqa: ANN401 - as the class says
            result = self.method.process(pair, T_lm_navsb, ordered["index"])
            if self.fuses:
                results.append(result)
            return result

        return map_pair

    def report(self, answer: Any, order: Order) -> Answer:  # noqa: ANN401 - as the class says
        """Save the points and the disparities; TypeError if the result has neither."""
        cloud = answer if isinstance(answer, PointCloud) else getattr(answer, "cloud", None)
        disparity = answer if isinstance(answer, np.ndarray) else getattr(answer, "disparity_px", None)
        if order["call"] != "pair" and not isinstance(cloud, PointCloud):
            subject = "for a set of pairs" if order["call"] == "set" else "from 'fuse'"
            raise TypeError(
                f"the mapper returned {_described(answer)}: a PointCloud, or an object with a PointCloud as 'cloud', "
                f"is required {subject}"
            )
        if disparity is not None:
            np.save(order["output"] + ".disparity.npy", np.asarray(disparity, np.float32))
        if isinstance(cloud, PointCloud):
            np.save(order["output"] + ".cloud.npy", cloud.to_structured())
        elif disparity is None:
            raise TypeError(
                f"the mapper returned {_described(answer)}: a PointCloud, a disparity image, or an object with a "
                "PointCloud as 'cloud' or a disparity image as 'disparity_px' is required"
            )
        is_concatenated = isinstance(cloud, PointCloud) and cloud.fused is False
        return {
            "stamp_ns": _stamp(getattr(answer, "stamp_ns", order["pairs"][-1]["stamp_ns"])),
            "fused": not is_concatenated,
            "statistics": _figures(answer) | _figures(self.method),
            "warnings": [str(line) for line in getattr(answer, "warnings", ())],
        }


def _version_of(method: object) -> str:
    """Return the version that a method states; TypeError unless this is a text or a number."""
    version = getattr(method, "version", None)
    if version is None:
        return "not stated"
    if not isinstance(version, str | int | float):
        raise TypeError(f"'version' has the type {type(version).__name__}: a text such as '1.0' is required")
    return str(version)


def _stamp(stated: object) -> int:
    """Return the stamp of a result, ns; TypeError unless this is a whole number."""
    if isinstance(stated, bool) or not isinstance(stated, int | np.integer):
        raise TypeError(f"the stamp is {stated!r:.40}: a whole number of nanoseconds is required")
    return int(stated)


def _figures(of: object) -> dict[str, float]:
    """Return the statistics of a method or result by name; other values than finite numbers are ignored."""
    stated = getattr(of, "statistics", {})
    figures: dict[str, float] = {}
    for name, value in stated.items() if isinstance(stated, Mapping) else ():
        with suppress(TypeError, ValueError, OverflowError):
            number = float(value)
            if math.isfinite(number):
                figures[str(name)] = number
    return figures


def _described(answer: object) -> str:
    shape = getattr(answer, "shape", None)
    return type(answer).__name__ + ("" if shape is None else f" of shape {shape}")


def open_method(setup: Setup) -> PythonClass:
    """Return the method of a setup."""
    return PythonMapper(setup) if setup["task"] == "mapping" else PythonLocaliser(setup)
