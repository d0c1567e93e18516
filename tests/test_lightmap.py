"""Atlases and lightmaps: which texels, where on the surface, and what their light becomes."""

from __future__ import annotations

import sys
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core import atlas as atlas_module
from cell_radiosity.core.atlas import NoUnwrapper, make_atlas, rasterize, read_atlas
from cell_radiosity.core.bake import restored
from cell_radiosity.core.cells import make_cells
from cell_radiosity.core.kernel import scene_arrays
from cell_radiosity.core.lightmap import Texels, average_cut, find_seams, look_up, make_images, make_texels
from cell_radiosity.core.lights import make_sources
from cell_radiosity.core.patches import make_patches
from cell_radiosity.core.polygons import clip_polygons
from cell_radiosity.core.raycast import RayCaster
from cell_radiosity.core.records import from_arrays, to_arrays
from cell_radiosity.core.state import load_state, save_state
from cell_radiosity.core.vectors import numbered

from scenes import Lamp, Material, Settings, World, bake, box, icosphere, join_meshes, point_light, run, sheet

LAMP = Lamp("point", (10.0, 10.0, 10.0), (1.0, 2.0, 2.0), radius=0.0)


def round_ball(place=(0, 0, 0), radius=0.4, splits=3):
    """A smooth ball that faces outward."""
    ball = icosphere("ball", radius, splits, inward=False)
    return replace(
        ball, vertices=ball.vertices + np.array(place, float), corner_normal=ball.vertices[ball.corner_vertex] / radius
    )


def bake_map(scene, atlas, cells, state=None, averaged=True, **settings):
    """The Bake of a scene at the texels of an atlas, which are its points."""
    texels, average = at_texels(atlas)
    return run(bake(scene, Settings(**settings), cells, texels, state=state, average=average if averaged else None))


def at_texels(atlas):
    """What `bake` takes as `place` and as `average`."""
    known = {}

    def place(scene, flipped, cells, light, kept):
        yield from ()
        known.update(scene=scene, flipped=flipped)
        texels = from_arrays(Texels, "points", kept) if kept else make_texels(scene, atlas, flipped, cells)
        return scene, texels, to_arrays("points", texels)

    def average(texels, light, cells, seed, places):
        return average_cut(known["scene"], atlas, known["flipped"], texels, light, cells, seed, places)

    return place, average


def seams_of(scene, atlas):
    flipped = np.zeros(len(scene.polygon_material), bool)
    return find_seams(scene, atlas, flipped, RayCaster(scene.vertices, scene.triangles, scene.usable))


def clipped_area(triangle, column, row):
    """Area of the part of a triangle (3, 2) in one texel."""
    polygon, sides = triangle[None], np.array([3])
    for axis, sign, level in ((0, 1, column), (0, -1, -column - 1), (1, 1, row), (1, -1, -row - 1)):
        polygon, sides = clip_polygons(polygon, sides, sign * polygon[..., axis] - level)
    p = polygon[0, : sides[0]]
    q = np.roll(p, -1, axis=0)
    return abs((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum()) / 2


def test_rows_are_numbered_in_their_order(rng):
    for rows in (
        rng.integers(-2, 3, (500, 3)),
        rng.integers(0, 2, (50, 1)),
        np.zeros((0, 2)),
        np.array([[-0.0], [0.0]]),
    ):
        assert np.array_equal(numbered(rows), np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1))


