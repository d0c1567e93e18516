"""Guided rays: nothing is counted twice or left out, they take noise away, and are called for only where that pays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core import flats, host, pictures
from cell_radiosity.core.bake import bake, run
from cell_radiosity.core.cells import LocalCells, make_cells
from cell_radiosity.core.gather import SEEDS, gather_points, light_arrays, sides_of
from cell_radiosity.core.guide import MOST_GROUPS, NOTHING, Guide, bright_sides, make_guide
from cell_radiosity.core.lights import make_sources
from cell_radiosity.core.points import block_arrays, make_points
from cell_radiosity.core.polygons import polygon_factor
from cell_radiosity.core.records import to_arrays
from cell_radiosity.core.rows import guide_rows
from cell_radiosity.core.settings import Settings
from cell_radiosity.core.state import load_state, save_state

from scenes import Lamp, Material, box, join_meshes, sheet, solve_scene

MATERIALS = (Material("walls", (0.7, 0.6, 0.5)), Material("panel", (0, 0, 0), (40.0, 30.0, 20.0)))


def panels(count, size=0.02, height=0.97):
    """Small squares below a ceiling, count times count of them, each with the four corners (4, 3)."""
    places = (np.arange(count) + 0.5) / count
    for x in places:
        for y in places:
            low, high = np.array([x, y]) - size / 2, np.array([x, y]) + size / 2
            yield [
                (low[0], high[1], height),
                (high[0], high[1], height),
                (high[0], low[1], height),
                (low[0], low[1], height),
            ]


def room(count=9, n=6):
    """A room lit by many small panels, more than are sampled one by one."""
    lights = [sheet(f"panel {k}", corners, material=1) for k, corners in enumerate(panels(count))]
    return join_meshes([box("room", n=n), *lights], MATERIALS)


@pytest.fixture(scope="module")
def lit():
    """A kernel of the room whose panels no source stands for, its points, the guide to them, and the sides that emit."""
    scene, cells = room(), LocalCells()
    solved = solve_scene(scene, cells, 0.2, found=True, row_rays=16)
    glows = solved.surfaces.found.mean(axis=0)
    sides = np.flatnonzero(glows > 0).astype(np.int32)
    guide = Guide(sides, glows[sides] * solved.patches.area[sides >> 1])
    points = make_points(scene, np.zeros(len(scene.polygon_material), bool), cells)
    solution, side = replace(solved.solution, guide=guide), sides_of(points, cells)
    arrays = light_arrays(points, solution, solved.surfaces, np.zeros((3, 1)), side)
    kernel = cells._kernel.renewed(arrays)
    return kernel, points, guide, solved


def exact(points, ids):
    """(K,) what the panels give points, nothing in between, in the first channel: Lambert's formula."""
    place, normal = points.position[ids], points.normal[ids]
    return 40.0 * sum(polygon_factor(place, normal, np.array(corners)) for corners in panels(9))


def floor(points):
    return np.flatnonzero((points.normal[:, 2] > 0.9) & (points.position[:, 2] < 0.1)).astype(np.int32)


def found(kernel, points, ids, rays, seeds):
    """(R, K) light of the panels in the first channel, by independent replicates."""
    own = block_arrays(points, ids)
    each = [gather_points(kernel, rays, rays, 1, SEEDS * k, 0, **own)["found"][0] for k in range(seeds)]
    return np.stack(each).astype(float)


def test_light_is_what_the_closed_form_says_with_a_tenth_of_the_variance(lit):
    """Counted twice, left out, or weighed by other densities than rays have, the means would be off; unguided, so would the
    variance. The panels' backs, which face the ceiling, are in the guide and can give the floor nothing."""
    kernel, points, guide, _ = lit
    assert len(guide) > MOST_GROUPS
    ids = floor(points)
    unguided = kernel.renewed(to_arrays("guide", NOTHING))
    guided, plain = found(kernel, points, ids, 16, 40), found(unguided, points, ids, 16, 40)
    true = exact(points, ids)
    for light in (guided, plain):
        mean = light.mean(axis=1)
        assert abs(mean.mean() - true.mean()) < 4 * mean.std(ddof=1) / np.sqrt(len(mean))
    deviation = (guided.mean(axis=0) - true) / (guided.std(axis=0, ddof=1) / np.sqrt(len(guided)))
    assert (deviation**2).mean() < 2.0
    assert guided.var(axis=0).mean() < plain.var(axis=0).mean() / 10


def test_what_a_point_gets_does_not_depend_on_the_others_of_its_task(lit):
    kernel, points, *_ = lit
    ids = np.arange(len(points), dtype=np.int32)
    whole = gather_points(kernel, 8, 8, 1, 0, 1, **block_arrays(points, ids))
    parts = [gather_points(kernel, 8, 8, 1, 0, 1, **block_arrays(points, part)) for part in np.array_split(ids, 7)]
    for name in whole:
        assert np.array_equal(whole[name], np.concatenate([part[name] for part in parts], axis=-1))


