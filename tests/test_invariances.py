"""What must not change the light: where a scene is, how large, how its meshes are written down, how its lamps are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from cell_radiosity.core.cells import LocalCells

from scenes import Lamp, Material, Mesh, Settings, World, bake, box, join_meshes, run

SETTINGS = Settings(error=0.002, gather_rays=256, row_rays=32, patch_edge=1 / 16)
MEAN = 0.01  # noise of an object's mean light at these settings

share = st.floats(0.1, 0.9)
inside = st.floats(0.3, 0.7)
color = st.tuples(share, share, share)


@st.composite
def rooms(draw):
    """A room with a block somewhere, two small lamps outside of the block, an open side under a sky or none."""
    low = np.array([draw(st.sampled_from((0.125, 0.25, 0.375))) for _ in range(2)] + [0.0])
    high = low + [draw(st.sampled_from((0.125, 0.25, 0.375))) for _ in range(3)]
    faces = "xXyYzZ" if draw(st.booleans()) else "xXyYz"
    materials = [Material("walls", draw(color)), Material("block", draw(color))]
    block = box("block", low, high, 2, False, dict.fromkeys("xXyYzZ", 1))
    lamps = [
        Lamp("point", tuple(np.array(draw(color))), (draw(inside), draw(inside), 0.75)),
        Lamp("point", tuple(np.array(draw(color))), (0.25, draw(inside), 0.7)),
    ]
    world = World((0.1, 0.2, 0.3)) if len(faces) < 6 else World()
    return join_meshes([box("room", n=3, faces=faces), block], materials, lamps, world)


def light(scene, settings=SETTINGS):
    """The Bake of a scene, and its light (P, C)."""
    baked = run(bake(scene, settings, LocalCells()))
    return baked, (baked.light.direct + baked.light.indirect).T


def means(scene):
    """{object: (C,)} mean light by area; objects whose names differ after a slash count as one."""
    baked, total = light(scene)
    names = [scene.objects[o].split("/")[0] for o in baked.points.object]
    result = {}
    for name in sorted(set(names)):
        area = baked.points.area * np.array([n == name for n in names])
        result[name] = (area[:, None] * total).sum(axis=0) / area.sum()
    return result


def assert_same_means(scene, other):
    """The light of two ways to write one scene down is the same but for noise."""
    first, second = means(scene), means(other)
    assert first.keys() == second.keys()
    for name in first:
        np.testing.assert_allclose(first[name], second[name], rtol=3 * MEAN, atol=MEAN * max(first["room"]))


def with_lamps(scene, change):
    return replace(scene, lamps=tuple(change(lamp) for lamp in scene.lamps))


def meshes_of(scene):
    """The scene's objects as Meshes again."""
    result = []
    for o, name in enumerate(scene.objects):
        polygons = [
            scene.corner_vertex[a:b].tolist()
            for a, b, owner in zip(scene.polygon_start, scene.polygon_start[1:], scene.polygon_object)
            if owner == o
        ]
        result.append(
            Mesh.of_polygons(name, scene.vertices, polygons, scene.polygon_material[scene.polygon_object == o])
        )
    return result


def joined(scene, meshes):
    return join_meshes(meshes, scene.materials, scene.lamps, scene.world)


def polygons_of(mesh):
    return [p.tolist() for p in np.split(mesh.corner_vertex, mesh.polygon_start[1:-1])]


few = settings(max_examples=3, deadline=None, derandomize=True, phases=(Phase.explicit, Phase.generate))


@few
@given(rooms(), st.integers(-30, 30))
def test_scale(scene, power):
    """Every length times a power of two, lamps as much stronger: the same bits."""
    factor = 2.0**power
    larger = with_lamps(
        replace(scene, vertices=scene.vertices * factor),
        lambda lamp: replace(
            lamp,
            position=tuple(factor * np.array(lamp.position)),
            strength=tuple(factor * factor * np.array(lamp.strength)),
        ),
    )
    np.testing.assert_array_equal(light(larger)[1], light(scene)[1])


@few
@given(rooms(), st.tuples(*[st.integers(-100, 100)] * 3))
def test_translation(scene, step):
    moved = with_lamps(
        replace(scene, vertices=scene.vertices + np.array(step, float)),
        lambda lamp: replace(lamp, position=tuple(np.array(lamp.position) + step)),
    )
    assert_same_means(scene, moved)


