"""Light of replicates: block by block it is what it is in one go, whoever finds it; and the last replicate's share of the noise
follows from the others'."""

from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core import gather
from cell_radiosity.core import replicates as module
from cell_radiosity.core.bake import bake, run
from cell_radiosity.core.cells import LocalCells, make_cells
from cell_radiosity.core.replicates import Near, Replicate, around, mean_light
from cell_radiosity.core.settings import Settings

from scenes import Lamp, Material, box, join_meshes, sheet

SETTINGS = Settings.for_error(0.02, gather_rays=48, patch_edge=0.1)


def room(n=24):
    """A room with a lit panel and a window to a block, whose light differs from channel to channel."""
    panel = sheet("panel", [(0.3, 0.7, 0.98), (0.7, 0.7, 0.98), (0.7, 0.3, 0.98), (0.3, 0.3, 0.98)], material=1)
    block = box("block", (0.2, 0.3, 0.0), (0.5, 0.6, 0.45), n // 3, False)
    materials = [Material("rose", (0.7, 0.5, 0.3)), Material("panel", (0, 0, 0), (30.0,) * 3)]
    return join_meshes([box("room", n=n), block, panel], materials, written=[True, True, False])


@pytest.fixture(scope="module")
def whole():
    return run(bake(room(), SETTINGS, LocalCells()))


@pytest.mark.parametrize("size", [300, 1000])
def test_blocks_of_light_are_what_the_whole_is(whole, size, monkeypatch):
    """A block too small by one ring of neighbors, or one that does not know how many neighbors the last of them have, would
    show at its rim. The same bits by cells and by the host."""
    monkeypatch.setattr(gather, "WHOLE", size)
    monkeypatch.setattr(module, "BLOCK", size)
    assert len(module.light_blocks(len(whole.points), True)) > 2
    found = []
    for cells in (LocalCells(), make_cells(2)):
        with cells:
            found.append(run(bake(room(), SETTINGS, cells)))
    for name in ("direct", "indirect", "variance", "blurred"):
        mine, other = (getattr(baked.light, name) for baked in found)
        assert np.array_equal(mine, other)
        expected = getattr(whole.light, name)
        assert np.abs(mine - expected).max() < 1e-9 * np.abs(expected).max()
    assert found[0].estimate.total == pytest.approx(whole.estimate.total, rel=1e-9)


def test_a_block_reads_no_more_than_its_surroundings(whole):
    """Of many points only those within so many steps are read."""
    points, part = whole.points, slice(0, 100)
    near = around(points, part)
    assert near[part].all()
    assert 100 < np.count_nonzero(near) < len(points) / 2


def test_light_is_the_same_whichever_replicate_comes_last(whole):
    """What the filter makes of the last follows from the others, as long as all were taken everywhere."""
    state = whole.state()
    replicates, links = state.gathered.replicates, state.gathered.links
    assert len(replicates) > 2
    first = mean_light(whole.points, links, replicates, 1, 1.0)
    again = mean_light(whole.points, links, replicates[::-1], 1, 1.0)
    one_left = [replace(r, taken=r.taken & (np.arange(len(r.taken)) > 0)) for r in replicates]  # goes through all
    third = mean_light(whole.points, links, one_left, 1, 1.0)
    far = ~around(whole.points, slice(0, 1))
    for name, light in first.items():
        scale = np.abs(light).max()
        assert np.abs(light - again[name]).max() < 1e-11 * scale
        assert np.abs(light - third[name])[..., far].max() < 1e-11 * scale


def test_dark_replicates_have_no_light_and_no_noise():
    points = run(bake(room(3), replace(SETTINGS, gather_rays=8), LocalCells())).points
    count = len(points)
    dark, all_of_them = np.zeros((3, count), np.float32), np.ones(count, bool)
    one = Replicate(8, 8, all_of_them, all_of_them, dark, dark, dark, np.ones(count, np.float32))
    light = mean_light(points, np.ones(len(points.neighbor), bool), [one, one], 1, 1.0)
    assert all(not array.any() for array in light.values())


def test_direct_light_counts_by_its_own_test_rays(rng):
    """Its mean, and what its scatter says of the noise, are those of the replicates that have test rays, by their number."""
    count, tests = 20_000, (8, 8, 40, 0)
    place, nobody = np.zeros((count, 3)), np.zeros(0, np.int32)
    points = Near(place, place + (0.0, 0.0, 1.0), np.zeros(count + 1, np.int32), nobody)
    every, dark = np.ones(count, bool), np.zeros((3, count), np.float32)
    direct = [(1.0 + rng.normal(0, n**-0.625, (3, count))).astype(np.float32) if n else dark for n in tests]
    replicates = [
        Replicate(400 if n != 8 else 8, n, every, every, d, dark, dark, np.ones(count, np.float32))
        for n, d in zip(tests, direct)
    ]
    light = mean_light(points, np.zeros(0, bool), replicates, 1, 1.0)
    mean = np.average(direct[:3], axis=0, weights=[n**1.25 for n in tests[:3]])
    np.testing.assert_allclose(light["direct"], mean, rtol=1e-5)
    assert light["variance"].mean() == pytest.approx(np.square(light["direct"] - 1.0).mean(), rel=0.05)
    none = mean_light(points, np.zeros(0, bool), replicates[3:], 1, 1.0)
    assert not none["direct"].any()
    assert not none["variance"].any()


def test_a_point_whose_rays_all_missed_is_smoothed_like_its_neighbors(rng):
    """Nothing is near it. Where few rays met anything those that met nothing stayed black dots on dim walls."""
    floor = sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 16, 16)
    lamp = Lamp("point", (1.0, 1.0, 1.0), (0.5, 0.5, 1.0), radius=0.05)
    points = run(bake(join_meshes([floor], lamps=[lamp]), replace(SETTINGS, gather_rays=8), LocalCells())).points
    count, dark = len(points), np.zeros((3, len(points)), np.float32)
    every, links = np.ones(count, bool), np.ones(len(points.neighbor), bool)
    missed = np.flatnonzero(np.abs(points.position[:, :2] - 0.5).max(axis=1) < 0.05)
    replicates = []
    for _ in range(4):
        hits = rng.binomial(8, 0.3, count).astype(np.float32)
        hits[missed] = 0.0
        replicates.append(Replicate(8, 8, every, every, dark, dark, np.tile(hits / 2.4, (3, 1)), 4.0 * hits / 8))
    indirect = mean_light(points, links, replicates, 1, 1.0)["indirect"]
    assert len(missed)
    assert indirect[:, missed].min() > 0.4
    np.testing.assert_allclose(indirect.mean(), 1.0, atol=0.03)
