"""What a cell holds: the arrays that every task works on, and the ray caster built over them.

Owns the `Kernel` and the one step that all tasks share, finding the patch sides that rays meet. Nothing here changes
from task to task, so a task may run twice, anywhere, in any order, with the same result.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from .alpha import Alpha, make_alpha
from .crowd import Given, any_long, make_crowd, members_of
from .guide import NOTHING, GuideGeometry
from .lights import BALL, Sources, unoccluded
from .patches import Patches, patch_of_hit
from .raycast import RayCaster
from .records import from_arrays, to_arrays
from .sky import cells_of
from .vectors import dot, length

NONE = np.zeros(0)  # stands for an array that there is not: cells keep what they are not given anew
MOST_GIVEN = 1 << 21  # of groups of a crowd on patch sides that are kept, 24 MB
LEVEL = 0.9999  # cosine of the angle between a side and its places, up to which they are flat
WIDE = 0.03  # of the scene's diagonal: a side that reaches further from its middle is wide
MOST_FACTORS = 1 << 21  # of sources at points that are kept, 16 MB


def cast_arrays(scene, veiled=False):
    """The arrays that cells need to cast rays, as {name: array}. veiled: as if rays might pass surfaces, even if none
    can."""
    alpha = make_alpha(scene, veiled)
    return {
        "scene.vertices": scene.vertices, "scene.triangles": scene.triangles, "scene.usable": scene.usable,
        "scene.shading": NONE if scene.shading is None else scene.shading[scene.polygon_object[scene.triangle_polygon]],
        **({"scene.alpha.kind": NONE} if alpha is None else to_arrays("scene.alpha", alpha)),
    }  # fmt: skip


def transport_arrays(patches, sources, occluded=True, sky=1):
    """Those that they need beside them for transport. occluded: something may stand between a source and what it could
    light; else no ray looks whether it does. sky: cells of the map that escaping rays read."""
    return {
        **to_arrays("patches", patches), **to_arrays("sources", sources),
        **to_arrays("guide", NOTHING), "occlusion.any": np.array(occluded), "alpha.coverage": NONE, "sky.cells": np.array(sky),
    }  # fmt: skip


def scene_arrays(scene, patches, sources, sky=1):
    """The arrays that cells need for transport, as {name: array}."""
    return {**cast_arrays(scene), **transport_arrays(patches, sources, sky=sky)}


class Kernel:
    """The arrays of a cell by name, and what is built from them when first asked for."""

    def __init__(self, arrays):
        self.arrays = dict(arrays)
        self.tasks, self.peak = 0, 0.0  # done, and memory [MB] at the last look
        self._last = {}

    @cached_property
    def caster(self):
        alpha = from_arrays(Alpha, "scene.alpha", self.arrays) if len(self.arrays["scene.alpha.kind"]) else None
        shading = self.arrays["scene.shading"]
        return RayCaster(
            self.vertices, self.triangles, self.arrays["scene.usable"], alpha, shading if len(shading) else None
        )

    @property
    def vertices(self):
        return self.arrays["scene.vertices"]

    @property
    def triangles(self):
        return self.arrays["scene.triangles"]

    @cached_property
    def patches(self):
        return from_arrays(Patches, "patches", self.arrays)

    @cached_property
    def sizes(self):
        """(N,) float32 square roots of the areas of patches, in scene diagonals."""
        return (np.sqrt(self.patches.area) * self.caster.frame[1]).astype(np.float32)

    @property
    def sources(self):
        """The Sources that are tested one by one."""
        return self._split[0]

    @property
    def crowd(self):
        """The Crowd of the others, or None."""
        return self._split[1]

    @property
    def picked(self):
        """All sources as those places need them that pick a single one: Sources, and a Crowd of the others or None."""
        return self._split[2:]

    @cached_property
    def _split(self):
        every = from_arrays(Sources, "sources", self.arrays)
        middle, scale = self.caster.frame
        diagonal = 1.0 / scale
        chosen, endless = members_of(every, diagonal), every.kind > BALL
        alone = every.only(~chosen) if chosen.any() else every
        pieces = (
            ~endless if chosen.any() or any_long(every) else chosen
        )  # a few that are not long are as well picked whole
        whole = every.only(~pieces) if pieces.any() else every
        return alone, make_crowd(every, chosen, middle, diagonal), whole, make_crowd(every, pieces, middle, diagonal)

    @cached_property
    def sky_size(self):
        """Cells of a side of the map that escaping rays read."""
        return int(np.sqrt(self.arrays["sky.cells"]))

    @property
    def coverage(self):
        """(N,) share of patches that is there, or None: all of all."""
        coverage = self.arrays["alpha.coverage"]
        return coverage if len(coverage) else None

    @property
    def occluded(self):
        """Whether something may stand between a source and what it could light."""
        return bool(self.arrays["occlusion.any"])

    @property
    def shadowed(self):
        """(S,) bool: the Sources that are tested one by one, before which something may stand."""
        return self.sources.shadows & self.occluded

    @cached_property
    def guide(self):
        """What rays are guided to, as a GuideGeometry, or None."""
        return GuideGeometry(self) if len(self.arrays["guide.sides"]) else None

    @cached_property
    def element_corners(self):
        """Corners (M, 4, 3) of the patches' elements, a triangle's last one twice, and the patch (M,) of each."""
        p, a, b = np.moveaxis(self.patches.element_frame, 1, 0)
        far = np.where(self.patches.element_square[:, None], p + a + b, p + b)
        owner = np.repeat(np.arange(len(self.patches)), np.diff(self.patches.element_start))
        return np.stack([p, p + a, far, p + b], axis=1), owner

    @cached_property
    def factors(self):
        """(P, S) what every source would give every point with nothing in between, per unit of strength: NaN where it
        has not been asked for, or None if it would take too much memory. Each replicate asks for the same again."""
        shape = int(self.arrays["points.count"]), len(self.sources)
        return np.full(shape, np.nan) if shape[0] * shape[1] <= MOST_FACTORS else None

    def factors_at(self, ids, position, normal):
        """(N, S) those at points ids (N,), with their positions and normals (N, 3)."""
        if not len(self.sources):
            return np.zeros((len(ids), 0))
        new = slice(None) if self.factors is None else np.isnan(self.factors[ids, 0])
        place = position[new], normal[new]
        found = np.stack([unoccluded(self.sources, s, *place) for s in range(len(self.sources))], axis=1)
        if self.factors is None:
            return found
        self.factors[ids[new]] = found
        return self.factors[ids]

    @cached_property
    def _given(self):
        """What the crowd of `picked` may give patch sides, as Given with a row for each side, NaN where it has not been asked
        for, and their extents (N,) [m]; None if it would take too much memory."""
        crowd, patches = self.picked[1], self.patches
        shape = 2 * len(patches), crowd.groups
        if shape[0] * shape[1] > MOST_GIVEN:
            return None
        corner, owner = self.element_corners
        extent = np.zeros(len(patches))
        np.maximum.at(extent, owner, length(corner - patches.centroid[owner, None]).max(axis=1))
        return Given(np.full(shape, np.nan, np.float32), np.zeros(shape), np.arange(shape[0])), extent

    def given_on(self, side, position, normal):
        """What the crowd of `picked` may give places (K, 3) with normals (K, 3), as Given. side: (K,) that they lie on, or None.

        Many rays meet one side, and what groups may give all of it is found once, which takes half of the time of the control
        where hundreds of faces glow. A side that is not flat, or wide, has places that get what its middle does not: they are
        looked at one by one.
        """
        crowd, patches = self.picked[1], self.patches
        if side is None or self._given is None:
            return crowd.given(position, normal)
        (given, extent), patch = self._given, side >> 1
        level = dot(np.where(side[:, None] & 1, -patches.normal[patch], patches.normal[patch]), normal) > LEVEL
        level &= extent[patch] * self.caster.frame[1] <= WIDE
        new = np.unique(side[level & np.isnan(given.each[side, 0])])
        if len(new):
            up = np.where(new[:, None] & 1, -patches.normal[new >> 1], patches.normal[new >> 1])
            found = crowd.given_patches(patches.centroid[new >> 1], extent[new >> 1], up)
            given.each[new], given.upto[new] = found.each, found.upto
        if level.all():
            return given._replace(row=side)
        mixed = Given(given.each[side], given.upto[side], np.arange(len(side)))
        bent = crowd.given(position[~level], normal[~level])
        mixed.each[~level], mixed.upto[~level] = bent.each, bent.upto
        return mixed

    def renewed(self, arrays):
        """A kernel with some arrays replaced; what was built from the others is kept."""
        kernel = Kernel({**self.arrays, **arrays})
        # A look at the memory at every renewal would be a hundredth of a small bake.
        kernel.tasks, kernel.peak, kernel._last = self.tasks, self.peak, self._last
        built = {
            "caster": "scene.", "patches": "patches.", "sizes": "patches.", "element_corners": "patches.",
            "_split": "sources.", "guide": "guide.", "_given": ("patches.", "sources."),
        }  # fmt: skip
        for name, prefix in built.items():
            if name in self.__dict__ and not any(key.startswith(prefix) for key in arrays):
                kernel.__dict__[name] = self.__dict__[name]
        return kernel

    def once(self, function, *arguments):
        """What a pure function gives, which is not asked again as long as the arguments are those of the last time: all tasks
        of a replicate want the same tables, of which each is half a millisecond's work."""
        if self._last.get(function, (None,))[0] != arguments:
            self._last[function] = arguments, function(*arguments)
        return self._last[function][1]

    def spent(self):
        """What `RayCaster.spent` says."""
        return self.caster.spent() if "caster" in self.__dict__ else (0.0, 0, {})

    def patch_hit(self, triangle, u, v):
        """(K,) int32 patches on which hits (triangle, u, v) of K rays fell."""
        return patch_of_hit(self.patches, self.vertices, self.triangles, triangle, u, v)

    def hits(self, origins, directions):
        """What K rays meet first, as Hits."""
        triangle, u, v, distance, back = self.caster.hits(origins, directions)
        side = self.patch_hit(triangle, u, v)
        side *= 2
        side += back
        escaped = np.flatnonzero(triangle < 0)
        side[escaped] = -1 if self.sky_size == 1 else cells_of(directions[escaped], self.sky_size) - self.sky_size**2
        return Hits(side, triangle, u, v, distance, back)


class Hits(NamedTuple):
    """What K rays meet first: side (K,) int32, 2 * patch + (1 on its back); where the ray escaped, the cell of the sky that
    it went to less the number of cells, so that the last cell is -1. triangle (K,), -1 where it escaped, the place u, v
    (K,) in it, the distance (K,) in scene diagonals, and whether it is the back (K,)."""

    side: np.ndarray
    triangle: np.ndarray
    u: np.ndarray
    v: np.ndarray
    distance: np.ndarray
    back: np.ndarray
