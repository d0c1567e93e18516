"""Alpha: surfaces that light passes by chance, a ray at a time.

Owns the record `Alpha` and the choice whether a ray goes on behind a place where it met a surface: a hash of the ray
itself and of how often it went on before, so that it is the same in any task, on any cell. A ray that goes on is not
dimmed, and nothing caps how often it does: no light is lost. Only rays that meet such a surface pay for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .sampling import mix


@dataclass(frozen=True)
class Alpha:
    """How much of a surface is there. Row 0 of the K kinds stands for opaque ones.

    kind: (T,) int16 of each triangle. value: (K,) alpha of each kind, a factor of its image if it has one.
    first, height, width: (K,) where its image lies in pixels (Z,), row 0 at the bottom; height 0: it has none.
    repeat: (K,) bool. uv: (U, 3, 2) float32 places of the corners of triangles in their images; uv_of: (T,) int32 which.
    """

    kind: np.ndarray
    value: np.ndarray
    first: np.ndarray
    height: np.ndarray
    width: np.ndarray
    repeat: np.ndarray
    pixels: np.ndarray
    uv: np.ndarray
    uv_of: np.ndarray

    def at(self, triangle, u, v):
        """(K,) alpha at places u, v (K,) of triangles (K,)."""
        kind = self.kind[triangle]
        result = self.value[kind]
        image = np.flatnonzero(self.height[kind] > 0)
        if len(image):
            kind = kind[image]
            corner = self.uv[self.uv_of[triangle[image]]].astype(float)
            a, b = u[image, None].astype(float), v[image, None].astype(float)
            place = corner[:, 0] + a * (corner[:, 1] - corner[:, 0]) + b * (corner[:, 2] - corner[:, 0])
            place = np.nan_to_num(place, nan=0.0, posinf=0.0, neginf=0.0)
            place = np.where(self.repeat[kind, None], place % 1.0, np.clip(place, 0.0, 1.0))
            column = np.minimum((place[:, 0] * self.width[kind]).astype(np.int64), self.width[kind] - 1)
            row = np.minimum((place[:, 1] * self.height[kind]).astype(np.int64), self.height[kind] - 1)
            result[image] *= self.pixels[self.first[kind] + row * self.width[kind] + column]
        return result

    def passed(self, triangle, u, v, name, depth):
        """(K,) bool: rays that met triangles (K,), -1 for none, at u, v (K,) and go on. name: (K, N) uint32 that
        tell the rays apart; depth: how often they went on before."""
        going = np.zeros(len(triangle), bool)
        met = np.flatnonzero((self.kind[triangle] > 0) & (triangle >= 0))
        if len(met):
            going[met] = mix(name[met], depth) >= self.at(triangle[met], u[met], v[met])
        return going


def make_alpha(scene, always=False):
    """The Alpha of a scene, or None if all of it is opaque, unless it is `always` wanted."""
    chosen = [k for k, m in enumerate(scene.materials) if m.transparent]
    kind_of = np.zeros(len(scene.materials), np.int16)
    kind_of[chosen] = np.arange(1, len(chosen) + 1)
    kind = kind_of[scene.polygon_material[scene.triangle_polygon]]
    if not kind.any() and not always:
        return None
    images = [np.zeros((0, 0), np.float32)]
    values, repeat = [1.0], [False]
    for k in chosen:
        material = scene.materials[k]
        texture = None if material.alpha_texture is None else scene.textures[material.alpha_texture]
        images.append(np.zeros((0, 0), np.float32) if texture is None else texture.pixels[..., 0])
        values.append(min(max(material.alpha, 0.0), 1.0))
        repeat.append(texture is not None and texture.repeat)
    size = np.array([image.size for image in images])
    height = np.array([len(image) for image in images])
    imaged = np.flatnonzero(height[kind] > 0)
    uv_of = np.full(len(kind), -1, np.int32)
    uv_of[imaged] = np.arange(len(imaged))
    corner_uv = np.zeros((len(scene.corner_vertex), 2)) if scene.corner_uv is None else scene.corner_uv
    return Alpha(
        kind=kind,
        value=np.array(values),
        first=np.cumsum(size) - size,
        height=height,
        width=np.array([image.shape[1] for image in images]),
        repeat=np.array(repeat),
        pixels=np.concatenate([image.reshape(-1) for image in images]).astype(np.float32),
        uv=corner_uv[scene.triangle_corner[imaged]].astype(np.float32),
        uv_of=uv_of,
    )
