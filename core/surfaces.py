"""Surfaces: what patch sides and corners do with light.

Owns the record `Surfaces` and everything that varies over a surface: image textures, and readings of shader graphs.
Transport sees the mean over each patch; a layer that shows the surface's own color sees the value at the corner.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .alpha import make_alpha
from .patches import patch_of_hit
from .sampling import GOLDEN, fraction, scatter
from .vectors import counted

LARGEST_REFLECTANCE = 0.999  # of reflectance and translucency together: more has no steady state in a closed room
INSET = 0.02  # how far a corner's color is taken from inside its polygon, as a share of the way to the middle
SAMPLES = 16  # of a texture, per cell of a facet's grid


@dataclass(frozen=True)
class Surfaces:
    """What sides do with light, (C, 2 N) each, a row per color channel: reflectance, translucency [-], and exitance
    [W/m^2] in two parts: `sampled`, of faces that are sampled as sources, and `found`, which rays find by meeting it.
    coverage: (2 N,) share of a side that is there, where rays may pass some; None: all of all. The other fields are those
    of what is there.
    """

    reflectance: np.ndarray
    translucency: np.ndarray
    sampled: np.ndarray
    found: np.ndarray
    coverage: np.ndarray | None = None

    def one_channel(self):
        """The Surfaces of a scene without color: one channel, the mean of all."""
        mean = {
            n: getattr(self, n).mean(axis=0, keepdims=True) for n in ("reflectance", "translucency", "sampled", "found")
        }
        return replace(self, **mean)

    def reflecting(self, sides):
        """The Surfaces with only some sides (2 N,) bool reflecting light."""
        return replace(self, reflectance=self.reflectance * sides, translucency=self.translucency * sides)

    @property
    def exitance(self):
        """(C, 2 N) all light that sides emit [W/m^2]."""
        return self.sampled + self.found

    @cached_property
    def returned(self):
        """(C, 2 N) share of light that sides send on."""
        return self.reflectance + self.translucency

    def send(self, arriving):
        """(C, 2 N) what sides send on of light (C, 2 N) that arrives on them: back, and through to the other side."""
        sent = self.reflectance * arriving
        if self._thin:
            through = self.translucency * arriving
            sent[:, 0::2] += through[:, 1::2]
            sent[:, 1::2] += through[:, 0::2]
        return sent

    @cached_property
    def _thin(self):
        return bool(self.translucency.any())


@dataclass(frozen=True)
class Texture:
    """An image as a surface's color. pixels: (height, width, 3) linear float32, row 0 at the bottom. repeat: beyond
    0..1 it is repeated, else its rim is extended."""

    name: str
    pixels: np.ndarray
    repeat: bool = True

    @cached_property
    def mean(self):
        """(3,) mean color."""
        return np.einsum("hwc->c", self.pixels.astype(float)) / max(self.pixels[..., 0].size, 1)

    def at(self, uv):
        """(K, 3) nearest pixel at uv (K, 2); a uv that is not finite reads as 0."""
        uv = np.nan_to_num(uv, nan=0.0, posinf=0.0, neginf=0.0)
        uv = uv % 1.0 if self.repeat else np.clip(uv, 0.0, 1.0)
        height, width = self.pixels.shape[:2]
        column = np.minimum((uv[:, 0] * width).astype(np.int64), width - 1)
        row = np.minimum((uv[:, 1] * height).astype(np.int64), height - 1)
        return self.pixels[row, column].astype(float)


@dataclass(frozen=True)
class Readings:
    """Colors read off surfaces whose graphs are not understood: at S places (triangle (S,), uv (S, 2) in it), and at
    corners (K,). reflectance, exitance: (S, 3); corner_reflectance, corner_exitance: (K, 3)."""

    triangle: np.ndarray
    uv: np.ndarray
    reflectance: np.ndarray
    exitance: np.ndarray
    corner: np.ndarray
    corner_reflectance: np.ndarray
    corner_exitance: np.ndarray


def make_surfaces(scene, patches, sampled):
    """The Surfaces of patches. sampled: (P,) bool, polygons whose light is sampled."""
    material = scene.polygon_material[patches.polygon]
    reflectance, exitance, translucency = (
        _of_materials(scene, n)[material] for n in ("reflectance", "exitance", "translucency")
    )
    alpha = make_alpha(scene)
    _paint(scene, patches, reflectance, exitance, alpha)
    excess = np.maximum((reflectance + translucency) / LARGEST_REFLECTANCE, 1.0)
    own = sampled[patches.polygon][:, None]
    parts = (reflectance / excess, translucency / excess, np.where(own, exitance, 0.0), np.where(own, 0.0, exitance))
    coverage = None if alpha is None else np.repeat(_coverage(scene, patches, alpha), 2)
    return Surfaces(*(np.repeat(part.T, 2, axis=1) for part in parts), coverage)


def reflects(scene):
    """Whether any of its materials may reflect light, or let it through."""
    shades = (m.reflectance + m.translucency for m in scene.materials)
    return scene.readings is not None or any(any(s) or m.texture is not None for s, m in zip(shades, scene.materials))


def reflecting_polygons(scene):
    """(P,) bool, polygons that may reflect light, or let it through."""
    textured = np.array([m.texture is not None for m in scene.materials])
    shades = _of_materials(scene, "reflectance") + _of_materials(scene, "translucency")
    found = (shades.any(axis=1) | textured)[scene.polygon_material]
    if scene.readings is not None:
        read = scene.triangle_polygon[scene.readings.triangle]
        found[read] = False
        found[read[(scene.readings.reflectance > 0).any(axis=1)]] = True
    return found


def corner_surfaces(scene, corner):
    """Reflectance and exitance (K, 3) at corners (K,) of the scene."""
    polygon = np.repeat(np.arange(len(scene.polygon_material)), np.diff(scene.polygon_start))[corner]
    material = scene.polygon_material[polygon]
    reflectance, exitance = _of_materials(scene, "reflectance")[material], _of_materials(scene, "exitance")[material]
    for number, m in enumerate(scene.materials):
        if m.texture is not None:
            mine = material == number
            uv = _inside(scene.corner_uv, polygon[mine], corner[mine], scene.polygon_start)
            reflectance[mine] += np.asarray(m.tint) * scene.textures[m.texture].at(uv)
    if scene.readings is not None:
        place = np.full(len(scene.corner_vertex), -1)
        place[scene.readings.corner] = np.arange(len(scene.readings.corner))
        read = place[corner] >= 0
        reflectance[read] = scene.readings.corner_reflectance[place[corner][read]]
        exitance[read] = scene.readings.corner_exitance[place[corner][read]]
    return _bounded(reflectance), exitance


def place_surfaces(scene, triangle, weight):
    """Reflectance and exitance (K, 3) at places of the scene's triangles (K,), given by weights (K, 3) of their corners."""
    material = scene.polygon_material[scene.triangle_polygon[triangle]]
    corner = scene.triangle_corner[triangle]
    reflectance, exitance = _of_materials(scene, "reflectance")[material], _of_materials(scene, "exitance")[material]
    for number, m in enumerate(scene.materials):
        if m.texture is not None:
            mine = material == number
            uv = np.einsum("kv,kvd->kd", weight[mine], scene.corner_uv[corner[mine]])
            reflectance[mine] += np.asarray(m.tint) * scene.textures[m.texture].at(uv)
    if scene.readings is not None:
        place = np.full(len(scene.corner_vertex), -1)
        place[scene.readings.corner] = np.arange(len(scene.readings.corner))
        read = np.flatnonzero((place[corner] >= 0).all(axis=1))
        for result, values in (
            (reflectance, scene.readings.corner_reflectance), (exitance, scene.readings.corner_exitance),
        ):  # fmt: skip
            result[read] = np.einsum("kv,kvc->kc", weight[read], values[place[corner[read]]])
    return _bounded(reflectance), exitance


