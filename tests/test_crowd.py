"""A crowd of sources: what it gives is the sum of what each would, whichever members are picked, and shadows fall as they
do when each is tested alone. Patches beside sources are finer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core import crowd as core_crowd
from cell_radiosity.core.bake import bake, run
from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.crowd import make_crowd, members_of, search_rows
from cell_radiosity.core.kernel import Kernel, scene_arrays
from cell_radiosity.core.lights import BALL, make_sources, unoccluded
from cell_radiosity.core.patches import make_patches
from cell_radiosity.core.raycast import RayCaster
from cell_radiosity.core.sampling import tangents
from cell_radiosity.core.settings import Settings
from cell_radiosity.core.steep import MOST_MORE, make_fine_patches

from scenes import Lamp, Material, Mesh, box, icosphere, join_meshes, sheet

KINDS = {
    "points": dict(kind="point"),
    "balls": dict(kind="point", radius=0.05),
    "spots": dict(kind="spot", angle=1.2, blend=0.3),
    "soft spots": dict(kind="spot", angle=1.2, blend=0.3, radius=0.03),
    "squares": dict(kind="area", size=(0.1, 0.1)),
    "tubes": dict(kind="area", size=(0.5, 0.03)),
    "disks": dict(kind="area", size=(0.15, 0.1), ellipse=True),
}
CLEAR = 0.6  # of the places from the lamps [m], where one pick alone must not be far off


def frames(rng, count):
    """Axes of lamps that are turned at random."""
    z = rng.normal(size=(count, 3))
    z /= np.sqrt((z * z).sum(axis=1))[:, None]
    x = np.cross(z, np.roll(z, 1, axis=1) + (0.1, 0.2, 0.3))
    x /= np.sqrt((x * x).sum(axis=1))[:, None]
    return [tuple(map(tuple, f)) for f in zip(x, np.cross(z, x), z)]


def colored(rng, count, **kind):
    """Lamps here and there in a cube of 4 m."""
    return [
        Lamp(strength=tuple(rng.uniform(1, 2) * np.array((1.0, 0.8, 0.6))), position=tuple(p), axes=axes, **kind)
        for p, axes in zip(rng.uniform(0, 4, (count, 3)), frames(rng, count))
    ]


@pytest.fixture(params=KINDS, ids=str)
def among(request, rng):
    """A crowd with nothing in between, places among it with normals, and what all its sources give there, (C, K)."""
    scene = join_meshes([], lamps=colored(rng, 60, **KINDS[request.param]))
    sources, _ = make_sources(scene)
    chosen = members_of(sources, 100.0)  # so large a scene that none is tested alone
    assert chosen.all()
    crowd = make_crowd(sources, chosen, np.full(3, 2.0), 7.0)
    position = rng.uniform(0, 4, (3000, 3))
    away = np.min([np.sqrt(((position - p) ** 2).sum(axis=1)) for p in sources.position], axis=0)
    position = position[away > CLEAR]
    normal = np.array([f[2] for f in frames(rng, len(position))])
    light = sum(unoccluded(sources, s, position, normal) * sources.strength[s][:, None] for s in range(len(sources)))
    far = np.array([[0, 0, -90.0], [9, 0, -90], [0, 9, -90]])
    return crowd, RayCaster(far, np.array([[0, 1, 2]]), np.ones(1, bool)), position, normal, light


def off(found, light):
    return np.sqrt(((found - light) ** 2).sum() / (light**2).sum())


def test_picks_add_up_to_what_all_give_unhindered(among):
    """Nearly without noise, the less the more picks: left out, counted twice or weighed by other chances, it would stay."""
    crowd, caster, position, normal, light = among
    ids = np.arange(len(position))
    few, many = (
        crowd.at_points(caster, ids, position, normal, normal, lambda given, n=n: np.full(len(given), n), 3)
        for n in (16, 256)
    )
    assert off(few, light) < 0.06
    assert off(many, light) < 0.012
    assert abs(many.sum() / light.sum() - 1) < 2e-3


def test_few_points_get_what_they_get_among_many(among):
    crowd, caster, position, normal, _ = among

    def count(given):
        return np.clip(given * 1e9, 4, 9).astype(int)

    ids = np.arange(len(position))
    whole = crowd.at_points(caster, ids, position, normal, normal, count, 1)
    some = ids[5::7]
    assert np.array_equal(
        crowd.at_points(caster, some, position[some], normal[some], normal[some], count, 1), whole[:, some]
    )


def test_single_picks_have_the_right_mean(among, rng):
    """Within the noise, which is that of some picks of a whole crowd, not of one in a hundred that counts a hundredfold."""
    crowd, caster, position, normal, light = among
    given, start = crowd.given(position, normal), caster.start(position, normal)
    draws = [
        crowd.one(caster, position, normal, start, given, *rng.random((3, len(position)))).sum() for _ in range(64)
    ]
    assert abs(np.mean(draws) - light.sum()) < 4 * np.std(draws) / 8
    assert np.std(draws) < 4 * light.sum() / np.sqrt(len(position))


def test_single_picks_by_what_a_patch_gets_have_the_right_mean(among, rng):
    """Wherever on the patch the places lie: groups that give its middle nothing may give its rim something."""
    crowd, caster, position, normal, _ = among
    extent, whole = np.full(len(position), 0.2), np.arange(len(position))
    many = lambda given: np.full(len(given), 256)
    t1, t2 = tangents(normal)
    place = (
        position + rng.uniform(-0.14, 0.14, (len(position), 1)) * t1 + rng.uniform(-0.14, 0.14, (len(position), 1)) * t2
    )
    light, start = crowd.at_points(caster, whole, place, normal, normal, many, 3), caster.start(place, normal)
    given = crowd.given_patches(position, extent, normal).of(whole)
    draws = [crowd.one(caster, place, normal, start, given, *rng.random((3, len(place)))).sum() for _ in range(64)]
    assert abs(np.mean(draws) - light.sum()) < 4 * np.std(draws) / 8 + 2e-3 * light.sum()
    assert np.std(draws) < 4 * light.sum() / np.sqrt(len(place))


def test_what_a_side_may_get_depends_on_no_other(rng):
    """Places that are turned another way than it, and those of wide sides, are looked at alone."""
    scene = shop()
    sources, _ = make_sources(scene)
    patches = make_patches(scene, 0.05)
    kernel = Kernel(scene_arrays(scene, patches, sources))
    side = 2 * rng.integers(0, len(patches), 500)
    position, normal = patches.centroid[side >> 1], patches.normal[side >> 1].copy()
    normal[::50] = normal[1]
    found, again = (k.given_on(side[own], position[own], normal[own]) for k, own in (
        (kernel, np.arange(500)), (Kernel(kernel.arrays), np.arange(500)[3::7])
    ))  # fmt: skip
    assert np.array_equal(found.each[found.row[3::7]], again.each[again.row])
    assert np.array_equal(found.total[3::7], again.total)
    alone = kernel.picked[1].given(position, normal)
    bent = np.abs(np.einsum("kd,kd->k", patches.normal[side >> 1], normal) - 1) > 1e-3
    assert bent.any()
    assert np.array_equal(found.total[bent], alone.total[bent])
    flat = ~bent & (alone.total > 0)
    assert (found.total[flat] > 0).all()
    assert not np.array_equal(found.total[flat], alone.total[flat])
    wide = Kernel(scene_arrays(scene, make_patches(scene, 0.2), sources))
    assert np.array_equal(wide.given_on(np.full(500, 0), position, normal).total, alone.total)


def test_patches_get_their_mean(among, rng):
    """Small patches get what their centers do; a wide one, with places all over it, gets what those do in the mean."""
    crowd, caster, position, normal, light = among
    x = rng.random((2, len(position), 64))
    place, up = (np.repeat(v[:, None], 64, axis=1) for v in (position, normal))
    found = crowd.on_patches(caster, position, np.full(len(position), 0.01), place, up, *x)
    assert off(found, light) < 0.06
    assert abs(found.sum() / light.sum() - 1) < 3e-3


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize("turned", [False, True])
def test_groups_are_known_from_afar(two_sided, turned, rng):
    """What they are given is what their members give in all, whichever way these are turned; and near ones are exact."""
    axes = frames(rng, 64) if turned else [((1, 0, 0), (0, 1, 0), (0, 0, 1))] * 64
    lamps = [Lamp("area", (1.0,) * 3, tuple(p), a, size=(0.1, 0.1)) for p, a in zip(rng.uniform(0, 1, (64, 3)), axes)]
    sources, _ = make_sources(join_meshes([], lamps=lamps))
    sources = replace(sources, two_sided=np.full(64, two_sided))
    crowd = make_crowd(sources, np.ones(64, bool), np.zeros(3), 3.0)
    position = rng.normal(size=(2000, 3))
    position = 0.5 + 4 * position / np.sqrt((position**2).sum(axis=1))[:, None]
    normal = np.array([f[2] for f in frames(rng, len(position))])
    light = sum(unoccluded(sources, s, position, normal) for s in range(64)) * np.pi
    given = crowd._sums(crowd._place(position, normal)).astype(float).sum(axis=1) * crowd._relative[2]
    above = ((0.5 - position) * normal).sum(axis=1) > 1.0  # the horizon cuts none
    assert off(given[above], light[above]) < (0.07 if turned else 0.03)
    assert abs(given[above].mean() / light[above].mean() - 1) < 0.03


def test_a_place_looks_at_few_of_many(rng):
    """Members that are looked at, for each place: no more than a few times the root of their number."""
    looked = []
    for count in (256, 16_384):
        place = rng.uniform(0, 4, (count, 3))
        sources, _ = make_sources(join_meshes([], lamps=[Lamp("point", (1.0,) * 3, tuple(p)) for p in place]))
        crowd = make_crowd(sources, np.ones(count, bool), np.zeros(3), 7.0)
        place = crowd._place(rng.uniform(0, 4, (500, 3)), np.tile((0.0, 0.0, 1.0), (500, 1)))
        looked.append(len(crowd._first[0]) + crowd._far(place)[1].sum() * crowd._first[2] / 500)
    assert looked[1] < 24 * looked[0]
    assert looked[1] < 0.2 * count


def test_search_finds_what_searching_each_row_finds(rng):
    for count in (1, 2, 7, 64, 100):
        upto = np.cumsum(rng.random((20, count)) * (rng.random((20, count)) > 0.3), axis=1)
        row = np.repeat(np.arange(20), 30)
        target = rng.random(600) * upto[row, -1] * 0.999
        found = search_rows(upto, row, target)
        assert np.array_equal(
            found, [min(np.searchsorted(upto[r], t, side="right"), count - 1) for r, t in zip(row, target)]
        )


def shop(count=49):
    """A room with a block in it, lit by small panels below the ceiling and by as many bulbs, a few of them shaded."""
    side = int(count**0.5)
    places = [((i + 0.5) / side, (j + 0.5) / side) for i in range(side) for j in range(side)]
    panels = [
        sheet(
            f"panel {k}", [(x, y + 0.02, 0.9), (x + 0.02, y + 0.02, 0.9), (x + 0.02, y, 0.9), (x, y, 0.9)], material=1
        )
        for k, (x, y) in enumerate(places)
    ]
    lamps = [Lamp("point", (0.004, 0.003, 0.002), (x + 0.06, y + 0.04, 0.8), radius=0.01) for x, y in places]
    materials = (Material("walls", (0.6, 0.5, 0.4)), Material("panel", (0, 0, 0), (6.0, 7.0, 8.0)))
    return join_meshes(
        [box("room", n=8), box("block", (0.3, 0.3, 0), (0.6, 0.7, 0.6), 4, False), *panels], materials, lamps
    )


@pytest.mark.heavy
def test_shadows_fall_as_when_each_source_is_tested_alone(monkeypatch):
    """At every point, within the noise of both; a crowd takes far fewer rays."""
    settings = Settings(error=0.01, gather_rays=256, row_rays=64, patch_edge=1 / 20, graded=False)
    one = run(bake(shop(), settings, LocalCells()))
    monkeypatch.setattr(core_crowd, "MOST_SOURCES", 1000)
    each = run(bake(shop(), settings, LocalCells()))
    assert one.rays < each.rays / 3
    area, written = one.points.area, one.points.object < 2
    a, b = (x.light.direct[:, written] for x in (one, each))
    assert abs((area[written] * a).sum() / (area[written] * b).sum() - 1) < 2e-3
    assert np.sqrt((area[written] * (a - b) ** 2).sum() / (area[written] * b * b).sum()) < 0.02
    indirect = [(x.points.area * x.light.indirect).sum(axis=1) for x in (one, each)]
    np.testing.assert_allclose(*indirect, rtol=0.01)


def test_few_sources_are_no_crowd_and_suns_never_are():
    sun = Lamp("sun", (1.0, 1.0, 1.0), axes=((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    bulb = Lamp("point", (1.0, 1.0, 1.0))
    sources, _ = make_sources(join_meshes([], lamps=[bulb] * 32))
    assert not members_of(sources, 1.0).any()
    sources, _ = make_sources(join_meshes([], lamps=[bulb] * 33 + [sun]))
    assert np.array_equal(members_of(sources, 1.0), sources.kind <= BALL)
    large = Lamp("area", (1.0, 1.0, 1.0), size=(2.0, 2.0))
    sources, _ = make_sources(join_meshes([], lamps=[bulb] * 33 + [large]))
    assert np.array_equal(members_of(sources, 10.0), sources.kind == BALL)


@pytest.mark.parametrize("error", [0.02, 0.008])
def test_glowing_ball_of_thousands_of_faces(error):
    """A mesh of 5 120 triangles as a lamp: the light of a ball, exitance r^2 cos / d^2, in every color."""
    ball = icosphere("ball", 0.3, 4, inward=False, material=1)
    ball = replace(ball, vertices=ball.vertices + (0.2, 0.1, 1.0))
    floor = sheet("floor", [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], 20, 20)
    materials = (Material("floor", (0, 0, 0)), Material("ball", (0, 0, 0), (20.0, 10.0, 5.0)))
    scene = join_meshes([floor, ball], materials, written=[True, False])
    baked = run(bake(scene, Settings(error=error), LocalCells()))
    toward = np.array((0.2, 0.1, 1.0)) - baked.points.position
    square = (toward**2).sum(axis=1)
    shown = scene.triangle_normal_area[1][scene.polygon_material[scene.triangle_polygon] == 1].sum() / 4 / np.pi
    light = np.array((20.0, 10.0, 5.0))[:, None] * shown * toward[:, 2] / square**1.5
    area, found = baked.points.area, baked.light.direct + baked.light.indirect
    assert baked.converged
    assert np.sqrt((area * (found - light) ** 2).sum() / (area * light**2).sum()) < error
    np.testing.assert_allclose((area * found).sum(axis=1), (area * light).sum(axis=1), rtol=2e-3)


def faces(corners, polygons):
    """Flat sources of glowing faces, and which of them those are."""
    mesh = Mesh.of_polygons("glow", corners, polygons)
    return make_sources(join_meshes([mesh], [Material("glow", (0, 0, 0), (1.0, 1.0, 1.0))]))


def test_faces_are_sources_whatever_their_shape():
    """In one plane they are one, if that is convex; a warped one is the triangles that rays meet."""
    square = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    grid = [(x, y, 0) for y in range(3) for x in range(3)]
    quads = [[0, 1, 4, 3], [1, 2, 5, 4], [3, 4, 7, 6], [4, 5, 8, 7]]
    for corners, polygons, areas in (
        (square, [[0, 1, 2, 3]], [1.0]),
        ([*square[:3], (0, 1, 0.2)], [[0, 1, 2, 3]], [0.5, 0.5 * (1 + 2 * 0.2**2) ** 0.5]),
        ([(np.cos(t), np.sin(t), 0) for t in np.arange(8) * np.pi / 4], [list(range(8))], [8 * 2**-0.5 / 2]),
        (grid, quads, [4.0]),
        (grid, quads[:3], [1.0, 1.0, 1.0]),
    ):
        sources, sampled = faces(corners, polygons)
        assert sampled.all()
        np.testing.assert_allclose(np.sort(sources.areas), np.sort(areas), rtol=1e-9)
        assert np.isclose(
            sources.areas.sum(), join_meshes([Mesh.of_polygons("", corners, polygons)]).triangle_normal_area[1].sum()
        )
        assert (sources.reaches >= np.sqrt(sources.areas / np.pi)).all()
        first = sources.only(np.arange(len(sources)) == len(sources) - 1)
        assert np.array_equal(first.polygon(0), sources.polygon(len(sources) - 1))


def test_a_fold_is_left_to_rays():
    """Triangles of it lie on one another: as sources they would shine twice there."""
    square = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    for corners in ([square[0], square[2], square[1], square[3]], [*square[:3], (0.9, 0.1, 0)]):
        sources, sampled = faces(corners, [[0, 1, 2, 3]])
        assert not len(sources)
        assert not sampled.any()


def test_pieces_fill_their_sources(monkeypatch, rng):
    """Each point of a source lies in one piece of it: area and center are kept, and so are the edges' lengths in bounds."""
    corners = rng.uniform(size=(40, 3, 3))
    far = corners[:, 1] + corners[:, 2] - corners[:, 0]
    quads = np.stack([corners[:, 0], corners[:, 1], far, corners[:, 2]], axis=1)
    for shapes in (corners, quads):
        sources, _ = faces(shapes.reshape(-1, 3), np.arange(shapes[..., 0].size).reshape(len(shapes), -1).tolist())
        crowd = make_crowd(sources, np.ones(len(sources), bool), np.zeros(3), 3.0)
        assert len(crowd.members) > 3 * len(sources)
        area = np.bincount(crowd.members.source, crowd.members.area)
        np.testing.assert_allclose(area, sources.areas)
        middle = (
            np.stack(
                [np.bincount(crowd.members.source, crowd.members.area * x) for x in crowd.members.center.T], axis=1
            )
            / area[:, None]
        )
        np.testing.assert_allclose(middle, sources.position, atol=1e-9)
        assert crowd.members.reach.max() < 0.5 * sources.reaches.max()


