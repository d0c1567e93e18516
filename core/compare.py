"""How far a bake is off: from a reference made otherwise, or from a finer bake of the same scene."""

from __future__ import annotations

import numpy as np

from .accuracy import RARE
from .layers import layer_colors, vertex_means


def off_reference(bake, reference):
    """Relative error of a Bake at corners of its scene against a reference, as a float; None where they share no light.

    reference: {name: array}; for each object NAME that is to be compared NAME.A (V,) area [m^2], NAME.mask (V,) bool, the
    vertices that count, and NAME.EA and NAME.EB (V, 3) irradiance / pi, made apart, so that their noises cancel.
    """
    return of_all(parts_off_reference(bake, reference))


def off_at_vertices(found, reference):
    """Relative error of irradiance / pi, {name: (V, 3)} at the vertices of objects, whoever found it: see
    `off_reference`."""
    return of_all(_parts_at_vertices(found, reference))


def off_finer(bake, finer):
    """Relative error of a Bake against a finer one at the same points, as a float."""
    return of_all(parts_off_finer(bake, finer)) or 0.0


def of_all(parts):
    """Relative error of all objects together; None where there is no light. parts: {object: sums of squares of what it is
    off, and of its light, times area; area}."""
    off, truth = (sum(part[k] for part in parts.values()) for k in (0, 1))
    return float(np.sqrt(max(off, 0.0) / truth)) if truth > 0 else None


def of_objects(parts):
    """{object: relative error}, without those that are next to black."""
    truth, area = (sum(part[k] for part in parts.values()) for k in (1, 2))
    return {
        name: float(np.sqrt(max(off, 0.0) / own))
        for name, (off, own, size) in parts.items()
        if own * area > RARE**2 * truth * size
    }


def parts_off_reference(bake, reference):
    """The parts, see `of_all`, of a Bake against a reference, see `off_reference`."""
    scene = bake.scene
    colors = layer_colors(bake, "Lighting")
    first = scene.polygon_start[np.searchsorted(scene.polygon_object, np.arange(len(scene.objects) + 1))]
    found = {}
    for name, written, begin, end in zip(scene.objects, scene.written, first, first[1:]):
        if written and f"{name}.A" in reference:
            own = scene.corner_vertex[begin:end]
            found[name] = vertex_means(colors[begin:end], own - own.min(), len(reference[f"{name}.A"]))
    return _parts_at_vertices(found, reference)


def parts_off_finer(bake, finer):
    """The parts, see `of_all`, of a Bake against a finer one at the same points, those that count in the error."""
    points, light, truth = bake.points, bake.light.total, finer.light.total
    area = points.area if bake.seen is None else points.area * bake.seen
    count = len(bake.scene.objects)
    sums = ((light - truth) ** 2).sum(axis=0), (truth**2).sum(axis=0), np.ones(len(points))
    sums = (np.bincount(points.object, area * of, count) for of in sums)
    return {name: part for name, *part in zip(bake.scene.objects, *sums)}


def _parts_at_vertices(found, reference):
    parts = {}
    for name, mean in found.items():
        area, mask, one, other = (reference[f"{name}.{k}"] for k in ("A", "mask", "EA", "EB"))
        area = (area * mask)[:, None]
        parts[name] = (area * (mean - one) * (mean - other)).sum(), (area * one * other).sum(), area.sum()
    return parts