@pytest.mark.parametrize("rays", [1, 16])
def test_first_light_of_sides_is_what_the_closed_form_says(lit, rays):
    kernel, _, guide, solved = lit
    patches = solved.patches
    ids = np.flatnonzero((patches.normal[:, 2] > 0.9) & (patches.centroid[:, 2] < 0.1))
    light = solved.surfaces.found[:, guide.sides]
    rows = np.stack([guide_rows(kernel, 2 * ids, rays, seed, light)["guided"][0] for seed in range(24)])
    places = patches.element_frame[patches.element_start[ids]]
    steps = (np.arange(6) + 0.5) / 6
    true = np.mean(
        [
            40.0 * sum(polygon_factor(x, patches.normal[ids], np.array(corners)) for corners in panels(9))
            for a in steps
            for b in steps
            for x in (places[:, 0] + a * places[:, 1] + b * places[:, 2],)
        ],
        axis=0,
    )
    assert patches.element_square[patches.element_start[ids]].all()
    mean = rows.mean(axis=0)
    assert (
        abs(mean.mean() / true.mean() - 1) < 4 * rows.mean(axis=1).std(ddof=1) / np.sqrt(len(rows)) / true.mean() + 1e-3
    )


def test_an_evenly_lit_room_guides_no_rays():
    hits = np.arange(64 * 16).reshape(64, 16) % 200
    light, area = np.ones(201), np.ones(200)
    light[200] = 0.0
    for points in (1_000, 10**8):
        bright = bright_sides(hits, np.ones(64), np.zeros(64), light, light[:200], area, 1e-4, points, 1000)
        assert not bright.any()


def test_few_bright_sides_are_guided_to_if_there_are_points_enough_and_the_sky_is_no_side():
    hits = np.arange(64 * 16).reshape(64, 16) % 200
    light, area = np.full(201, 0.01), np.ones(200)
    light[[17, 60]] = 5.0
    weight, direct = np.ones(64), np.zeros(64)
    for points, wanted in ((1, []), (10**6, [17, 60])):
        bright = bright_sides(hits, weight, direct, light, np.zeros(200), area, 0.01, points, 1000)
        assert np.flatnonzero(bright).tolist() == wanted
    # So much comes straight from lamps that the noise of the rest does not matter.
    assert not bright_sides(hits, weight, np.full(64, 1e4), light, np.zeros(200), area, 0.01, 10**6, 1000).any()
    often = np.where(hits % 6, hits, 17)  # a wide one is met well by chance
    assert not bright_sides(often, weight, direct, light, np.zeros(200), area, 0.01, 10**6, 1000).any()
    light[200], hits[:, 0] = 50.0, -1  # what most of the light comes from cannot be guided to
    assert not bright_sides(hits, weight, direct, light, np.zeros(200), area, 0.01, 10**6, 1000).any()


def test_a_guide_is_to_bright_sides_that_can_be_seen():
    bright = np.zeros(50, bool)
    bright[10:40] = True
    light, area = np.arange(50.0), np.full(50, 2.0)
    few = make_guide(bright, np.array([[3, 11, -1, 12]]), light, area)
    assert few.sides.tolist() == [11, 12]
    assert few.power.tolist() == [22.0, 24.0]
    most = make_guide(bright, np.arange(10, 30)[None], light, area)
    assert most.sides.tolist() == list(range(10, 40))


@pytest.fixture
def always(monkeypatch):
    """Rays are guided wherever there is something bright, and most panels are left to them."""
    for module in (flats, pictures):
        monkeypatch.setattr(module, "MOST_FLATS", flats.MOST_SOURCES)
    monkeypatch.setattr(host, "bright_sides", lambda *a: np.append(a[3], 0)[: len(a[5])] > 3 * a[3].mean())


SETTINGS = Settings(error=0.1, row_rays=16, patch_edge=1 / 20, graded=False, gather_rays=32)


def test_the_same_bits_from_any_number_of_cells_and_after_a_state(always, tmp_path):
    """The guide, and what it found first, are part of a state: without them, rows would be solved for another light."""
    scene = room(7)
    results = []
    for count in (1, 2):
        with make_cells(count) as cells:
            results.append(run(bake(scene, SETTINGS, cells)))
    one, two = results
    assert len(one.solution.guide)
    assert np.array_equal(one.light.total, two.light.total)
    assert np.array_equal(one.solution.irradiance, two.solution.irradiance)
    assert "rays are guided" in next(e.reason for e in one.survey.effects if e.name == "interreflection")

    save_state(one.state(), tmp_path / "state")
    known = load_state(tmp_path / "state")
    assert np.array_equal(known.solution.guide.sides, one.solution.guide.sides)
    more = replace(SETTINGS, gather_rays=64)
    on = run(bake(scene, more, LocalCells(), state=known))
    whole = run(bake(scene, more, LocalCells(), state=one.state()))
    assert np.array_equal(on.light.total, whole.light.total)
    afresh = run(bake(scene, more, LocalCells()))
    assert on.rays < 0.8 * afresh.rays


