"""What is known of a run as messages of Foxglove's schemas."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from foxglove.messages import (
    Color,
    CompressedImage,
    Grid,
    ImageAnnotations,
    LinePrimitive,
    LinePrimitiveLineType,
    PackedElementField,
    PackedElementFieldNumericType,
    Point2,
    Point3,
    PointCloud,
    PointsAnnotation,
    PointsAnnotationType,
    Pose,
    PosesInFrame,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    Timestamp,
    Vector2,
    Vector3,
)

from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.live.path import PathRow, Point
from sfr_loc_map.live.updates import CloudSample, ElevationSample, ImageSample, TrackSample

MAP_FRAME, DRIVE_FRAME = "lm", "ds"
ERROR_SCALE = 20.0
"""So much larger are errors drawn than they are."""
ELLIPSE_POINTS = 36
FLOAT32_BYTES = 4
GREEN, BLUE = Color(r=0.1, g=0.6, b=0.2, a=1.0), Color(r=0.1, g=0.3, b=0.9, a=1.0)
VIOLET, GREY = Color(r=0.86, g=0.24, b=0.86, a=1.0), Color(r=0.6, g=0.6, b=0.6, a=1.0)
RED, YELLOW = Color(r=0.9, g=0.1, b=0.1, a=1.0), Color(r=0.9, g=0.7, b=0.0, a=1.0)


def image(sample: ImageSample) -> CompressedImage:
    """Return an image, a JPEG file."""
    return CompressedImage(
        timestamp=_stamp(sample.stamp_ns), frame_id=sample.topic.replace("/", "_"), data=sample.jpeg, format="jpeg"
    )


def cloud(sample: CloudSample) -> PointCloud:
    """Return a cloud with the fields x y z sigma error float32, metres; error is NaN where it is not known."""
    error = np.full(len(sample.points), np.nan, np.float32) if sample.error is None else sample.error
    columns = np.ascontiguousarray(np.column_stack([sample.points, error]), "<f4")
    return PointCloud(
        timestamp=_stamp(sample.stamp_ns),
        frame_id=MAP_FRAME,
        pose=_pose((0.0, 0.0, 0.0)),
        point_stride=columns.shape[1] * FLOAT32_BYTES,
        fields=_fields(("x", "y", "z", "sigma", "error")),
        data=columns.tobytes(),
    )


def grid(sample: ElevationSample) -> Grid:
    """Return a map from above with its layers as fields."""
    _, columns, layers = sample.layers.shape
    stride = layers * FLOAT32_BYTES
    return Grid(
        timestamp=_stamp(sample.stamp_ns),
        frame_id=MAP_FRAME,
        pose=_pose((*sample.origin_m, 0.0)),
        column_count=columns,
        cell_size=Vector2(x=sample.cell_m, y=sample.cell_m),
        row_stride=columns * stride,
        cell_stride=stride,
        fields=_fields(sample.names),
        data=np.ascontiguousarray(sample.layers, "<f4").tobytes(),
    )


def track_annotations(sample: TrackSample, scale: float) -> ImageAnnotations:
    """Return tracks (inliers, outliers, landmarks not found) and outlines of masks, to be drawn on the left image.

    Args:
        sample: The tracks.
        scale: Pixels of the image that is shown for one of the image that was tracked in.
    """
    stamp, tracks = _stamp(sample.stamp_ns), sample.tracks * np.float32(scale)
    residual = sample.tracks[:, 4]
    found = np.isfinite(sample.tracks[:, :4]).all(axis=1)
    kinds = ((found & (residual < 1.0), YELLOW), (found & (residual >= 1.0), VIOLET))
    lines = [
        _lines(stamp, tracks[rows, :4].reshape(-1, 2), PointsAnnotationType.LineList, color) for rows, color in kinds
    ]
    missed = tracks[np.isnan(residual) & np.isfinite(sample.tracks[:, 2:4]).all(axis=1), 2:4]
    lines.append(_lines(stamp, missed, PointsAnnotationType.Points, GREY))
    rings = [ring * np.float32(scale) for ring in sample.masks.get("left", ())]
    lines += [_lines(stamp, ring, PointsAnnotationType.LineLoop, RED) for ring in rings]
    return ImageAnnotations(points=lines)


def _lines(stamp: Timestamp, points: FloatArray32, kind: PointsAnnotationType, color: Color) -> PointsAnnotation:
    corners = [Point2(x=x, y=y) for x, y in points.tolist()]
    return PointsAnnotation(timestamp=stamp, type=kind, points=corners, outline_color=color, thickness=1.0)


def estimates(rows: list[PathRow]) -> PosesInFrame:
    """Return the estimated positions, in the frame of the truth; attitudes are not shown."""
    return _poses(rows[-1].stamp_ns if rows else 0, (row.position for row in rows))


def truths(rows: list[PathRow]) -> PosesInFrame:
    """Return the true positions."""
    known = [row for row in rows if row.truth is not None]
    return _poses(known[-1].stamp_ns if known else 0, (row.truth for row in known if row.truth is not None))


def scene(rows: list[PathRow]) -> SceneUpdate:
    """Return both paths, the errors enlarged (`ERROR_SCALE`) and the 3-sigma ellipse of the newest pose as lines."""
    known = [row for row in rows if row.truth is not None]
    lines = [
        _line("truth", GREEN, [row.truth for row in known if row.truth is not None]),
        _line("estimate", BLUE, [row.position for row in rows]),
        _line("error", RED, [end for row in known for end in _error_ends(row)], LinePrimitiveLineType.LineList),
        _line("3 sigma", YELLOW, _ellipse(rows[-1]) if rows else [], LinePrimitiveLineType.LineLoop),
    ]
    stamp = _stamp(rows[-1].stamp_ns if rows else 0)
    return SceneUpdate(
        entities=[SceneEntity(timestamp=stamp, frame_id=DRIVE_FRAME, id=name, lines=[line]) for name, line in lines]
    )


def _line(
    name: str, color: Color, points: list[Point], kind: LinePrimitiveLineType = LinePrimitiveLineType.LineStrip
) -> tuple[str, LinePrimitive]:
    corners = [Point3(x=x, y=y, z=z) for x, y, z in points]
    return name, LinePrimitive(
        type=kind, pose=_pose((0.0, 0.0, 0.0)), thickness=2.0, scale_invariant=True, points=corners, color=color
    )


def _error_ends(row: PathRow) -> tuple[Point, Point]:
    assert row.truth is not None
    (x, y, z), (a, b, c) = row.truth, row.error or (0.0, 0.0, 0.0)
    return row.truth, (x + ERROR_SCALE * a, y + ERROR_SCALE * b, z + ERROR_SCALE * c)


def _ellipse(row: PathRow) -> list[Point]:
    """Return the 3-sigma ellipse of the position, x and y, of the size it has."""
    if row.covariance_xy is None:
        return []
    xx, yy, xy = row.covariance_xy
    values, axes = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    half = 3.0 * np.sqrt(np.maximum(values, 0.0))
    angles = np.linspace(0.0, 2.0 * math.pi, ELLIPSE_POINTS, endpoint=False)
    ring = axes @ (half[:, None] * np.stack([np.cos(angles), np.sin(angles)]))
    x, y, z = row.position
    return [(x + dx, y + dy, z) for dx, dy in ring.T.tolist()]


def _poses(stamp_ns: int, positions: Iterable[Point]) -> PosesInFrame:
    return PosesInFrame(timestamp=_stamp(stamp_ns), frame_id=DRIVE_FRAME, poses=[_pose(place) for place in positions])


def _pose(place: Point) -> Pose:
    x, y, z = place
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))


def _fields(names: tuple[str, ...]) -> list[PackedElementField]:
    kind = PackedElementFieldNumericType.Float32
    return [PackedElementField(name=name, offset=FLOAT32_BYTES * n, type=kind) for n, name in enumerate(names)]


def _stamp(stamp_ns: int) -> Timestamp:
    return Timestamp(sec=stamp_ns // NS_PER_S, nsec=stamp_ns % NS_PER_S)
