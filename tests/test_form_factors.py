"""Form factors: Lambert's factor and sampled rows against the closed forms of the literature."""

from __future__ import annotations

import numpy as np
import pytest

from cell_radiosity.core import rows
from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.kernel import scene_arrays
from cell_radiosity.core.lights import BALL, Sources, from_one_test, make_sources, unoccluded
from cell_radiosity.core.lights import test_rays as rays_toward
from cell_radiosity.core.patches import make_patches
from cell_radiosity.core.polygons import angle, polygon_factor
from cell_radiosity.core.raycast import RayCaster
from cell_radiosity.core.sampling import lattice

from scenes import Lamp, Mesh, box, join_meshes

SQUARE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], float)
RAYS = 1 << 14


def raised(polygon, height):
    return np.asarray(polygon, float) + (0, 0, height)


def hinged(degrees):
    turn = np.radians(degrees)
    return SQUARE @ np.array([(np.cos(turn), 0, np.sin(turn)), (0, 1, 0), (0, 0, 1)])


def disk(radius, height, sides=256):
    turn = 2 * np.pi * np.arange(sides) / sides
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(sides, height)], axis=1)


PAIRS = {
    "opposed squares at 0.1": (SQUARE, raised(SQUARE, 0.1), 0.82699452239726),
    "opposed squares at 0.5": (SQUARE, raised(SQUARE, 0.5), 0.41525328357715),
    "opposed squares at 1": (SQUARE, raised(SQUARE, 1), 0.19982489569839),
    "opposed squares at 2": (SQUARE, raised(SQUARE, 2), 0.06858958881855),
    "opposed squares at 10": (SQUARE, raised(SQUARE, 10), 0.00316205683875),
    "perpendicular squares, common edge": (SQUARE, hinged(90), 0.20004377607540),
    "perpendicular strip of 0.1": (SQUARE, hinged(90) * (1, 1, 0.1), 0.04325136940069),
    "hinged squares, 60 degrees": (SQUARE, hinged(60), 0.370905321150),
    "hinged squares, 30 degrees": (SQUARE, hinged(30), 0.619028323091),
    "coaxial disks 1, 1 at 1": (disk(1, 0), disk(1, 1), 0.38196601125011),
    "coaxial disks 1, 2 at 1": (disk(1, 0), disk(2, 1), 0.76393202250021),
    "coaxial disks 1, 0.5 at 2": (disk(1, 0), disk(0.5, 2), 0.04805898398896),
    "triangle to triangle": ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 0, 1), (0, 1, 1), (1, 0, 1)], 0.115049228150),
    "triangle to tilted quad": ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 0, 1), (0, 1, 1), (1, 1, 2), (1, 0, 2)], 0.120091316468),
    "square to tilted triangle": (SQUARE, [(2, 0, 0.5), (1.5, 0.5, 2), (2, 1, 1)], 0.037995400399),
    "squares that touch in a corner": (SQUARE, [(0, 1, 0), (0, 2, 0), (0, 2, 1), (0, 1, 1)], 0.040592230102),
}  # fmt: skip


def sent(cells, shooter, *others):
    """Share of a shooter's light (front side) that arrives on each of other polygons, by a row of many rays."""
    start_pair(cells, shooter, *others)
    (result,) = cells.take([cells.submit("rows", sides=np.array([0]), rays=RAYS, seed=3)])
    hits = result["hits"][0]
    return [float((hits >> 1 == k).mean()) for k in range(1, len(others) + 1)]


@pytest.mark.parametrize("name", PAIRS)
def test_row_of_a_pair(cells, name):
    """A row's entry is the pair's form factor, within four standard deviations of independent rays."""
    shooter, receiver, expected = PAIRS[name]
    (found,) = sent(cells, shooter, receiver)
    assert abs(found - expected) < 4 * np.sqrt(expected * (1 - expected) / RAYS)