def test_every_texel_that_a_triangle_touches_is_found_and_no_other(rng):
    place = rng.uniform(0, 9, (40, 3, 2))
    place[20:] = place[20:, :1] + rng.uniform(-0.7, 0.7, (20, 3, 2))  # small ones, most within a texel or two
    place = np.clip(place, 0, 9)
    found = set()
    for triangle, column, row, weight, distance in rasterize(place, np.full((40, 2), 9)):
        found |= set(zip(triangle.tolist(), column.tolist(), row.tolist()))
        center = np.stack([column + 0.5, row + 0.5], axis=1)
        at = np.einsum("kv,kvd->kd", weight, place[triangle])
        np.testing.assert_allclose(np.sqrt(((at - center) ** 2).sum(axis=1)), distance, atol=1e-9)
        assert weight.min() >= 0
        np.testing.assert_allclose(weight.sum(axis=1), 1)
        # No place of the triangle is nearer to the center: neither its corners nor places on its edges.
        share = np.linspace(0, 1, 41)[:, None, None]
        for k in range(3):
            edge = (1 - share) * place[triangle, k] + share * place[triangle, (k + 1) % 3]
            assert (np.sqrt(((edge - center) ** 2).sum(axis=-1)) >= distance - 1e-9).all()
    for k in range(40):
        for column in range(9):
            for row in range(9):
                area = clipped_area(place[k], column, row)
                if area > 1e-9:
                    assert (k, column, row) in found
                elif area == 0 and (k, column, row) in found:
                    assert (
                        clipped_area(place[k] + [1e-6, 1e-6], column, row)
                        + clipped_area(place[k] - [1e-6, 1e-6], column, row)
                        < 1e-3
                    )  # no more than a rim that lies on the texel's edge


@pytest.mark.parametrize("together", [False, True])
def test_an_atlas_has_the_density_asked_for_and_no_overlap(together):
    scene = join_meshes([box("room", high=(4, 3, 2), n=3), round_ball((1, 1, 1))])
    atlas = make_atlas(scene, density=20.0, together=together)
    assert atlas.names == (("atlas",) if together else ("room", "ball"))
    assert not atlas.findings
    assert (atlas.uv >= 0).all()
    assert (atlas.uv <= 1).all()
    a, b = atlas.place[:, 1] - atlas.place[:, 0], atlas.place[:, 2] - atlas.place[:, 0]
    density = np.sqrt(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2 / scene.triangle_normal_area[1][atlas.triangle])
    room = scene.polygon_object[scene.triangle_polygon[atlas.triangle]] == 0
    np.testing.assert_allclose(density[room], 20.0, rtol=0.08)
    assert (density[~room] > 8).all()


def test_an_atlas_of_a_given_size():
    scene = join_meshes([box("room", high=(4, 3, 2), n=3), round_ball((1, 1, 1))])
    atlas = make_atlas(scene, size=128, together=True)
    assert atlas.size.tolist() == [[128, 128]]
    assert not atlas.findings
    covered = sum(
        len(np.unique(column + 128 * row)) for _, column, row, _, _ in rasterize(atlas.place, atlas.size[atlas.image])
    )
    assert covered > 0.5 * 128 * 128


@pytest.mark.parametrize("scale", [2.0**-30, 2.0**30])
def test_an_atlas_does_not_know_the_scale(scale):
    """xatlas alone takes small meshes for nothing, and gives places that are no numbers."""
    mesh = box("room", high=(4, 3, 2), n=3)
    usual = make_atlas(join_meshes([mesh]), size=64)
    other = make_atlas(join_meshes([replace(mesh, vertices=mesh.vertices * scale)]), size=64)
    assert np.array_equal(other.place, usual.place)
    assert other.findings == usual.findings == ()


@pytest.mark.parametrize("splits", [5, 6])
def test_a_dense_ball_is_not_folded(splits):
    """Its neighbors bend so little that a ball of triangles passes for a plane if only neighbors are looked at."""
    scene = join_meshes([round_ball(splits=splits)])
    atlas = make_atlas(scene, density=200.0)
    assert not atlas.findings
    a, b = atlas.place[:, 1] - atlas.place[:, 0], atlas.place[:, 2] - atlas.place[:, 0]
    shrunk = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2 / (200.0**2 * scene.triangle_normal_area[1])
    assert shrunk.min() > 0.4