@few
@given(rooms(), st.integers(0, 1000))
def test_rotation(scene, seed):
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    turned = with_lamps(
        replace(scene, vertices=scene.vertices @ turn.T, corner_normal=scene.corner_normal @ turn.T),
        lambda lamp: replace(lamp, position=tuple(turn @ np.array(lamp.position))),
    )
    assert_same_means(scene, turned)


@few
@given(rooms(), st.randoms(use_true_random=False))
def test_order_of_polygons_and_of_objects(scene, random):
    meshes = []
    for mesh in meshes_of(scene):
        order = list(range(len(mesh.polygon_material)))
        random.shuffle(order)
        polygons = polygons_of(mesh)
        starts = [random.randrange(4) for _ in order]
        meshes.append(
            Mesh.of_polygons(
                mesh.name, mesh.vertices, [polygons[k][s:] + polygons[k][:s] for k, s in zip(order, starts)],
                mesh.polygon_material[order],
            )
        )  # fmt: skip
    assert_same_means(scene, joined(scene, meshes[::-1]))


@few
@given(rooms())
def test_vertices_of_its_own_for_every_polygon(scene):
    """Unwelded: every polygon a sheet by itself."""
    meshes = []
    for mesh in meshes_of(scene):
        polygons = np.arange(len(mesh.corner_vertex)).reshape(-1, 4)
        meshes.append(
            Mesh.of_polygons(mesh.name, mesh.vertices[mesh.corner_vertex], polygons.tolist(), mesh.polygon_material)
        )
    assert_same_means(scene, joined(scene, meshes))


@few
@given(rooms())
def test_polygons_split_along_a_diagonal(scene):
    meshes = []
    for mesh in meshes_of(scene):
        halves = [half for a, b, c, d in polygons_of(mesh) for half in ((a, b, c), (a, c, d))]
        meshes.append(Mesh.of_polygons(mesh.name, mesh.vertices, halves, np.repeat(mesh.polygon_material, 2)))
    first, second = means(scene), means(joined(scene, meshes))
    for name in first:  # a corner counts for a quarter of its quad, but for a third of two halves or of one
        np.testing.assert_allclose(first[name], second[name], rtol=0.12)


@few
@given(rooms(), st.integers(1, 5))
def test_objects_split_in_two(scene, cut):
    meshes = []
    for mesh in meshes_of(scene):
        polygons = polygons_of(mesh)
        for part, chosen in (("a", slice(0, cut)), ("b", slice(cut, None))):
            meshes.append(
                Mesh.of_polygons(f"{mesh.name}/{part}", mesh.vertices, polygons[chosen], mesh.polygon_material[chosen])
            )
    assert_same_means(scene, joined(scene, meshes))


@few
@given(rooms())
def test_a_lamp_is_two_lamps_of_half_its_strength(scene):
    halves = [replace(lamp, strength=tuple(np.array(lamp.strength) / 2)) for lamp in scene.lamps]
    _, total = light(scene)
    np.testing.assert_allclose(light(replace(scene, lamps=(*halves, *halves)))[1], total, atol=1e-6 * total.mean())


@few
@given(rooms())
def test_light_is_linear_in_the_lamps(scene):
    """Two lamps and the sky together give the sum of what each gives, but for what the filter and the stops of each leave."""
    dark, even = replace(scene, world=World()), replace(SETTINGS, graded=False, row_rays=64)  # the same patches for all
    parts = [replace(dark, lamps=(lamp,)) for lamp in scene.lamps] + [replace(scene, lamps=())]
    alone = sum(light(part, even)[1] for part in parts)
    total = light(scene, even)[1]
    np.testing.assert_allclose(alone, total, atol=0.02 * total.mean())


@few
@given(rooms(), st.permutations((0, 1, 2)))
def test_channels_change_places(scene, order):
    def change(values):
        return tuple(np.array(values)[list(order)])

    other = replace(
        with_lamps(scene, lambda lamp: replace(lamp, strength=change(lamp.strength))),
        materials=tuple(replace(m, reflectance=change(m.reflectance)) for m in scene.materials),
        world=World(change(scene.world.radiance)),
    )
    _, total = light(scene)
    np.testing.assert_allclose(light(other)[1], total[:, list(order)], atol=1e-6 * total.mean())