@pytest.mark.parametrize("name", PAIRS)
def test_analytic_row_of_a_pair(cells, name):
    """Lambert's factors at Gauss points: to 1 %; disks, which are polygons of many elements, to 2 %."""
    shooter, receiver, expected = PAIRS[name]
    _scene, _patches = start_pair(cells, shooter, receiver)
    (row,) = cells.take([cells.submit("analytic", sides=np.array([0]), seed=0)])
    assert set(row["target"] >> 1) == {1}
    assert row["share"].sum() == pytest.approx(expected, rel=0.02 if "disk" in name else 0.01)


def test_analytic_row_with_an_obstruction(cells):
    """The visible share is sampled: 16 rays from the shooter to the half hidden square."""
    n = 6
    top = [raised(SQUARE / n + (i / n, j / n, 0), 1) for i in range(n) for j in range(n)]
    plate = np.array([(0.25, 0.25, 0.75), (0.75, 0.25, 0.75), (0.75, 0.75, 0.75), (0.25, 0.75, 0.75)])
    start_pair(cells, SQUARE, plate, *top)
    (row,) = cells.take([cells.submit("analytic", sides=np.array([0]), seed=0)])
    assert row["share"][row["target"] >> 1 > 1].sum() == pytest.approx(0.115620602132, rel=0.03)


def start_pair(cells, *polygons):
    """A scene of one patch per polygon, and its patches; the cells hold it."""
    scene = join_meshes([Mesh.of_polygons(str(k), p, [list(range(len(p)))]) for k, p in enumerate(polygons)])
    patches = make_patches(scene)
    cells.start(scene_arrays(scene, patches, make_sources(scene)[0]))
    return scene, patches


def test_row_with_an_obstruction(cells):
    """Opposed unit squares with a plate of half their size between them (FACET's case)."""
    plate = np.array([(0.25, 0.25, 0.75), (0.75, 0.25, 0.75), (0.75, 0.75, 0.75), (0.25, 0.75, 0.75)])
    _, found = sent(cells, SQUARE, plate, raised(SQUARE, 1))
    assert abs(found - 0.115620602132) < 4 * np.sqrt(0.1156 * 0.8844 / RAYS)


def test_rows_of_a_closed_cube_sum_to_one(cells):
    faces = [SQUARE, raised(SQUARE, 1)] + [
        np.roll(SQUARE, k, axis=1) + np.eye(3)[k - 1] * s for k in (1, 2) for s in (0, 1)
    ]
    assert sum(sent(cells, *faces)) == 1.0


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((0, 0, -1), 0.13853160599489),
        ((0.5, 0.5, -1), 0.23945647046077),
    ],
)
def test_element_to_square(point, expected):
    factor = polygon_factor(np.array([point], float), np.array([(0.0, 0, 1)]), SQUARE)
    assert factor[0] == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize(
    ("gap", "expected"), [(0.5, 0.190135882385), (0.1, 0.422544860239), (0.01, 0.492158952163), (1e-6, 0.499999215797)]
)
def test_element_on_the_floor_near_a_wall(gap, expected):
    wall = np.array([(0, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1)], float)
    factor = polygon_factor(np.array([(gap, 0.5, 0)]), np.array([(0.0, 0, 1)]), wall)
    assert factor[0] == pytest.approx(expected, abs=1e-11)


def test_nothing_is_seen_of_ones_own_plane(rng):
    """From the middle of a wall's quads to one of them, whose corner comes out a last bit above the wall there."""
    quad = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)])
    up = np.array([[0.0, 0.0, 1.0]])
    for corner in range(4):
        for bits in (0.0, 1e-17, 1e-16):
            off = quad.copy()
            off[corner] += bits * np.array([1.0, -1.0, 1.0])
            assert polygon_factor(quad[corner : corner + 1], up, off)[0] < 1e-12
    near = quad + (0, 0, 1e-6)  # just above it there is all of it
    assert polygon_factor(np.array([(0.5, 0.5, 0.0)]), up, near)[0] > 0.999


@pytest.mark.parametrize("tilt", [0.0, 1e-5, -1e-5, 1e-3])
def test_of_a_face_that_an_element_lies_on_nothing_is_seen(tilt):
    """Inside, on an edge and on a corner, with a hemisphere that leans a bit; a hair below it, it is all that is seen."""
    face = SQUARE - SQUARE.mean(axis=0)
    places = np.array([face.mean(axis=0), (face[0] + face[1]) / 2, face[0], 0.3 * face[0]])
    lean = np.array([(np.sin(tilt), 0.0, np.cos(tilt))])
    normals = np.repeat(lean, len(places), axis=0)
    assert polygon_factor(places, normals, face).max() == 0.0
    below = places[:1] - 1e-6 * lean
    assert polygon_factor(below, lean, face)[0] > 0.99


