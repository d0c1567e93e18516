"""The survey: what a scene calls for, the edge where each decision turns, and that leaving out changes nothing."""

from __future__ import annotations

import ast
import inspect
from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core import convexity, effects, kernel
from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.choices import EVEN
from cell_radiosity.core.effects import survey
from cell_radiosity.core.lights import make_sources
from cell_radiosity.core.pieces import shut_in
from cell_radiosity.core.settings import EFFECTS
from cell_radiosity.core.share import light_contrast
from cell_radiosity.core.surfaces import Readings, Texture

from scenes import Lamp, Material, Mesh, Settings, World, bake, box, icosphere, join_meshes, run, sheet

GRAY, RED = Material("gray", (0.5, 0.5, 0.5)), Material("red", (0.7, 0.2, 0.2))
PANEL = Lamp("area", (10.0, 10.0, 10.0), position=(0.5, 0.5, 0.9), size=(0.3, 0.3), name="panel")


def decided(scene, error=0.02, **settings):
    """{effect: (needed, reason)}."""
    found = survey(scene, Settings(error=error, **settings))
    assert [e.name for e in found.effects] == list(EFFECTS)
    return {e.name: (e.needed, e.reason) for e in found.effects}


def room(*more, lamps=(PANEL,), materials=(GRAY,), world=World(), n=4, **fields):
    return join_meshes([box(n=n), *more], materials, lamps, world, **fields)


def with_vertex(scene, place, to):
    """A scene with the vertices at a place moved."""
    vertices = scene.vertices.copy()
    vertices[(np.abs(vertices - place) < 1e-9).all(axis=1)] = to
    return replace(scene, vertices=vertices)


def test_empty_gray_room_needs_lamps_and_bounces_only():
    found = decided(room())
    assert {name for name, (needed, _) in found.items() if needed} == {"lamps", "interreflection"}
    assert found["lamps"][1] == "1 area"
    assert "1 reflectance" in found["color"][1]
    assert "6 planes" in found["occlusion"][1]


def with_places(scene):
    """A scene whose images lie on it as seen from above."""
    return replace(scene, corner_uv=scene.vertices[scene.corner_vertex][:, :2].copy())


def glow_read(light):
    """Readings of one place of a face."""
    color = np.full((1, 3), 0.5)
    return Readings(np.array([0]), np.full((1, 2), 0.3), color, light * color, np.zeros(0, int), color[:0], color[:0])


BLOCK = box("block", (0.4, 0.4, 0), (0.6, 0.6, 0.2), inward=False)
SPOT, CHECKS = np.full((64, 64, 3), 0.1, np.float32), np.indices((4, 4)).sum(axis=0) % 2 * 0.5 + 0.2
SPOT[40, 40] = 1e4


def glowing_ceiling(n, exitance=(1, 1, 1)):
    """A room whose ceiling is n x n glowing faces."""
    return join_meshes([box(n=n, materials={"Z": 1})], [GRAY, Material("glow", exitance=exitance)])


def shaded_floor(world):
    """A floor below a sheet under the open sky."""
    places = [(0, 0), (1, 0), (1, 1), (0, 1)]
    sheets = (sheet(str(z), [(x, y, z) for x, y in places]) for z in (0, 0.5))
    return join_meshes([*sheets], [Material("black", (0, 0, 0))], [], world)


def painted(pixels):
    """A room with an image on its walls."""
    return room(
        materials=[Material("image", (0, 0, 0), texture=0)], textures=(Texture("image", pixels.astype(np.float32)),)
    )


def lamp_beside(*shapes):
    """Things with a lamp off their corner, to which three sides of a block are turned."""
    return join_meshes(shapes, [GRAY], [Lamp("point", (10.0,) * 3, (3.0, 3.0, 3.0), radius=0.1)])


