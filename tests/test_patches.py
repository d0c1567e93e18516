"""Patches: the pieces of polygons that they are cut into."""

from __future__ import annotations

import numpy as np
import pytest

from cell_radiosity.core.patches import make_patches

from scenes import Mesh, join_meshes


@pytest.mark.parametrize("edge", [1.0, 0.5, 0.3, 0.1])
def test_patches_make_up_their_polygons(rng, edge):
    """Whatever the shape of a polygon, and however many cells its grid has along each side, nothing of it is left out or
    there twice: trapezoids, whose triangles cut cells corner to corner or not, and polygons of three to six corners."""
    shapes = []
    for _ in range(300):
        wide, left, right = rng.uniform(0.1, 1.0, 3)
        shapes.append([(0, 0), (wide, 0), (wide, right), (0, left)])
        turn = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 7)))
        shapes.append(rng.uniform(0.3, 1.0) * np.stack([np.cos(turn), np.sin(turn)], axis=1))
    corners = [np.column_stack([shape, np.full(len(shape), float(k))]) for k, shape in enumerate(shapes)]
    polygons = np.split(np.arange(sum(map(len, corners))), np.cumsum([len(c) for c in corners])[:-1])
    mesh = Mesh.of_polygons("shapes", np.concatenate(corners), [p.tolist() for p in polygons])
    scene = join_meshes([mesh])
    patches = make_patches(scene, edge)
    cut = np.bincount(patches.polygon, patches.area, len(shapes))
    whole = np.bincount(scene.triangle_polygon, scene.triangle_normal_area[1], len(shapes))
    np.testing.assert_allclose(cut[whole > 1e-3], whole[whole > 1e-3], rtol=1e-6)