def test_factor_is_additive_where_the_horizon_cuts(rng):
    """A polygon's factor is the sum of its parts' factors, also for points that see only some of it."""
    corners = rng.normal(size=(500, 2))
    whole = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
    middle = np.array([*corners[0].clip(-0.9, 0.9), 0.0])
    points = rng.normal(size=(500, 3)) + (0, 0, 1.5)
    normals = rng.normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    parts = sum(polygon_factor(points, normals, np.array([whole[k], whole[(k + 1) % 4], middle])) for k in range(4))
    np.testing.assert_allclose(parts, polygon_factor(points, normals, whole), atol=1e-12)


@pytest.mark.parametrize("polygon", [SQUARE, disk(1, 0, sides=24)])
@pytest.mark.parametrize("size", [1, 7])
def test_factor_at_a_point_does_not_depend_on_the_others(rng, polygon, size):
    points, normals = rng.normal(size=(210, 3)) + (0, 0, 0.5), rng.normal(size=(210, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    parts = [slice(k, k + size) for k in range(0, len(points), size)]
    alone = np.concatenate([polygon_factor(points[p], normals[p], polygon) for p in parts])
    assert (alone == polygon_factor(points, normals, polygon)).all()


def test_factor_degenerates_quietly():
    """On a corner, on an edge, in the plane, with repeated corners: a finite factor between 0 and 1."""
    points = np.array([(0, 0, 0), (0.5, 0, 0), (0.5, 0.5, 0), (3, 0, 0)], float)
    up = np.tile((0.0, 0, 1), (4, 1))
    factor = polygon_factor(points, up, SQUARE[[0, 0, 1, 2, 3]])
    assert np.isfinite(factor).all()
    assert ((factor >= 0) & (factor <= 1)).all()


def test_angle_is_the_arctangent(rng):
    sine, cosine = np.abs(rng.normal(size=100_000)), rng.normal(size=100_000)
    np.testing.assert_allclose(angle(sine, cosine), np.arctan2(sine, cosine), atol=1e-15, rtol=4e-16)
    assert angle(np.array([0.0, 0.0, 1.0, 0.0]), np.array([0.0, 1.0, 0.0, -1.0])).tolist() == [0, 0, np.pi / 2, np.pi]


@pytest.mark.parametrize("blend", [0.0, 0.5])
def test_irradiance_of_a_spot(rng, blend):
    """That of the places of its disk, each in its own place in the cone; and one test ray stands for all of them."""
    radius, half, height = 0.3, 0.5, 2.0
    spot = Sources(
        kind=np.array([BALL], np.int8),
        strength=np.ones((1, 3)),
        position=np.array([(0, 0, height)]),
        direction=np.array([(0, 0, -1.0)]),
        two_sided=np.array([False]),
        radius=np.array([radius]),
        soft=np.array([True]),
        cone=np.array([(np.cos(half), blend)]),
        corner_start=np.zeros(2, np.int32),
        corner=np.zeros((0, 3)),
        origin=np.zeros(1, np.int32),
        shadows=np.array([True]),
    )
    count = 60
    points = np.stack([np.linspace(0, 2, count), np.zeros(count), rng.uniform(-0.2, 0.2, count)], axis=1)
    normals = rng.normal(size=(count, 3)) * 0.3 + (0, 0, 1)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    a, b = lattice(4096)
    expected = np.empty(count)
    for k in range(count):
        axis = np.array((0, 0, height)) - points[k]
        distance = np.linalg.norm(axis)
        axis /= distance
        across = np.cross(axis, (0, 1, 0))
        across /= np.linalg.norm(across)
        disk = (
            radius
            * np.sqrt(a)[:, None]
            * (np.cos(2 * np.pi * b)[:, None] * across + np.sin(2 * np.pi * b)[:, None] * np.cross(axis, across))
        )
        toward = distance * axis + disk
        rise = (toward[:, 2] / np.linalg.norm(toward, axis=1) - np.cos(half)) / max((1 - np.cos(half)) * blend, 1e-9)
        ramp = np.clip(rise, 0, 1)
        light = np.maximum(toward @ normals[k], 0) * ramp * ramp * (3 - 2 * ramp)
        expected[k] = light.mean() / (distance * (distance**2 + radius**2))
    factor = unoccluded(spot, 0, points, normals)
    np.testing.assert_allclose(factor, expected, atol=expected.max() / 32)  # 32 places of the disk
    assert (factor == 0).any()
    assert ((factor > 0) & (factor < 0.3 * factor.max())).any()  # the rim

    # Cells keep what they found, each at the points that it came to: it must not depend on which these are.
    for size in (1, 7):
        parts = [slice(k, k + size) for k in range(0, count, size)]
        assert (np.concatenate([unoccluded(spot, 0, points[p], normals[p]) for p in parts]) == factor).all()

    nothing = RayCaster(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros(0, bool))
    owner = np.repeat(np.arange(count), len(a))
    where, up, to = points[owner], normals[owner], (np.tile(a, count), np.tile(b, count))
    _, seen = rays_toward(spot, 0, nothing, where, up, up, nothing.start(where, up), *to)
    mean = from_one_test(spot, 0, where, up, seen, to[0]).reshape(count, -1).mean(axis=1)
    np.testing.assert_allclose(mean, expected, atol=1e-3 * expected.max())


@pytest.mark.parametrize("away", [1e3, 1e5, 1e7, 1e9])
def test_small_polygon_far_away(away, rng):
    """What an element sees of a square that is so much smaller than it is far: A cos cos' / (pi r^2), to the digits that its
    corners' places still have."""
    way = rng.normal(size=(200, 3))
    way /= np.sqrt((way * way).sum(axis=1))[:, None]
    normal = np.roll(way, 1, axis=0) + 2 * way
    normal /= np.sqrt((normal * normal).sum(axis=1))[:, None]
    square = SQUARE - (0.5, 0.5, 0)
    found = polygon_factor(-way * away, normal, square)
    expected = (way * normal).sum(axis=1) * np.abs(way[:, 2]) / (np.pi * away**2)
    clear = np.abs(way[:, 2]) > 0.1
    np.testing.assert_allclose(found[clear], expected[clear], rtol=1e-6 + 1e-14 * away)


@pytest.mark.parametrize("lamp", [
    Lamp("sun", (1.0,) * 3, axes=((1, 0, 0), (0, 0.8, -0.6), (0, 0.6, 0.8)), angle=0.3),
    Lamp("point", (1.0,) * 3, (0.5, 0.5, 0.6), radius=0.2),
    Lamp("area", (1.0,) * 3, (0.5, 0.5, 0.35), size=(0.3, 0.4)),
])  # fmt: skip
def test_patches_that_are_turned_away_from_all_sources_get_nothing(lamp, monkeypatch):
    """They are left out before there are any places on them; with all of them looked at it is the same, bit for bit."""
    scene = join_meshes([box(n=2), box("block", (0.3, 0.3, 0.2), (0.6, 0.7, 0.5), 2, False)], lamps=[lamp])
    cells, patches = LocalCells(), make_patches(scene, 0.3)
    cells.start(scene_arrays(scene, patches, make_sources(scene)[0]))
    asked = dict(sides=np.arange(2 * len(patches)), samples=4, seed=0)
    looked_at, turned = [], rows._turned
    monkeypatch.setattr(rows, "_turned", lambda kernel, sides: looked_at.append(turned(kernel, sides)) or looked_at[-1])
    (some,) = cells.take([cells.submit("direct", **asked)])
    monkeypatch.setattr(rows, "_turned", lambda kernel, sides: np.arange(len(sides)))
    (every,) = cells.take([cells.submit("direct", **asked)])
    assert 0 < len(looked_at[0]) < 0.8 * len(asked["sides"])
    assert all(np.array_equal(some[name], every[name]) for name in every)