def _inside(corner_uv, polygon, corner, start):
    """(K, 2) the uv of corners, moved a little into their polygons: on the rim of a texture the pixel is not certain."""
    middle = np.add.reduceat(corner_uv, start[:-1], axis=0) / np.diff(start)[:, None]
    return corner_uv[corner] + INSET * (middle[polygon] - corner_uv[corner])


def _of_materials(scene, name):
    """(M, 3) float64 a field of all materials."""
    return _bounded(np.array([getattr(m, name) for m in scene.materials], float), name != "exitance")


def _bounded(values, share=True):
    """Shares of light within 0 and the largest that is allowed; light itself at least 0."""
    return np.clip(np.nan_to_num(values), 0.0, LARGEST_REFLECTANCE if share else None)


def _coverage(scene, patches, alpha):
    """(N,) mean alpha of patches."""
    triangle, uv = _places_on(patches, np.flatnonzero((alpha.kind > 0) & scene.usable))
    coverage = np.ones((len(patches), 1))
    _set_means(scene, patches, triangle, uv, alpha.at(triangle, uv[:, 0], uv[:, 1])[:, None], coverage)
    return coverage[:, 0]


def _paint(scene, patches, reflectance, exitance, alpha):
    """Set the reflectance and exitance (N, 3) of patches whose surfaces are textured or were read, in place: of the part
    of them that is there, by its Alpha (None: all)."""
    textured = [k for k, m in enumerate(scene.materials) if m.texture is not None]
    if textured:
        material = scene.polygon_material[scene.triangle_polygon]
        mine = np.flatnonzero(np.isin(material, textured) & scene.usable)
        triangle, uv = _places_on(patches, mine)
        values = np.empty((len(triangle), 3))
        for k in textured:
            m, chosen = scene.materials[k], material[triangle] == k
            corner = scene.corner_uv[scene.triangle_corner[triangle[chosen]]]
            u, v = uv[chosen, :1], uv[chosen, 1:]
            place = corner[:, 0] + u * (corner[:, 1] - corner[:, 0]) + v * (corner[:, 2] - corner[:, 0])
            values[chosen] = np.asarray(m.reflectance) + np.asarray(m.tint) * scene.textures[m.texture].at(place)
        there = None if alpha is None else alpha.at(triangle, uv[:, 0], uv[:, 1])[:, None]
        values = _bounded(values) if there is None else _bounded(values) * there
        _set_means(scene, patches, triangle, uv, values, reflectance, there)
    if scene.readings is not None:
        read = scene.readings
        there = None if alpha is None else alpha.at(read.triangle, read.uv[:, 0], read.uv[:, 1])[:, None]
        _set_means(scene, patches, read.triangle, read.uv, _bounded(read.reflectance), reflectance, there)
        _set_means(scene, patches, read.triangle, read.uv, np.maximum(read.exitance, 0.0), exitance, there)
        np.minimum(reflectance, LARGEST_REFLECTANCE, out=reflectance)