def shelf_beside_a_lamp(height):
    """A floor below a shelf, both facing up, and beside them an upright lamp that shines away, with its middle at a height."""
    places = [(0, 0), (1, 0), (1, 1), (0, 1)]
    sheets = (sheet(str(z), [(x, y, z) for x, y in places]) for z in (0, 0.5))
    lamp = replace(PANEL, position=(5.0, 0.5, height), axes=((0, 0, 1), (0, 1, 0), (-1, 0, 0)), size=(0.02, 0.02))
    return join_meshes([*sheets], [GRAY], [lamp])


# Each leave-out, a scene that has it left out, and one at the edge, where it is needed.
PUSHED = dict(place=(0.5, 0.5, 0.0), to=(0.5, 0.5, 1e-4))
TURNS = {
    "a vertex pushed in": ("occlusion", room(), with_vertex(room(), **PUSHED)),
    "a vertex pulled out": ("occlusion", room(), with_vertex(room(), (0.5, 0.5, 0.0), (0.5, 0.5, -1e-4))),
    "a lamp above the ceiling": (
        "occlusion", room(lamps=[replace(PANEL, position=(0.5, 0.5, 1.0))]), room(lamps=[replace(PANEL, position=(0.5, 0.5, 1.001))]),
    ),
    "a lamp wider than the room": ("occlusion", room(), room(lamps=[replace(PANEL, size=(1.01, 0.1))])),
    "a sheet in the room": ("occlusion", room(), room(sheet("sheet", [(0.4, 0.4, 0.5), (0.6, 0.4, 0.5), (0.6, 0.6, 0.5), (0.4, 0.6, 0.5)]))),
    "a room beside it": ("occlusion", room(), room(box("other", (1.2, 0, 0), (2.2, 1, 1)))),
    "black walls": (
        "interreflection", room(materials=[Material("black", (0.003,) * 3)]), room(materials=[Material("coal", (0.006,) * 3)]),
    ),
    "a ball over a plane": (
        "interreflection",
        join_meshes([sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])], [GRAY], [PANEL]),
        join_meshes([sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]), box("block", (0.4, 0.4, 0), (0.6, 0.6, 0.2), inward=False)], [GRAY], [PANEL]),
    ),
    "a tinted lamp": ("color", room(), room(lamps=[PANEL, replace(PANEL, strength=(10.0, 9.0, 8.0))])),
    "a tinted wall": ("color", room(), join_meshes([box(n=4, materials={"x": 1})], [GRAY, RED], [PANEL])),
    "a hue within the error": (
        "color", room(materials=[Material("almost", (0.5, 0.5, 0.5005))]), room(materials=[Material("hue", (0.5, 0.5, 0.505))]),
    ),
    "a lamp that is on": ("lamps", room(lamps=[replace(PANEL, strength=(0, 0, 0))]), room(lamps=[replace(PANEL, strength=(0, 0, 1e-9))])),
    "a face that glows": ("emission", room(), join_meshes([box(n=4, materials={"Z": 1})], [GRAY, Material("glow", exitance=(1, 1, 1))])),
    "a window": ("sky", room(world=World((1, 1, 1))), join_meshes([box(n=4, faces="xXyYz")], [GRAY], [PANEL], World((1, 1, 1)))),
    "a blinding sky": ("sky", room(world=World((1, 1, 1))), room(world=World((1e6, 1e6, 1e6)))),
    "an image": (
        "textures",
        room(materials=[Material("plain", (0, 0, 0), texture=0)], textures=(Texture("plain", np.full((4, 4, 3), 0.5, np.float32)),)),
        room(materials=[Material("image", (0, 0, 0), texture=0)], textures=(Texture("image", np.tile(np.linspace(0.4, 0.5, 4, dtype=np.float32)[:, None, None], (1, 4, 3))),)),
    ),
    "a pane": ("transparency", room(), room(materials=[replace(GRAY, alpha=0.999)])),
    "a mesh of two": (
        "instances", room(box("a", (1.1, 0, 0), (1.2, 0.1, 0.1)), shared=np.array([0, 1])), room(box("a", (1.1, 0, 0), (1.2, 0.1, 0.1)), shared=np.array([0, 0])),
    ),
    "emission that was read": (
        "emission", room(readings=glow_read(0.0)), room(readings=glow_read(1e-6)),
    ),
    "a wall turned round": (
        "two-sided", room(), join_meshes([box(n=4, faces="xXyYz"), sheet("lid", [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])], [GRAY], [PANEL]),
    ),
    "a lamp over a block": (
        "occlusion",
        join_meshes([box("block", inward=False)], [GRAY], [replace(PANEL, position=(0.5, 0.5, 2.0))]),
        join_meshes([box("block", inward=False), box("knob", (0.4, 0.4, 1), (0.6, 0.6, 1.1), inward=False)], [GRAY], [replace(PANEL, position=(0.5, 0.5, 2.0))]),
    ),
    "a dent in a block": (
        "occlusion", lamp_beside(box("block", n=2, inward=False)), with_vertex(lamp_beside(box("block", n=2, inward=False)), (1.0, 0.5, 0.5), (1 - 1e-4, 0.5, 0.5)),
    ),
    "a block with a floor": (
        "occlusion", lamp_beside(box("block", n=2, inward=False)), lamp_beside(box("block", n=2, inward=False), sheet("floor", [(-1, -1, 0), (3, -1, 0), (3, 3, 0), (-1, 3, 0)])),
    ),
    "a lamp that is lit": (
        "occlusion", room(BLOCK, lamps=[replace(PANEL, strength=(0, 0, 0))]), room(BLOCK, lamps=[replace(PANEL, strength=(0, 0, 1e-9))]),
    ),
    "a lamp whose rim rises above the floor's plane": ("occlusion", shelf_beside_a_lamp(-0.0101), shelf_beside_a_lamp(-0.0099)),
    "a gray face among black ones": (
        "interreflection", room(materials=[Material("black", (0, 0, 0)), GRAY]),
        room(sheet("speck", [(0.4, 0.4, 0.001), (0.5, 0.4, 0.001), (0.5, 0.5, 0.001), (0.4, 0.5, 0.001)], material=1), materials=[Material("black", (0, 0, 0)), GRAY]),
    ),
    "a lamp at all": ("lamps", room(lamps=[]), room()),
    "a world that is hardly black": (
        "sky", join_meshes([box(n=4, faces="xXyYz")], [GRAY], [PANEL], World()), join_meshes([box(n=4, faces="xXyYz")], [GRAY], [PANEL], World((0, 0, 1e-9))),
    ),
    "an image at all": ("textures", room(), painted(np.tile(CHECKS[..., None], 3))),
    "a block under an even sky": (
        "occlusion", join_meshes([box(faces="z")], [GRAY], [], World((1, 1, 1))), join_meshes([box(faces="z"), BLOCK], [GRAY], [], World((1, 1, 1))),
    ),
    "a block under an even sky that reflects": (
        "occlusion", join_meshes([box(faces="z"), BLOCK], [Material("black", (0, 0, 0))], [], World((1, 1, 1))), join_meshes([box(faces="z"), BLOCK], [GRAY], [], World((1, 1, 1))),
    ),
    "lamps without shadows": (
        "occlusion", room(BLOCK, materials=[Material("black", (0, 0, 0))], lamps=[replace(PANEL, shadows=False)]),
        room(BLOCK, materials=[Material("black", (0, 0, 0))], lamps=[replace(PANEL, shadows=False), PANEL]),
    ),
    "faces that glow, one more than are looked at": ("occlusion", glowing_ceiling(16), glowing_ceiling(17)),
    "a bright place in the sky": ("occlusion", shaded_floor(World((1, 1, 1))), shaded_floor(World(map=SPOT))),
    "a tinted sky": (
        "color",
        join_meshes([box(n=4, faces="xXyYz")], [GRAY], [PANEL], World((1, 1, 1))),
        join_meshes([box(n=4, faces="xXyYz")], [GRAY], [PANEL], World((1, 1, 0.99))),
    ),
    "a tinted sky that is not seen": ("color", room(world=World((1, 1, 0.9))), join_meshes([box(n=4, faces="xXyYz")], [GRAY], [PANEL], World((1, 1, 0.9)))),
    "a tinted glow": ("color", glowing_ceiling(2), glowing_ceiling(2, (1, 1, 0.99))),
    "a tinted pixel": ("color", painted(np.tile(CHECKS[..., None], 3)), painted(np.tile(CHECKS[..., None], 3) * np.array([1, 1, 0.98]))),
    "nodes that were read": ("textures", room(), room(readings=glow_read(0.0))),
    "an image of what is there": (
        "transparency",
        room(
            materials=[replace(GRAY, alpha_texture=0)],
            textures=(Texture("a", np.ones((2, 2, 3), np.float32)),),
        ),
        room(materials=[replace(GRAY, alpha_texture=0)], textures=(Texture("a", np.tile(np.float32([[1, 1], [1, 0.99]])[..., None], 3)),)),
    ),
    "walls that let light through": ("two-sided", room(), room(materials=[replace(GRAY, translucency=(0.01,) * 3)])),
    "two rooms": (
        "islands",
        join_meshes([box(n=4), box("other", (1, 0, 0), (2, 1, 1), n=4, faces="XyYzZ")], [GRAY], [PANEL]),
        join_meshes([box(n=4), box("other", (1.2, 0, 0), (2.2, 1, 1), n=4)], [GRAY], [PANEL, replace(PANEL, position=(1.7, 0.5, 0.9))]),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TURNS)
