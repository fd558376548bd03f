"""Ray tracing of pixels, shadows and occlusions."""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MissingExtraError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit
from sfr_loc_map.simulation.ground_mesh import Mesh
from sfr_loc_map.simulation.noise import hash2, mix, unit
from sfr_loc_map.suite_names import Side

SKY = -2  #: Object number of the sky.
GROUND = -1  #: Object number of the ground; rocks are numbered from 0.
BAND_RAYS = 1 << 17  #: Rays that are traced together: few enough for the processor's cache.
LIFT_M = 2e-4  #: Shadow rays start this far above the surface, m, so that a triangle does not shade itself.
LIFT_PER_RANGE = 1e-4  #: Additional height per metre of range, because float32 is coarser at long range.
NUDGE = 1e-5  #: Change of direction with which a ray is traced again if it passed between two tiles.
LEVEL_RAY = -0.05  #: Rays whose z component is below this value are expected to hit the ground.
SKY_RANGE_M = 1e9  #: Range of a ray that hits no surface, m: beyond all haze.
CAMERA_REACH = 0.999  #: Rays to a camera end at this fraction of the distance, so that they do not reach the camera.
PLASTIC_NUMBER = 1.32471795724474602596  #: Root of `x^3 = x + 1`, for `sample_offsets`.
SUN_SAMPLE_KEY = 17  #: Arbitrary key of the random points of the sun's disc.
Float32s = NDArray[np.float32]


class Hits(NamedTuple):
    """Hits of N rays."""

    points: FloatArray  #: `(N, 3)` float64, metres, DS; undefined for the sky.
    normals: FloatArray  #: `(N, 3)` float64, interpolated unit normals.
    objects: NDArray[np.int32]  #: `(N,)` int32, -2 for the sky, -1 for the ground, else the number of a rock.
    ranges: FloatArray  #: `(N,)` float64, metres.


def pixel_rays(rig: StereoRig, T_ds_cam: Transform, u: FloatArray | IntArray, v: FloatArray | IntArray) -> FloatArray:
    """Return unit rays `(N, 3)` in DS through pixels `(N,)` of a camera with the optical frame `T_ds_cam`."""
    x = (u - rig.cx) / rig.fx
    y = (v - rig.cy) / rig.fy
    length = 1.0 / np.sqrt(x * x + y * y + 1.0)
    return np.column_stack([(a * x + b * y + c) * length for a, b, c in T_ds_cam.rotation])


def sample_offsets(samples: int) -> FloatArray:
    """Return sample offsets `(S, 3)` in a pixel and its exposure: column, row, time, about -0.5 to 0.5, mean 0.

    The two-dimensional additive recurrence of the plastic number covers the pixel uniformly, even with few samples.
    """
    k = np.arange(samples)
    steps = (1 / PLASTIC_NUMBER, 1 / PLASTIC_NUMBER**2)
    offset = np.mod(0.5 + np.outer(k + 1, steps), 1.0)
    table = np.column_stack((offset, (k + 0.5) / samples))
    return np.asarray(table - table.mean(axis=0))


