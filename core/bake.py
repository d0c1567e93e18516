"""A bake, from a scene to the light at its points: the whole path of the data on one page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import log
from time import perf_counter, process_time

import numpy as np

from .cells import peak_memory
from .contacts import cut_contacts
from .effects import Survey, simplified, survey
from .gather import Light, gather
from .groups import Groups, make_groups, weighted
from .health import mend
from .host import Solution, solve
from .kernel import transport_arrays
from .lights import emitting_polygons, make_sources
from .occlusion import find_openness
from .paper import solve_paper
from .patches import Patches, make_patches, patch_of_hit
from .placing import refill, thin_findings
from .points import Points, make_points
from .scene import Scene, World
from .settings import Settings
from .sky import split_sky
from .surfaces import make_surfaces

ROUGH_RAYS = 32  # of a point, to tell where a mesh must be finer
EASED, EASED_FINE = 4.0, 2.0  # times the length of patches where nothing casts a shadow; the latter below 1 % error


@dataclass(frozen=True)
class Progress:
    """Where a bake stands. phase: "survey", "patches", "transport" or "gather". done: share of the phase, 0..1. round, bound: of
    the transport. points: gathered so far. rays: cast so far. seconds: since the bake began. left: seconds, a guess.
    error: estimated so far. take(): the Bake as it stands, as long as it has not gone on; None before there is light."""

    phase: str
    done: float
    seconds: float
    rays: int = 0
    round: int = 0
    bound: float | None = None
    points: int = 0
    left: float | None = None
    error: float | None = None
    take: Callable | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True)
class Bake:
    """A finished bake: every record of its path, seconds by phase, CPU seconds, and what the cells used. groups: light
    groups, if they were asked for, and by_group: a Light with a channel for each group's.
    openness: (P,) 1 less ambient occlusion, if it was asked for."""

    scene: Scene
    settings: Settings
    survey: Survey
    patches: Patches
    points: Points
    solution: Solution
    light: Light
    seconds: dict = field(default_factory=dict)
    rays: int = 0
    cells: dict = field(default_factory=dict)
    groups: Groups | None = None
    by_group: Light | None = None
    openness: np.ndarray | None = None


def bake(scene, settings, cells, place=None, group_of=None):
    """Bake a scene: a generator that yields Progress and returns the Bake. cells: any `Cells`; they are left running.
    place: generator function of (scene, flipped, cells, light) that returns the Scene to write and its Points, None for
    the scene's corners; light: generator function of Points, that returns (P,) what they get, roughly. group_of: the light
    group of a lamp's or object's name, see groups.make_groups; None keeps no groups."""
    try:
        return (yield from _bake(scene, settings, cells, place, group_of))
    finally:
        cells.clear()


def _bake(scene, settings, cells, place, group_of):
    clock = _Clock(cells)
    scene = mend(scene)
    found = survey(scene, settings, cells)
    clock.lap("survey")
    yield Progress("survey", 1.0, clock.total())

    settings = _eased(settings, found)
    edge = None if settings.patch_edge is None else settings.patch_edge * scene.diagonal
    patches = make_patches(scene, edge)
    world = scene.world if found.needs("sky") else World()
    sky, _ = split_sky(world)
    sources, sampled = make_sources(replace(scene, world=world))
    if not found.needs("color"):
        sources = sources.one_channel()
    groups = make_groups(scene, group_of, emitting_polygons(scene)) if group_of else None
    ungrouped, sources = sources, groups.of_sources(sources) if groups else sources
    cells.start(transport_arrays(patches, sources, found.needs("occlusion"), len(sky)))
    # Patches that are to be the mesh's own polygons stay what they are.
    if edge is not None and found.needs("occlusion"):
        patches = cut_contacts(scene, patches, cells)
    surfaces, sky = _surfaces(scene, patches, sampled, found, np.pi * sky.T)
    if groups:
        owner = scene.polygon_object[patches.polygon]
        _, surfaces, sky = groups.apart(ungrouped, surfaces, sky, owner)
    if surfaces.coverage is not None:
        cells.start({"alpha.coverage": surfaces.coverage[::2]})
    clock.lap("patches")
    yield Progress("patches", 1.0, clock.total())

    if settings.schedule == "paper":
        solving = solve_paper(patches, surfaces, sources, sky, cells, settings)
    else:
        solving = solve(patches, surfaces, sky, cells, settings, found)
    solution = yield from _each(solving, lambda r: _of_round(r, settings, clock))
    clock.lap("transport")

    flipped = _flipped(scene, patches, solution, settings.side)
    written = scene
    if place:

        def rough_light(points):
            rough = replace(settings, gather_rays=min(ROUGH_RAYS, settings.gather_rays))
            light = gather(points, solution, surfaces, sky, scene.diagonal, cells, rough)
            light = yield from _each(light, lambda done: _of_points(*done, clock))
            return (light.direct + light.indirect).mean(axis=0)

        written, points = yield from place(scene, flipped, cells, rough_light)
    else:
        points = make_points(scene, flipped, cells if found.needs("occlusion") else None)
    gathering = gather(points, solution, surfaces, sky, scene.diagonal, cells, settings)
    light = yield from _each(gathering, lambda done: _of_points(*done, clock))
    light = refill(points, light)
    openness = None
    if settings.occlusion is not None:
        finding = find_openness(points, settings.occlusion, cells, settings.seed)
        openness = yield from _each(finding, lambda done: _of_points(*done, clock))
    by_group = light
    if groups:
        light = weighted(light, groups)
    clock.lap("gather")
    thin = tuple(thin_findings(scene, points))
    after = found.after(scene, patches, solution, settings.error, cells.note, thin)
    return Bake(
        written, settings, after, patches, points, solution, light,
        seconds=clock.seconds(), rays=clock.rays(), cells=clock.cells(), groups=groups,
        by_group=by_group if groups else None, openness=openness,
    )  # fmt: skip


def _eased(settings, found):
    """Settings for a room in which nothing casts a shadow, unless patches were asked for: light then varies as slowly as
    the room is wide, so patches several times as long, with rows of twice the rays, do as well, and fewer gather rays,
    whose noise the filter spreads over more points."""
    usual = Settings.for_error(settings.error)
    if any(found.needs(name) for name in ("occlusion", "sky", "textures", "transparency")):
        return settings
    if settings.patch_edge != usual.patch_edge or settings.rows != "rays":
        return settings
    longer = EASED if settings.error >= 0.01 else EASED_FINE
    return replace(
        settings,
        patch_edge=longer * settings.patch_edge,
        row_rays=2 * settings.row_rays,
        gather_rays=max(int(settings.gather_rays / longer), 8),
    )


def _surfaces(scene, patches, sampled, found, sky):
    """The Surfaces of patches, and exitance (C, M) of the sky, without what the survey found to be left out."""
    surfaces = make_surfaces(simplified(scene, found), patches, sampled)
    if not found.needs("color"):
        surfaces, sky = surfaces.one_channel(), sky.mean(axis=0, keepdims=True)
    if not found.needs("two-sided"):
        surfaces = surfaces.reflecting(np.arange(2 * len(patches)) % 2 == 0)
    if not (found.needs("interreflection") or surfaces.found.any() or sky.any()):
        surfaces = surfaces.reflecting(np.zeros(2 * len(patches), bool))
    return surfaces, sky


def run(generator, show=None):
    """Drive a generator to its end, showing what it yields; returns what it returns."""
    while True:
        try:
            progress = next(generator)
        except StopIteration as end:
            return end.value
        if show:
            show(progress)


def _each(generator, progress):
    """Yield `progress` of all that a generator yields; returns what it returns."""
    while True:
        try:
            item = next(generator)
        except StopIteration as end:
            return end.value
        yield progress(item)


def _of_round(done, settings, clock):
    """Progress of the transport: the bound falls about evenly in its logarithm."""
    share = min(log(max(done.bound, 1e-12)) / log(settings.error / 10), 1.0) if done.bound < 1 else 0.0
    return Progress("transport", float(share), clock.total(), clock.rays(), done.number, done.bound)


def _of_points(points, count, clock):
    """Progress of the gather, with a guess at the seconds left."""
    share = points / max(count, 1)
    spent = clock.since_lap()
    return Progress(
        "gather", share, clock.total(), clock.rays(), points=points, left=spent * (1 - share) / max(share, 1e-9)
    )


def _flipped(scene, patches, solution, side):
    """(P,) bool: polygons whose back side's light is asked for."""
    if side == "front":
        return np.zeros(len(scene.polygon_material), bool)
    if side == "back":
        return np.ones(len(scene.polygon_material), bool)
    # The patch at the middle of every triangle tells which side of its polygon gets more.
    triangle = np.flatnonzero(scene.usable)
    third = np.full(len(triangle), 1 / 3, np.float32)
    patch = patch_of_hit(patches, scene.vertices, scene.triangles, triangle, third, third)
    light = solution.irradiance.sum(axis=0).reshape(-1, 2)[patch] * scene.triangle_normal_area[1][triangle, None]
    front, back = (
        np.bincount(scene.triangle_polygon[triangle], light[:, k], len(scene.polygon_material)) for k in range(2)
    )
    return back > front


class _Clock:
    """Wall and CPU seconds of the phases of one bake, and what its cells used, which may have worked before."""

    def __init__(self, cells):
        self._cells, self._usage = cells, cells.usage.snapshot()
        self._restarted = cells.restarted
        self._begun = self._lap = perf_counter()
        self._cpu = process_time()
        self._phases = {}

    def lap(self, phase):
        now = perf_counter()
        self._phases[phase], self._lap = now - self._lap, now

    def total(self):
        return perf_counter() - self._begun

    def since_lap(self):
        return perf_counter() - self._lap

    def rays(self):
        return self._cells.usage.rays - self._usage.rays

    def seconds(self):
        used, before = self._cells.usage, self._usage
        here = process_time() - self._cpu
        cpu = here + used.cpu - before.cpu - (used.here - before.here)
        return {**self._phases, "cpu": cpu, "embree_cpu": used.embree - before.embree}

    def cells(self):
        """Number of cells, restarts, and peak memory [MB] of the host and of each cell."""
        memory = {k: v for k, v in self._cells.usage.memory.items() if k != "host"}
        return dict(
            count=self._cells.count,
            restarted=self._cells.restarted - self._restarted,
            host_mb=peak_memory(),
            cells_mb=list(memory.values()),
        )