def test_decision_turns_at_its_edge(name):
    effect, without, with_it = TURNS[name]
    without, with_it = map(with_places, (without, with_it))
    assert not decided(without)[effect][0], decided(without)[effect][1]
    assert decided(with_it)[effect][0], decided(with_it)[effect][1]


# How reasons to leave an effect out end, without what they count.
LEFT_OUT = {
    "occlusion": (
        "no lamp casts shadows: they are switched off (panel)",
        "that anything could stand before",
        "no face is turned to a lamp",
        "planes), with all lamps in front of them: nothing can cast a shadow",
        "planes of the faces that light reaches: nothing can cast a shadow",
    ),
    "interreflection": ("rays from faces met a face", "met a face that reflects", "is reflected, at the 2 % asked for"),
    "color": ("one channel is solved",),
    "lamps": ("no lamp gives light", "there is no lamp"),
    "emission": ("no face emits light",),
    "sky": ("the world is black", "rays escaped"),
    "textures": ("no material has an image", "images are of one color, to 0 %"),
    "two-sided": ("nor did those of lamps and sky",),
    "transparency": ("every surface is opaque",),
    "instances": ("no two objects share a mesh",),
    "islands": ("can see one another, directly or by way of others",),
}


def test_every_reason_to_leave_something_out_has_an_edge():
    """As scenes of `TURNS` show; all that the survey can give are told here: each is a sentence in its source."""
    found = {effect: set() for effect in EFFECTS}
    for effect, without, _ in TURNS.values():
        needed, reason = decided(with_places(without))[effect]
        found[effect] |= {end for end in LEFT_OUT[effect] if reason.endswith(end)} if not needed else set()
    assert found == {effect: set(ends) for effect, ends in LEFT_OUT.items()}
    calls = [node for node in ast.walk(ast.parse(inspect.getsource(effects))) if isinstance(node, ast.Call)]
    calls = [c for c in calls if getattr(c.func, "id", "") == "Effect" and getattr(c.args[1], "value", True) is False]
    # Two calls give two reasons each, and two the same one.
    assert len(calls) == sum(map(len, LEFT_OUT.values())) - 2 + 1


