"""A bake, from a scene to the light at its points: the whole path of the data on one page."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .cells import LocalCells
from .course import Course, each
from .flats import emitting_polygons
from .groups import make_groups, scaled, weighted
from .health import mend
from .prices import PRICED
from .state import StateError


def bake(scene, settings, cells, place=None, group_of=None, state=None, average=None):
    """Bake a scene: a generator that yields Progress and returns the Bake.

    scene, settings: what to bake, and what it may cost.
    cells: any `Cells`, that do the work; they are left running.
    place: generator function (scene, flipped, cells, light, kept) that returns the Scene to write, its Points, and
        {name: array} to keep; given these as `kept`, else None, it returns the same again without a ray. Its `light` is a
        generator function of Points that returns (P,) what they get, roughly. None: the points are the scene's corners.
    group_of: the light group of a lamp's or object's name, see `groups.make_groups`; None keeps no groups.
    state: the State of a bake of the same scene, to go on from: no ray of it is cast again.
    average: generator function (points, light, cells, seed, places) that returns the first three fields of `Averages`: of
        the points whose light of sampled sources is to be that of a whole surface around them. None: of no points.

    Raises StateError if the state is of another scene.
    """
    scene = mend(scene)
    groups = make_groups(scene, group_of, emitting_polygons(scene)) if group_of else None
    if state is not None:
        state.check(scene, settings, groups)
    try:
        course = Course(scene, settings, cells, place, groups, state)
        yield from through(course)
        if course.too_coarse():
            best = course.result()
            course.refine()
            yield from each(through(course), lambda progress: replace(progress, take=lambda: best))
        yield from course.finish(average)
        course.clock.lap("gather")
        return course.result()
    finally:
        cells.clear()


def through(course):
    """All steps of a Course to light with the error asked for, or as near to it as rays at points come."""
    yield from course.transport()  # patches, and the radiosity of their sides
    yield from course.pilot()  # first light at the points, and how far it is off
    course.price = course.price or course.prices()
    while wanted := course.wanted():
        course.ask(wanted)
        yield from course.gather()
        yield from course.look()
    course.clock.lap("gather")


def price(scene, settings, cells, errors=PRICED, place=None, group_of=None):
    """The price list of a scene, a tuple of Price for each of the errors: what a bake finds out with its pilot. A generator
    that yields Progress, which has no light to take; see `bake`."""
    try:
        scene = mend(scene)
        groups = make_groups(scene, group_of, emitting_polygons(scene)) if group_of else None
        course = Course(scene, settings, cells, place, groups)
        for part in (course.transport(), course.pilot()):
            yield from each(part, lambda progress: replace(progress, take=None))
        return course.prices(errors)
    finally:
        cells.clear()


def restored(scene, state, place=None):
    """The Bake that a State has come to, without casting a ray: a generator, as `place` is one; see `bake`. Raises
    StateError if the scene is another, or there is no light at points yet."""
    scene = mend(scene)
    state.check_scene(scene)
    if state.gathered is None:
        raise StateError("its bake has not come to the light at points yet: carry it on first")
    course = Course(scene, state.settings, LocalCells(), place, state.groups, state)
    course.lay()
    yield from course.take_up()
    return course.result()


def relit(baked, factors):
    """A Bake with light groups as it would be with their strengths times factors (G, 3), as nearly as it is now: a weighted
    sum, without a ray. How far it is off is not known."""
    by_group = scaled(baked.by_group, baked.groups, factors)
    unknown = dict(variance=np.zeros_like(by_group.variance), blurred=np.zeros_like(by_group.blurred))
    light = replace(weighted(by_group, baked.groups), **unknown)
    return replace(baked, light=light, by_group=by_group, factors=np.asarray(factors, float), estimate=None, price=())


def run(generator, show=None):
    """Drive a generator to its end, showing what it yields; returns what it returns."""
    while True:
        try:
            progress = next(generator)
        except StopIteration as end:
            return end.value
        if show:
            show(progress)