def test_what_is_wrong_with_a_uv_map_is_said_by_face_count():
    scene = join_meshes([sheet("floor", ((0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0)), 4, 4)])
    uv = scene.vertices[scene.corner_vertex][:, :2] / 4
    assert not read_atlas(scene, uv).findings
    moved = uv.copy()
    moved[:4] += [0.25, 0.0]  # the first face onto the second
    moved[-4:] += [0.5, 0.0]  # the last out of the square
    moved[-8:-4] = 0.3
    found = {text for _, text, _ in read_atlas(scene, moved).findings}
    assert found == {
        "2 faces overlap others in the UV map", "1 faces lie outside the UV map's unit square",
        "1 faces have no area in the UV map",
    }  # fmt: skip
    assert read_atlas(scene, np.full_like(uv, np.nan)).findings


def test_a_tiled_uv_map_is_looked_at_as_little_as_another(monkeypatch):
    """Each of 10 000 faces fills the image: all are found, by a grid that they do not cover more often than the image."""
    looked = []
    real = atlas_module.rasterize

    def counted(*arguments):
        for found in real(*arguments):
            looked.append(len(found[0]))
            yield found

    monkeypatch.setattr(atlas_module, "rasterize", counted)
    scene = join_meshes([sheet("floor", ((0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0)), 100, 100)])
    uv = np.tile([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)], (10_000, 1))
    found = read_atlas(scene, uv, size=1024)
    assert [text for _, text, _ in found.findings] == ["10000 faces overlap others in the UV map"]
    assert sum(looked) < 3 * 1024**2


def test_an_image_that_would_be_too_large_is_refused():
    scene = join_meshes([sheet("field", ((0, 0, 0), (4e4, 0, 0), (4e4, 4e4, 0), (0, 4e4, 0)))])
    with pytest.raises(ValueError, match="field: its lightmap would be 6"):
        make_atlas(scene)


def test_without_xatlas_the_message_says_what_to_do(monkeypatch):
    monkeypatch.setitem(sys.modules, "xatlas", None)
    with pytest.raises(NoUnwrapper, match="--uv"):
        make_atlas(join_meshes([box()]))


def test_texels_show_the_light_at_their_places(cells):
    """Each texel in the middle of a chart has the closed form at its center, found through the atlas' own UV."""
    scene = join_meshes([box("room", high=(4, 3, 2.5)), sheet("table", ((1, 1, 1), (2, 1, 1), (2, 2, 1), (1, 2, 1)))],
                        [Material(reflectance=(0, 0, 0))], [Lamp("point", (7, 8, 9), (1.5, 1.5, 2.2))])  # fmt: skip
    atlas = make_atlas(scene, density=16.0, together=True)
    baked = bake_map(scene, atlas, cells)
    texels = baked.points
    vertices = scene.vertices[scene.triangles[atlas.triangle[texels.row]]]
    at = np.einsum("kv,kvd->kd", texels.weight, vertices)
    inside = texels.weight.min(axis=1) > 0.02
    center = np.stack([texels.column + 0.5, texels.line + 0.5], axis=1)
    np.testing.assert_allclose(
        np.einsum("kv,kvd->kd", texels.weight, atlas.place[texels.row])[inside], center[inside], atol=1e-6
    )
    way = np.array((1.5, 1.5, 2.2)) - at
    far = np.sqrt((way**2).sum(axis=1))
    expected = np.maximum((way * texels.geometric).sum(axis=1), 0) / far**3
    low = np.abs(at[:, 2]) < 0.1
    shadow = low & (np.abs(at[:, :2] - 1.5) < 1.0).all(axis=1)  # of the table
    clear = inside & ~shadow & (at[:, 2] < 2.4)
    for channel, strength in enumerate((7, 8, 9)):
        np.testing.assert_allclose(baked.light.direct[channel, clear], strength * expected[clear], rtol=2e-3, atol=1e-4)
    assert not baked.light.direct[0, low & (np.abs(at[:, :2] - 1.5) < 0.85).all(axis=1)].any()