@pytest.mark.parametrize(
    ("effect", "scene", "turns"),
    [
        ("interreflection", room(materials=[Material("black", (0.003,) * 3)]), 0.015),
        ("color", room(materials=[Material("hue", (0.5, 0.5, 0.505))]), 0.2),
        ("textures", painted(np.tile(0.5 + 0.01 * CHECKS[..., None], 3)), 0.05),
        ("sky", room(world=World((1, 1, 1))), 1e-3),
    ],
    ids=["reflection", "hue", "image", "sky"],
)
def test_decisions_follow_the_error_asked_for(effect, scene, turns):
    """What is left out at an error is called for at a little less of it."""
    scene = with_places(scene)
    left_out = [not decided(scene, error=error)[effect][0] for error in (2 * turns, turns / 2)]
    assert left_out == [True, False], decided(scene, error=turns)[effect][1]


def test_backs_that_are_asked_for_see_the_sky():
    """A closed room is lit by a lamp alone; its outside by the sky, if that is what is written."""
    scene = room(world=World((1, 1, 1)))
    assert {side: decided(scene, side=side)["sky"][0] for side in ("front", "back", "lit")} == {
        "front": False, "back": True, "lit": True,
    }  # fmt: skip


def test_even_sky_leaves_no_light_under_a_box():
    """A box without a bottom on an uncut floor under a sky without lamps: no patch carries light in below its walls."""
    floor = sheet("floor", [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], 16, 16)
    lid = box("lid", (-0.9, -0.9, 0), (1.1, 1.1, 1), 4, False, faces="xXyYZ")
    baked, light = light_of(join_meshes([floor, lid], [Material("white", (0.8,) * 3)], [], World((0.5, 0.5, 0.5))))
    below = (np.abs(baked.points.position[:, :2] - 0.1) < 0.95).all(axis=1) & (baked.points.object == 0)
    assert below.sum() > 30
    assert light[:, below].max() == 0.0 < light.mean()


