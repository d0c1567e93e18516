"""Layers: what the light at points becomes in a color attribute. Linear, unbounded, as radiance."""

from __future__ import annotations

import numpy as np

from .groups import one_group
from .surfaces import corner_surfaces, place_surfaces

LAYERS = ("Radiosity", "Lighting", "Direct", "Indirect", "Occlusion", "RadiosityError")
PLAIN = ("Occlusion", "RadiosityError")  # layers that are no light: they have no groups


def layer_colors(bake, layer, group=None):
    """(C, 3) float64 color of every corner of the scene in a layer; 0 at corners without a point.

    Radiosity: (exitance + reflectance * irradiance) / pi, what the eye sees. Lighting: irradiance / pi, without the
    surface's own color. Direct, Indirect: its two parts. Occlusion: 1 where nothing is near, less where something is.
    RadiosityError: the standard error of Lighting at each point, as replicates scatter. group: number of the light
    group that is meant, None for all light. Raises ValueError for a layer that is not known.
    """
    points, scene = bake.points, bake.scene
    colors = np.zeros((len(scene.corner_vertex), 3))
    if layer == "Occlusion":
        colors[points.corner] = bake.openness[points.corner_point][:, None]
        return colors
    if layer == "RadiosityError":
        colors[points.corner] = _scatter(bake.light)[:, points.corner_point].T
        return colors / np.pi
    colors[points.corner] = _arriving(_light_of(bake, group), layer)[:, points.corner_point].T
    if layer == "Radiosity":
        reflectance, exitance = corner_surfaces(scene, points.corner)
        glows = _glowing(bake, group)[points.object[points.corner_point]]
        colors[points.corner] = exitance * glows + reflectance * colors[points.corner]
    return colors / np.pi


def texel_colors(bake, atlas, layer, group=None):
    """(P, 3) float64 color in a layer of every point of a Bake, whose points are Texels of an atlas. group: see
    `layer_colors`."""
    if layer == "Occlusion":
        return np.repeat(bake.openness[:, None], 3, axis=1)
    if layer == "RadiosityError":
        return np.broadcast_to(_scatter(bake.light).T, (len(bake.points), 3)) / np.pi
    colors = np.broadcast_to(_arriving(_light_of(bake, group), layer).T, (len(bake.points), 3))
    if layer == "Radiosity":
        reflectance, exitance = place_surfaces(bake.scene, atlas.triangle[bake.points.row], bake.points.weight)
        colors = exitance * _glowing(bake, group)[bake.points.object] + reflectance * colors
    return colors / np.pi


def _scatter(light):
    """(C, P) standard error of the light at points [W/m^2]."""
    return np.sqrt(np.maximum(light.variance, 0.0))


def _light_of(bake, group):
    """The Light of a group, or of all."""
    return bake.light if group is None else one_group(bake.by_group, bake.groups, group)


def _glowing(bake, group):
    """(O, 3) how many times what an object emits counts in the light of a group (None: of all)."""
    glows = np.ones((len(bake.scene.objects), 3))
    if bake.factors is not None:
        lit = bake.groups.object >= 0
        glows[lit] = bake.factors[bake.groups.object[lit]]
    return glows if group is None else glows * (bake.groups.object == group)[:, None]


def _arriving(light, layer):
    """(C, P) the irradiance that a layer shows."""
    if layer not in LAYERS:
        raise ValueError(f"layer {layer!r} is not one of {', '.join(LAYERS)}")
    parts = {"Direct": light.direct, "Indirect": light.indirect}
    return parts[layer] if layer in parts else light.direct + light.indirect


def vertex_means(colors, corner_vertex, count):
    """(V, K) plain mean of corner values (C, K) over the corners of each of `count` vertices; 0 at loose ones."""
    number = np.maximum(np.bincount(corner_vertex, minlength=count), 1)
    return np.stack([np.bincount(corner_vertex, channel, count) for channel in colors.T], axis=1) / number[:, None]


def luminance(colors):
    """(...) brightness of linear colors (..., 3) (ITU-R BT.709)."""
    return np.einsum("...c,c->...", colors, np.array((0.2126, 0.7152, 0.0722)))