def _places_on(patches, triangles):
    """Places spread over triangles (T',), more where they are cut into more patches: triangle (S,), uv (S, 2)."""
    count = SAMPLES * patches.cells_around(triangles)
    owner, number = counted(count)
    u = (number + 0.5) / count[owner]
    v = fraction((number + 0.5) * GOLDEN + scatter(triangles, 11)[owner])
    fold = u + v > 1.0
    return triangles[owner], np.stack([np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)], axis=1)


def _set_means(scene, patches, triangle, uv, values, result, weight=None):
    """Set rows of `result` (N, D) to the sum of the values (S, D) that lie on each patch over that of their weights (S, 1),
    None: 1; a patch of a touched polygon without any gets its polygon's."""
    uv = uv.astype(np.float32)
    patch = patch_of_hit(patches, scene.vertices, scene.triangles, triangle, uv[:, 0], uv[:, 1])
    polygon = scene.triangle_polygon[triangle]
    weight = np.ones(len(values)) if weight is None else np.maximum(weight[:, 0], 1e-9)
    own = _means(patch, values, weight, len(patches))
    whole = _means(polygon, values, weight, len(scene.polygon_material))
    touched = ~np.isnan(whole[patches.polygon, 0])
    result[touched] = np.where(np.isnan(own), whole[patches.polygon], own)[touched]


def _means(owner, values, weight, count):
    """(count, D) sums of values (S, D) over sums of weights (S,), by owner (S,); NaN where there is none."""
    total = np.bincount(owner, weight, count).astype(float)  # of nothing, counts are integers
    total[np.bincount(owner, minlength=count) == 0] = np.nan
    return np.stack([np.bincount(owner, column, count) for column in values.T], axis=1) / total[:, None]