def sun_rays(sun: FloatArray, radius_rad: float, count: int, key: np.uint32) -> NDArray[np.float32]:
    """Return directions `(N, 3)` towards uniformly distributed points of the sun's disc; `key` is the random seed."""
    side = np.cross(sun, (0.0, 0.0, 1.0) if abs(sun[2]) < 0.99 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    out = np.empty((count, 3), np.float32)
    _disc(sun, side, np.cross(sun, side), radius_rad, key, out)
    return out


@jit
def _disc(
    sun: FloatArray, side: FloatArray, up: FloatArray, radius: float, key: np.uint32, out: NDArray[np.float32]
) -> None:
    """Write directions `(N, 3)` to points of a disc of angular radius `radius`, rad, around the direction `sun`."""
    for n in range(len(out)):
        h = hash2(n, SUN_SAMPLE_KEY, key)
        r = radius * np.sqrt(unit(h))
        angle = 2.0 * np.pi * unit(mix(h))
        a = r * np.cos(angle)
        b = r * np.sin(angle)
        for k in range(3):
            out[n, k] = sun[k] + a * side[k] + b * up[k]


def camera_pose(T_ds_sb: Transform, rig: StereoRig, side: Side) -> Transform:
    """Return `T_ds_cam` of the left or right optical frame."""
    T_ds_left = T_ds_sb @ rig.T_sb_left
    if side == "left":
        return T_ds_left
    return T_ds_left @ Transform(np.eye(3), np.array([rig.baseline_m, 0.0, 0.0]))


def require_tracer() -> None:
    """Raise MissingExtraError if the ray tracer is not installed."""
    try:
        import_module("embreex.rtcore_scene")
    except ImportError as error:
        raise MissingExtraError(
            "simulation requires the ray tracer embreex, which is not installed: pip install 'sfr_loc_map[sim]'"
        ) from error


class Tracer:
    """Finds the first hits of rays, and whether rays are blocked."""

    def __init__(self, mesh: Mesh) -> None:
        """Build the acceleration structure; MissingExtraError if the ray tracer is not installed."""
        require_tracer()
        self.mesh = mesh
        self._scene: Any = import_module("embreex.rtcore_scene").EmbreeScene(robust=True)
        self._keep: Any = import_module("embreex.mesh_construction").TriangleMesh(
            self._scene, mesh.vertices, mesh.triangles
        )

    def first(self, origins: Float32s, rays: Float32s) -> tuple[NDArray[np.int32], Float32s, Float32s]:
        """Return the first triangle `(N,)` that each ray `(N, 3)` hits, -1 for none, and the barycentric u, v."""
        hits = self._scene.run(origins, rays, output=1)
        return hits["primID"], hits["u"], hits["v"]

    def blocked(self, origins: Float32s, rays: Float32s, reach: Float32s | None = None) -> Mask:
        """Return the mask of rays `(N, 3)` that hit anything, within `reach` ray lengths if given."""
        found: NDArray[np.int32] = self._scene.run(origins, rays, dists=reach, query="OCCLUDED")
        return found >= 0


def trace_primary_rays(tracer: Tracer, origin: FloatArray, rays: FloatArray) -> Hits:
    """Return the hits of rays; points are computed in float64 on the plane of the triangle."""
    count = len(rays)
    starts = np.empty((count, 3), np.float32)
    starts[:] = origin
    first = tracer.first(starts, rays.astype(np.float32))
    leaks = np.flatnonzero((first[0] < 0) & (rays[:, 2] < LEVEL_RAY))
    if len(leaks):  # these rays passed between two tiles
        again = tracer.first(starts[leaks], (rays[leaks] + NUDGE).astype(np.float32))
        for values, found in zip(first, again, strict=True):
            values[leaks] = found
    hits = Hits(np.empty((count, 3)), np.empty((count, 3)), np.empty(count, np.int32), np.empty(count))
    _intersect_planes(origin, rays, *first, tracer.mesh, hits)
    return hits


@jit
def _intersect_planes(
    origin: FloatArray,
    rays: FloatArray,
    triangles: NDArray[np.int32],
    us: Float32s,
    vs: Float32s,
    mesh: Mesh,
    out: Hits,
) -> None:
    """Write the hits: intersections of the rays with the planes of their triangles, in double precision."""
    edge1 = np.empty(3)
    edge2 = np.empty(3)
    face = np.empty(3)
    for n in range(len(triangles)):
        number = triangles[n]
        if number < 0:
            out.objects[n] = SKY
            out.ranges[n] = SKY_RANGE_M
            for k in range(3):
                out.points[n, k] = 0.0
                out.normals[n, k] = 0.0
            continue
        a = mesh.triangles[number, 0]
        b = mesh.triangles[number, 1]
        c = mesh.triangles[number, 2]
        out.objects[n] = mesh.objects[number]
        for k in range(3):
            start = np.float64(mesh.vertices[a, k])
            edge1[k] = np.float64(mesh.vertices[b, k]) - start
            edge2[k] = np.float64(mesh.vertices[c, k]) - start
        top = 0.0
        bottom = 0.0
        for k in range(3):
            p = (k + 1) % 3
            q = (k + 2) % 3
            face[k] = edge1[p] * edge2[q] - edge1[q] * edge2[p]
            top += face[k] * (np.float64(mesh.vertices[a, k]) - origin[k])
            bottom += face[k] * rays[n, k]
        out.ranges[n] = top / bottom
        u = us[n]
        v = vs[n]
        squared_length = 0.0
        for k in range(3):
            out.points[n, k] = origin[k] + out.ranges[n] * rays[n, k]
            out.normals[n, k] = (1.0 - u - v) * mesh.normals[a, k] + u * mesh.normals[b, k] + v * mesh.normals[c, k]
            squared_length += out.normals[n, k] * out.normals[n, k]
        scale = 1.0 / np.sqrt(squared_length)
        for k in range(3):
            out.normals[n, k] *= scale


def trace_shadow_rays(
    tracer: Tracer, hits: Hits, suns: Float32s, occluder: tuple[Tracer, Transform] | None = None
) -> Float32s:
    """Return `(N,)`: 1 where sunlight arrives from the direction `suns` `(N, 3)`, 0 where it is blocked.

    `occluder` is a shape with its pose in DS; the shape casts a shadow but is invisible.
    """
    lit = np.zeros(len(suns), np.float32)
    # surfaces that face away from the sun need no ray
    sunward = np.flatnonzero((hits.objects != SKY) & (np.einsum("ij,ij->i", hits.normals, suns) > 0.0))
    if not len(sunward):
        return lit
    starts = _just_above(hits, sunward)
    rays = suns[sunward]
    free = ~tracer.blocked(starts, rays)
    if occluder is not None:
        shape, T_ds_own = occluder
        T_own_ds = T_ds_own.inverse()
        own_starts = T_own_ds.apply(starts).astype(np.float32)
        free &= ~shape.blocked(own_starts, (rays @ T_own_ds.rotation.T).astype(np.float32))
    lit[sunward] = free
    return lit


def _just_above(hits: Hits, rows: NDArray[np.intp]) -> Float32s:
    """Return the starts `(M, 3)` of rays from hits, given by their rows `(M,)`, slightly above their surfaces."""
    points = hits.normals[rows]
    points *= (LIFT_M + LIFT_PER_RANGE * hits.ranges[rows])[:, None]
    points += hits.points[rows]
    return np.asarray(points, np.float32)


def occlusion_mask(tracer: Tracer, hits: Hits, T_ds_cam: Transform, rig: StereoRig) -> Mask:
    """Return the mask `(N,)` of surface hits that a camera does not observe: outside the image, or occluded."""
    x, y, depth = T_ds_cam.inverse().apply(hits.points).T
    u_times_depth = rig.fx * x + rig.cx * depth
    v_times_depth = rig.fy * y + rig.cy * depth
    # The image extends by half a pixel beyond the centres of its outer pixels. Behind the camera, no point is inside.
    inside = (
        (-0.5 * depth < u_times_depth)
        & (u_times_depth < (rig.width - 0.5) * depth)
        & (-0.5 * depth < v_times_depth)
        & (v_times_depth < (rig.height - 0.5) * depth)
    )
    surface = hits.objects != SKY
    mask: Mask = surface & ~inside
    rows = np.flatnonzero(surface & inside)
    if len(rows):
        towards = np.asarray(T_ds_cam.translation - hits.points[rows], np.float32)
        reach = np.full(len(rows), CAMERA_REACH, np.float32)
        mask[rows] = tracer.blocked(_just_above(hits, rows), towards, reach)
    return mask
