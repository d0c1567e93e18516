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
    of the triangles that rays may pass, or None. shading: (T,) bool, those that cast shadows, or None: all do.
    `frame` is (center, scale): what turns world space into the space that is traced.
    """

    def __init__(self, vertices, triangles, usable, alpha=None, shading=None):
        self._alpha = alpha
        used = _used(vertices, triangles[usable])
        low, high = (vertices[used].min(axis=0), vertices[used].max(axis=0)) if len(used) else (np.zeros(3), np.ones(3))
        diagonal = float(np.sqrt(((high - low) ** 2).sum()))
        self.frame = ((low + high) / 2, 1.0 / diagonal if diagonal > 0 else 1.0)
        self._all = self._shading = self._made(vertices, triangles, usable, used)
        if shading is not None:
            chosen = usable & shading
            self._shading = self._made(vertices, triangles, chosen, _used(vertices, triangles[chosen]))
        self._seconds, self._rays, self._parts = 0.0, 0, {}
        if alpha is not None:
            self._normal = normal_and_area(*np.moveaxis(vertices[triangles], 1, 0))[0].astype(np.float32)

    def _made(self, vertices, triangles, chosen, used):
        """Chosen triangles (T,) bool, over only the vertices (K,) that these use, as an Embree scene, None if there are none,
        and their numbers, None if they are all."""
        if not chosen.any():
            return None, None
        number = np.zeros(len(vertices), np.int32)
        number[used] = np.arange(len(used), dtype=np.int32)
        scene = EmbreeScene(robust=True)
        TriangleMesh(scene, self.place(vertices[used]), number[triangles[chosen]])
        return scene, None if chosen.all() else np.flatnonzero(chosen).astype(np.int32)

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

    def hits(self, origins, directions, passing=True, shading=False):
        """The first hit of each of K rays. origins: (K, 3) float32 from `start`; directions: (K, 3) float32.

        Returns triangle (K,) int32, -1 where the ray escaped; u, v (K,) float32 place in the triangle; distance (K,)
        float32 in scene diagonals; back (K,) bool, the ray met the triangle's back side. passing: rays may pass
        surfaces that are there in part. shading: only what casts shadows is met.
        """
        among = self._shading if shading else self._all
        if among[0] is None:
            none = np.zeros(len(origins), np.float32)
            return np.full(len(origins), -1, np.int32), none, none, none, np.zeros(len(origins), bool)
        found = self._first(among, origins, directions)
        if self._alpha is not None and passing:
            begun = thread_time()
            for going, more in self._further(among, origins, directions, found):
                for values, new in zip(found, more):
                    values[going] = new
            self.note("transparency", begun)
        return found

    def blocked(self, origins, targets):
        """(K,) bool: whether anything lies between origins and targets, both (K, 3) float32 from `start` or `place`."""
        return self._stopped(self._all, origins, targets - origins, None, dists=1.0)

    def shaded(self, origins, targets, key, reach=1.0):
        """(K,) bool: whether anything that casts shadows lies between origins and targets on sources, both (K, 3) float32 from
        `start` or `place`.

        key: (K,) numbers that tell rays between the same two places apart, which may pass surfaces by chance. reach: share
        of the way that counts.
        """
        return self._stopped(self._shading, origins, targets - origins, key, dists=reach)

    def shaded_toward(self, origins, directions, key=None):
        """(K,) bool: whether rays without end hit anything that casts shadows; origins from `start`, directions (K, 3)
        float32; key: see `shaded`."""
        return self._stopped(self._shading, origins, directions, key)

    def _stopped(self, among, origins, directions, key, **options):
        """(K,) bool: whether rays are stopped by something among what `_made` made, that they do not pass."""
        if among[0] is None:
            return np.zeros(len(origins), bool)
        if self._alpha is None:
            return self._run(among, origins, directions, query="OCCLUDED", **options) >= 0
        found = self._first(among, origins, directions, **options)
        begun = thread_time()
        for going, more in self._further(among, origins, directions, found, options.get("dists", np.inf), key):
            found[0][going] = more[0]
        self.note("transparency", begun)
        return found[0] >= 0

    def _first(self, among, origins, directions, **options):
        """What `hits` returns, of the first triangles that are met, whatever they are."""
        hit = self._run(among, origins, directions, output=True, **options)
        normal = hit["Ng"]
        facing = normal[:, 0] * directions[:, 0]
        facing += normal[:, 1] * directions[:, 1]
        facing += normal[:, 2] * directions[:, 2]
        triangle = hit["primID"]
        if among[1] is not None:
            triangle = np.where(triangle < 0, -1, np.take(among[1], triangle))
        return triangle, hit["u"], hit["v"], hit["tfar"], facing > 0

    def _further(self, among, origins, directions, found, end=np.inf, key=None):
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
            triangle, u, v, distance, back = self._first(among, start, direction)
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

    def _run(self, among, origins, directions, **options):
        begun = thread_time()
        result = among[0].run(origins, directions, **options)
        self._seconds += thread_time() - begun
        self._rays += len(origins)
        return result


def _used(vertices, triangles):
    """(K,) the vertices that triangles use, in order."""
    used = np.zeros(len(vertices), bool)
    used[triangles] = True
    return np.flatnonzero(used)
