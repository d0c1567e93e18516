"""Ray casting: the only module that touches embreex.

Embree works in float32 and its errors are relative to the size of the coordinates, so the facade moves the scene to
the origin and scales it to a diagonal of 1 in float64 before anything is rounded. There the distance `OFFSET` means
the same in every scene: rays start that far from their surface, along its normal. (Offsets along the ray leak light
through thin walls; offsets along the normal do not.) Robust mode: without it rays slip through between triangles.
"""

from __future__ import annotations

from time import thread_time

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from .scene import normal_and_area

OFFSET = 1e-5  # of the scene's diagonal: no false hits and no leaks in 250 000 segments of the closed-box test


class RayCaster:
    """Casts rays at the triangles of a scene. Points are given in world space, float64; directions are unit vectors.

    vertices: (V, 3) float64. triangles: (T, 3) int. usable: (T,) bool, the triangles that can be hit. alpha: the Alpha
    of the triangles that rays may pass, or None.
    `frame` is (center, scale): what turns world space into the space that is traced.
    """

    def __init__(self, vertices, triangles, usable, alpha=None):
        self._alpha = alpha
        self._empty = not usable.any()
        used = np.zeros(len(vertices), bool)
        used[triangles[usable]] = True
        used = np.flatnonzero(used)
        # The numbers of those that are there, if some are not.
        self._triangle = None if usable.all() else np.flatnonzero(usable).astype(np.int32)
        low, high = (vertices[used].min(axis=0), vertices[used].max(axis=0)) if len(used) else (np.zeros(3), np.ones(3))
        diagonal = float(np.sqrt(((high - low) ** 2).sum()))
        self.frame = ((low + high) / 2, 1.0 / diagonal if diagonal > 0 else 1.0)
        # The scene holds only usable triangles, over only the vertices that these use.
        number = np.zeros(len(vertices), np.int32)
        number[used] = np.arange(len(used), dtype=np.int32)
        self._scene = EmbreeScene(robust=True)
        self._seconds, self._rays, self._parts = 0.0, 0, {}
        if alpha is not None:
            self._normal = normal_and_area(*np.moveaxis(vertices[triangles], 1, 0))[0].astype(np.float32)
        if len(used):
            TriangleMesh(self._scene, self.place(vertices[used]), number[triangles[usable]])

    @property
    def veiled(self):
        """Whether rays may pass some of the triangles."""
        return self._alpha is not None

    def place(self, points):
        """World points (..., 3) in the space that is traced, float32."""
        return self._framed(points, 0.0, np.zeros(3))

    def start(self, points, normals):
        """Where rays from surface points (..., 3) set out, float32: `OFFSET` above the surface, along its normal."""
        return self._framed(points, OFFSET, normals)

    def _framed(self, points, offset, normals):
        """Points (..., 3) so far along normals (..., 3), in the space that is traced. Coordinate by coordinate, which takes
        a quarter to two thirds of the time."""
        (center, scale), shape = self.frame, np.broadcast_shapes(np.shape(points), np.shape(normals))
        result = np.empty(shape, np.float32)
        for k in range(3):
            along = points[..., k] - center[k]
            along *= scale
            result[..., k] = along + offset * normals[..., k] if offset else along
        return result

    def hits(self, origins, directions, passing=True):
        """The first hit of each of K rays. origins: (K, 3) float32 from `start`; directions: (K, 3) float32.

        Returns triangle (K,) int32, -1 where the ray escaped; u, v (K,) float32 place in the triangle; distance (K,)
        float32 in scene diagonals; back (K,) bool, the ray met the triangle's back side. passing: rays may pass
        surfaces that are there in part.
        """
        if self._empty:
            none = np.zeros(len(origins), np.float32)
            return np.full(len(origins), -1, np.int32), none, none, none, np.zeros(len(origins), bool)
        found = self._first(origins, directions)
        if self._alpha is not None and passing:
            begun = thread_time()
            for going, more in self._further(origins, directions, found):
                for values, new in zip(found, more):
                    values[going] = new
            self.note("transparency", begun)
        return found

    def blocked(self, origins, targets, key=None, reach=1.0):
        """(K,) bool: whether anything lies between origins and targets, both (K, 3) float32 from `start` or `place`.

        key: (K,) numbers that tell rays between the same two places apart, which may pass surfaces by chance. reach: share
        of the way that counts.
        """
        return self._stopped(origins, targets - origins, key, dists=reach)

    def blocked_toward(self, origins, directions, key=None):
        """(K,) bool: whether rays without end hit anything; origins from `start`, directions (K, 3) float32; key: see
        `blocked`."""
        return self._stopped(origins, directions, key)

    def _stopped(self, origins, directions, key, **options):
        """(K,) bool: whether rays are stopped by something that they do not pass."""
        if self._empty:
            return np.zeros(len(origins), bool)
        if self._alpha is None:
            return self._run(origins, directions, query="OCCLUDED", **options) >= 0
        found = self._first(origins, directions, **options)
        begun = thread_time()
        for going, more in self._further(origins, directions, found, options.get("dists", np.inf), key):
            found[0][going] = more[0]
        self.note("transparency", begun)
        return found[0] >= 0

    def _first(self, origins, directions, **options):
        """What `hits` returns, of the first triangles that are met, whatever they are."""
        hit = self._run(origins, directions, output=True, **options)
        normal = hit["Ng"]
        facing = normal[:, 0] * directions[:, 0]
        facing += normal[:, 1] * directions[:, 1]
        facing += normal[:, 2] * directions[:, 2]
        triangle = hit["primID"]
        if self._triangle is not None:
            triangle = np.where(triangle < 0, -1, np.take(self._triangle, triangle))
        return triangle, hit["u"], hit["v"], hit["tfar"], facing > 0

    def _further(self, origins, directions, found, end=np.inf, key=None):
        """For rays that pass what they have `found`, again and again: yields their numbers (L,), and what they find behind
        it, up to the distance `end`."""
        name = np.column_stack([origins, directions] if key is None else [origins, directions, key])
        name = name.astype(np.float32).view(np.uint32)
        going, depth, start = np.arange(len(origins)), 0, origins
        triangle, u, v, distance, back = found
        travelled = distance
        while True:
            passed = self._alpha.passed(triangle, u, v, name[going], depth)
            if not passed.any():
                return
            # The next ray sets out above the other side of what was passed.
            lift = np.where(back[passed], OFFSET, -OFFSET)[:, None] * self._normal[triangle[passed]]
            going, travelled, depth = going[passed], travelled[passed], depth + 1
            direction = directions[going]
            start = (start[passed] + distance[passed, None] * direction + lift).astype(np.float32)
            triangle, u, v, distance, back = self._first(start, direction)
            travelled = travelled + distance
            triangle = np.where(travelled < end, triangle, -1)
            yield going, (triangle, u, v, travelled, back)

    def note(self, part, since):
        """Count the CPU seconds of this thread since a moment (of `time.thread_time`) as those of a part of the work."""
        self._parts[part] = self._parts.get(part, 0.0) + thread_time() - since

    def spent(self):
        """CPU seconds inside Embree, rays cast, and {part: CPU seconds} that were noted, since the last call."""
        spent = self._seconds, self._rays, self._parts
        self._seconds, self._rays, self._parts = 0.0, 0, {}
        return spent

    def _run(self, origins, directions, **options):
        begun = thread_time()
        result = self._scene.run(origins, directions, **options)
        self._seconds += thread_time() - begun
        self._rays += len(origins)
        return result
