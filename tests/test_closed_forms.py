"""Radiosity against answers in closed form, through the real solver and its processes."""

from __future__ import annotations

import numpy as np
import pytest

from scenes import Lamp, Material, Settings, bake, box, icosphere, join_meshes, run, sheet, solve_scene


def gray(reflectance, exitance=0.0):
    return Material("gray", (reflectance,) * 3, (exitance,) * 3)


@pytest.mark.parametrize("found", [False, True], ids=["faces are sampled", "rays find the faces"])
@pytest.mark.parametrize("reflectance", [0.0, 0.5, 0.9])
def test_furnace(cells, reflectance, found):
    """Closed, with the same reflectance and exitance everywhere: B = E / (1 - rho), whatever the shape."""
    room = join_meshes([box(n=4)], [gray(reflectance, 1.0)])
    solved = solve_scene(room, cells, found=found, error=1e-4)
    inside = solved.radiosity[:, 0::2]
    np.testing.assert_allclose(inside, 1 / (1 - reflectance), rtol=1e-4 if found else 3e-3)
    assert not solved.radiosity[:, 1::2].max() > 1.0 + 1e-9  # outside there is only what the faces emit


def test_furnace_with_random_reflectances(cells, rng):
    """E = (1 - rho) L gives B = L for any rho: only rows that sum to 1 do this."""
    reflectance = rng.uniform(0.05, 0.95, 6 * 16)
    materials = [gray(r, 1 - r) for r in reflectance]
    mesh = box(n=4)
    room = join_meshes([type(mesh)(**{**mesh.__dict__, "polygon_material": np.arange(96)})], materials)
    solved = solve_scene(room, cells, found=True, error=1e-4)
    np.testing.assert_allclose(solved.radiosity[:, 0::2], 1.0, rtol=2e-4)


def test_spherical_cavity(cells):
    """Inside a sphere the kernel has rank one: H = sum a E / (1 - sum a rho), the same everywhere."""
    materials = [gray(0.2, 1.0), gray(0.8)]
    sphere = join_meshes([icosphere(splits=2, material=lambda c: (c[:, 2] < 0).astype(int))], materials)
    solved = solve_scene(sphere, cells, found=True, row_rays=256, error=1e-4)
    share = solved.patches.area / solved.patches.area.sum()
    rho = solved.surfaces.reflectance[0, 0::2]
    expected = (share * solved.surfaces.exitance[0, 0::2]).sum() / (1 - (share * rho).sum())
    arriving = solved.solution.irradiance[0, 0::2]
    assert abs((share * arriving).sum() / expected - 1) < 2e-3
    # A sphere of triangles is not quite a sphere (0.996 to 1.0046); 256 rays of a lattice add some 1 % of noise.
    assert np.abs(arriving / expected - 1).max() < 0.04


def test_mean_identity_at_high_reflectance(cells, rng):
    """Closed, one reflectance, any exitance: mean B = mean E / (1 - rho). A cap on bounces fails here, and so do rows whose
    noise piles up, by some percent."""
    materials = [gray(0.95, e) for e in rng.uniform(0, 1, 6)]
    room = join_meshes([box(n=8, materials=dict(zip("xXyYzZ", range(6))))], materials)
    solved = solve_scene(room, cells, found=True, row_rays=16, error=1e-3)
    assert abs(solved.mean(solved.radiosity)[0] / (solved.mean(solved.surfaces.exitance)[0] / 0.05) - 1) < 1e-4


def test_cube_of_three_reflectances(cells):
    """Ceiling E = 1, rho .8; walls .5; floor .2: averages in the limit of small patches."""
    materials = [gray(0.5), gray(0.8, 1.0), gray(0.2)]
    room = join_meshes([box(n=16, materials={"Z": 1, "z": 2})], materials)
    solved = solve_scene(room, cells, row_rays=64)
    polygon = {face: np.arange(256) + 256 * k for k, face in enumerate("xXyYzZ")}
    ceiling, floor = (solved.mean(solved.radiosity, polygon[f])[0] for f in "Zz")
    wall = np.mean([solved.mean(solved.radiosity, polygon[f])[0] for f in "xXyY"])
    assert ceiling == pytest.approx(1.1481, rel=0.002)
    assert wall == pytest.approx(0.17272, rel=0.005)
    assert floor == pytest.approx(0.068025, rel=0.005)


@pytest.mark.parametrize("reflectance", [0.05, 0.5, 0.8, 0.95])
def test_cie_171_5_8_internal_reflection(cells, reflectance):
    """A 4 m cube with 10 000 lm in its middle: mean indirect illuminance rho Phi / (S (1 - rho))."""
    lamp = Lamp("point", (10_000 / (4 * np.pi),) * 3, (2, 2, 2))
    room = join_meshes([box(high=(4, 4, 4), n=32)], [gray(reflectance)], [lamp])
    solved = solve_scene(room, cells, row_rays=32)
    expected = reflectance * 10_000 / (96 * (1 - reflectance))
    indirect = solved.mean(solved.solution.irradiance)[0] - 10_000 / 96
    assert indirect == pytest.approx(expected, rel=0.01)


def test_power_is_balanced_after_every_round(cells):
    """emitted = absorbed + escaped + unshot, to rounding, while light is shot and after the solve."""
    materials = [gray(0.7), gray(0.3, 2.0)]
    room = join_meshes(
        [
            box(n=6, materials={"Z": 1}, faces="xXyYzZ"[:5] + "Z"),
            box("block", (0.3, 0.3, 0.2), (0.6, 0.7, 0.5), 3, False),
        ],
        materials,
        [Lamp("point", (3.0, 2.0, 1.0), (0.5, 0.2, 0.8))],
    )
    solved = solve_scene(room, cells, row_rays=16)
    energy = solved.solution.energy
    balance = energy["absorbed_w"] + energy["escaped_w"] + energy["unshot_w"]
    assert balance == pytest.approx(energy["emitted_w"], rel=1e-12)
    assert abs(energy["unshot_w"]) < 0.02 * energy["emitted_w"]


def test_a_sliver_of_a_lamp_that_is_hidden_is_found_by_many_rays(cells):
    """Four tests at points where a plate hides a twentieth of the lamp mostly find all of it: what a few tests settle must
    not stay settled however many rays follow, or replicates never agree at the rim of a shadow."""
    plate = sheet("plate", [(0, -2, 1), (0, 2, 1), (2, 2, 1), (2, -2, 1)])
    floor = sheet("floor", [(-2, -0.1, 0), (2, -0.1, 0), (2, 0.1, 0), (-2, 0.1, 0)], 400, 1)
    scene = join_meshes([floor, plate], [Material("w", (0, 0, 0))], [Lamp("sun", (3.0,) * 3, (0, 0, 9), angle=0.3)])
    baked = [
        run(bake(scene, Settings(gather_rays=8192, pilot_rays=4096, seed=seed, force=("occlusion",)), cells))
        for seed in range(4)
    ]
    points = baked[0].points
    floor = points.normal[:, 2] * (points.position[:, 2] < 0.5) > 0
    light = np.stack([b.light.total[0, floor] for b in baked])
    rim = (light.mean(axis=0) > 0.05) & (light.mean(axis=0) < 2.95)
    assert rim.sum() > 20
    assert light[:, rim].std(axis=0).max() < 0.03