@pytest.mark.parametrize(("count", "sampled"), [(5, 25), (7, 32), (9, 0)])
def test_of_too_many_glowing_faces_the_strongest_are_sampled_if_they_give_most(count, sampled, monkeypatch):
    """32 of 49 panels alike do, 32 of 81 do not."""
    monkeypatch.setattr(flats, "MOST_FLATS", flats.MOST_SOURCES)
    sources, polygons = make_sources(room(count))
    assert len(sources) == polygons.sum() == sampled


@pytest.mark.heavy
def test_guided_or_not_the_light_is_the_same_within_the_noise(always, monkeypatch):
    """Light that comes from panels by way of walls, too: the transport's own, and what points read of it."""
    scene, cells = room(7, 4), LocalCells()
    powers = []
    for guided in (True, False):
        if not guided:
            monkeypatch.setattr(host, "bright_sides", lambda *a: np.zeros(len(a[5]), bool))
        bakes = [run(bake(scene, replace(SETTINGS, seed=seed), cells)) for seed in range(12)]
        assert all(bool(len(b.solution.guide)) == guided for b in bakes)
        parts = ((b.points.area * light).sum() for b in bakes for light in (b.light.direct, b.light.indirect))
        powers.append(np.array(list(parts)).reshape(-1, 2))
    guided, plain = powers
    error = np.sqrt((guided.var(axis=0, ddof=1) + plain.var(axis=0, ddof=1)) / len(plain))
    assert (abs(guided.mean(axis=0) - plain.mean(axis=0)) < 4 * error).all()
    assert (guided.var(axis=0) < plain.var(axis=0) / 2).all()


def test_points_beside_a_bright_spot_stay_bounded(always):
    """The spot and points of the next wall share an edge: with guided rays alone, some would get light without end."""
    lamp = Lamp("spot", (600.0, 600.0, 600.0), (0.5, 0.5, 0.3), angle=0.6, axes=((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    scene = join_meshes([box("room", n=8)], MATERIALS[:1], [lamp])
    baked = run(bake(scene, SETTINGS, LocalCells()))
    assert len(baked.solution.guide)
    exitance = 0.7 * baked.solution.irradiance.max()
    assert baked.light.indirect.max() <= exitance
    assert np.isfinite(baked.light.total).all()


@pytest.mark.parametrize(("side", "sides"), [("front", [True, False]), ("back", [False, True]), ("lit", [True, True])])
def test_what_is_asked_for_are_the_sides_that_are_written(monkeypatch, side, sides):
    """The inside of a shade gets more light than all the room, and would hide how little of it comes from there."""

    def solve(patches, surfaces, sky, cells, settings, survey, before, written, points, owner):
        assert written.reshape(-1, 2).tolist() == [sides] * len(patches)
        assert owner is None
        raise InterruptedError

    monkeypatch.setattr("cell_radiosity.core.course.solve", solve)
    scene = join_meshes(
        [box("room", n=4)], [Material("gray", (0.5,) * 3)], [Lamp("point", (1.0,) * 3, (0.5, 0.5, 0.5))]
    )
    with pytest.raises(InterruptedError):
        run(bake(scene, Settings(side=side), LocalCells()))


def test_rays_are_guided_to_what_lights_an_object_if_each_is_to_reach_the_error(cells):
    """A dim cabinet that gets its light from one bright spot: it does not count in the whole, but by itself it does."""
    spot = Lamp("spot", (300.0,) * 3, (0.5, 0.5, 0.5), angle=0.3)
    front = [sheet(f"front {k}", c, 4, 4) for k, c in enumerate((
        [(1, 0, 0), (1, 1, 0), (1, 1, 0.45), (1, 0, 0.45)], [(1, 0, 0.55), (1, 1, 0.55), (1, 1, 1), (1, 0, 1)],
    ))]  # fmt: skip
    scene = join_meshes(
        [box("lit", n=8, faces="xyYzZ"), *front, box("cabinet", (1, 0, 0), (2, 1, 1), 16, faces="XyYzZ")],
        [Material("gray", (0.6,) * 3)],
        [spot, Lamp("area", (30.0,) * 3, (0.5, 0.5, 0.9), size=(0.3, 0.3))],
    )
    whole, each = (
        run(bake(scene, Settings(error=0.02, per_object=own, gather_rays=16), cells)) for own in (False, True)
    )
    assert not len(whole.solution.guide)
    assert len(each.solution.guide)