def test_lightmap_and_vertices_agree_and_seams_close(cells):
    """The same light at common places within the error asked for; across seams the images differ by less than 1 %."""
    ball = round_ball((3, 2, 1))
    room = box("room", high=(4, 3, 2.5), n=12)
    scene = join_meshes([room, ball], lamps=[replace(LAMP, radius=0.1)])
    atlas = make_atlas(scene, density=16.0, together=True)
    settings = dict(error=0.01, gather_rays=128, row_rays=32)
    mapped = bake_map(scene, atlas, cells, **settings)
    baked = run(bake(scene, Settings(**settings), cells))
    light = mapped.light.direct + mapped.light.indirect
    seams = seams_of(scene, atlas)
    images = make_images(atlas, mapped.points, light, seams)
    # Vertices in the middle of a flat face or of the ball: the lightmap read there, in any triangle that has them.
    vertex, first = np.unique(scene.triangles[atlas.triangle].reshape(-1), return_index=True)
    row, corner = np.divmod(first, 3)
    inner = ((scene.vertices[vertex] > 0.01) & (scene.vertices[vertex] < np.array((4, 3, 2.5)) - 0.01)).sum(axis=1) >= 2
    seen = look_up(atlas, images, row, np.eye(3)[corner])[inner]
    there = point_light(baked, scene.vertices[vertex[inner]])[:, : len(light)]
    assert np.sqrt(((seen - there) ** 2).sum() / (there**2).sum()) < 0.01
    assert len(seams.left) > 100
    flat = np.moveaxis(images[0], -1, 0).reshape(len(light), -1)
    before = np.moveaxis(make_images(atlas, mapped.points, light)[0], -1, 0).reshape(len(light), -1)
    gap = lambda values: np.sqrt((seams.differences(values) ** 2).mean()) / light.mean()
    assert gap(flat) < 0.01
    assert gap(before) > 3 * gap(flat)  # there was something to close
    np.testing.assert_allclose(flat.mean(), before.mean(), rtol=0.01)


def test_touching_objects_meet_without_a_seam_and_corners_stay_sharp(cells):
    """A floor of two sheets that touch: matched along their line. Walls at right angles are not."""
    floor = [sheet("left", ((0, 0, 0), (1.03, 0, 0), (1.03, 2, 0), (0, 2, 0))),
             sheet("right", ((1.03, 0, 0), (2, 0, 0), (2, 2, 0), (1.03, 2, 0)), 2, 3)]  # fmt: skip
    wall = sheet("wall", ((0, 2, 0), (2, 2, 0), (2, 2, 2), (0, 2, 2)))
    scene = join_meshes([*floor, wall], lamps=[Lamp("point", (5, 5, 5), (1.1, 1, 0.7), radius=0.05)])
    atlas = make_atlas(scene, density=10.0)
    seams = seams_of(scene, atlas)
    assert {tuple(sorted(pair)) for pair in seams.object.tolist()} == {(0, 1)}
    assert len(seams.left) >= 2 * 2 * 20
    baked = bake_map(scene, atlas, cells)
    images = make_images(atlas, baked.points, baked.light.direct, seams)
    width, height = atlas.size.max(axis=0)
    flat = np.zeros((len(baked.light.direct), 3, height, width))
    for k, image in enumerate(images):
        flat[:, k, : image.shape[0], : image.shape[1]] = np.moveaxis(image, -1, 0)
    gap = np.abs(seams.differences(flat.reshape(len(flat), -1)))
    assert gap.max() < 0.01 * baked.light.direct.max()