def tube(gap):
    """A room whose western wall has a glowing tube before it."""
    corners = [(gap, 0.2, 0.5), (gap, 0.8, 0.5), (gap, 0.8, 0.51), (gap, 0.2, 0.51)]
    materials = (Material("walls", (0.6, 0.5, 0.4)), Material("tube", (0, 0, 0), (50.0, 50.0, 50.0)))
    return join_meshes([box("room", n=10), sheet("tube", corners, material=1)], materials)


def test_patches_beside_a_source_are_finer():
    edge = 0.1
    scene = tube(0.02)
    even, fine = make_patches(scene, edge), make_fine_patches(scene, make_sources(scene)[0], edge, 0.0)
    size = np.bincount(fine.polygon, minlength=601) / np.bincount(even.polygon, minlength=601)
    beside = np.zeros(601, bool)
    for p in np.unique(fine.polygon[fine.centroid[:, 0] < 1e-6]):
        center = fine.centroid[fine.polygon == p].mean(axis=0)
        beside[p] = abs(center[2] - 0.5) < 0.06 and abs(center[1] - 0.5) < 0.25
    assert (size[beside] >= 4).all()
    assert np.median(size) == 1
    assert len(fine) <= MOST_MORE * len(even)
    assert np.isclose(fine.area.sum(), even.area.sum())
    assert len(make_fine_patches(scene, None, edge, 0.0)) == len(even)


