"""What is said of a scene's data and of a bake: what is wrong, by object, and what was done."""

from __future__ import annotations

import pytest

from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.health import direct_check, mend

from scenes import Lamp, Material, Settings, bake, box, join_meshes, run, sheet


def lit(meshes, lamps, reflectance=0.5):
    scene = join_meshes(meshes, [Material("m", (reflectance,) * 3)], lamps)
    return run(bake(scene, Settings(patch_edge=1 / 30), LocalCells()))


LAMPS = {
    "point": Lamp("point", (1, 1, 1), (0.5, 0.5, 0.5)),
    "spot": Lamp("spot", (1, 1, 1), (0.5, 0.5, 0.8), angle=1.0, blend=0.5),
    "area": Lamp("area", (1, 1, 1), (0.5, 0.5, 0.9), size=(0.2, 0.3)),
    "disk": Lamp("area", (1, 1, 1), (0.5, 0.5, 0.9), size=(0.2, 0.3), ellipse=True),
}


@pytest.mark.parametrize("kind", LAMPS)
def test_all_that_a_lamp_sends_lands_in_a_closed_room(kind):
    baked = lit([box(n=2)], [LAMPS[kind]])
    assert direct_check(baked.scene, baked.solution) == pytest.approx(1.0, abs=0.01)
    assert not baked.survey.health


def test_a_lamp_whose_light_is_not_found_is_named():
    baked = lit([box(n=2)], [Lamp("point", (1, 1, 1), (1e-6, 0.46, 0.52))])
    assert direct_check(baked.scene, baked.solution) < 0.7
    assert any(f.object == "lamps" for f in baked.survey.health)


def test_nothing_is_said_of_lamps_where_light_can_escape():
    alone = sheet("alone", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    for meshes in ([alone], [box(n=2, faces="xXyYz")]):
        baked = lit(meshes, [LAMPS["point"]])
        assert direct_check(baked.scene, baked.solution) is None
        assert not any(f.object == "lamps" for f in baked.survey.health)


def test_white_is_found_only_where_light_has_no_end():
    """A closed white room with a lamp is named; the dark inside of a white block, and a room with one gray wall, are not."""
    white, gray = Material("white", (1.0,) * 3), Material("gray", (0.5,) * 3)
    lamp = [LAMPS["point"]]
    closed = join_meshes([box("room", n=2)], [white], lamp)
    block = join_meshes(
        [box("room", n=2, materials=dict.fromkeys("xXyYzZ", 1)), box("block", (0.1, 0.1, 0), (0.3, 0.3, 0.2), 1, False)],
        [white, gray], lamp,
    )  # fmt: skip
    wall = join_meshes([box("room", n=2, materials={"x": 1})], [white, gray], lamp)
    named = [[f.object for f in mend(scene).health] for scene in (closed, block, wall)]
    assert named == [["room"], [], []]


def test_a_mended_scene_is_not_mended_again():
    scene = mend(join_meshes([box(n=1), box(n=1)]))
    assert mend(scene) is scene
    assert len(scene.health) == 1