def test_texels_under_a_box_do_not_darken_the_floor_beside_it(cells):
    """The box covers parts of texels: these are asked beside it; those wholly under it are not baked at all."""
    block = box("block", (0.93, 0.93, 0), (2.04, 2.04, 1), inward=False, faces=("x", "X", "y", "Y", "Z"))
    scene = join_meshes([sheet("floor", ((0, 0, 0), (3, 0, 0), (3, 3, 0), (0, 3, 0))), block],
                        [Material(reflectance=(0, 0, 0))], [Lamp("sun", (1, 1, 1))])  # fmt: skip
    uv = scene.vertices[scene.corner_vertex][:, :2] / 3
    atlas = read_atlas(replace(scene, written=np.array([True, False])), uv, size=24)
    baked = bake_map(replace(scene, written=np.array([True, False])), atlas, cells)
    assert baked.points.hidden + baked.points.moved.sum() == 9 * 9  # whose centers the box covers
    assert baked.points.hidden >= 5 * 5
    assert baked.points.moved.sum() >= 4 * 8
    (image,) = make_images(atlas, baked.points, baked.light.direct)
    np.testing.assert_allclose(image, 1.0, atol=1e-9)  # the sun stands overhead: all the floor that shows is lit


def test_texels_at_the_bottom_of_a_box_do_not_see_below_the_floor(cells):
    """The sky shines below the floor too: all texels of the box that are baked are on its sides and its top."""
    floor = sheet("floor", ((0, 0, 0), (3, 0, 0), (3, 3, 0), (0, 3, 0)))
    scene = join_meshes([floor, box("block", (1, 1, 0), (2, 2, 1), inward=False)], [Material(reflectance=(0.5,) * 3)],
                        world=World((1.0, 1.0, 1.0)), written=[False, True])  # fmt: skip
    baked = bake_map(scene, make_atlas(scene, density=8.0), cells)
    assert baked.points.hidden >= 8 * 8
    assert baked.points.geometric[:, 2].min() > -0.5
    assert len(baked.points) >= 5 * 8 * 8


SUN = np.array((0.5, 0.3, -1.0))
BLOCK = np.array(((1.3, 1.5, 0.0), (2.1, 2.2, 1.0)))


def sunny_floor(glow=0.0):
    """A floor, to be written, and a black block on it under a sun that is a mere point: Scene and Atlas."""
    floor = sheet("floor", ((0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0)))
    back = -SUN / np.sqrt((SUN**2).sum())
    side = np.cross((0, 1, 0), back) / np.sqrt((np.cross((0, 1, 0), back) ** 2).sum())
    lamps = [Lamp("sun", (1, 1, 1), axes=(tuple(side), tuple(np.cross(back, side)), tuple(back)))]
    if glow:
        lamps.append(Lamp("area", (glow, glow, glow), (2, 2, 3), name="glow"))
    block = box("block", *BLOCK, inward=False)
    scene = join_meshes([floor, block], [Material(reflectance=(0, 0, 0))], lamps, written=[True, False])
    return scene, make_atlas(scene, density=16.0)


def sun_in_texels(scene, atlas, texels, parts=24):
    """(P,) share of the part of each texel that shows, of which the sun is seen, by a fine grid; by a coarse one where that
    shows no edge."""
    place, vertices = atlas.place[texels.row], scene.vertices[scene.triangles[atlas.triangle[texels.row]]]
    a, b = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]
    det = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]

    def counted(k, parts):
        """How many places of a grid in texels k (K,) are lit, and how many show."""
        lit, seen = np.zeros(len(k)), np.zeros(len(k))
        for x in (np.arange(parts) + 0.5) / parts:
            for y in (np.arange(parts) + 0.5) / parts:
                to = np.stack([texels.column[k] + x, texels.line[k] + y], axis=1) - place[k, 0]
                s, t = (
                    (to[:, 0] * b[k, 1] - to[:, 1] * b[k, 0]) / det[k],
                    (a[k, 0] * to[:, 1] - a[k, 1] * to[:, 0]) / det[k],
                )
                at = np.einsum("vk,kvd->kd", np.stack([1 - s - t, s, t]), vertices[k])
                near, far = np.sort((BLOCK[:, None] - at) / -SUN, axis=0)
                shows = ((at[:, :2] >= 0) & (at[:, :2] <= 4)).all(axis=1)
                shows &= ~((at >= BLOCK[0]) & (at <= BLOCK[1]))[:, :2].all(axis=1)
                lit += shows & (np.maximum(near.max(axis=1), 1e-9) >= far.min(axis=1))
                seen += shows
        return lit, seen

    coarse = 12
    lit, seen = counted(np.arange(len(texels)), coarse)
    cut = np.flatnonzero((lit % coarse**2 > 0) | (seen % coarse**2 > 0))
    assert len(cut) < len(lit) / 2
    lit[cut], seen[cut] = counted(cut, parts)
    return lit / np.maximum(seen, 1), seen > 0