def test_patches_far_from_sources_are_as_ever():
    scene = tube(0.5)
    walls = [
        p.polygon < 600 for p in (make_patches(scene, 0.1), make_fine_patches(scene, make_sources(scene)[0], 0.1, 0.0))
    ]
    assert walls[0].sum() == walls[1].sum()


def test_the_strength_of_all_lamps_together_does_not_change_patches():
    scene = tube(0.02)
    brighter = replace(
        scene, materials=tuple(replace(m, exitance=tuple(7 * x for x in m.exitance)) for m in scene.materials)
    )
    a, b = (make_fine_patches(s, make_sources(s)[0], 0.1, 0.0) for s in (scene, brighter))
    assert np.array_equal(a.centroid, b.centroid)


@pytest.mark.parametrize("away", [1e3, 1e8, 1e14])
@pytest.mark.parametrize("small", [1e-3, 1e-9])
def test_members_of_any_size_near_and_far(away, small, rng):
    """Lamps in a room, specks among them that are as strong, and lamps so far away that each gives what a near one does:
    all of them are picked by what they give, as float32 has it."""
    kinds = [dict(kind="point"), dict(kind="point", radius=small), dict(kind="area", size=(small, small))]
    lamps = [lamp for kind in kinds for lamp in colored(rng, 20, **kind)]
    lamps = [replace(k, strength=tuple(np.array(k.strength) / small**2)) if k.kind == "area" else k for k in lamps]
    far = colored(rng, 20, kind="point")
    lamps += [
        replace(
            k, position=tuple(2 + away * (np.array(k.position) - 2)), strength=tuple(np.array(k.strength) * away**2)
        )
        for k in far
    ]
    sources, _ = make_sources(join_meshes([], lamps=lamps))
    crowd = make_crowd(sources, np.ones(len(sources), bool), np.full(3, 2.0), 7.0)
    position = rng.uniform(0, 4, (3000, 3))
    near = np.min([np.sqrt(((position - p) ** 2).sum(axis=1)) for p in sources.position], axis=0)
    position = position[near > CLEAR]
    normal = np.array([f[2] for f in frames(rng, len(position))])
    light = sum(unoccluded(sources, s, position, normal) * sources.strength[s][:, None] for s in range(len(sources)))
    caster = RayCaster(np.eye(3), np.array([[0, 1, 2]]), np.ones(1, bool))
    ids, count = np.arange(len(position)), lambda given: np.full(len(given), 64)
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        found = crowd.at_points(caster, ids, position, normal, normal, count, 3, occluded=False)
        given = crowd.given(position, normal)
        single = [
            crowd.one(caster, position, normal, position, given, *rng.random((3, len(position))), occluded=False)
            for _ in range(64)
        ]
        slope = crowd.slope(position, normal, np.full(len(position), 0.1))
    assert off(found, light) < 0.06
    assert abs(found.sum() / light.sum() - 1) < 5e-3
    assert abs(np.mean(single) * light.size / light.sum() - 1) < 0.02
    assert np.isfinite(slope).all()
    assert slope.min() > 0
