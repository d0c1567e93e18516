"""How far a bake is off: from a reference made otherwise, or from a finer bake of the same scene."""

from __future__ import annotations

import numpy as np

from .layers import layer_colors, vertex_means


def off_reference(bake, reference):
    """Relative error of a Bake at corners of its scene against a reference, as a float; None where they share no light.

    reference: {name: array}; for each object NAME that is to be compared NAME.A (V,) area [m^2], NAME.mask (V,) bool, the
    vertices that count, and NAME.EA and NAME.EB (V, 3) irradiance / pi, made apart, so that their noises cancel.
    """
    scene = bake.scene
    colors = layer_colors(bake, "Lighting")
    first = scene.polygon_start[np.searchsorted(scene.polygon_object, np.arange(len(scene.objects) + 1))]
    found = {}
    for name, written, begin, end in zip(scene.objects, scene.written, first, first[1:]):
        if written and f"{name}.A" in reference:
            own = scene.corner_vertex[begin:end]
            found[name] = vertex_means(colors[begin:end], own - own.min(), len(reference[f"{name}.A"]))
    return off_at_vertices(found, reference)


def off_at_vertices(found, reference):
    """Relative error of irradiance / pi, {name: (V, 3)} at the vertices of objects, whoever found it: see `off_reference`."""
    off = truth = 0.0
    for name, mean in found.items():
        area, mask, one, other = (reference[f"{name}.{k}"] for k in ("A", "mask", "EA", "EB"))
        area = (area * mask)[:, None]
        off += (area * (mean - one) * (mean - other)).sum()
        truth += (area * one * other).sum()
    return float(np.sqrt(max(off, 0.0) / truth)) if truth > 0 else None


def off_finer(bake, finer):
    """Relative error of a Bake against a finer one at the same points, as a float."""
    area, light, truth = bake.points.area, bake.light.total, finer.light.total
    return float(np.sqrt((area * (light - truth) ** 2).sum() / max((area * truth**2).sum(), 1e-300)))
