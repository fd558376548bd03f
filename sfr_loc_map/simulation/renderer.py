"""Pictures and exact truth of a scene by ray tracing."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MissingExtraError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit
from sfr_loc_map.simulation.mesh import Mesh

BAND_RAYS = 1 << 17
"""Rays traced at once: few enough to stay in the processor's cache."""
LIFT_M = 2e-4
"""Shadow rays start this far above the surface, so that a triangle does not shade itself."""
LIFT_PER_RANGE = 1e-4
NUDGE = 1e-5
LEVEL_RAY = -0.05
"""A ray that goes down by more than this must meet the ground."""
SKY_OBJECT = -2


def require_tracer() -> None:
    """Check that the ray tracer is there.

    Raises:
        MissingExtraError: If not.
    """
    try:
        import_module("embreex.rtcore_scene")
    except ImportError as error:
        raise MissingExtraError(
            "simulation needs the ray tracer embreex, which is not installed: pip install 'sfr_loc_map[sim]'"
        ) from error


class Tracer:
    """Finds what rays hit first, and whether light reaches a place."""

    def __init__(self, mesh: Mesh) -> None:
        """Build the search tree.

        Raises:
            MissingExtraError: If the ray tracer is not installed.
        """
        require_tracer()
        self.mesh = mesh
        self._scene: Any = import_module("embreex.rtcore_scene").EmbreeScene(robust=True)
        self._keep: Any = import_module("embreex.mesh_construction").TriangleMesh(
            self._scene, mesh.vertices, mesh.triangles
        )

    def first(self, origins: NDArray[np.float32], rays: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
        """Return `primID` (-1 for none), `u`, `v` of the first hit of each ray `(N, 3)`."""
        hits: dict[str, NDArray[Any]] = self._scene.run(origins, rays, output=1)
        return hits

    def blocked(
        self, origins: NDArray[np.float32], rays: NDArray[np.float32], reach: NDArray[np.float32] | None = None
    ) -> NDArray[np.bool_]:
        """Tell which rays `(N, 3)` meet anything, before `reach` ray lengths if given."""
        found: NDArray[np.int32] = self._scene.run(origins, rays, dists=reach, query="OCCLUDED")
        return found >= 0


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """What each ray of a band sees.

    Attributes:
        points: `(N, 3)` float64, metres, DS; undefined for the sky.
        normals: `(N, 3)` float64, unit, smooth.
        objects: `(N,)` int32, -2 for the sky, -1 for the ground, else the number of a rock.
        ranges: `(N,)` float64, metres.
    """

    points: FloatArray
    normals: FloatArray
    objects: NDArray[np.int32]
    ranges: FloatArray


def see(tracer: Tracer, origin: FloatArray, rays: FloatArray) -> Hits:
    """Return what rays see, the points in double precision on the plane of the triangle that was hit.

    Args:
        tracer: The scene.
        origin: `(3,)` metres, DS, where all rays start.
        rays: `(N, 3)` unit, DS.
    """
    count = len(rays)
    starts = np.empty((count, 3), np.float32)
    starts[:] = origin
    hits = tracer.first(starts, rays.astype(np.float32))
    leaks = np.flatnonzero((hits["primID"] < 0) & (rays[:, 2] < LEVEL_RAY))
    if len(leaks):  # rays that slipped through the seam of two tiles
        again = tracer.first(starts[leaks], (rays[leaks] + NUDGE).astype(np.float32))
        for name in ("primID", "u", "v"):
            hits[name][leaks] = again[name]
    out = Hits(np.empty((count, 3)), np.empty((count, 3)), np.empty(count, np.int32), np.empty(count))
    mesh = tracer.mesh
    _resolve(
        origin, rays, hits["primID"], hits["u"], hits["v"], mesh.vertices, mesh.normals, mesh.triangles, mesh.objects,
        out.points, out.normals, out.objects, out.ranges,
    )  # fmt: skip
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Occluder:
    """Something that moves and casts a shadow but is not seen.

    Attributes:
        tracer: Its shape in its own frame.
        T_ds_own: Where it is.
    """

    tracer: Tracer
    T_ds_own: Transform


def sun_seen(
    tracer: Tracer, hits: Hits, suns: NDArray[np.float32], occluder: Occluder | None = None
) -> NDArray[np.float32]:
    """Return 1 where light comes from the direction `suns` `(N, 3)`, 0 where it is blocked; `(N,)`."""
    lit = np.zeros(len(suns), np.float32)
    facing = np.empty(len(suns), np.int64)
    starts = np.empty((len(suns), 3), np.float32)
    count = _facing(hits.points, hits.normals, hits.objects, hits.ranges, suns, facing, starts)
    if not count:
        return lit
    facing, starts = facing[:count], starts[:count]
    rays = suns[facing]
    free = ~tracer.blocked(starts, rays)
    if occluder is not None:
        T_own_ds = occluder.T_ds_own.inverse()
        own = T_own_ds.apply(starts).astype(np.float32)
        free &= ~occluder.tracer.blocked(own, (rays @ T_own_ds.rotation.T).astype(np.float32))
    lit[facing] = free
    return lit


@jit
def _facing(
    points: FloatArray,
    normals: FloatArray,
    objects: NDArray[np.int32],
    ranges: FloatArray,
    suns: NDArray[np.float32],
    facing: NDArray[np.int64],
    starts: NDArray[np.float32],
) -> int:
    """Collect the hits that are turned to the sun, and points just above them; the others need no ray."""
    count = 0
    for n in range(len(objects)):
        if objects[n] == SKY_OBJECT:
            continue
        if normals[n, 0] * suns[n, 0] + normals[n, 1] * suns[n, 1] + normals[n, 2] * suns[n, 2] > 0.0:
            facing[count] = n
            for k in range(3):
                starts[count, k] = points[n, k] + (LIFT_M + LIFT_PER_RANGE * ranges[n]) * normals[n, k]
            count += 1
    return count


def hidden(tracer: Tracer, hits: Hits, T_ds_cam: Transform, rig: StereoRig) -> NDArray[np.bool_]:
    """Tell which hits `(N,)` a camera does not see: outside its picture or behind something; the sky counts as seen."""
    count = len(hits.objects)
    out = np.zeros(count, bool)
    which = np.empty(count, np.int64)
    starts, away = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    lens = np.array([rig.fx, rig.fy, 0.5 * rig.width, 0.5 * rig.height])
    T_cam_ds = T_ds_cam.inverse().matrix
    inside = _in_picture(
        hits.points, hits.normals, hits.objects, hits.ranges, T_cam_ds, T_ds_cam.translation, lens,
        out, which, starts, away,
    )  # fmt: skip
    if inside:
        reach = np.full(inside, 0.999, np.float32)
        out[which[:inside]] = tracer.blocked(starts[:inside], away[:inside], reach)
    return out


@jit
def _in_picture(
    points: FloatArray,
    normals: FloatArray,
    objects: NDArray[np.int32],
    ranges: FloatArray,
    T_cam_ds: FloatArray,
    camera: FloatArray,
    lens: FloatArray,
    out: NDArray[np.bool_],
    which: NDArray[np.int64],
    starts: NDArray[np.float32],
    away: NDArray[np.float32],
) -> int:
    """Mark the hits outside a picture; collect the others, with points just above them and the way to the camera."""
    count = 0
    local = np.empty(3)
    for n in range(len(objects)):
        if objects[n] == SKY_OBJECT:
            continue
        for k in range(3):
            local[k] = T_cam_ds[k, 3]
            for m in range(3):
                local[k] += T_cam_ds[k, m] * points[n, m]
        across, down = (
            abs(lens[0] * local[0]),
            abs(lens[1] * local[1]),
        )  # from the principal point, the picture's middle
        out[n] = not (local[2] > 0.0 and across < lens[2] * local[2] and down < lens[3] * local[2])
        if not out[n]:
            which[count] = n
            for k in range(3):
                starts[count, k] = points[n, k] + (LIFT_M + LIFT_PER_RANGE * ranges[n]) * normals[n, k]
                away[count, k] = camera[k] - points[n, k]
            count += 1
    return count


@jit
def _resolve(
    origin: FloatArray,
    rays: FloatArray,
    prims: NDArray[np.int32],
    us: NDArray[np.float32],
    vs: NDArray[np.float32],
    vertices: NDArray[np.float32],
    smooth: NDArray[np.float32],
    triangles: NDArray[np.int32],
    kinds: NDArray[np.int32],
    points: FloatArray,
    normals: FloatArray,
    objects: NDArray[np.int32],
    ranges: FloatArray,
) -> None:
    edge1, edge2, face = np.empty(3), np.empty(3), np.empty(3)
    for n in range(len(prims)):
        if prims[n] < 0:
            objects[n] = SKY_OBJECT
            ranges[n] = 1e9
            for k in range(3):
                points[n, k] = 0.0
                normals[n, k] = 0.0
            continue
        a, b, c = triangles[prims[n], 0], triangles[prims[n], 1], triangles[prims[n], 2]
        objects[n] = kinds[prims[n]]
        for k in range(3):
            start = np.float64(vertices[a, k])
            edge1[k] = np.float64(vertices[b, k]) - start
            edge2[k] = np.float64(vertices[c, k]) - start
        top, bottom, length = 0.0, 0.0, 0.0
        for k in range(3):
            p, q = (k + 1) % 3, (k + 2) % 3
            face[k] = edge1[p] * edge2[q] - edge1[q] * edge2[p]
            top += face[k] * (np.float64(vertices[a, k]) - origin[k])
            bottom += face[k] * rays[n, k]
        ranges[n] = top / bottom
        u, v = us[n], vs[n]
        for k in range(3):
            points[n, k] = origin[k] + ranges[n] * rays[n, k]
            normals[n, k] = (1.0 - u - v) * smooth[a, k] + u * smooth[b, k] + v * smooth[c, k]
            length += normals[n, k] * normals[n, k]
        length = 1.0 / np.sqrt(length)
        for k in range(3):
            normals[n, k] *= length
