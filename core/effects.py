"""The survey: which effects of light a scene calls for, what is ignored, and what is wrong with its data.

Owns the records `Effect` and `Survey` and every decision to leave something out. A decision comes with its reason.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

DARK = 1e-3  # an object whose front gets less than this share of what its back gets is lit from behind


@dataclass(frozen=True)
class Effect:
    """One effect: whether the scene needs it, and why, in words that name what decided."""

    name: str
    needed: bool
    reason: str
    seconds: float | None = None


@dataclass(frozen=True)
class Finding:
    """Something wrong with an object's data, and what was done about it."""

    object: str
    finding: str
    action: str


@dataclass(frozen=True)
class Survey:
    """Effects in a fixed order; ignored: (object, reason) of what cannot be simulated; health: findings."""

    effects: tuple
    ignored: tuple = ()
    health: tuple = ()

    def after(self, scene, patches, solution, cells_note=""):
        """The survey with what only the bake shows: objects that are lit from behind, and cells that failed."""
        owner = scene.polygon_object[patches.polygon]
        power = patches.area[:, None] * solution.irradiance.sum(axis=0).reshape(-1, 2)
        front, back = (np.bincount(owner, power[:, k], len(scene.objects)) for k in range(2))
        behind = np.flatnonzero(scene.written & (front < DARK * back))
        faces = np.bincount(scene.polygon_object, minlength=len(scene.objects))
        more = (
            Finding(
                scene.objects[o],
                f"{faces[o]} faces are lit from behind",
                "their front side is baked; --side back or lit takes the other",
            )
            for o in behind
        )
        cells = (Finding("cells", "the cells could not all be used", cells_note),) if cells_note else ()
        return replace(self, health=(*self.health, *more, *cells))


def survey(scene):
    """The Survey of a scene, before any ray is cast."""
    return Survey(
        effects=(_lamps(scene), _emission(scene), _sky(scene)),
        ignored=tuple(scene.ignored),
        health=(*scene.health, *_unusable(scene)),
    )


def _lamps(scene):
    kinds = [lamp.kind for lamp in scene.lamps if max(lamp.strength) > 0]
    if not kinds:
        return Effect("lamps", False, "no lamp gives light")
    return Effect("lamps", True, ", ".join(f"{kinds.count(k)} {k}" for k in sorted(set(kinds))))


def _emission(scene):
    bright = np.array([max(m.exitance) > 0 for m in scene.materials], bool)
    faces = int(bright[scene.polygon_material].sum())
    if not faces:
        return Effect("emission", False, "no face emits light")
    return Effect("emission", True, f"{faces} faces emit light")


def _sky(scene):
    if max(scene.world.radiance) <= 0:
        return Effect("sky", False, "the world is black")
    return Effect("sky", True, "the world gives light")


def _unusable(scene):
    """Findings about polygons that are left out: vertices that are not finite, or no area."""
    count = len(scene.objects)
    owner = scene.polygon_object[scene.triangle_polygon]
    finite = np.isfinite(scene.vertices).all(axis=1)[scene.triangles].all(axis=1)
    for o in np.flatnonzero(np.bincount(owner[~finite], minlength=count)):
        faces = len(np.unique(scene.triangle_polygon[~finite & (owner == o)]))
        yield Finding(
            scene.objects[o], f"{faces} faces have vertices that are not finite numbers", "they were left out"
        )
    flat = finite & ~scene.usable
    for o in np.flatnonzero(np.bincount(owner[flat], minlength=count)):
        faces = len(np.unique(scene.triangle_polygon[flat & (owner == o)]))
        yield Finding(scene.objects[o], f"{faces} faces have a part without area", "it was left out")
