"""Patches that alone keep a bake from its error are made finer, once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_accuracy import furnished

from cell_radiosity.core import course as core_course
from cell_radiosity.core.accuracy import Estimate
from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.patches import make_patches
from cell_radiosity.core.points import make_points
from cell_radiosity.core.records import to_arrays
from cell_radiosity.core.state import load_state, save_state

from scenes import Settings, bake, run

ERROR = 0.0125
own_knobs = Settings.for_error.__func__


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """Patches of a quarter of the scene are the usual ones, for any error, beside sources too: two thirds as long reach 1.25 % here."""
    monkeypatch.setattr(core_course, "make_fine_patches", lambda scene, sources, *size: make_patches(scene, *size))
    monkeypatch.setattr(
        Settings,
        "for_error",
        classmethod(lambda cls, error, **others: own_knobs(cls, error, **({"patch_edge": 1 / 4} | others))),
    )


def stages(**more):
    """Progress of a bake, as (patches so far, Progress), and what the bake returns at last."""
    baking, found, patches = bake(furnished(), Settings.for_error(ERROR), LocalCells(), **more), [], 0
    while True:
        try:
            progress = next(baking)
        except StopIteration as end:
            return found, end.value
        patches += progress.phase == "patches"
        found.append((patches, progress))


def same(a, b):
    return all(np.array_equal(getattr(a.light, n), getattr(b.light, n)) for n in ("direct", "indirect", "variance"))


def test_patches_are_made_finer_once_if_they_alone_keep_the_error_from_being_reached():
    """The result is that of a bake that began with the finer patches, at the same points, and better than the first."""
    found, refined = stages()
    assert [number for number, progress in found if progress.phase == "patches"] == [1, 2]
    settings = replace(Settings.for_error(ERROR), patch_edge=1 / 6)
    straight = run(bake(furnished(), settings, LocalCells()))
    assert refined.settings == settings
    assert same(refined, straight)
    assert refined.converged
    assert refined.estimate.total <= ERROR


def test_what_there_is_can_be_taken_meanwhile():
    """While finer patches are under way it is the light that the others have brought, not the patches' own."""
    baking, seen = bake(furnished(), Settings.for_error(ERROR), LocalCells()), 0
    for progress in baking:
        seen += progress.phase == "patches"
        if seen == 2:
            taken = progress.take()
            break
    baking.close()
    assert taken.light.done.all()
    assert taken.estimate.total > ERROR
    assert not taken.converged


def test_points_that_were_placed_by_the_light_stay(monkeypatch):
    """What places them is asked once more, with what it has kept: it need not look at the light again."""
    monkeypatch.setattr(core_course, "PLACED", 1)  # no more points are foreseen than on vertices
    given = []

    def place(scene, flipped, cells, light, kept):
        given.append(kept)
        points = make_points(scene, flipped, cells)
        yield from ()
        return scene, points, to_arrays("points", points)

    refined = run(bake(furnished(), Settings.for_error(ERROR), LocalCells(), place))
    assert given[0] is None
    assert len(given) == 2
    assert np.array_equal(given[1]["points.position"], refined.points.position)
    assert same(refined, stages()[1])


@pytest.mark.parametrize("attempt", [1, 2])
@pytest.mark.parametrize("phase", ["patches", "transport", "gather", "error"])
def test_a_bake_broken_off_before_or_after_goes_on_to_the_same_bits(tmp_path, attempt, phase):
    expected = stages()[1]
    baking, seen = bake(furnished(), Settings.for_error(ERROR), LocalCells()), 0
    for progress in baking:
        seen += progress.phase == "patches"
        if seen == attempt and progress.phase == phase:
            save_state(progress.state(), tmp_path / "s")
            break
    baking.close()
    found, again = stages(state=load_state(tmp_path / "s"))
    assert same(again, expected)
    assert again.settings.patch_edge == expected.settings.patch_edge
    assert again.converged
    assert max(number for number, _ in found) == 3 - attempt


def test_finer_patches_are_the_last_resort():
    """A bake that ends above its error begins anew with finer patches if what they average away accounts for that, however
    little is certain of the rest; not if more would be missing, and not where the error is reached."""
    course = core_course.Course(furnished(), Settings.for_error(0.02), LocalCells())
    found = Estimate(total=0.03, interior=0.03, noise=0.013, averaged=0.024)
    for estimate, coarse in (
        (found, True),
        (replace(found, total=0.01), True),  # narrow things in bright light hide the rest
        (replace(found, averaged=0.021), False),
        (replace(found, averaged=0.0, shared=0.025), False),
        (replace(found, total=0.019, interior=0.019, averaged=0.014), False),
    ):
        course.estimate = estimate
        assert course.too_coarse() == coarse


@pytest.mark.parametrize(
    "asked", [dict(gather_rays=200), dict(patch_edge=1 / 3), dict(graded=False), dict(seconds=0.5), dict(error=0.02)]
)
def test_patches_stay_where_they_were_asked_for_or_would_not_help(asked):
    """Rays or patches set by hand, a time, and an error that is reached."""
    settings = replace(Settings.for_error(ERROR), **asked)
    assert run(bake(furnished(), settings, LocalCells())).settings.patch_edge == settings.patch_edge


@pytest.mark.parametrize(("polygons", "times"), [(6, 2.25), (5, 1.5)])
def test_finer_patches_are_more_patches(polygons, times):
    """A room of 216 quads, about as long as patches: a third shorter, they would be the same 216. Of 150 quads they are
    four times as many."""
    course = core_course.Course(furnished(polygons), Settings.for_error(0.02), LocalCells())
    course.settings = replace(course.settings, patch_edge=1 / 8)
    course.refine()
    assert course.settings.patch_edge == pytest.approx(1 / 8 / times)
