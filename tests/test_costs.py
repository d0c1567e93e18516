"""What effects are said to have cost, by a clock that counts rays: then it is known to the last one."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core import cells as cells_module
from cell_radiosity.core import gather
from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.raycast import RayCaster
from cell_radiosity.core.report import make_report

from scenes import Lamp, Material, Settings, World, bake, box, join_meshes, run, sheet

GRAY, GLOW = Material("gray", (0.5, 0.5, 0.5)), Material("glow", (0, 0, 0), (20.0, 20.0, 20.0))
LAMP = Lamp("point", (1.0, 1.0, 1.0), (0.2, 0.2, 0.8), radius=0.05)
PANEL = sheet("panel", [(0.4, 0.6, 0.95), (0.6, 0.6, 0.95), (0.6, 0.4, 0.95), (0.4, 0.4, 0.95)], 1, 1, 1)
BLOCK = box("block", (0.3, 0.3, 0.0), (0.6, 0.6, 0.4), 2, False, faces="xXyYZ")


@pytest.fixture
def rays(monkeypatch):
    """Rays cast so far by (task, whether one asks only if it is stopped); under "first", those that set out."""
    count, task = Counter(), [""]

    def counted(name, function):
        def work(*arguments, **named):
            before, task[0] = task[0], name
            try:
                return function(*arguments, **named)
            finally:
                task[0] = before

        return work

    for name, function in cells_module.TASKS.items():
        monkeypatch.setitem(cells_module.TASKS, name, counted(name, function))
    monkeypatch.setattr(gather, "_links", counted("links", gather._links))  # from point to point

    def cast(self, among, origins, directions, real=RayCaster._run, **options):
        count[task[0], self.asking] += len(origins)
        return real(self, among, origins, directions, **options)

    def setting_out(self, *rest, real, asking, **options):
        count["first"] += len(rest[-1 - asking])
        self.asking = asking
        return real(self, *rest, **options)

    monkeypatch.setattr(RayCaster, "asking", False, raising=False)
    monkeypatch.setattr(RayCaster, "_run", cast)
    for name, asking in (("hits", False), ("_stopped", True)):
        real = getattr(RayCaster, name)
        monkeypatch.setattr(
            RayCaster, name, lambda *a, real=real, asking=asking, **o: setting_out(*a, real=real, asking=asking, **o)
        )

    def clock():
        return float(sum(n for key, n in count.items() if key != "first"))

    monkeypatch.setattr("time.thread_time", clock)
    for module in ("raycast", "lights", "crowd", "direct", "gather", "clock"):
        monkeypatch.setattr(f"cell_radiosity.core.{module}.thread_time", clock)
    return count


def costs(meshes, materials=(GRAY, GLOW), lamps=(), **settings):
    """The Bake of a scene, and what each of the effects that it needs has cost."""
    scene = join_meshes(meshes, materials, lamps, settings.pop("world", World()))
    baked = run(bake(scene, Settings(error=0.05, **settings), LocalCells()))
    return baked, {effect.name: effect.seconds if effect.needed else None for effect in baked.survey.effects}


def of(rays, *tasks, asking=None):
    return sum(n for key, n in rays.items() if key != "first" and key[0] in tasks and asking in (None, key[1]))


def test_rays_are_told_apart_by_what_they_are_for(rays):
    baked, cost = costs([box("room", n=4), BLOCK], lamps=[LAMP])
    assert cost["occlusion"] == of(rays, "direct", "gather", asking=True) + of(rays, "links", "contacts") > 0
    assert cost["lamps"] == of(rays, "direct", "gather", asking=True) > 0
    assert cost["interreflection"] == of(rays, "rows") + of(rays, "gather", asking=False) > 0
    assert all(cost[name] is None for name in set(cost) - {"occlusion", "lamps", "interreflection"})
    assert baked.rays == sum(n for key, n in rays.items() if key != "first")


def test_lamps_and_glowing_faces_share_by_their_tests(rays):
    """Three lamps alike and one panel: each takes its part, and no more than there is."""
    lamps = [LAMP, Lamp("point", (1.0, 1.0, 1.0), (0.8, 0.2, 0.8), radius=0.05)]
    _, cost = costs([box("room", n=4), BLOCK, PANEL], lamps=lamps)
    assert cost["lamps"] + cost["emission"] == pytest.approx(of(rays, "direct", "gather", asking=True))
    assert 0.2 < cost["emission"] / cost["lamps"] < 1.0
    assert cost["sky"] is None


def test_without_reflection_rays_are_the_skys(rays):
    """Sampled bright directions and all the rays that look for the rest, where nothing else needs them."""
    pixels = np.full((32, 32, 3), 0.1)
    pixels[16, 18] = 3000.0
    black = [Material("black", (0.0, 0.0, 0.0))]
    _, cost = costs(
        [sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 4, 4), BLOCK], black, world=World(map=pixels)
    )
    rest = of(rays, "rows") + of(rays, "gather", asking=False)
    assert cost["sky"] == of(rays, "direct", "gather", asking=True) + rest
    assert cost["interreflection"] is None


def test_transparency_costs_what_goes_on(rays):
    """All rays but those that set out."""
    veil = sheet("veil", [(0.1, 0.1, 0.6), (0.9, 0.1, 0.6), (0.9, 0.9, 0.6), (0.1, 0.9, 0.6)], 2, 2, 1)
    baked, cost = costs([box("room", n=4), veil], [GRAY, Material("veil", (0.5, 0.5, 0.5), alpha=0.5)], [LAMP])
    assert cost["transparency"] == baked.rays - rays["first"] > 0


def test_nothing_is_said_of_what_nothing_is_known_of():
    """With a true clock: figures of work that was done, less than all of it; the report has them, null for the rest of what
    was needed, and for what was not an estimate, marked as one."""
    baked, cost = costs([box("room", n=6), BLOCK], lamps=[LAMP])
    assert all(0 < cost[name] < baked.seconds["cpu"] for name in ("occlusion", "lamps", "interreflection"))
    report = make_report(baked, scene="", version="", layers=(), domain="corner", start=0.0, read=0.0, write=0.0)
    assert {e["name"]: e["seconds"] if e["needed"] else None for e in report["effects"]} == cost
    assert report["error"]["requested"] == baked.settings.error
    assert report["error"]["floor"] == baked.floor
    narrow = replace(baked, estimate=replace(baked.estimate, total=0.003, interior=0.01))
    error = make_report(narrow, scene="", version="", layers=(), domain="corner", start=0.0, read=0.0, write=0.0)[
        "error"
    ]
    assert error["estimated"] == error["interior"] == 0.01  # what the bake has gone by, not the smaller of both
    in_time = replace(baked, settings=replace(baked.settings, seconds=9.0))  # for which nobody asked for an error
    error = make_report(in_time, scene="", version="", layers=(), domain="corner", start=0.0, read=0.0, write=0.0)[
        "error"
    ]
    assert error == report["error"] | {"requested": None, "floor": None}
    assert all(e["estimated"] != e["needed"] for e in report["effects"] if e["seconds"] is not None)
    assert all(e["seconds"] is not None for e in report["effects"] if not e["needed"])


@pytest.mark.parametrize(
    ("name", "scene"),
    {
        "occlusion": dict(meshes=[box("room", n=16)], lamps=[LAMP]),
        "interreflection": dict(meshes=[sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 40, 40)], lamps=[LAMP]),
    }.items(),
)  # fmt: skip
def test_what_was_left_out_would_have_cost_about_what_it_then_does(rays, name, scene):
    """By the clock that counts rays, which knows what they are for; those of a leave-out and of the bake with it forced."""
    baked, _ = costs(**scene)
    foretold = next(e.seconds for e in baked.survey.effects if e.name == name)
    before = baked.rays
    forced, _ = costs(**scene, force=(name,))
    assert 0.5 < foretold / (forced.rays - before) < 2.0
    assert not next(e.needed for e in baked.survey.effects if e.name == name)


def test_an_effect_that_had_nothing_to_do_would_have_cost_nothing(rays):
    baked, _ = costs([box("room", n=8), BLOCK], lamps=[LAMP])
    left = {e.name: e.seconds for e in baked.survey.effects if not e.needed}
    assert left["emission"] == left["sky"] == left["textures"] == left["instances"] == 0 < left["transparency"]


def test_an_empty_convex_room_tests_nothing(rays):
    """Lamps are all that is there, and nothing is tested; what a sky or glowing faces have taken nobody can tell."""
    _, cost = costs([box("room", n=4)], lamps=[LAMP])
    assert cost["occlusion"] is None
    assert cost["lamps"] == of(rays, "direct", "gather", asking=True) == 0
    rays.clear()
    _, cost = costs([box("room", n=4, faces="xXyYz")], world=World((1.0, 1.0, 1.0)))
    assert cost["sky"] is None
    assert cost["interreflection"] == of(rays, "rows") + of(rays, "gather", asking=False) > 0


def test_a_bake_that_ends_early_has_taken_all_of_its_time():
    """Also the time of the phase that goes on: a bake that Esc ended after 24 s was said to have taken 13."""
    scene = join_meshes([box("room", n=4), BLOCK], [GRAY], [LAMP])
    taken = []
    for progress in bake(scene, Settings(error=0.02), LocalCells()):
        early = progress.take and progress.take()
        if early:
            phases = [early.seconds[name] for name in ("survey", "patches", "transport", "gather")]
            assert sum(phases) >= progress.seconds - 1e-9
            taken.append(phases)
    assert len(taken) > 2
    assert np.all(np.diff(taken, axis=0) > -1e-9)  # no phase gives its time back
