"""Meshes made finer: their shape, and the light that they can hold."""

from __future__ import annotations

import numpy as np
import pytest

from cell_radiosity.core.bake import bake, run
from cell_radiosity.core.settings import Settings
from cell_radiosity.core.subdivide import Fitting, fit_mesh, make_remesh, remeshed, split, split_long, whole_pieces
from cell_radiosity.core.vectors import cross, dot, length

from scenes import Lamp, Material, box, icosphere, join_meshes, sheet


def angles(pieces):
    """(T, 3) angles of pieces [rad]."""
    corner = pieces.position[pieces.vertex]
    u, v = np.roll(corner, -1, axis=1) - corner, np.roll(corner, 1, axis=1) - corner
    return np.arctan2(length(cross(u, v)), dot(u, v))


def normals(pieces):
    a, b, c = np.moveaxis(pieces.position[pieces.vertex], 1, 0)
    return cross(b - a, c - a) / 2


def edge_uses(pieces):
    """How many triangles use each edge, by places."""
    number = pieces.edges()[0]
    return np.bincount(number.reshape(-1))


SHAPES = {
    "box": lambda: [box("box", high=(3, 2, 1))],
    "sheets that touch": lambda: [box(face, high=(3, 2, 1), faces=(face,)) for face in "xXyYzZ"],
    "ball": lambda: [icosphere(splits=1)],
    "needle": lambda: [box("needle", high=(9, 0.3, 0.2))],
}


@pytest.mark.parametrize("shape", SHAPES)
def test_splits_leave_no_cracks_slivers_or_folds(shape, rng):
    """However edges are marked: closed surfaces stay closed, area and facing stay, no angle falls below half the least."""
    scene = join_meshes(SHAPES[shape]())
    pieces = whole_pieces(scene)
    least, area = angles(pieces).min(), length(normals(pieces)).sum()
    assert (edge_uses(pieces) == 2).all()
    for _ in range(7):
        count = len(pieces.edges()[2])
        before = pieces
        pieces = split(pieces, rng.random(count) < rng.choice([0.02, 0.2, 0.7]))
        assert np.array_equal(pieces.position[: len(before.position)], before.position)  # vertices are only added
    assert len(pieces.triangle) > 40 * scene.triangles.shape[0] / 12
    assert (edge_uses(pieces) == 2).all()
    assert angles(pieces).min() > 0.49 * least
    assert length(normals(pieces)).sum() == pytest.approx(area, rel=1e-9)
    assert (dot(normals(pieces), scene.triangle_normal_area[0][pieces.triangle]) > 0).all()
    # Corners' weights say where they are.
    corner = scene.vertices[scene.triangles[pieces.triangle]]
    np.testing.assert_allclose(
        np.einsum("tkv,tvd->tkd", pieces.weight, corner), pieces.position[pieces.vertex], atol=1e-12
    )


def test_polygons_that_need_no_split_stay_whole():
    scene = join_meshes([sheet("floor", ((0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0)), 4, 4)])
    pieces = whole_pieces(scene)
    number, ends, edge_length, _ = pieces.edges()
    one = np.zeros(len(ends), bool)
    one[number[0, edge_length[number[0]].argmax()]] = True
    remesh, corner = make_remesh(scene, split(pieces, one))
    finer = remeshed(scene, remesh)
    assert sorted(np.diff(remesh.polygon_start)) == [3] * 4 + [4] * 15
    assert finer.triangle_normal_area[1].sum() == pytest.approx(16)
    np.testing.assert_allclose(
        finer.vertices[finer.corner_vertex[corner]], split(pieces, one).position[split(pieces, one).vertex], atol=1e-12
    )
    assert (finer.triangle_normal_area[0][:, 2] > 0.999).all()


def shadow_scene():
    """A floor of one quad under a sun that stands overhead, and a plate that shades a square turned by 30 degrees."""
    turn = np.array([(np.cos(a), np.sin(a)) for a in np.radians(30 + 45 + 90 * np.arange(4))])
    plate = np.column_stack([2 + turn, np.full(4, 1.0)])
    floor = sheet("floor", ((0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0)))
    black = Material(reflectance=(0, 0, 0))
    scene = join_meshes([floor, sheet("plate", plate)], [black], [Lamp("sun", (1, 1, 1))], written=[True, False])
    axis = np.array([(np.cos(a), np.sin(a)) for a in np.radians((30, 120))])
    return scene, lambda at: 1.0 - (np.abs((at[:, :2] - 2) @ axis.T) < np.sqrt(0.5)).all(axis=1)


