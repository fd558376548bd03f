"""Rays through the pixels of an image and towards the sun, and what they hit: exact, by ray tracing."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MissingExtraError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit, jit_inline
from sfr_loc_map.simulation.noise import hash2, mix, unit
from sfr_loc_map.simulation.terrain import Mesh

SKY, GROUND = -2, -1  #: Object that a ray hits, if it is not the rock of that number.


class Hits(NamedTuple):
    """Hits of N rays."""

    points: FloatArray  #: `(N, 3)` float64, metres, DS; undefined for the sky.
    normals: FloatArray  #: `(N, 3)` float64, unit, smooth.
    objects: NDArray[np.int32]  #: `(N,)` int32, -2 for the sky, -1 for the ground, else the number of a rock.
    ranges: FloatArray  #: `(N,)` float64, metres.


class Camera(NamedTuple):
    """A pinhole camera as kernels take it."""

    rotation: FloatArray  #: `(3, 3)` optical frame to DS.
    centre: FloatArray  #: `(3,)` metres, DS.
    fx: float  #: Focal length along rows, pixels.
    fy: float  #: Focal length along columns, pixels.
    cx: float  #: Principal point, pixels.
    cy: float  #: Principal point, pixels.

    @classmethod
    def of(cls, rig: StereoRig, T_ds_cam: Transform) -> Camera:
        """Return a camera of a rig at a pose of its optical frame."""
        rotation, centre = np.ascontiguousarray(T_ds_cam.rotation), np.ascontiguousarray(T_ds_cam.translation)
        return cls(rotation, centre, float(rig.fx), float(rig.fy), float(rig.cx), float(rig.cy))


@jit
def pixel_rays(camera: Camera, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return unit rays `(N, 3)` in DS through pixels `(N,)`."""
    out = np.empty((len(u), 3))
    rotation = camera.rotation
    for n in range(len(u)):
        x, y = (u[n] - camera.cx) / camera.fx, (v[n] - camera.cy) / camera.fy
        length = 1.0 / np.sqrt(x * x + y * y + 1.0)
        for k in range(3):
            out[n, k] = (rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2]) * length
    return out


def sample_offsets(samples: int) -> FloatArray:
    """Return the offsets of samples in a pixel and in the exposure `(S, 3)`: column, row, time, in [-0.5, 0.5), mean 0.

    The additive sequence of the plastic number in two dimensions: a few samples cover the pixel evenly.
    """
    k = np.arange(samples)
    root = 1.32471795724474602596
    offset = np.mod(0.5 + np.outer(k + 1, (1 / root, 1 / root**2)), 1.0)
    table = np.column_stack((offset, (k + 0.5) / samples))
    return np.asarray(table - table.mean(axis=0))


