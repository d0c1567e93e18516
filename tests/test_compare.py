"""How far a bake is off, against references whose distance from it is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.compare import (
    of_all,
    of_objects,
    off_finer,
    off_reference,
    parts_off_finer,
    parts_off_reference,
)
from cell_radiosity.core.layers import layer_colors, vertex_means

from scenes import Lamp, Material, Settings, bake, box, join_meshes, run, sheet


@pytest.fixture(scope="module")
def baked():
    """Three objects of one reflectance under a lamp; the second is not written."""
    meshes = [sheet("floor", [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0)], 4, 4),
              sheet("wall", [(0, 2, 0), (2, 2, 0), (2, 2, 2), (0, 2, 2)], 3, 3),
              box("block", (0.5, 0.5, 0.2), (1.0, 1.0, 0.6), 2, False)]  # fmt: skip
    lamp = Lamp("point", (9.0, 8.0, 7.0), (1.0, 0.5, 1.5))
    scene = join_meshes(meshes, [Material("gray", (0.5, 0.5, 0.5))], [lamp], written=(True, False, True))
    return run(bake(scene, Settings(error=0.1), LocalCells()))


def reference(baked, name):
    """What a Bake itself has at the vertices of an object, as a reference."""
    scene = baked.scene
    size = np.diff(scene.polygon_start)
    own = np.repeat(scene.polygon_object == scene.objects.index(name), size)
    vertex = scene.corner_vertex[own] - scene.corner_vertex[own].min()
    mean = vertex_means(layer_colors(baked, "Lighting")[own], vertex, vertex.max() + 1)
    area = 1.0 + np.arange(len(mean)) % 3
    return {f"{name}.A": area, f"{name}.mask": np.ones(len(mean), bool), f"{name}.EA": mean, f"{name}.EB": mean}


def test_a_share_too_much_is_that_share(baked):
    exact = {**reference(baked, "floor"), **reference(baked, "block")}
    assert off_reference(baked, exact) == 0
    brighter = {k: 1.25 * v if k.endswith(("EA", "EB")) else v for k, v in exact.items()}
    assert off_reference(baked, brighter) == pytest.approx(0.2)


def test_noise_of_the_two_halves_cancels(baked, rng):
    exact = reference(baked, "floor")
    noise = 0.5 * exact["floor.EA"].mean() * rng.standard_normal(exact["floor.EA"].shape)
    split = {**exact, "floor.EA": exact["floor.EA"] + noise, "floor.EB": exact["floor.EB"] - noise}
    assert off_reference(baked, split) == 0  # as one half alone it would be half of the light
    assert off_reference(baked, {**split, "floor.EB": split["floor.EA"]}) > 0.3


def test_vertices_that_do_not_count_and_objects_that_are_not_there(baked):
    far = reference(baked, "floor")
    wrong = {**far, "floor.EA": far["floor.EA"].copy()}
    wrong["floor.EA"][0] += 100.0
    wrong["floor.EB"] = wrong["floor.EA"]
    assert off_reference(baked, wrong) > 0.9
    wrong["floor.mask"] = np.arange(len(far["floor.A"])) > 0
    assert off_reference(baked, wrong) == 0
    assert off_reference(baked, reference(baked, "wall")) is None  # it was not written
    assert off_reference(baked, {}) is None


def test_off_a_finer_bake(baked):
    finer = run(bake(baked.scene, Settings(error=0.1, gather_rays=512), LocalCells()))
    assert off_finer(finer, finer) == 0
    assert 0 < off_finer(baked, finer) < 0.1


def test_each_object_by_its_own_light(baked):
    """One object a quarter too bright: it alone is off, by a fifth, and all together by its share of the light."""
    exact = {**reference(baked, "floor"), **reference(baked, "block")}
    brighter = {k: 1.25 * v if k in ("floor.EA", "floor.EB") else v for k, v in exact.items()}
    parts = parts_off_reference(baked, brighter)
    assert of_objects(parts) == {"floor": pytest.approx(0.2), "block": 0.0}
    assert of_all(parts) == off_reference(baked, brighter)
    assert 0 < of_all(parts) < 0.2


def test_objects_next_to_black_have_no_figure():
    """The same area and a millionth of the light: one more, and it has one."""
    assert of_objects({"lit": (0.01, 1.0, 1.0), "dark": (1.0, 0.4e-6, 1.0)}) == {"lit": pytest.approx(0.1)}
    assert set(of_objects({"lit": (0.01, 1.0, 1.0), "dark": (1.0, 0.6e-6, 1.0)})) == {"lit", "dark"}
    assert of_objects({}) == {}
    assert of_all({}) is None


def test_objects_off_a_finer_bake(baked):
    finer = run(bake(baked.scene, Settings(error=0.1, gather_rays=512), LocalCells()))
    each = of_objects(parts_off_finer(baked, finer))
    assert set(each) == {"floor", "block"}  # the wall was not written
    assert min(each.values()) < off_finer(baked, finer) < max(each.values())


def test_what_reflects_nothing_does_not_count_against_a_finer_bake(baked):
    """A lamp that only glows may be as wrong as it will; where all points count, as in bakes of which nothing else is known,
    it does."""
    points, light = baked.points, baked.light
    block = points.object == baked.scene.objects.index("block")
    wrong = replace(baked, light=replace(light, direct=light.direct + 9.0 * block), seen=~block)
    assert off_finer(wrong, baked) == 0
    assert "block" not in of_objects(parts_off_finer(wrong, baked))
    assert off_finer(replace(wrong, seen=None), baked) > 0.9