def test_walls_of_separate_sheets_are_one_convex_room():
    """Geometry is judged by position: six sheets that share no vertex are the same room."""
    sheets = [box(face, n=3, faces=[face]) for face in "xXyYzZ"]
    found = decided(join_meshes(sheets, [GRAY], [PANEL]))
    assert not found["occlusion"][0]
    assert not found["islands"][0]


def test_shared_meshes_are_counted():
    many = [box(str(k), (k + 0.1, 0, 0), (k + 0.3, 0.2, 0.2), inward=False) for k in range(3)]
    scene = join_meshes([box(), *many], [GRAY], [PANEL], shared=np.array([0, 1, 1, 1]))
    assert decided(scene)["instances"] == (True, "3 objects share 1 meshes; each is lit by itself")
    assert not decided(replace(scene, shared=np.arange(4)))["instances"][0]


def light_of(scene, **settings):
    baked = run(bake(scene, Settings(error=0.02, patch_edge=1 / 20, gather_rays=24, **settings), LocalCells()))
    return baked, np.broadcast_to(baked.light.direct + baked.light.indirect, (3, len(baked.points)))


FORCED = {
    "room": room(),
    "black room": room(materials=[Material("black", (0.003,) * 3)]),
    "floor under a sun": join_meshes([sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 6, 6)], [GRAY], [Lamp("sun", (3, 3, 3))]),
    "block under a lamp": join_meshes([box("block", n=3, inward=False)], [GRAY], [replace(PANEL, position=(2.0, 1.0, 3.0))]),
    "closed room under a sky": room(world=World((0.5, 0.5, 0.5))),
    "almost gray": room(materials=[Material("almost", (0.5, 0.5, 0.5005))]),
    "ball": join_meshes([icosphere(splits=2)], [GRAY], [Lamp("point", (1, 1, 1), radius=0.05)]),
}  # fmt: skip


@pytest.mark.parametrize("name", FORCED)
def test_leaving_out_changes_nothing(name):
    """All effects forced on give the same light to a fifth of the error asked for; forced effects are told apart."""
    scene = FORCED[name]
    baked, light = light_of(scene)
    forced, expected = light_of(scene, force=EFFECTS)
    assert all(e.needed for e in forced.survey.effects)
    assert any(e.reason.startswith("forced") for e in forced.survey.effects)
    assert len(baked.light.direct) == 1
    assert len(forced.light.direct) == 3
    area = baked.points.area
    error = np.sqrt((area * (light - expected) ** 2).sum() / (area * expected**2).sum())
    assert error < 0.2 * 0.02 + 1e-9
    if not scene.world.brightest:  # a sky that is left out also shines on the outside of walls
        assert baked.solution.energy["emitted_w"] == pytest.approx(forced.solution.energy["emitted_w"], rel=5e-3)


