"""Patches: the pieces of polygons that they are cut into."""

from __future__ import annotations

import numpy as np
import pytest

from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.contacts import cut_contacts
from cell_radiosity.core.kernel import scene_arrays
from cell_radiosity.core.lights import make_sources
from cell_radiosity.core.patches import make_patches, patch_of_hit

from scenes import Mesh, box, join_meshes, sheet


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


@pytest.mark.parametrize("n", [1, 40])
def test_a_hit_is_found_on_the_patch_that_it_lies_on(rng, n):
    """On a floor of one quad and on one finer than its patches, with a block that cuts both; that a ray met nothing is no
    patch's."""
    block = box("block", (0.33, 0.33, 0.0), (0.61, 0.55, 0.4), inward=False)
    scene = join_meshes([sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], n, n), block])
    cells, patches = LocalCells(), make_patches(scene, 0.13)
    cells.start(scene_arrays(scene, patches, make_sources(scene)[0]))
    patches = cut_contacts(scene, patches, cells)
    triangle = rng.integers(0, len(scene.triangles), 4000)
    u, v = np.sort(rng.random((2, 4000)).astype(np.float32), axis=0)
    v -= u
    patch = patch_of_hit(
        patches, scene.vertices, scene.triangles, np.append(triangle, -1), np.append(u, 0), np.append(v, 0)
    )
    a, b, c = scene.corners_of(triangle)
    place = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    own = np.repeat(np.arange(len(patches)), np.diff(patches.element_start))
    for k in np.unique(patch[:-1]):
        frame, square = patches.element_frame[own == k], patches.element_square[own == k]
        arm = place[patch[:-1] == k, None] - frame[:, 0]
        s, t = np.moveaxis(np.linalg.pinv(np.moveaxis(frame[:, 1:], 1, 2)) @ arm[..., None], 2, 0)[..., 0]
        inside = (np.minimum(s, t) > -1e-4) & (np.where(square, np.maximum(s, t), s + t) < 1 + 1e-4)
        assert inside.any(axis=1).all()
