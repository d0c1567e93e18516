"""The sky: the octahedral map, what rays find of it and what is sampled, against closed forms and against a sun."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.effects import survey
from cell_radiosity.core.sky import cell_directions, cells_of, solid_angles, split_sky

from scenes import Lamp, Material, Settings, World, bake, box, join_meshes, point_light, run, sheet, solve_scene

FLOOR = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
BLACK, GRAY = Material("black", (0, 0, 0)), Material("gray", (0.6, 0.6, 0.6))


def sky_map(radiance, size=128):
    """World of a function of directions (K, 3) that gives radiance (K,) or (K, 3)."""
    values = np.asarray(radiance(cell_directions(size)), float)
    values = values if values.ndim == 2 else np.repeat(values[:, None], 3, axis=1)
    return World(map=values.reshape(size, size, 3).astype(np.float32))


def disk(toward, half, radiance):
    """A disk of some half angle about a direction, as a function of directions."""
    toward = np.asarray(toward) / np.linalg.norm(toward)
    return lambda d: np.where((d * toward).sum(axis=1) > np.cos(half), radiance, 0.0)


def baked(scene, **settings):
    knobs = {"error": 0.02, "patch_edge": 1 / 20, "row_rays": 64, "gather_rays": 256, **settings}
    return run(bake(scene, Settings(**knobs), LocalCells()))


def test_cells_and_directions_are_each_other(rng):
    for size in (1, 2, 7, 32):
        for a, b in ((0.5, 0.5), (0.01, 0.99)):
            np.testing.assert_array_equal(cells_of(cell_directions(size, a, b), size), np.arange(size * size))
    d = rng.normal(size=(20_000, 3))
    counts = np.bincount(cells_of(d, 8), minlength=64) / len(d)
    np.testing.assert_allclose(counts, solid_angles(8) / (4 * np.pi), atol=5 * np.sqrt(1 / 64 / len(d)))
    assert solid_angles(32).sum() == pytest.approx(4 * np.pi)


@pytest.mark.parametrize("bright", [0.0, 300.0])
def test_split_loses_nothing(bright):
    """What rays find and what is sampled add up to the map: power, and power along each axis."""
    spot = disk((1, 0.5, 0.7), 0.15, bright)
    world = sky_map(lambda d: 1.0 + 0.5 * d[:, 2] + spot(d))
    cells, groups = split_sky(world)
    assert bool(groups) == (bright > 0)
    whole = world.map.reshape(-1, 3) * solid_angles(128)[:, None]
    found = cells * solid_angles(32)[:, None]
    assert found.sum() + sum(g.irradiance.sum() for g in groups) == pytest.approx(whole.sum(), rel=2e-3)
    along = np.einsum("kc,kd->cd", found, cell_directions(32))
    along = along + sum(np.outer(g.irradiance, g.directions.mean(axis=0)) for g in groups)
    np.testing.assert_allclose(along, np.einsum("kc,kd->cd", whole, cell_directions(128)), atol=2e-3 * whole.sum())


@pytest.mark.parametrize("tilt", [0.0, 0.7, 2.0])
def test_gradient_on_a_tilted_plane(tilt):
    """L = a + b z gives a plane whose normal is n an irradiance of pi a + 2/3 pi b n_z, at points and on patches."""
    c, s = np.cos(tilt), np.sin(tilt)
    corners = [(x * c, y, -x * s) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    world = sky_map(lambda d: np.stack([2.0 + d[:, 2], 1.0 - d[:, 2], 3.0 + 0 * d[:, 2]], axis=1))
    scene = join_meshes([sheet("plane", corners, 3, 3)], [GRAY], world=world)
    exact = np.pi * np.array([2.0, 1.0, 3.0]) + 2 / 3 * np.pi * np.array([1.0, -1.0, 0.0]) * c
    light = baked(scene, force=("interreflection",))
    np.testing.assert_allclose(light.light.direct.mean(axis=1), exact, rtol=1e-2)
    np.testing.assert_allclose(light.light.direct, np.repeat(exact[:, None], 16, axis=1), rtol=0.03)
    np.testing.assert_allclose(light.solution.irradiance[:, ::2].mean(axis=1), exact, rtol=0.02)


def test_bright_disk_is_like_a_sun():
    """A small bright disk in the map against a sun of the same irradiance and angle: light, shadow, and reflections."""
    toward, half = np.array((0.4, 0.2, 0.9)) / np.linalg.norm((0.4, 0.2, 0.9)), 0.2
    irradiance = 4.0 * np.pi * np.sin(half) ** 2
    meshes = [
        sheet("floor", [(-1, -1, 0), (2, -1, 0), (2, 2, 0), (-1, 2, 0)], 12, 12),
        box("block", (0.3, 0.3, 0), (0.6, 0.6, 0.5), n=4, inward=False),
    ]
    x = np.cross((0, 1, 0), toward)
    x = x / np.linalg.norm(x)
    sun = Lamp("sun", (irradiance,) * 3, axes=(tuple(x), tuple(np.cross(toward, x)), tuple(toward)), angle=2 * half)
    of_sun = baked(join_meshes(meshes, [GRAY], [sun]))
    of_sky = baked(join_meshes(meshes, [GRAY], world=sky_map(disk(toward, half, 4.0), 512)))
    for part in ("direct", "indirect"):
        expected, found = getattr(of_sun.light, part)[0], getattr(of_sky.light, part)[0]
        area = of_sun.points.area
        error = np.sqrt((area * (found - expected) ** 2).sum() / (area * expected**2).sum())
        assert error < (0.02 if part == "direct" else 0.05)
        assert (area * found).sum() == pytest.approx((area * expected).sum(), rel=0.01 if part == "direct" else 0.03)


def test_map_of_one_color_is_one_color():
    """The same light as without a map, to the noise of cells that rays pick apart."""
    meshes = [sheet("floor", FLOOR, 6, 6), sheet("wall", [(0, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1)][::-1], 6, 6)]
    plain = baked(join_meshes(meshes, [GRAY], world=World((0.3, 0.3, 0.3))))
    mapped = baked(join_meshes(meshes, [GRAY], world=sky_map(lambda d: np.full(len(d), 0.3))))
    np.testing.assert_allclose(mapped.light.direct, plain.light.direct, rtol=1e-6)
    np.testing.assert_allclose(mapped.light.indirect, plain.light.indirect, rtol=1e-6)
    energy = mapped.solution.energy
    assert energy["emitted_w"] == pytest.approx(plain.solution.energy["emitted_w"], rel=1e-6)


def test_light_through_a_hole():
    """A box with a small hole under a map: only the directions in the hole give light, at points and on patches."""
    lid = [
        [(0, 0, 1), (0.3, 0, 1), (0.3, 1, 1), (0, 1, 1)], [(0.7, 0, 1), (1, 0, 1), (1, 1, 1), (0.7, 1, 1)],
        [(0.3, 0, 1), (0.7, 0, 1), (0.7, 0.3, 1), (0.3, 0.3, 1)], [(0.3, 0.7, 1), (0.7, 0.7, 1), (0.7, 1, 1), (0.3, 1, 1)],
    ]  # fmt: skip
    meshes = [box(n=4, faces="xXyYz"), *(sheet(str(k), corners[::-1]) for k, corners in enumerate(lid))]
    world = sky_map(
        lambda d: np.stack([np.where(d[:, 2] > 0, 1.0, 0.0), np.where(d[:, 0] > 0, 1.0, 0.0), 0 * d[:, 0]], axis=1)
    )
    scene = join_meshes(meshes, [BLACK], world=world)
    found = point_light(
        baked(scene, gather_rays=1024, force=("interreflection", "color")),
        [(0.5, 0.5, 0), (0.25, 0.5, 0), (0.75, 0.5, 0)],
    )
    lamp = Lamp("area", (1.0,) * 3, position=(0.5, 0.5, 1.0), size=(0.4, 0.4))
    exact = point_light(
        baked(join_meshes([box(n=4)], [BLACK], [lamp])), [(0.5, 0.5, 0), (0.25, 0.5, 0), (0.75, 0.5, 0)]
    )[:, 0]
    np.testing.assert_allclose(found[:, 0], exact, rtol=0.06)
    np.testing.assert_allclose(found[:, 1], exact * (0.5, 1.0, 0.0), rtol=0.1, atol=0.01 * exact[0])


def test_survey_of_a_map():
    """A tinted map brings color back; a closed room leaves all of the map out, its bright parts too."""
    spot = disk((0.1, 0.2, 1.0), 0.1, 1.0)
    gray, tinted = (
        sky_map(lambda d: 0.01 + spot(d)),
        sky_map(lambda d: np.stack([0.01 + spot(d)] * 2 + [0.011 + spot(d)], axis=1)),
    )
    assert split_sky(gray)[1]
    floor = join_meshes([sheet("floor", FLOOR)], [GRAY], world=gray)
    assert not survey(floor).needs("color")
    assert survey(replace(floor, world=tinted)).needs("color")
    lamp = Lamp("area", (10.0,) * 3, position=(0.5, 0.5, 0.9), size=(0.3, 0.3))
    closed = join_meshes([box(n=4)], [GRAY], [lamp], gray)
    assert not survey(closed).needs("sky")
    dark = replace(closed, world=World())
    np.testing.assert_array_equal(baked(closed).light.direct, baked(dark).light.direct)


@pytest.mark.parametrize("rows", ["rays", "analytic"])
def test_rows_take_a_map(rows):
    """Either estimator, on patches: a map of one color gives what the color gives."""
    scene = join_meshes([sheet("floor", FLOOR, 2, 2)], [GRAY], world=sky_map(lambda d: np.full(len(d), 0.5)))
    solved = solve_scene(scene, LocalCells(), edge=0.3, rows=rows)
    np.testing.assert_allclose(solved.mean(solved.solution.irradiance), 0.5 * np.pi, rtol=1e-6)


@pytest.mark.parametrize("size", [1, 3, 8])
def test_coarse_maps_are_as_fine_ones(size, rng):
    """A map of fewer cells than rays read: none of these is empty, and no light is lost."""
    coarse = World(map=rng.uniform(0.5, 1.5, (size, size, 3)))
    cells, groups = split_sky(coarse)
    assert np.isfinite(cells).all()
    assert not groups
    middle = cells_of(cell_directions(32), size)
    inside = middle == cells_of(cell_directions(32, 0.1, 0.1), size)
    inside &= middle == cells_of(cell_directions(32, 0.9, 0.9), size)
    np.testing.assert_allclose(cells[inside], coarse.map.reshape(-1, 3)[middle][inside], rtol=1e-12)