def test_each_effect_can_be_forced_by_itself():
    for name in EFFECTS:
        found = decided(room(), force=(name,))
        assert found[name][0]
        assert sum(needed for needed, _ in found.values()) <= 3


def test_no_ray_looks_for_shadows_in_a_convex_room():
    """Rays cast: with nothing that can stand in the way, none toward the lamp."""
    black = room(materials=[Material("black", (0, 0, 0))])
    free, _ = light_of(black)
    tested, _ = light_of(black, force=("occlusion",))
    assert tested.rays - free.rays > 4 * len(free.points)
    assert tested.rays > free.rays + len(tested.points)


def test_light_that_nothing_hides_is_found_once_for_all_replicates(monkeypatch):
    """And for the control points among them."""
    found, real = [], kernel.unoccluded
    monkeypatch.setattr(
        kernel,
        "unoccluded",
        lambda sources, s, position, *rest: found.append(len(position)) or real(sources, s, position, *rest),
    )
    lamps = [PANEL, replace(PANEL, position=(0.3, 0.3, 0.9))]
    baked, _ = light_of(room(lamps=lamps))
    assert len(baked.state().gathered.replicates) > 1
    assert baked.state().traced.rounds > 0
    assert sum(found) == len(lamps) * len(baked.points)


@pytest.mark.parametrize("ratio", [1.0, 1e12])
def test_dim_room_beside_a_bright_one(ratio):
    """Two rooms that cannot see one another, one lamp so much brighter than the other: each is solved to its own bound."""
    lamp = replace(PANEL, strength=(1.0, 1.0, 1.0))
    bright = replace(PANEL, strength=(ratio,) * 3, position=(1.7, 0.5, 0.9))
    white = Material("white", (0.9,) * 3)
    scene = join_meshes([box("dim", n=4), box("bright", (1.2, 0, 0), (2.2, 1, 1), n=4)], [white], [lamp, bright])
    baked, light = light_of(scene)
    rooms = [light[0][baked.points.object == k] for k in (0, 1)]
    areas = [baked.points.area[baked.points.object == k] for k in (0, 1)]
    # In a closed room of one reflectance the mean irradiance is that of the direct light over 1 - reflectance.
    for values, area, strength in zip(rooms, areas, (1.0, ratio)):
        direct = baked.light.direct[0][baked.points.object == (strength != 1.0)] if ratio != 1.0 else None
        if direct is not None:
            assert (area * values).sum() == pytest.approx((area * direct).sum() / 0.1, rel=0.02)
    assert (areas[0] * rooms[0]).sum() == pytest.approx((areas[1] * rooms[1]).sum() / ratio, rel=0.02)
    assert baked.solution.converged


@pytest.mark.parametrize("side", ["front", "back"])
@pytest.mark.parametrize("name", [*TURNS])
def test_few_rays_decide_as_all_do_where_nothing_is_left_to_see(name, side, monkeypatch):
    for scene in TURNS[name][1:]:
        early = decided(scene, side=side)
        with monkeypatch.context() as patched:
            patched.setattr("cell_radiosity.core.evidence.EARLY", 1)  # all rays are cast at once
            assert {k: needed for k, (needed, _) in early.items()} == {
                k: needed for k, (needed, _) in decided(scene, side=side).items()
            }


