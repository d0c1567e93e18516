"""Faces that touch: what lies on a floor gets nothing from beyond it, and the two sides of a thin wall keep their light."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.kernel import cast_arrays
from cell_radiosity.core.layers import layer_colors, vertex_means
from cell_radiosity.core.points import make_points
from cell_radiosity.core.touching import TOUCH, shared

from scenes import Lamp, Material, Mesh, Settings, World, bake, box, icosphere, join_meshes, run, sheet

SKY = World((1.0, 1.0, 1.0))
CORNERS = [(x, y, z) for z in (0, 1) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]
FACES = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6)]  # the first is the bottom


def floor(half, name="floor"):
    return sheet(name, [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)])


def block(gap=0.0, smooth=False):
    """A welded cube, so far above the floor [m]."""
    mesh = Mesh.of_polygons("block", np.array(CORNERS, float) + (0, 0, gap), FACES)
    if smooth:
        normal = mesh.vertices - mesh.vertices.mean(axis=0)
        mesh = replace(mesh, corner_normal=normal[mesh.corner_vertex])
    return mesh


def baked_of(meshes, cells, scale=1.0, **fields):
    scene = join_meshes(meshes, [Material("gray", (0.5,) * 3)], world=SKY, **fields)
    return run(bake(replace(scene, vertices=scene.vertices * scale), Settings(error=0.02), cells))


def corner_light(baked, name):
    """Irradiance / pi of an object's corners, (polygons, corners of each)."""
    mine = baked.scene.polygon_object == baked.scene.objects.index(name)
    first = baked.scene.polygon_start[np.flatnonzero(mine)[0]]
    size = np.diff(baked.scene.polygon_start)[mine]
    return layer_colors(baked, "Lighting")[first : first + size.sum(), 0].reshape(len(size), -1)


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e3])
@pytest.mark.parametrize("half", [2.0, 0.6, 0.5])
@pytest.mark.parametrize("gap", [0.0, 1e-5, -1e-5])
def test_the_bottom_of_a_block_on_a_floor_is_black(cells, gap, half, scale):
    """Standing, lifted and sunk by less than rays tell, under a sky that shines below the floor too: nothing gets there, to
    the last bit but where it is sunk, and the vertices at its foot have a third less than the mean of the sides there."""
    light = corner_light(baked_of([floor(half), block(gap)], cells, scale), "block")
    assert light[0].max() <= (1e-3 if gap < 0 else 0.0)
    foot = np.array(FACES)[2:, :2]
    assert light[2:, :2].min() > 0.3
    means = vertex_means(light.reshape(-1, 1), np.concatenate(FACES), 8)[:, 0]
    for vertex in range(4):
        assert means[vertex] == pytest.approx(light[2:, :2][foot == vertex].sum() / 3, rel=1e-3)


def test_only_what_a_floor_covers_is_black(cells):
    """A floor smaller than the block: what stands out beyond it gets the whole sky from below, points on the floor nothing."""
    solid = box("block", (-0.5, -0.5, 0), (0.5, 0.5, 1), 3, False)
    baked = baked_of([floor(0.3), solid], cells)
    below = (baked.points.object == 1) & (baked.points.normal[:, 2] < -0.9)
    light, place = baked.light.total[0, below], np.abs(baked.points.position[below, :2]).max(axis=1)
    assert (place < 0.3).sum() == 4
    assert light[place < 0.3].max() == 0.0
    np.testing.assert_allclose(light[place > 0.3], np.pi, rtol=1e-6)


def test_a_smooth_block_keeps_the_light_of_its_sides(cells):
    """Its corners share their normals; what is at the bottom is apart all the same, and black."""
    light = corner_light(baked_of([floor(2.0), block(smooth=True)], cells), "block")
    assert light[0].max() == 0.0
    assert light[2:, :2].min() > 0.3


def test_what_stands_against_a_wall_is_black_behind(cells):
    """In the corner of a room without a ceiling, so that its back, its side and its bottom are covered."""
    room = box("room", n=2, faces="xXyYz")
    cupboard = box("cupboard", (0, 0, 0), (0.4, 0.3, 0.6), 2, False)
    baked = baked_of([room, cupboard], cells)
    own = baked.points.object == 1
    hidden = own & (baked.points.normal.min(axis=1) < -0.9)
    assert baked.light.total[0, hidden].max() == 0.0
    assert baked.light.total[0, own & ~hidden].min() > 0.05


