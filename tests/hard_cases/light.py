"""Hard cases of light: reflectances near 1, extreme ratios, lamps in odd places, rooms that light hardly reaches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cases import case, findings, gray, of, off, total

from scenes import Lamp, Material, World, box, join_meshes, sheet

POWER = 100.0
CUBE = 1.0 / (4 * np.pi) * POWER  # intensity of a point lamp of that power [W/sr]


def mean(baked, name=None):
    """(C,) mean irradiance by area, of one object or of all."""
    area = baked.points.area * (1.0 if name is None else of(baked, name))
    return (area[:, None] * total(baked)).sum(axis=0) / area.sum()


def patch_mean(baked):
    """(C,) mean irradiance of the fronts of all patches."""
    light = baked.solution.irradiance[:, 0::2]
    return (light * baked.patches.area).sum(axis=1) / baked.patches.area.sum()


def lit_cube(reflectance):
    """A closed cube with a lamp of 100 W in the middle."""
    return join_meshes([box("cube", n=12)], [Material("m", reflectance)], [Lamp("point", (CUBE,) * 3, (0.5,) * 3)])


@case(within=0.01)
def reflectances_from_0_to_999(bake):
    """A closed cube with a lamp: mean H = Phi / (A (1 - rho)) for rho 0, 0.5, 0.95 and 0.999."""
    worst = 0.0
    for rho in (0.0, 0.5, 0.95, 0.999):
        worst = max(worst, off(patch_mean(bake(lit_cube((rho,) * 3))), POWER / 6 / (1 - rho)))
    return worst


@case(within=0.01)
def reflectance_of_1_and_more_in_a_closed_room(bake):
    """No steady state: it counts as 0.999, H = Phi / (A 0.001), and a finding names the room."""
    worst = 0.0
    for rho in (1.0, 1.5, 1e12, np.inf):
        baked = bake(lit_cube((rho,) * 3))
        assert any(f.object == "cube" for f in findings(baked, "0.999")), baked.survey.health
        worst = max(worst, off(patch_mean(baked), POWER / 6 / 0.001))
    return worst


@case(within=0.01)
def reflectance_of_1_in_an_open_room(bake):
    """A white cavity, open above: nearly all light leaves it again (escaped = emitted but for 0.1 % a bounce)."""
    scene = join_meshes([box("cube", n=8, faces="xXyYz")], [gray(1.0)], [Lamp("point", (CUBE,) * 3, (0.5,) * 3)])
    energy = bake(scene).solution.energy
    return abs(energy["escaped_w"] / energy["emitted_w"] - 1)


@case(within=0.01)
def reflectance_of_1_in_one_channel(bake):
    """Each channel as if it were alone: 0.2, 0.5 and 0.999 in place of 1."""
    return off(patch_mean(bake(lit_cube((0.2, 0.5, 1.0)))) * (0.8, 0.5, 0.001), POWER / 6)


@case(within=0.01, row_rays=32)
def rows_that_memory_does_not_hold(bake):
    """A white room with a block, memory for half of the rays of rows: mean H = Phi / (A (1 - rho)), and a finding says so."""
    block = box("block", (0.2, 0.3, 0.0), (0.5, 0.6, 0.4), 4, False)
    scene = join_meshes([box("cube", n=12), block], [gray(0.9)], [Lamp("point", (CUBE,) * 3, (0.7,) * 3)])
    baked = bake(scene, memory=5e5)
    assert baked.solution.rows.rays < 32
    assert findings(baked, "rows of 32 rays"), baked.survey.health
    sent = (baked.solution.direct[:, 0::2] * baked.patches.area).sum(axis=1) / baked.patches.area.sum()
    return off(patch_mean(baked), sent / 0.1)


@case(within=0.0)
def no_light_at_all(bake):
    """Black, and no ray for rows."""
    return float(total(bake(join_meshes([box("room", n=3)], [gray(0.5)]))).max())


@case(within=0.02)
def nothing_but_sky(bake):
    """A block under a sky of radiance L, on nothing: pi L on top, half of it on the sides, all of it below."""
    baked = bake(join_meshes([box("block", n=4, inward=False)], [gray(0.5)], world=World((0.3, 0.6, 1.0))))
    return off(total(baked), np.pi * np.array((0.3, 0.6, 1.0)))


@case(within=0.0)
def an_emitter_seen_edge_on(bake):
    """A glowing square in the plane of a floor: not one photon."""
    floor = sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 4, 4)
    lamp = sheet("lamp", [(1, 0, 0), (2, 0, 0), (2, 1, 0), (1, 1, 0)], 1, 1, 1)
    return float(total(bake(join_meshes([floor, lamp], [gray(0.5), gray(0.0, 5.0)])))[:25].max())


@case(within=1e-4)
def light_from_1e_minus_30_to_1e30(bake):
    """A glowing room of any strength gets as many times as much; what is next to nothing is black, and so is what is beyond all
    measure, with a finding."""

    def room(exitance):
        return bake(join_meshes([box("room", n=4, materials={"Z": 1})], [gray(0.5), gray(0.5, exitance)]))

    one = total(room(1.0))
    worst = max(off(total(room(e)) / e, one) for e in (1e-30, 1e-6, 1e12, 1e29))
    for exitance, told in ((1e-300, False), (1e31, True), (1e300, True)):
        baked = room(exitance)
        assert not total(baked).any()
        assert bool(findings(baked, "beyond all measure")) == told, baked.survey.health
    return worst


@case(within=1e-12)
def a_ratio_of_1e12(bake):
    """A dim room beside one that is 1e12 times brighter: the dim one is what it is alone."""
    dim = [box("dim", n=3)]
    both = [*dim, box("bright", (5, 0, 0), (6, 1, 1), 3, materials=dict.fromkeys("xXyYzZ", 1))]
    materials = [gray(0.5, 1.0), gray(0.5, 1e12)]
    baked = bake(join_meshes(both, materials))
    return max(
        off(total(baked)[of(baked, "dim")], 2.0) - 5e-3, off(total(baked)[of(baked, "bright")], 2e12) - 5e-3, 0.0
    )


@case(within=0.0)
def a_lamp_inside_a_solid(bake):
    """A lamp in a closed block lights the inside of the block and nothing else."""
    block = box("block", (0.4, 0.4, 0.4), (0.6, 0.6, 0.6), 3, False)
    baked = bake(join_meshes([box("room", n=4), block], [gray(0.6)], [Lamp("point", (1, 1, 1), (0.5, 0.5, 0.5))]))
    assert findings(baked, "behind")
    return float(total(baked).max())


@case(within=0.02)
def a_lamp_on_a_surface(bake):
    """A point lamp exactly in a wall, and one just before it: half of its light reaches the other walls."""
    worst = 0.0
    for x in (0.0, 1e-5):
        scene = replace(lit_cube((0.0,) * 3), lamps=(Lamp("point", (CUBE,) * 3, (x, 0.46, 0.52)),))
        baked = bake(scene)
        inner = baked.patches.centroid[:, 0] > 1e-3
        landed = (baked.solution.irradiance[:, 0::2] * baked.patches.area * inner).sum(axis=1)
        worst = max(worst, off(landed, POWER / 2))
    return worst


@case(within=1.0)
def a_lamp_very_near(bake):
    """A lamp 1e-6 from a wall: what lands in the room is not more than it sends."""
    scene = replace(lit_cube((0.0,) * 3), lamps=(Lamp("point", (CUBE,) * 3, (1e-6, 0.46, 0.52)),))
    return bake(scene).solution.energy["emitted_w"] / (3 * POWER) - 0.01


@case(within=0.01)
def a_lamp_that_is_larger_than_the_room(bake):
    """A point lamp with a radius of 3 m in a room of 1 m: finite, and never more than it sends."""
    scene = replace(lit_cube((0.0,) * 3), lamps=(Lamp("point", (CUBE,) * 3, (0.5,) * 3, radius=3.0),))
    return max(bake(scene).solution.energy["emitted_w"] / (3 * POWER) - 1.0, 0.0)


def rooms_in_a_row(count):
    """`count` rooms of 1 m in a row, joined by doors that are set off from one another; a lamp in the first."""
    shell = box("shell", high=(count, 1, 1), n=1)
    walls = []
    for k in range(1, count):
        left = 0.0 if k % 2 else 0.4
        walls.append(sheet(f"wall {k}", [(k, left, 0), (k, left + 0.6, 0), (k, left + 0.6, 1), (k, left, 1)], 2, 2))
    floors = [
        sheet(f"floor {k}", [(k, 0, 1e-3), (k + 1, 0, 1e-3), (k + 1, 1, 1e-3), (k, 1, 1e-3)], 3, 3)
        for k in range(count)
    ]
    return join_meshes([shell, *walls, *floors], [gray(0.7)], [Lamp("point", (1, 1, 1), (0.3, 0.5, 0.7))])


@case(within=0.03)
def labyrinth_of_20_rooms(bake):
    """Every room is darker than the one before it, down to 1e-3 of the first as bright as at a tenth of the error, and
    no light is lost in a closed labyrinth."""
    near, nearer = (bake(rooms_in_a_row(20), patch_edge=1 / 100, error=error) for error in (5e-3, 5e-4))
    light, finer = (np.array([mean(b, f"floor {k}")[0] for k in range(20)]) for b in (near, nearer))
    assert near.solution.energy["escaped_w"] == 0
    assert (np.diff(light) <= 0).all()
    seen = finer > 1e-3 * finer[0]
    assert seen.sum() >= 4
    return float(np.abs(light / np.where(seen, finer, 1) - 1)[seen].max())


@case(within=0.02)
def long_corridor(bake):
    """A closed corridor of 50 : 1 : 1 with a lamp at one end: mean H = Phi / (A (1 - rho)), wherever the light goes."""
    scene = join_meshes([box("corridor", high=(50, 1, 1), n=12)], [gray(0.8)], [Lamp("point", (CUBE,) * 3, (0.5,) * 3)])
    return off(patch_mean(bake(scene, patch_edge=1 / 150)), POWER / (202 * 0.2))


@case(within=5e-3)
def coincident_emitters(bake):
    """A furnace that is there twice, in the same place: still H = E / (1 - rho)."""
    return off(total(bake(join_meshes([box("one", n=2), box("two", n=2)], [gray(0.5, 1.0)]))), 2.0)


@case(within=0.02)
def values_that_are_no_numbers(bake):
    """Lamps, materials and skies that are NaN, infinite or negative give no light; the rest of the scene is as without."""
    bad = [Material("nan", (np.nan, -1, 0.5), (np.nan, -5, 0)), Material("inf", (0.5,) * 3, (np.inf, 0, 0))]
    lamps = [
        Lamp("point", (CUBE,) * 3, (0.5, 0.5, 0.5)),
        Lamp("point", (np.nan, 1, 1), (0.2, 0.2, 0.2)), Lamp("sun", (np.inf,) * 3), Lamp("spot", (1, 1, 1), (np.nan, 0, 0), angle=1.0),
        Lamp("area", (-1, -1, -1), (0.1, 0.1, 0.9)), Lamp("point", (1, 1, 1), (0.3, 0.3, 0.3), radius=np.nan),
    ]  # fmt: skip
    block = box(
        "block", (0.1, 0.1, 0.1), (0.12, 0.12, 0.12), 1, False, materials=dict(zip("xXyYzZ", (1, 2, 1, 2, 1, 2)))
    )
    baked = bake(join_meshes([box("room", n=4), block], [gray(0.5), *bad], lamps, World((np.nan, -1, np.inf))))
    plain = bake(join_meshes([box("room", n=4)], [gray(0.5)], lamps[:1]))
    return off(mean(baked, "room"), mean(plain, "room"))