def test_rays_end_early_where_everything_is_called_for(monkeypatch):
    """A floor in the sun below a sheet that is turned to the sky: an eighth of the rays shows all that there is."""
    floor = sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    turned = sheet("turned", [(0, 0, 0.5), (0, 1, 0.5), (1, 1, 0.5), (1, 0, 0.5)])
    rays = []
    for early in (8, 1):
        monkeypatch.setattr("cell_radiosity.core.evidence.EARLY", early)
        cells = LocalCells()
        survey(join_meshes([floor, turned], [GRAY], [Lamp("sun", (1.0,) * 3)]), Settings(error=0.01), cells)
        rays.append(cells.usage.rays)
    assert rays[0] < rays[1] / 3


def test_survey_of_nothing():
    found = survey(join_meshes([]))
    assert not any(e.needed for e in found.effects)
    broken = Mesh.of_polygons("broken", [(np.nan, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [[0, 1, 2], [1, 2, 3]])
    assert survey(join_meshes([broken], lamps=[PANEL])).health[0].object == "broken"


BULB = Material("bulb", (0.1, 0.1, 0.1), exitance=(30.0, 30.0, 30.0))


def bulb(inward=False, faces="xXyYzZ"):
    return box("bulb", (0.4, 0.4, 0.6), (0.6, 0.6, 0.8), inward=inward, faces=faces)


@pytest.mark.parametrize(
    ("parts", "material", "shut"),
    [
        ([bulb()], BULB, True),
        (
            [
                bulb(),
                box("stand", (0.45, 0.45, 0.5), (0.55, 0.55, 0.59), inward=False, materials=dict.fromkeys("xXyYzZ", 1)),
            ],
            BULB,
            True,
        ),
        ([bulb(faces="xXyYZ")], BULB, False),
        ([bulb(inward=True)], BULB, False),
        (
            [
                bulb(),
                box(
                    "filament",
                    (0.49, 0.49, 0.69),
                    (0.51, 0.51, 0.71),
                    inward=False,
                    materials=dict.fromkeys("xXyYzZ", 1),
                ),
            ],
            BULB,
            False,
        ),
        ([bulb()], replace(BULB, alpha=0.9), False),
        ([bulb()], replace(BULB, translucency=(0.1, 0.1, 0.1)), False),
        ([bulb()], replace(BULB, exitance=(0.0, 0.0, 0.0)), False),
    ],
    ids=["closed", "on a stand", "open below", "inside out", "round a thing", "see-through", "translucent", "dark"],
)
def test_inside_of_a_closed_lamp_is_left_out(parts, material, shut):
    """Its faces are sources to one side, if no one else can see the other."""
    scene = join_meshes(
        [sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], material=1), *parts], [material, GRAY]
    )
    found = shut_in(scene, survey(scene).island)
    assert np.array_equal(found, shut & (scene.polygon_object == 1))
    assert make_sources(scene, found)[0].two_sided.all() != shut


def test_light_of_a_closed_lamp_is_the_same_without_its_inside(monkeypatch):
    scene = room(bulb(), lamps=[], materials=[GRAY, BULB])
    scene = replace(scene, polygon_material=np.where(scene.polygon_object == 1, 1, 0).astype(np.int32))
    baked, light = light_of(scene, force=("color",))
    monkeypatch.setattr("cell_radiosity.core.course.shut_in", lambda *a: None)
    both, expected = light_of(scene, force=("color",))
    assert baked.rays < both.rays
    area = baked.points.area * (baked.points.object == 0)
    assert np.sqrt((area * (light - expected) ** 2).sum() / (area * expected**2).sum()) < 0.02
    assert (area * light).sum() == pytest.approx((area * expected).sum(), rel=5e-3)


def test_what_was_read_of_nodes_is_what_decides():
    """A material that Cycles had to read reflects what was read, not what the viewport shows."""
    scene = room(materials=[Material("read", (0.8, 0.8, 0.8))], readings=glow_read(0.0))
    assert decided(scene)["interreflection"][1].startswith("read reflects 50 %")
    tinted = replace(glow_read(0.0), reflectance=np.array([[0.5, 0.5, 0.4]]))
    assert decided(scene.but(readings=tinted))["color"] == (
        True,
        "the material read is tinted: its channels differ by 21.4 %",
    )


