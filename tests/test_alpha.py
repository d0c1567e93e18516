"""Surfaces that rays pass by chance: what gets through, that no light is lost, and that holes are holes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.effects import survey
from cell_radiosity.core.gather import sides_of
from cell_radiosity.core.health import mend
from cell_radiosity.core.kernel import Kernel, cast_arrays, scene_arrays
from cell_radiosity.core.lights import make_sources
from cell_radiosity.core.surfaces import Texture

from scenes import Lamp, Material, Settings, World, bake, box, join_meshes, point_light, run, sheet, solve_scene

FLOOR = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
SUN = Lamp("sun", (2.0, 1.0, 0.5))


def at_height(z, inset=-1.0):
    low, high = inset, 1 - inset
    return [(low, low, z), (high, low, z), (high, high, z), (low, high, z)]


def baked(scene, **settings):
    return run(bake(scene, Settings(**{"error": 0.02, "patch_edge": 1 / 20, **settings}), LocalCells()))


def rays_up(scene, count=40_000):
    """The kernel of a scene, starts of rays spread over the floor, and their direction."""
    kernel = Kernel(cast_arrays(scene))
    k = np.arange(count)
    place = np.stack([(k * 0.7548776662) % 1.0, (k * 0.5698402910) % 1.0, np.zeros(count)], axis=1)
    start = kernel.caster.start(0.8 * place + (0.1, 0.1, 0.0), np.array([0.0, 0.0, 1.0]))
    return kernel, start, np.tile(np.float32([0, 0, 1]), (count, 1))


def test_share_that_passes():
    """Rays through sheets of alpha 0.5 and 0.7, by all three kinds of query, within five standard deviations."""
    sheets = [
        sheet("floor", FLOOR),
        sheet("a", at_height(0.3), material=1),
        sheet("b", at_height(0.6), material=2),
        sheet("top", at_height(0.9)),
    ]
    scene = join_meshes(sheets, [Material(), Material(alpha=0.5), Material(alpha=0.7)])
    kernel, start, up = rays_up(scene)
    spread = 5 * 0.5 / np.sqrt(len(start))
    triangle, _, _, distance, back = kernel.caster.hits(start, up)
    share = np.bincount(triangle // 2, minlength=4) / len(start)
    np.testing.assert_allclose(share, [0, 0.5, 0.35, 0.15], atol=spread)
    np.testing.assert_allclose(distance * scene.diagonal, np.array([0, 0.3, 0.6, 0.9])[triangle // 2], atol=1e-3)
    assert back.all()
    for height, blocked in ((0.2, 0.0), (0.5, 0.5), (0.8, 0.85)):
        target = kernel.caster.place(kernel.caster.frame[0] + start / kernel.caster.frame[1] + (0, 0, height))
        assert kernel.caster.shaded(start, target, None).mean() == pytest.approx(blocked, abs=spread)
    open_above = join_meshes(sheets[:3], scene.materials)
    kernel, start, up = rays_up(open_above)
    assert kernel.caster.shaded_toward(start, up).mean() == pytest.approx(0.85, abs=spread)


def test_nothing_caps_how_often_a_ray_goes_on():
    """Forty sheets of alpha 0.02: 0.98^40 of the rays get through, not 0."""
    scene = join_meshes(
        [sheet("floor", FLOOR), *(sheet(str(k), at_height(0.02 * k + 0.1), material=1) for k in range(40))],
        [Material(), Material(alpha=0.02)],
    )
    kernel, start, up = rays_up(scene)
    through = 1 - kernel.caster.shaded_toward(start, up).mean()
    assert through == pytest.approx(0.98**40, abs=5 * 0.5 / np.sqrt(len(start)))


def test_the_same_ray_makes_the_same_choice():
    """However rays are cut into tasks, and whatever their order."""
    scene = join_meshes(
        [sheet("floor", FLOOR), sheet("a", at_height(0.3), material=1)], [Material(), Material(alpha=0.5)]
    )
    kernel, start, up = rays_up(scene, 999)
    whole = kernel.caster.hits(start, up)[0]
    order = np.argsort(whole, kind="stable")[::-1]
    np.testing.assert_array_equal(kernel.caster.hits(start[order], up[order])[0], whole[order])
    np.testing.assert_array_equal(kernel.caster.hits(start[100:200], up[100:200])[0], whole[100:200])


def test_sun_through_two_sheets():
    sheets = [
        sheet("floor", FLOOR, 8, 8),
        sheet("a", at_height(0.3), material=1),
        sheet("b", at_height(0.6), material=2),
    ]
    black = [Material("black", (0, 0, 0)), Material("a", (0, 0, 0), alpha=0.5), Material("b", (0, 0, 0), alpha=0.3)]
    scene = join_meshes(sheets, black, [SUN], written=[True, False, False])
    # 81 points of some 380 test rays each: the mean over all to 1 % (five standard deviations), each point to 0.3.
    for angle in (0.0, 0.01):
        light = baked(replace(scene, lamps=(replace(SUN, angle=angle),)), gather_rays=256).light.direct
        np.testing.assert_allclose(light.mean(axis=1), np.array(SUN.strength) * 0.5 * 0.7, rtol=0.04)
        assert np.abs(light[0] / (SUN.strength[0] * 0.35) - 1).max() < 0.4


def test_furnace_with_a_veil():
    """A closed room in which all that is there emits (1 - reflectance) L: L everywhere, whatever passes the veil."""
    veil = sheet("veil", [(0.2, 0.2, 0.2), (0.8, 0.2, 0.3), (0.8, 0.8, 0.7), (0.2, 0.8, 0.6)], 3, 3, material=1)
    walls = Material("walls", (0.5,) * 3, exitance=(0.5,) * 3)
    scene = join_meshes([box(n=4), veil], [walls, Material("veil", (0.2,) * 3, exitance=(0.8,) * 3, alpha=0.4)])
    solved = solve_scene(scene, LocalCells(), edge=0.25, found=True, row_rays=64)
    veil = solved.scene.polygon_object[solved.patches.polygon] == 1
    np.testing.assert_allclose(solved.radiosity[:, 0::2], 1.0, atol=2e-3)
    np.testing.assert_allclose(solved.radiosity[:, 1::2][:, veil], 1.0, atol=2e-3)
    energy = solved.solution.energy
    assert energy["emitted_w"] == pytest.approx(
        energy["absorbed_w"] + energy["escaped_w"] + energy["unshot_w"], rel=1e-9
    )
    # What is emitted is what is there.
    area = solved.patches.area[veil].sum()
    assert energy["emitted_w"] == pytest.approx(3 * (2 * 6 * 0.5 + 2 * 0.4 * area * 0.8), rel=1e-6)


def test_image_with_holes_is_like_holes():
    """A sheet whose image is 0 in every other square, against a mesh of the squares that are left."""
    board = (np.indices((4, 4)).sum(axis=0) % 2).astype(np.float32)
    pixels = np.repeat(board[..., None], 3, axis=2)
    squares = [sheet(str(k), [(x, y, 0.3), (x + 0.5, y, 0.3), (x + 0.5, y + 0.5, 0.3), (x, y + 0.5, 0.3)], material=1)
               for k, (row, column) in enumerate(np.argwhere(board > 0)) for x, y in [(column / 2 - 0.5, row / 2 - 0.5)]]  # fmt: skip
    whole = replace(
        sheet("board", at_height(0.3, -0.5), material=1), corner_uv=np.array([(0, 0), (1, 0), (1, 1), (0, 1.0)])
    )
    gray = [Material("floor", (0.6,) * 3), Material("board", (0.4,) * 3)]
    lamp = Lamp("area", (5.0,) * 3, position=(0.5, 0.5, 1.5), size=(0.5, 0.5))
    holes = join_meshes([sheet("floor", FLOOR, 12, 12), *squares], gray, [lamp], World((0.1,) * 3))
    image = join_meshes(
        [sheet("floor", FLOOR, 12, 12), whole], [gray[0], replace(gray[1], alpha_texture=0)], [lamp], World((0.1,) * 3),
        textures=(Texture("board", pixels),),
    )  # fmt: skip
    places = [(x, y, 0) for x in (0.25, 0.5, 0.75) for y in (0.25, 0.5, 0.75)]
    found = point_light(baked(image, gather_rays=512), places)
    np.testing.assert_allclose(found, point_light(baked(holes, gather_rays=512), places), rtol=0.04)


def test_an_image_that_is_the_same_all_over_is_one_share():
    """Of what is there: rays choose as they would without the image."""
    veil = sheet("veil", [(0, 0, 0.5), (1, 0, 0.5), (1, 1, 0.5), (0, 1, 0.5)], 1, 1)
    half = Texture("half", np.full((3, 2, 3), 0.5, np.float32))
    material = Material("veil", alpha=0.8, alpha_texture=0)
    mended = mend(join_meshes([veil], [material], [], World((1.0, 1.0, 1.0)), textures=(half,)))
    assert mended.materials[0] == replace(material, alpha=0.4, alpha_texture=None)
    uneven = Texture("uneven", np.array([[[1.0] * 3, [0.5] * 3]], np.float32))
    assert mend(mended.but(materials=(material,), textures=(uneven,), mended=False)).materials[0] == material


def test_survey_says_what_rays_pass():
    scene = join_meshes(
        [box(n=2), sheet("veil", at_height(0.5, 0.2), material=1)], [Material(), Material("lace", alpha=0.5)]
    )
    found = {e.name: e for e in survey(scene).effects}
    assert found["transparency"].reason == "rays pass 1 faces of lace"
    assert found["two-sided"].needed or not scene.lamps
    opaque = replace(scene, materials=(Material(), Material("lace", alpha=1.0)))
    assert not {e.name: e for e in survey(opaque).effects}["transparency"].needed


@pytest.mark.parametrize("alpha", [0.0, 0.3, 1.0])
def test_points_lie_on_their_own_surface_whether_light_passes_it_or_not(alpha):
    """Under a sky of many cells: a ray down to find what a point lies on stops there."""
    scene = join_meshes(
        [sheet("floor", FLOOR), sheet("veil", at_height(0.3), material=1)],
        [Material(), Material("veil", alpha=alpha)],
        [SUN],
        World(map=np.full((32, 32, 3), 0.2)),
    )
    result = baked(scene, gather_rays=16)
    cells = LocalCells()
    cells.start(scene_arrays(result.scene, result.patches, make_sources(scene)[0], sky=1024))
    side = sides_of(result.points, cells)
    own = result.scene.polygon_object[result.patches.polygon[side >> 1]]
    np.testing.assert_array_equal(own, result.points.object)
    assert (side >= 0).all()
    assert not (side & 1).any()


def test_faces_that_no_ray_finds_have_no_side():
    """A speck beside a floor of a million times its size lies on nothing that rays know, and is baked all the same."""
    speck = box("speck", (0.5, 0.5, 1e3), (0.5 + 1e-6, 0.5 + 1e-6, 1e3 + 1e-6), inward=False)
    scene = join_meshes(
        [sheet("floor", 1e6 * np.array(FLOOR, float)), speck], lamps=[SUN], world=World(map=np.full((32, 32, 3), 0.2))
    )
    light = baked(scene, gather_rays=16).light
    assert np.isfinite(light.direct).all()
    assert np.isfinite(light.indirect).all()