def test_texels_that_a_shadow_cuts_have_the_mean_over_their_surface(cells):
    """And only these are another than what their middle gets: so little is asked for beside."""
    scene, atlas = sunny_floor()
    baked, plain = (bake_map(scene, atlas, cells, averaged=a) for a in (True, False))
    share, shows = sun_in_texels(scene, atlas, baked.points)
    truth = share[shows] / np.sqrt(1 + 0.25 + 0.09)
    off = [np.abs(b.light.direct[0, shows] - truth) for b in (baked, plain)]
    error = [np.sqrt((x**2).sum() / (truth**2).sum()) for x in off]
    assert error[0] < 0.006
    assert error[1] > 0.03
    assert off[0].max() < 0.12
    changed = (baked.light.direct != plain.light.direct).any(axis=0)
    cut = np.flatnonzero(shows)[(truth > 0.01 * truth.max()) & (truth < 0.99 * truth.max())]
    assert changed[cut].mean() > 0.9
    assert changed.sum() < 0.03 * len(changed)
    assert baked.rays < 1.15 * plain.rays


@pytest.mark.parametrize(("density", "asked"), [(4.0, 0.1), (16.0, 0.02), (16.0, 0.005)])
def test_the_estimate_is_of_what_texels_show(density, asked, cells):
    """Of a sun's hard shadows on black: all that is off are the texels that its edges cut. Where little error is asked for
    they are looked at in more places."""
    scene, _ = sunny_floor()
    atlas = make_atlas(scene, density=density)
    baked = bake_map(scene, atlas, cells, error=asked)
    share, shows = sun_in_texels(scene, atlas, baked.points, parts=72)
    truth = share[shows] / np.sqrt(1 + 0.25 + 0.09)
    off = baked.light.direct[0, shows] - truth
    error = np.sqrt((off**2).sum() / (truth**2).sum())
    assert 0.6 < baked.estimate.total / error < 1.5
    assert error < asked
    again = bake_map(scene, atlas, cells, state=baked.state(), error=asked)
    assert again.estimate.total == baked.estimate.total
    assert again.converged == baked.converged


def test_what_is_reflected_and_what_no_edge_cuts_stays_as_it_is(cells):
    """A lamp beside the sun: its soft light is the same, whatever is known of the sun's."""
    scene, atlas = sunny_floor(glow=1.0)
    baked, plain = (bake_map(scene, atlas, cells, averaged=a) for a in (True, False))
    assert np.array_equal(baked.light.indirect, plain.light.indirect)
    changed = (baked.light.direct != plain.light.direct).any(axis=0)
    assert 0 < changed.sum() < 0.05 * len(changed)
    assert baked.light.direct.sum() == pytest.approx(plain.light.direct.sum(), rel=2e-3)
    open_ = replace(scene, lamps=scene.lamps[1:])
    baked, plain = (bake_map(open_, atlas, cells, averaged=a, gather_rays=64) for a in (True, False))
    changed = (baked.light.direct != plain.light.direct).any(axis=0)
    assert not changed[np.abs(baked.points.position[:, :2] - 1.8).max(axis=1) > 1.2].any()