@pytest.mark.parametrize("lit", [False, True])
def test_the_sides_of_a_thin_wall_keep_their_light(cells, lit):
    """A house of two boxes in one place, one turned in and one turned out: outside there is the sky, inside there is not."""
    inside, outside = box("inside", n=3), box("outside", n=2, inward=False)
    lamp = [Lamp("point", (1.0, 1.0, 1.0), (0.5, 0.5, 0.5))] if lit else []
    ball = icosphere("ball", 0.1, 1, False)
    ball = replace(ball, vertices=ball.vertices + (0.7, 0.5, 0.3))
    baked = baked_of([inside, outside, ball], cells, lamps=lamp)
    light = baked.light.total[0]
    np.testing.assert_allclose(light[baked.points.object == 1], np.pi, rtol=1e-6)
    indoors = light[baked.points.object == 0]
    assert (indoors.min() > 0.1) if lit else (indoors.max() == 0.0)


def test_a_wall_parts_a_floor_under_a_bare_sky(cells):
    """No lamp and no sun, so no test rays: the light of the sky is shaded all the same, and what is behind a closed wall on
    a line of the floor's mesh gets none."""
    ground = sheet("ground", [(0, 0, 0), (2, 0, 0), (2, 1, 0), (0, 1, 0)], 4, 2)
    hut = box("hut", (1, 0, 0), (2, 1, 1), 2, False, faces="xXyYZ")
    baked = baked_of([ground, hut], cells)
    place = baked.points.position
    under = (baked.points.object == 0) & (place[:, 0] > 1.0)
    assert baked.light.total[0, under].max() == 0.0
    at_wall = (baked.points.object == 0) & (np.abs(place[:, 0] - 1.0) < 0.01) & ~under
    assert baked.light.total[0, at_wall].min() > 1.0


def test_blocks_apart_by_more_than_touching_are_not_moved(cells):
    """A block so far above a floor that rays start between them sees the floor, and the light that gets in beside it."""
    gap = 20 * TOUCH
    light = corner_light(baked_of([floor(0.5), block(gap)], cells), "block")
    assert 0.0 < light[0].max() < 0.5


@pytest.mark.parametrize("alpha", [0.0, 0.1])
def test_what_hardly_is_there_hides_nothing(cells, alpha):
    """A block on a clear pane: its bottom gets nearly all of the sky below."""
    solid = box("block", (-0.5, -0.5, 0), (0.5, 0.5, 1), 3, False, materials=dict.fromkeys("xXyYzZ", 1))
    materials = [Material("pane", (0.0,) * 3, alpha=alpha), Material("gray", (0.5,) * 3)]
    baked = run(bake(join_meshes([floor(2.0), solid], materials, world=SKY), Settings(error=0.02), cells))
    below = (baked.points.object == 1) & (baked.points.normal[:, 2] < -0.9)
    np.testing.assert_allclose(baked.light.total[0, below], (1 - alpha) * np.pi, rtol=0.12)


def test_numbers_that_are_shared_are_all_found():
    generator = np.random.default_rng(1)
    values, others = (generator.integers(0, 1 << 62, 4000) for _ in range(2))
    values[:100] = others[:100]
    found = shared(values, others)
    assert found[:100].all()
    assert found[100:].mean() < 0.1


def test_many_points_that_touch_take_little_memory():
    """Two finely cut slabs on one another: rays from behind their faces are cast some at a time."""
    slabs = []
    for name, low, face in (("low", 0, "Z"), ("high", 1, "z")):
        for part, count, faces in ((name, 1, set("xXyYzZ") - {face}), (f"{name} {face}", 80, face)):
            slabs.append(box(part, (0, 0, low), (1, 1, low + 1), count, False, faces=sorted(faces)))
    scene, cells = join_meshes(slabs), LocalCells()
    cells.start(cast_arrays(scene))
    tracemalloc.start()
    points = make_points(scene, None, cells)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    touching = np.isin(points.object, (1, 3))
    assert touching.sum() == 2 * 81 * 81
    gap = np.abs(points.position[touching, 2] - 1)
    assert gap.min() > TOUCH * scene.diagonal  # all of them are moved
    assert peak < 5000 * len(points)