def sun_rays(sun: FloatArray, radius_rad: float, count: int, key: np.uint32) -> NDArray[np.float32]:
    """Return directions `(N, 3)` towards points of the sun's disc, evenly spread, the same for the same key."""
    side = np.cross(sun, (0.0, 0.0, 1.0) if abs(sun[2]) < 0.99 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    out = np.empty((count, 3), np.float32)
    _disc(sun, side, np.cross(sun, side), radius_rad, key, out)
    return out


@jit
def _disc(
    sun: FloatArray, side: FloatArray, up: FloatArray, radius: float, key: np.uint32, out: NDArray[np.float32]
) -> None:
    for n in range(len(out)):
        h = hash2(n, 17, key)
        r, angle = radius * np.sqrt(unit(h)), 6.283185307179586 * unit(mix(h))
        a, b = r * np.cos(angle), r * np.sin(angle)
        for k in range(3):
            out[n, k] = sun[k] + a * side[k] + b * up[k]


def camera_pose(T_ds_sb: Transform, rig: StereoRig, right: bool) -> Transform:
    """Return `T_ds_cam` of the left or right optical frame, from the pose of the stereo rig."""
    T_ds_left = T_ds_sb @ rig.T_sb_left
    if not right:
        return T_ds_left
    return T_ds_left @ Transform(np.eye(3), np.array([rig.baseline_m, 0.0, 0.0]))


BAND_RAYS = 1 << 17  #: Rays traced at once: few enough to stay in the processor's cache.
LIFT_M = 2e-4  #: Shadow rays start this far above the surface, so that a triangle does not shade itself.
LIFT_PER_RANGE = 1e-4
NUDGE = 1e-5
LEVEL_RAY = -0.05  #: A ray that goes down by more than this must meet the ground.
SKY_RANGE_M = 1e9
Float32s = NDArray[np.float32]


def require_tracer() -> None:
    """Check that the ray tracer is installed; raises MissingExtraError if not."""
    try:
        import_module("embreex.rtcore_scene")
    except ImportError as error:
        raise MissingExtraError(
            "simulation needs the ray tracer embreex, which is not installed: pip install 'sfr_loc_map[sim]'"
        ) from error


class FirstHits(NamedTuple):
    """First hits of N rays as the ray tracer returns them."""

    triangles: NDArray[np.int32]  #: `(N,)` int32, index of the triangle; -1 for none.
    us: Float32s  #: `(N,)` float32, barycentric coordinate of the second corner.
    vs: Float32s  #: `(N,)` float32, barycentric coordinate of the third corner.


class Tracer:
    """Finds what rays hit first, and whether light reaches a point."""

    def __init__(self, mesh: Mesh) -> None:
        """Build the search tree; raises MissingExtraError if the ray tracer is not installed."""
        require_tracer()
        self.mesh = mesh
        self._scene: Any = import_module("embreex.rtcore_scene").EmbreeScene(robust=True)
        self._keep: Any = import_module("embreex.mesh_construction").TriangleMesh(
            self._scene, mesh.vertices, mesh.triangles
        )

    def first(self, origins: Float32s, rays: Float32s) -> FirstHits:
        """Return the first hit of each ray `(N, 3)`."""
        hits = self._scene.run(origins, rays, output=1)
        return FirstHits(hits["primID"], hits["u"], hits["v"])

    def blocked(self, origins: Float32s, rays: Float32s, reach: Float32s | None = None) -> Mask:
        """Return the mask of the rays `(N, 3)` that hit anything, before `reach` ray lengths if given."""
        found: NDArray[np.int32] = self._scene.run(origins, rays, dists=reach, query="OCCLUDED")
        return found >= 0


def trace_primary_rays(tracer: Tracer, origin: FloatArray, rays: FloatArray) -> Hits:
    """Return the hits of rays; the points are exact on the plane of the triangle that was hit."""
    count = len(rays)
    starts = np.empty((count, 3), np.float32)
    starts[:] = origin
    first = tracer.first(starts, rays.astype(np.float32))
    leaks = np.flatnonzero((first.triangles < 0) & (rays[:, 2] < LEVEL_RAY))
    if len(leaks):  # rays that slipped through the seam of two tiles
        again = tracer.first(starts[leaks], (rays[leaks] + NUDGE).astype(np.float32))
        for values, found in zip(first, again, strict=True):
            values[leaks] = found
    hits = Hits(np.empty((count, 3)), np.empty((count, 3)), np.empty(count, np.int32), np.empty(count))
    _intersect_planes(origin, rays, first, tracer.mesh, hits)
    return hits


@jit
def _intersect_planes(origin: FloatArray, rays: FloatArray, first: FirstHits, mesh: Mesh, out: Hits) -> None:
    """Write the hits: intersections of the rays with the planes of their triangles, in double precision."""
    edge1, edge2, face = np.empty(3), np.empty(3), np.empty(3)
    for n in range(len(first.triangles)):
        number = first.triangles[n]
        if number < 0:
            out.objects[n], out.ranges[n] = SKY, SKY_RANGE_M
            for k in range(3):
                out.points[n, k] = 0.0
                out.normals[n, k] = 0.0
            continue
        a, b, c = mesh.triangles[number, 0], mesh.triangles[number, 1], mesh.triangles[number, 2]
        out.objects[n] = mesh.objects[number]
        for k in range(3):
            start = np.float64(mesh.vertices[a, k])
            edge1[k] = np.float64(mesh.vertices[b, k]) - start
            edge2[k] = np.float64(mesh.vertices[c, k]) - start
        top, bottom, length = 0.0, 0.0, 0.0
        for k in range(3):
            p, q = (k + 1) % 3, (k + 2) % 3
            face[k] = edge1[p] * edge2[q] - edge1[q] * edge2[p]
            top += face[k] * (np.float64(mesh.vertices[a, k]) - origin[k])
            bottom += face[k] * rays[n, k]
        out.ranges[n] = top / bottom
        u, v = first.us[n], first.vs[n]
        for k in range(3):
            out.points[n, k] = origin[k] + out.ranges[n] * rays[n, k]
            out.normals[n, k] = (1.0 - u - v) * mesh.normals[a, k] + u * mesh.normals[b, k] + v * mesh.normals[c, k]
            length += out.normals[n, k] * out.normals[n, k]
        length = 1.0 / np.sqrt(length)
        for k in range(3):
            out.normals[n, k] *= length


@dataclass(frozen=True, slots=True, eq=False)
class Occluder:
    """Something that moves and casts a shadow but is not visible."""

    tracer: Tracer  #: Its shape in its own frame.
    T_ds_own: Transform  #: Its pose.


def trace_shadow_rays(tracer: Tracer, hits: Hits, suns: Float32s, occluder: Occluder | None = None) -> Float32s:
    """Return 1 where light arrives from the direction `suns` `(N, 3)`, 0 where it is blocked; `(N,)`."""
    lit = np.zeros(len(suns), np.float32)
    sunward = np.empty(len(suns), np.int64)
    starts = np.empty((len(suns), 3), np.float32)
    count = _facing_sun(hits, suns, sunward, starts)
    if not count:
        return lit
    sunward, starts = sunward[:count], starts[:count]
    rays = suns[sunward]
    free = ~tracer.blocked(starts, rays)
    if occluder is not None:
        T_own_ds = occluder.T_ds_own.inverse()
        own = T_own_ds.apply(starts).astype(np.float32)
        free &= ~occluder.tracer.blocked(own, (rays @ T_own_ds.rotation.T).astype(np.float32))
    lit[sunward] = free
    return lit


@jit_inline
def _lift(hits: Hits, n: int, out: Float32s) -> None:
    """Write the point `(3,)` just above a hit."""
    for k in range(3):
        out[k] = hits.points[n, k] + (LIFT_M + LIFT_PER_RANGE * hits.ranges[n]) * hits.normals[n, k]


@jit
def _facing_sun(hits: Hits, suns: Float32s, sunward: IntArray, starts: Float32s) -> int:
    """Collect the hits that face the sun, and points just above them; the others need no ray."""
    count = 0
    normals = hits.normals
    for n in range(len(hits.objects)):
        if hits.objects[n] == SKY:
            continue
        if normals[n, 0] * suns[n, 0] + normals[n, 1] * suns[n, 1] + normals[n, 2] * suns[n, 2] > 0.0:
            sunward[count] = n
            _lift(hits, n, starts[count])
            count += 1
    return count


class IdealImage(NamedTuple):
    """An ideal image as kernels take it; the principal point is its centre."""

    T_cam_ds: FloatArray  #: `(4, 4)` DS to the optical frame.
    centre: FloatArray  #: `(3,)` optical centre, metres, DS.
    fx: float  #: Focal length along rows, pixels.
    fy: float  #: Focal length along columns, pixels.
    half_width: float  #: Pixels.
    half_height: float  #: Pixels.


def occlusion_mask(tracer: Tracer, hits: Hits, T_ds_cam: Transform, rig: StereoRig) -> Mask:
    """Return the mask `(N,)` of the hits that a camera does not see: outside its image or occluded; not the sky."""
    count = len(hits.objects)
    mask = np.zeros(count, bool)
    inside = np.empty(count, np.int64)
    starts, towards = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    halves = (0.5 * rig.width, 0.5 * rig.height)
    view = IdealImage(T_ds_cam.inverse().matrix, T_ds_cam.translation, float(rig.fx), float(rig.fy), *halves)
    found = _within_image(hits, view, mask, inside, starts, towards)
    if found:
        reach = np.full(found, 0.999, np.float32)
        mask[inside[:found]] = tracer.blocked(starts[:found], towards[:found], reach)
    return mask


@jit
def _within_image(
    hits: Hits, view: IdealImage, outside: Mask, inside: IntArray, starts: Float32s, towards: Float32s
) -> int:
    """Mark the hits outside an image; collect the others, with points just above them and vectors to the camera."""
    count = 0
    local = np.empty(3)
    for n in range(len(hits.objects)):
        if hits.objects[n] == SKY:
            continue
        for k in range(3):
            local[k] = view.T_cam_ds[k, 3]
            for m in range(3):
                local[k] += view.T_cam_ds[k, m] * hits.points[n, m]
        across, down = abs(view.fx * local[0]), abs(view.fy * local[1])  # from the image centre, times the depth
        outside[n] = not (local[2] > 0.0 and across < view.half_width * local[2] and down < view.half_height * local[2])
        if not outside[n]:
            inside[count] = n
            _lift(hits, n, starts[count])
            for k in range(3):
                towards[count, k] = view.centre[k] - hits.points[n, k]
            count += 1
    return count