def fitted(scene, fitting, cells):
    """The finer Scene and (C,) its light, baked."""

    def place(scene, flipped, cells, light, kept):
        finer, points, _ = yield from fit_mesh(scene, fitting, flipped, cells, light)
        return finer, points, {}

    baked = run(bake(scene, Settings(gather_rays=16), cells, place))
    light = np.zeros(len(baked.scene.corner_vertex))
    light[baked.points.corner] = (baked.light.direct + baked.light.indirect)[0, baked.points.corner_point]
    return baked.scene, light


def error_of(scene, light, truth, rng):
    """Root mean square of the piecewise-linear light's error at random places, over that of the light; and vertices."""
    mine = np.flatnonzero(scene.written[scene.polygon_object[scene.triangle_polygon]])
    upto = np.cumsum(scene.triangle_normal_area[1][mine])
    triangle = mine[np.searchsorted(upto, rng.random(20_000) * upto[-1])]
    weight = rng.dirichlet((1, 1, 1), len(triangle))
    at = np.einsum("kv,kvd->kd", weight, scene.vertices[scene.triangles[triangle]])
    shown = np.einsum("kv,kv->k", weight, light[scene.triangle_corner[triangle]])
    used = len(np.unique(scene.triangles[mine]))
    return np.sqrt(((shown - truth(at)) ** 2).sum() / (truth(at) ** 2).sum()), used


def test_shadows_cost_a_third_of_the_vertices_of_an_even_mesh(cells, rng):
    scene, truth = shadow_scene()
    even, vertices = error_of(*fitted(scene, Fitting(0.09, 0.09, passes=0), cells), truth, rng)
    finer, fewer = error_of(*fitted(scene, Fitting(0.7, 0.03, passes=12), cells), truth, rng)
    assert fewer < vertices / 3
    assert finer < even
    coarse, few = error_of(*fitted(scene, Fitting(0.7, 0.03, vertices=400, passes=12), cells), truth, rng)
    assert few <= 400
    assert coarse > finer


def test_what_is_left_alike_differs_little_or_is_small(cells):
    """At the end no edge is longer than asked for, and what differs by more than the contrast is as small as allowed."""
    scene, _ = shadow_scene()
    fitting = Fitting(0.8, 0.05, contrast=0.2, passes=20)
    finer, light = fitted(scene, fitting, cells)
    mine = np.flatnonzero(finer.written[finer.polygon_object[finer.triangle_polygon]])
    corner = finer.vertices[finer.triangles[mine]]
    longest = length(np.roll(corner, -1, axis=1) - corner).max(axis=1)
    assert longest.max() <= 0.8 * (1 + 1e-9)
    spread = np.ptp(light[finer.triangle_corner[mine]], axis=1)
    assert longest[spread > 0.2].max() < 2 * 0.05
    assert longest.min() >= 0.05
    assert longest[spread == 0].max() > 0.4  # and elsewhere nothing is spent


def test_the_same_mesh_again_and_with_other_cells(cells):
    from cell_radiosity.core.cells import make_cells

    scene, _ = shadow_scene()
    fitting = Fitting(0.7, 0.1)
    with make_cells(1) as one:
        results = [fitted(scene, fitting, c) for c in (cells, cells, one)]
    for finer, light in results[1:]:
        assert np.array_equal(finer.vertices, results[0][0].vertices)
        assert np.array_equal(finer.corner_vertex, results[0][0].corner_vertex)
        assert np.array_equal(light, results[0][1])


def test_no_point_is_asked_for_twice(cells):
    scene, _ = shadow_scene()
    asked = []

    def place(scene, flipped, cells, light, kept):
        def counting(points):
            asked.append(points.position)
            return (yield from light(points))

        finer, points, _ = yield from fit_mesh(scene, Fitting(0.7, 0.05, passes=8), flipped, cells, counting)
        return finer, points, {}

    baked = run(bake(scene, Settings(gather_rays=16), cells, place))
    assert len(asked) > 3
    assert sum(map(len, asked)) <= len(baked.points)


def test_a_long_edge_is_halved_until_it_is_short():
    pieces = split_long(whole_pieces(join_meshes([box(high=(3, 2, 1))])), 0.3)
    assert pieces.edges()[2].max() <= 0.3 * (1 + 1e-9)
    assert pieces.edges()[2].min() > 0.3 / 8