def test_a_bright_spot_of_the_sky_is_as_tinted_as_it_is():
    """Not more, because the sky beside it is dark; and hardly any, where it is dark itself."""
    pixels = np.full((64, 64, 3), 0.1, np.float32)
    pixels[32, 32] = (1000.0, 1000.0, 900.0)
    floor = sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    scene = join_meshes([floor], [GRAY], [], World(map=pixels))
    assert decided(scene)["color"] == (True, "the world is tinted: its channels differ by 10.3 %")
    pixels[32, 32] = (1e-4, 1e-4, 0.0)
    assert not decided(scene.but(world=World(map=pixels)))["color"][0]


def test_few_rays_from_a_small_thing_do_not_set_it_apart():
    """A leaf high above a floor, on edge: one in fifteen of its rays meets the floor."""
    floor = sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    leaf = sheet("leaf", [(0.5, 0.5, 1.5), (0.502, 0.5, 1.5), (0.502, 0.5, 1.502), (0.5, 0.5, 1.502)])
    found = decided(join_meshes([floor, leaf], [GRAY], [], World((1.0, 1.0, 1.0))), side="back")
    assert "floor, front" in found["islands"][1] or not found["islands"][0]
    assert "leaf" not in found["islands"][1]


def test_many_lamps_are_judged_by_the_strongest():
    """A thousand faint lamps do not hide that one is close to a wall; and light of as many alike is even."""
    rng = np.random.default_rng(3)
    places = rng.uniform(0.3, 0.7, (1000, 3))
    faint = [Lamp("point", (1e-4,) * 3, tuple(p), radius=0.01) for p in places]
    near = Lamp("point", (1.0,) * 3, (0.5, 0.5, 0.97), radius=0.001)
    assert light_contrast(room(lamps=faint)) < 0.5 * EVEN
    assert light_contrast(room(lamps=[*faint, near])) > EVEN < light_contrast(room(lamps=[near]))
    assert not decided(room(lamps=faint))["occlusion"][0]


@pytest.mark.parametrize("kind", ["in the middle", "all over", "one", "none"])
def test_sides_of_planes_are_those_of_all_places(kind, rng, monkeypatch):
    """Of each place alone; most planes are decided by few of them."""
    count = {"one": 1, "none": 0}.get(kind, 1000)
    places = rng.uniform(-0.5, 0.5, (count, 3)) * (0.1 if kind == "in the middle" else 1.0)
    normal = rng.normal(size=(2000, 3))
    normal /= np.sqrt((normal**2).sum(axis=1))[:, None]
    offset = rng.uniform(-0.6, 0.6, 2000)
    offset[:500] = (normal[:500] * rng.uniform(-0.5, 0.5, (500, 3))).sum(axis=1)
    distant = [(0.01, normal[7]), (0.3, normal[11])] if kind in ("one", "none") else []
    height = [normal @ place - offset for place in places]
    height += [normal @ direction + sign * reach for reach, direction in distant for sign in (1, -1)]
    pairs, real = [], convexity._heights
    monkeypatch.setattr(convexity, "_heights", lambda n, o, p: pairs.append(len(n) * len(p)) or real(n, o, p))
    above, below = convexity.find_sides(normal, offset, places, distant, 1e-6)
    assert np.array_equal(above, (np.array(height) > 1e-6).any(axis=0))
    assert np.array_equal(below, (np.array(height) < -1e-6).any(axis=0))
    assert sum(pairs) < 0.2 * len(normal) * max(count, 10)


@pytest.mark.parametrize("name", ["a lamp above the ceiling", "a lamp wider than the room", "a vertex pushed in"])
def test_heights_above_planes_are_found_in_parts(name, monkeypatch):
    scenes = TURNS[name][1:]
    whole = [decided(scene)["occlusion"] for scene in scenes]
    monkeypatch.setattr("cell_radiosity.core.convexity.MOST_HEIGHTS", 13)
    assert [decided(scene)["occlusion"] for scene in scenes] == whole
