"""Rooms with published answers: CIE 171:2006 (corrected where its tables are wrong) and Khodulev's cube."""

from __future__ import annotations

import numpy as np
import pytest

from scenes import Lamp, Material, Mesh, Settings, bake, box, join_meshes, point_light, run, sheet

BLACK, SHINE = Material("black", (0, 0, 0)), Material("shine", (0, 0, 0), (1, 1, 1))


def with_places(name, places, normal):
    """Tiny triangles whose first corners lie at places (K, 3), facing along normal: points to read light at."""
    normal = np.asarray(normal, float)
    a = np.roll(normal, 1)
    b = np.cross(normal, a)
    places = np.asarray(places, float)
    vertices = np.stack([places, places + 1e-3 * a, places + 1e-3 * b], axis=1).reshape(-1, 3)
    return Mesh.of_polygons(name, vertices, np.arange(len(vertices)).reshape(-1, 3).tolist())


def test_cie_171_5_6_diffuse_reflector(cells):
    """A floor of even exitance in a black room of 4 x 4 x 3 m: percent of it that reaches wall and ceiling."""
    heights, depths = [0.75, 1.25, 1.75, 2.25, 2.75], [0.25, 0.75, 1.25, 1.75]
    wall, ceiling = [(2, 1e-4, z) for z in heights], [(2, y, 3 - 1e-4) for y in depths]
    room = join_meshes(
        [
            box(high=(4, 4, 3), materials={"z": 1}),
            with_places("wall points", wall, (0, 1, 0)),
            with_places("ceiling points", ceiling, (0, 0, -1)),
        ],
        [BLACK, SHINE],
        written=[False, True, True],
    )
    baked = run(bake(room, Settings(), cells))
    found = 100 * point_light(baked, wall + ceiling)[:, 0]
    expected = [35.900505, 27.991624, 21.638511, 16.716315, 12.967372, 26.795188, 30.938711, 33.975719, 35.566592]
    np.testing.assert_allclose(found, expected, rtol=2e-3)


def test_cie_171_5_7_obstruction(cells):
    """The far wall shines; a block as wide as the room stands before it (corrected reference values)."""
    heights, depths = [2.75, 2.25, 1.75, 1.25, 0.75, 0.25], [0.25, 0.75, 1.25, 1.75, 2.25]
    wall, floor = [(2, 1e-4, z) for z in heights], [(2, y, 1e-4) for y in depths]
    room = join_meshes(
        [
            box(high=(4, 4, 3), materials={"Y": 1}),
            box("block", (0, 2.5, 0), (4, 2.7, 1), inward=False),
            with_places("wall points", wall, (0, 1, 0)),
            with_places("floor points", floor, (0, 0, 1)),
        ],
        [BLACK, SHINE],
        written=[False, False, True, True],
    )
    baked = run(bake(room, Settings(gather_rays=4096), cells))
    found = 100 * point_light(baked, wall + floor)[:, 0]
    expected = [16.070642, 16.329677, 15.398810, 13.322018, 10.316924, 7.078969, 3.382335, 3.628986, 3.012951, 0, 0]
    np.testing.assert_allclose(found, expected, rtol=0.01, atol=1e-9)


def test_khodulev_cube(cells):
    """A 10 m cube, reflectance 2/3, 50 000 cd in its middle: luminance at face centers and quarter points."""
    lamp = Lamp("point", (50_000,) * 3, (0, 0, 0))
    low, high = (-5, -5, -5), (5, 5, 5)
    places = [(0, 0, -5), (2.5, 0, -5), (2.5, 2.5, -5)]
    room = join_meshes([box("cube", low, high, n=16)], [Material("gray", (2 / 3,) * 3)], [lamp])
    baked = run(bake(room, Settings(gather_rays=1024, row_rays=32), cells))
    luminance = point_light(baked, places)[:, 0] * (2 / 3) / np.pi
    np.testing.assert_allclose(luminance, [892.79, 768.69, 686.69], rtol=0.004)


@pytest.mark.parametrize("lit", [True, False])
def test_two_opposed_squares(cells, lit):
    """B1 = (E1 + rho1 F E2) / (1 - rho1 rho2 F^2), and the same from the other side."""
    first, second = (
        Material("first", (0.5,) * 3, (float(lit),) * 3),
        Material("second", (0.8,) * 3, (float(not lit),) * 3),
    )
    a = sheet("a", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 8, 8, 0)
    b = sheet("b", [(0, 1, 1), (1, 1, 1), (1, 0, 1), (0, 0, 1)], 8, 8, 1)
    from scenes import solve_scene

    solved = solve_scene(join_meshes([a, b], [first, second]), cells, row_rays=128)
    means = [solved.mean(solved.radiosity, np.arange(64) + k)[0] for k in (0, 64)]
    if lit:
        # One patch per square would give 1.0162312 and 0.1624546; many patches come within 0.2 % of it.
        np.testing.assert_allclose(means, [1.0162312, 0.1624546], rtol=4e-3)
    else:
        np.testing.assert_allclose(
            means, [0.5 * 0.19982490 / (1 - 0.4 * 0.19982490**2), 1 / (1 - 0.4 * 0.19982490**2)], rtol=4e-3
        )
