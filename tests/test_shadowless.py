"""Lamps that cast no shadow: their light goes through everything, no ray looks for what stands before them, and the survey
says so. And objects that cast none: light straight from sources goes through them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core.bake import bake, run
from cell_radiosity.core.cells import TASKS, LocalCells
from cell_radiosity.core.effects import survey
from cell_radiosity.core.flats import MOST_SOURCES
from cell_radiosity.core.groups import one_group
from cell_radiosity.core.health import mend
from cell_radiosity.core.lights import make_sources, unoccluded
from cell_radiosity.core.raycast import RayCaster
from cell_radiosity.core.settings import EFFECTS, Settings
from cell_radiosity.core.state import StateError

from scenes import Lamp, Material, Mesh, World, box, join_meshes, sheet

GRAY, BLACK = Material("gray", (0.5,) * 3), Material("black", (0.0,) * 3)
LAMPS = {
    "point": Lamp("point", (1.0, 1.0, 1.0), (0.5, 0.5, 0.9)),
    "ball": Lamp("point", (1.0, 0.9, 0.8), (0.4, 0.6, 0.8), radius=0.05),
    "spot": Lamp("spot", (1.0, 0.9, 0.8), (0.4, 0.6, 0.8), radius=0.02, angle=1.2, blend=0.3),
    "sun": Lamp("sun", (3.0, 3.0, 2.0), angle=0.1),
    "area": Lamp("area", (9.0, 8.0, 7.0), (0.5, 0.5, 0.95), size=(0.3, 0.2)),
    "beam": Lamp("area", (9.0, 8.0, 7.0), (0.5, 0.5, 0.95), size=(0.3, 0.2), spread=1.5),
    "outside": Lamp("area", (90.0, 80.0, 70.0), (0.5, 0.5, 3.0), size=(0.5, 0.5)),
}
LAMPS = {name: replace(lamp, name=name) for name, lamp in LAMPS.items()}
SCREEN = sheet("screen", [(0.2, 0.2, 0.5), (0.8, 0.2, 0.5), (0.8, 0.8, 0.5), (0.2, 0.8, 0.5)], 3, 3)
BLOCK = box("block", (0.3, 0.3, 0.0), (0.6, 0.6, 0.4), 2, False, faces="xXyYZ")


def off(lamp):
    return replace(lamp, shadows=False)


def room(*lamps, more=(SCREEN, BLOCK), materials=(GRAY,), **fields):
    return join_meshes([box("room", n=6), *more], materials, lamps, **fields)


def unhindered(scene, points, lamps=None):
    """(3, P) irradiance that lamps give points with nothing in between."""
    sources, _ = make_sources(scene if lamps is None else replace(scene, lamps=lamps))
    each = [unoccluded(sources, s, points.position, points.normal) for s in range(len(sources))]
    return np.einsum("sp,sc->cp", np.array(each), sources.strength)


def baked(scene, cells=None, groups=None, **settings):
    settings = dict(error=0.05, gather_rays=16, force=("color",)) | settings
    return run(bake(scene, Settings(**settings), cells or LocalCells(), group_of=groups))


@pytest.mark.parametrize(("name", "schedule"), [*((name, "dynamic") for name in LAMPS), ("area", "paper")])
def test_light_goes_through_everything(name, schedule):
    """Direct light is that of a lamp with nothing in between, whatever is forced on; of one that casts shadows it is not."""
    rows = dict(error=0.5, patch_edge=0.5) if schedule == "paper" else {}
    for shadows in (False, True):
        scene = room(replace(LAMPS[name], shadows=shadows))
        found = baked(scene, schedule=schedule, force=EFFECTS, **rows)
        expected = unhindered(scene, found.points)
        gap = np.abs(found.light.direct - expected).max() / expected.max()
        if shadows:
            assert gap > 0.02
        else:
            assert gap < 1e-6
            assert found.light.indirect.mean() > 0.05 * expected.mean()


def test_what_is_reflected_is_that_of_light_that_went_through():
    """A closed room of one reflectance rho, lit from outside: of what a wall gets, rho / (1 - rho) times as much again."""
    scene = room(off(LAMPS["outside"]), more=())
    found = baked(scene, error=0.01, gather_rays=200)
    area = found.points.area
    direct, all_light = (
        (area * light).sum() for light in (found.light.direct, found.light.direct + found.light.indirect)
    )
    assert direct > 0
    assert all_light == pytest.approx(direct / (1 - 0.5), rel=0.02)
    assert survey(scene).islands == 2  # both sides of the walls have light
    assert survey(room(LAMPS["outside"], more=())).islands == 1


def test_bent_normals_see_what_is_above_the_surface():
    """A smooth ball in a box: the same light as of the lamp with shadows and nothing in its way."""
    turn = 2 * np.pi * np.arange(24) / 24
    rings = [[(0.3 * np.sin(t) * np.cos(p) + 0.5, 0.3 * np.sin(t) * np.sin(p) + 0.5, 0.3 * np.cos(t) + 0.5) for p in turn] for t in np.linspace(0.2, 2.9, 12)]  # fmt: skip
    faces = [[24 * r + c, 24 * (r + 1) + c, 24 * (r + 1) + (c + 1) % 24, 24 * r + (c + 1) % 24] for r in range(11) for c in range(24)]  # fmt: skip
    ball = Mesh.of_polygons("ball", np.array(rings).reshape(-1, 3), faces)
    ball = replace(ball, corner_normal=(ball.vertices[ball.corner_vertex] - 0.5) / 0.3)
    lamp = Lamp("area", (9.0,) * 3, (0.5, 0.5, 2.0), size=(0.6, 0.6))
    found = baked(join_meshes([ball], [BLACK], [off(lamp)]), force=("color", "occlusion"))
    alone = baked(join_meshes([ball], [BLACK], [lamp]), force=("color", "occlusion"), light_samples=16)
    expected = unhindered(found.scene, found.points)
    facing = (found.points.position[:, 2] - 0.5) > 0.12  # the whole lamp is above the horizon
    assert (found.points.normal != found.points.geometric).any()
    np.testing.assert_allclose(found.light.direct[:, facing], expected[:, facing], rtol=1e-5)
    gap = found.light.direct - alone.light.direct
    lower = (
        found.points.position[:, 2] < 0.4
    )  # there the ball is in its own shadow, but for the light that goes through
    assert np.abs(gap[:, ~lower]).max() < 0.05 * expected.max()
    assert (found.light.direct[:, lower] <= expected[:, lower] + 1e-9).all()


def test_no_ray_looks_for_what_stands_before_them(monkeypatch):
    """Of lamps in one room, only those that cast shadows have test rays, in the crowd too; none is left with all of them off,
    not even where occlusion is forced on."""
    tested, at_work, real = [], [False], RayCaster._stopped

    def counted(task):
        def work(*arguments, **named):
            at_work[0] = True
            try:
                return task(*arguments, **named)
            finally:
                at_work[0] = False

        return work

    for name in ("direct", "gather", "control"):
        monkeypatch.setitem(TASKS, name, counted(TASKS[name]))
    monkeypatch.setattr("cell_radiosity.core.gather._links", lambda kernel, points: np.ones(len(points.edges[0]), bool))
    monkeypatch.setattr(RayCaster, "_stopped", lambda self, among, o, *rest, **more: tested.append(at_work[0] * len(o)) or real(self, among, o, *rest, **more))  # fmt: skip

    def rays(*lamps):
        tested.clear()
        scene = room(*lamps)
        run(bake(scene, Settings(error=0.5, gather_rays=8, patch_edge=0.4, force=("occlusion",)), LocalCells()))
        return sum(tested)

    few = list(LAMPS.values())[:6]
    crowd = [replace(LAMPS["ball"], position=(0.1 + 0.02 * k, 0.3, 0.8)) for k in range(MOST_SOURCES + 2)]
    for lamps in (few, crowd):
        assert rays(*map(off, lamps)) == 0
        all_of_them = rays(*lamps)
        assert all_of_them > 0
        assert 0 < rays(*map(off, lamps[::2]), *lamps[1::2]) < 0.75 * all_of_them


def test_members_of_a_crowd_are_hidden_each_by_its_own_shadow():
    """Of a crowd in which every other lamp casts no shadow, groups tell both kinds apart."""
    rng = np.random.default_rng(5)
    places = rng.uniform((0.3, 0.3, 0.7), (0.7, 0.7, 0.95), (80, 3))
    lamps = [Lamp("point", (0.1, 0.1, 0.1), tuple(p), name="on" if k % 2 else "off", shadows=bool(k % 2)) for k, p in enumerate(places)]  # fmt: skip
    scene = room(*lamps)
    found = baked(scene, groups=lambda name: name, gather_rays=256)
    under = (np.abs(found.points.position[:, :2] - 0.5) < 0.12).all(axis=1) & (found.points.position[:, 2] < 0.01)
    assert under.any()
    own = {name: one_group(found.by_group, found.groups, k).direct for k, name in enumerate(found.groups.names)}
    free = unhindered(scene, found.points, [lamp for lamp in lamps if not lamp.shadows])
    assert np.sqrt(((own["off"] - free) ** 2).mean() / (free**2).mean()) < 0.05
    assert own["on"][:, under].max() < 0.02 * free.max()
    assert own["off"][:, under].min() > 0.9 * free[:, under].min()


BOX = box("chest", (0.1, 0.1, 0.1), (0.3, 0.3, 0.3), inward=False)
DECIDES = {
    "black, with a block": (room(off(LAMPS["area"]), materials=(BLACK,)), {"lamps", "two-sided"}),
    "black, one of two": (room(off(LAMPS["area"]), LAMPS["point"], materials=(BLACK,)), {"lamps", "two-sided", "occlusion"}),
    "gray, with a block": (room(off(LAMPS["area"])), {"lamps", "two-sided", "occlusion", "interreflection"}),
    "gray, empty": (room(off(LAMPS["area"]), more=()), {"lamps", "interreflection"}),
    "black, under an even sky": (join_meshes([SCREEN, box("floor", n=2, faces="z")], [BLACK], [off(LAMPS["area"])], World((1, 1, 1))), {"lamps", "sky", "two-sided", "occlusion", "islands"}),
    "a closed chest in it": (room(off(LAMPS["point"]), more=(BOX,)), {"lamps", "two-sided", "occlusion", "interreflection", "islands"}),
    "the same with shadows": (room(LAMPS["point"], more=(BOX,)), {"lamps", "occlusion", "interreflection"}),
}  # fmt: skip


@pytest.mark.parametrize("name", DECIDES)
def test_the_survey_counts_what_they_light(name):
    """Whatever is turned to them is lit, also what is closed; shadows alone call for nothing."""
    scene, needed = DECIDES[name]
    lamps = [replace(lamp, strength=(9.0,) * 3) for lamp in scene.lamps]
    assert {e.name for e in survey(replace(scene, lamps=lamps)).effects if e.needed} == needed


def test_the_survey_names_them():
    reasons = {e.name: e.reason for e in survey(room(off(LAMPS["area"]), LAMPS["point"])).effects}
    assert reasons["lamps"] == "1 area, 1 point; without shadows: area"
    assert reasons["occlusion"].endswith("; no shadow rays go to area")
    assert "shadow rays go" not in {e.name: e.reason for e in survey(room(LAMPS["point"])).effects}["occlusion"]
    dark = survey(room(*map(off, LAMPS.values()), materials=(BLACK,)))
    assert dark.effects[0].reason == "no lamp casts shadows: they are switched off (point, ball, spot and 4 more)"


def test_a_state_knows_whether_shadows_were_on():
    scene = room(LAMPS["area"])
    state = baked(scene).state()
    state.check_scene(scene)
    with pytest.raises(StateError, match="the lights have changed: area"):
        state.check_scene(replace(scene, lamps=(off(LAMPS["area"]),)))


def test_the_same_bits_in_other_cells(cells):
    """Also where some points of a task have bent normals and others do not."""
    scene = room(off(LAMPS["area"]), off(LAMPS["ball"]), LAMPS["spot"], off(LAMPS["sun"]))
    here, there = baked(scene), baked(scene, cells)
    assert np.array_equal(here.light.direct, there.light.direct)
    assert np.array_equal(here.light.indirect, there.light.indirect)


def clear(scene, *names):
    """A scene in which objects of some names cast no shadow."""
    return replace(scene, shading=np.array([name not in names for name in scene.objects]))


GLOW = Material("glow", (0.0,) * 3, exitance=(9.0,) * 3)
PANE = sheet("pane", [(0.45, 0.55, 0.9), (0.55, 0.55, 0.9), (0.55, 0.45, 0.9), (0.45, 0.45, 0.9)], material=1)
SKY = np.zeros((32, 32, 3))
SKY[15:17, 15:17] = 1000.0
THROUGH = {
    "point": dict(lamps=[LAMPS["point"]]),
    "sun": dict(lamps=[replace(LAMPS["sun"], angle=0.0)], faces="xXyYz"),
    "area": dict(lamps=[LAMPS["area"]]),
    "crowd": dict(lamps=[replace(LAMPS["ball"], position=(0.3 + 0.01 * k, 0.5, 0.8)) for k in range(MOST_SOURCES + 8)]),
    "glowing face": dict(more=[PANE]),
    "bright sky": dict(world=World(map=SKY), faces="xXyYz"),
}


@pytest.mark.parametrize("alpha", [1.0, 0.5])
@pytest.mark.parametrize("name", THROUGH)
def test_direct_light_goes_through_what_casts_no_shadow(name, alpha):
    """As if it were not there, on all else; and it falls on that too."""
    parts = {"lamps": [], "more": [], "world": World(), "faces": "xXyYzZ"} | THROUGH[name]
    materials = [BLACK, GLOW, replace(BLACK, alpha=alpha)]
    screen = replace(SCREEN, polygon_material=np.full(len(SCREEN.polygon_material), 2, np.int32))
    shapes = [box("room", n=6, faces=parts["faces"]), BLOCK, *parts["more"]]
    found, without, with_shadow = (
        baked(scene, gather_rays=64, light_samples=4, force=("color", "two-sided"))
        for scene in (
            clear(join_meshes([*shapes, screen], materials, parts["lamps"], parts["world"]), "screen"),
            join_meshes(shapes, materials, parts["lamps"], parts["world"]),
            join_meshes([*shapes, screen], materials, parts["lamps"], parts["world"]),
        )
    )
    others = found.points.object < len(shapes)

    def sorted_light(b):
        own = np.flatnonzero(b.points.object < len(shapes))
        place = np.column_stack([b.points.normal, b.points.position])[own].round(5)
        return b.light.direct[:, own[np.lexsort(place.T)]]

    light, expected, shaded = map(sorted_light, (found, without, with_shadow))
    size = np.sqrt((expected**2).mean())
    noise = {"point": 1e-6, "sun": 1e-6}.get(name, 0.04)
    assert np.sqrt(((light - expected) ** 2).mean()) < noise * size
    assert np.sqrt(((shaded - expected) ** 2).mean()) > 2.5 * noise * size
    assert found.light.direct[:, ~others].max() > 0


def test_reflected_light_meets_what_casts_no_shadow():
    """A gray screen in a black room: all that is reflected comes from it."""
    screen = replace(SCREEN, polygon_material=np.full(len(SCREEN.polygon_material), 1, np.int32))
    scene = join_meshes([box("room", n=6), screen], [BLACK, GRAY], [LAMPS["point"]])
    here, there = (baked(s, gather_rays=200) for s in (clear(scene, "screen"), scene))
    np.testing.assert_allclose(here.light.indirect.sum(), there.light.indirect.sum(), rtol=0.03)
    assert here.light.direct.sum() > 1.05 * there.light.direct.sum()


def test_the_survey_sees_through_what_casts_no_shadow():
    """A lamp in a closed shade lights the room around it, and a sun or a sky what lies in a closed tent."""
    shade = box("shade", (0.4, 0.4, 0.6), (0.6, 0.6, 0.9), inward=False)
    lamp = replace(LAMPS["point"], position=(0.5, 0.5, 0.8))
    lit = join_meshes([box("room", n=4), shade], [GRAY], [lamp])
    open_shade = survey(clear(lit, "shade"))
    assert open_shade.islands == 2
    assert survey(lit).islands == 1
    assert open_shade.effects[0].reason.endswith("; no shadow falls from shade")
    found = baked(clear(lit, "shade"), gather_rays=64)
    assert (found.light.direct + found.light.indirect)[:, found.points.object == 0].min() > 0
    for lamps, world in (([LAMPS["sun"]], World()), ([], World(map=SKY))):
        tent = join_meshes([box("tent", n=4)], [GRAY], lamps, world)
        for scene, bright in ((tent, False), (clear(tent, "tent"), True)):
            found = baked(scene, force=())
            assert (found.light.direct.max() > 0) == bright


@pytest.mark.parametrize("shadows", [True, False])
def test_a_white_room_that_only_light_through_walls_enters(shadows):
    """Its light has no steady state, if there is any."""
    scene = room(replace(LAMPS["outside"], shadows=shadows), more=(), materials=(Material("white", (1.0,) * 3),))
    said = [finding.finding for finding in mend(scene).health]
    assert any("no steady state" in text for text in said) != shadows


def test_a_state_knows_what_cast_shadows():
    scene = room(LAMPS["area"])
    state = baked(scene).state()
    state.check_scene(clear(scene))
    with pytest.raises(StateError, match="the geometry has changed: screen"):
        state.check_scene(clear(scene, "screen"))