def test_light_that_rays_find_stays_in_texels_that_the_sun_cuts(cells):
    """The sky is no sampled source: what it gives is in the middle of a texel what it is beside it."""
    scene, atlas = sunny_floor()
    sunny, cloudy = replace(scene, world=World((1.0, 1.0, 1.0))), replace(scene, world=World((1.0, 1.0, 1.0)), lamps=())
    baked, plain = (bake_map(sunny, atlas, cells, averaged=a, gather_rays=64).light.direct[0] for a in (True, False))
    sky = bake_map(cloudy, atlas, cells, gather_rays=64).light.direct[0]
    dark = bake_map(scene, atlas, cells, gather_rays=64).light.direct[0]
    cut = baked != plain
    assert cut.any()
    np.testing.assert_allclose(baked[cut], (sky + dark)[cut], rtol=0.01)


def test_means_over_texels_have_the_same_bits_with_other_cells_and_from_a_state(cells, tmp_path):
    scene, atlas = sunny_floor(glow=1.0)
    baked = bake_map(scene, atlas, cells)
    with make_cells(1) as one:
        other = bake_map(scene, atlas, one)
    save_state(baked.state(), tmp_path / "s")
    state = load_state(tmp_path / "s")
    again = bake_map(scene, atlas, cells, state=state)
    back = run(restored(scene, state, at_texels(atlas)[0]))
    for each in (other, again, back):
        assert np.array_equal(each.light.direct, baked.light.direct)
    assert back.rays == 0


def test_memory_of_texels_and_images_grows_with_their_number_alone(cells):
    """A long image beside small ones takes what it has, not what a square of its sides would; of nine times as many texels
    each takes no more."""

    def measure(density):
        scene = join_meshes(
            [box("room", high=(4, 3, 2), n=2), box("shelf", (0.5, 0.5, 0.5), (0.6, 2.5, 0.6), 1, False)], lamps=[LAMP]
        )
        atlas = make_atlas(scene, density=density)
        cells.start(scene_arrays(scene, *made))
        tracemalloc.start()
        try:
            texels = make_texels(scene, atlas, np.zeros(len(scene.polygon_material), bool), cells)
            first = tracemalloc.get_traced_memory()[1] / len(texels)
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            images = make_images(atlas, texels, np.ones((3, len(texels))))
            pixels = atlas.size.prod(axis=1).sum()
            return first, (tracemalloc.get_traced_memory()[1] - before) / pixels, images
        finally:
            tracemalloc.stop()

    made = (
        make_patches(join_meshes([box("room", n=1)]), 0.5),
        make_sources(join_meshes([box("room", n=1)], lamps=[LAMP]))[0],
    )
    (few, few_pixels, _), (many, many_pixels, images) = measure(20.0), measure(60.0)
    assert many < 1.1 * few
    assert many < 700
    assert many_pixels < 1.1 * few_pixels
    assert many_pixels < 140
    assert all((image == 1.0).all() for image in images)


def test_neighbors_of_texels_are_those_beside_above_and_below_in_their_chart(cells):
    scene = join_meshes([box("room", high=(2, 1, 1), n=2), round_ball((1, 0.5, 0.5), 0.2, 1)], lamps=[LAMP])
    atlas = make_atlas(scene, density=12.0)
    texels = bake_map(scene, atlas, cells, error=0.5).points
    place = [tuple(x) for x in np.stack([texels.image, atlas.chart[texels.row], texels.line, texels.column], axis=1)]
    number = {key: k for k, key in enumerate(place)}
    for k, (image, chart, line, column) in enumerate(place):
        around = [(image, chart, line + i, column + j) for i, j in ((0, 1), (0, -1), (1, 0), (-1, 0))]
        expected = sorted(number[key] for key in around if key in number)
        assert texels.neighbor[slice(*texels.neighbor_start[k : k + 2])].tolist() == expected
