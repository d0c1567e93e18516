"""Lights made stronger, weaker or of another color in the open file, at once and without a ray.

A bake with light groups leaves the layers of each group beside those of all light. Light is linear: these are the sum of
those, each times what its lights were changed by. The groups' own layers stay as they were baked.
"""

from __future__ import annotations

import numpy as np

from ..core.layers import LAYERS, PLAIN
from .marks import made_layers
from .outputs import EXPOSURE, coded, layer_of_group
from .viewport import baked_meshes

LIT = tuple(layer for layer in LAYERS if layer not in PLAIN)


def relight(scene, factors):
    """Make the layers of a scene's baked meshes, and their 8-bit copies, the sum of their light groups' layers times
    factors {group: (r, g, b)}. Left out are meshes that lack a group's layer, are linked, or in Edit Mode."""
    for mesh in baked_meshes(scene):
        if mesh.library is not None or mesh.is_editmode:
            continue
        made = made_layers(mesh)
        for layer in LIT:
            parts = {layer_of_group(layer, group): factor for group, factor in factors.items()}
            if made.issuperset((layer, *parts)) and all(name in mesh.color_attributes for name in (layer, *parts)):
                _write_sum(mesh, layer, parts)
        mesh.update()


def _write_sum(mesh, layer, parts):
    """Make a layer of a mesh the sum of others, its parts {name: (r, g, b)}, times these."""
    attributes = mesh.color_attributes
    values = np.empty(4 * len(attributes[layer].data), np.float32)
    total = np.zeros((len(attributes[layer].data), 3), np.float32)
    for name, factor in parts.items():
        attributes[name].data.foreach_get("color", values)
        total += values.reshape(-1, 4)[:, :3] * np.array(factor, np.float32)
    values.reshape(-1, 4)[:, :3] = total
    attributes[layer].data.foreach_set("color", values)
    copy = attributes.get(coded(layer))
    if copy is not None and EXPOSURE in mesh:
        values.reshape(-1, 4)[:, :3] = np.clip(total * 2.0 ** mesh[EXPOSURE], 0.0, 1.0)
        copy.data.foreach_set("color", values)
