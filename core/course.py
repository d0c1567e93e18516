"""The course of a bake: each step from a scene to the light at its points, and what decides on the next.

Owns `Course`. `bake` says in which order its steps are taken.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, partial
from math import inf, log, sqrt
from time import perf_counter

import numpy as np

from .accuracy import (
    CROWDED,
    MOST_RAYS,
    estimate_error,
    noise_wanted,
    rays_by_object,
    rays_tested,
    rays_wanted,
    share_of_light,
    shared_by_replicates,
    stalls,
)
from .averages import Averages, places_wanted
from .baked import Bake, Progress
from .budget import cells_within
from .cells import memory_now
from .choices import (
    SURE_RAYS,
    bounces_deeper,
    control_count,
    control_rays,
    eased,
    finer,
    goes_on,
    more_control,
    obstructed,
    parted,
    shadowless,
    sharpened,
)
from .clock import Clock
from .contacts import cut_contacts
from .control import FEW, Control, Traced, draw_control, tight_places
from .costs import Work, with_costs
from .effects import simplified, survey
from .gather import Gathering, light_arrays, patch_light, sides_of
from .groups import weighted
from .health import Finding
from .host import rays_that_fit, solve
from .kernel import cast_arrays, transport_arrays
from .lights import make_sources
from .occlusion import find_openness
from .paper import solve_paper
from .patches import count_patches, patch_of_hit, patch_size
from .pictures import add_pictures, near_pictures
from .pieces import shut_in
from .placing import refill, thin_findings
from .points import Points, make_points
from .prices import PRICED, Pilot, price_list
from .records import from_arrays, to_arrays
from .scene import World
from .settings import Settings
from .sky import split_sky
from .state import State, scene_prints
from .steep import make_fine_patches
from .surfaces import make_surfaces, reflecting_polygons, reflects

ROUGH_RAYS = 32  # of a point, to tell where a mesh must be finer
# So many times shorter are patches where the usual ones alone keep a bake from its error: the first that makes as many
# times more of them.
FINER = (1.5, 2.25, 3.4)
IN_TIME = 0.9  # of the time that is left is spent on another replicate
PLACED = 100_000  # points that are foreseen where they do not lie on the scene's vertices
PILOT = 2  # replicates of the pilot: how they scatter shows their noise
MOST_REPLICATES = 40  # that are gathered: what so many did not bring, more would not
SOLVED = 0.25  # of the error asked for: a known transport whose bound is below that is good enough


class Course:
    """A bake under way: the records of its path as far as they are made."""

    def __init__(self, scene, settings, cells, place=None, groups=None, state=None):
        self.cells, self._place, self.groups, self._known = cells, place, groups, state
        self.clock = Clock(cells)
        self.scene = self.written = scene
        self.settings = settings
        self._fit(0, self._points_foreseen(), begun=False)
        self.survey = self._surveyed(settings)
        self._asked, self.settings = settings, sharpened(eased(settings, self.survey), scene)
        self._coarse, self._row_rays, self._further = False, self.settings.row_rays, bounces_deeper(settings)
        if state:
            usual, self.settings = self._with_rows_that_fit(self.settings, state.patches), state.knobs(self.settings)
            self._coarse, self._further = finer(usual, self.settings), max(self._further, state.further)
            if self.settings.row_rays < usual.row_rays:  # for which the memory that there is now is not to blame
                self._row_rays = self.settings.row_rays
        self.solution = self.points = self.side = self.gathering = self.control = self.estimate = None
        self.openness = self.averaged = None
        self._places, self._round, self._solved = None, None, settings.error
        self._stalled = 0, False  # by so many replicates
        self._bounds, self._doubt, self.price = [], inf, state.price if state else ()
        self._before = state.seconds if state else {}
        self._gather_seconds, self._gather_rays = 0.0, 0
        self._control_seconds, self._control_rays = 0.0, 0
        self.clock.lap("survey")

    def _fit(self, patches, points, begun=True):
        """Let only so many cells work as fit into the memory that may be used."""
        self.cells.limit(cells_within(self.settings.memory, len(self.scene.triangles), patches, points, begun))

    def _with_rows_that_fit(self, settings, patches):
        """Settings with rows of patches that fit into the memory."""
        sides = len(patches) * (2 if self.survey.needs("two-sided") else 1)
        return replace(settings, row_rays=rays_that_fit(sides, settings))

    def _surveyed(self, settings):
        """The Survey: that of the known state, if it was made for an error as small."""
        known = self._known
        if known and known.settings.error <= settings.error:
            self.cells.start(cast_arrays(self.scene, "transparency" in known.settings.force))
            return known.survey
        if known:  # what is in its light stays there
            settings = replace(settings, force=tuple(e.name for e in known.survey.effects if e.needed) + settings.force)
        found = survey(self.scene, settings, self.cells)
        if known:
            known.agrees(found)
        return found

    def too_coarse(self):
        """Whether patches alone seem to keep the bake from its error, where they have the length that is usual for it: it
        would end above it otherwise."""
        settings, found, error = self.settings, self.estimate, self.settings.error
        usual = eased(Settings.for_error(error, per_object=settings.per_object), self.survey)
        if found is None or self._coarse or self._timed or settings.gather_rays is not None:
            return False
        if (settings.patch_edge, settings.graded, settings.rows) != (usual.patch_edge, usual.graded, usual.rows):
            return False
        # Noise that was left as it is, because what replicates share is more than the error for certain, can still be cured.
        noise = found.noise if found.shared > error else 0.0
        return found.furthest > error and found.furthest**2 - found.averaged**2 - noise**2 <= error * error

    def refine(self):
        """Begin anew, with the same points on finer patches: so much shorter that there are more of them, for polygons about
        as long as patches are not cut by a little."""
        usual = self.settings
        finer = [replace(usual, patch_edge=usual.patch_edge / times) for times in FINER]
        before, *counts = count_patches(self.scene, [patch_size(self.scene, s) for s in (usual, *finer)])
        self.settings = next((s for s, count in zip(finer, counts) if count > FINER[0] * before), finer[0])
        self._known = self.solution = self.gathering = self.control = self.estimate = self._round = None
        self._solved, self._bounds, self._doubt, self._stalled = self.settings.error, [], inf, (0, False)

    def lay(self):
        """Patches, and what they do with light."""
        scene, settings, cells, found, known = self.scene, self.settings, self.cells, self.survey, self._known
        edge, growth = patch_size(scene, settings)
        world = scene.world if found.needs("sky") else World()
        sky, _ = split_sky(world)
        shadows, seen = found.needs("occlusion"), len(sky)
        shut = shut_in(scene, found.island) if settings.side == "front" else None
        sources, sampled = make_sources(scene.but(world=world), shut)
        patches = known.patches if known else self._fine_patches(sources, sampled, edge, growth)
        self._fit(len(patches), self._points_foreseen())
        cells.start(transport_arrays(patches, sources, shadows, seen))
        # Patches that are to be the mesh's own polygons stay what they are.
        if not known and edge is not None and parted(settings, found):
            patches = cut_contacts(scene, patches, cells)
        sources, sampled = add_pictures(scene, patches, sources, sampled)
        if not known:
            self.settings = self._with_rows_that_fit(settings, patches)
        surfaces, sky = _surfaces(scene, patches, sampled, found, np.pi * sky.T)
        if not found.needs("color"):
            sources = sources.one_channel()
        if self.groups:
            sources, surfaces, sky = self.groups.apart(sources, surfaces, sky, scene.polygon_object[patches.polygon])
        cells.start(transport_arrays(patches, sources, shadows, seen))
        if surfaces.coverage is not None:
            cells.start({"alpha.coverage": surfaces.coverage[::2]})
        self.patches, self.surfaces, self.sources, self.sky = patches, surfaces, sources, sky
        if self.points is not None:  # they have been on other patches
            self.side = sides_of(self.points, cells)
        self.clock.lap("patches")

    def _fine_patches(self, sources, sampled, edge, growth):
        """Patches as they are at first, before they are cut where they touch."""
        if edge is None or not self.settings.graded:
            return make_fine_patches(self.scene, None, edge, growth)
        longest = near_pictures(self.scene, sampled, edge, self.cells)
        return make_fine_patches(self.scene, sources, edge, growth, longest)

    def transport(self):
        """Phase 1: patches, and the radiosity of their sides."""
        yield Progress("survey", 1.0, self.clock.total())
        self.lay()
        settings, known = self.settings, self._known
        yield self._progress("patches", 1.0)

        if known and known.solution and min(known.solved, known.solution.bound / SOLVED) <= settings.error:
            self.solution, self._solved = known.solution, min(known.solved, settings.error)
        elif settings.schedule == "paper":
            solving = solve_paper(self.patches, self.surfaces, self.sources, self.sky, self.cells, settings)
            self.solution = yield from each(self.clock.watch(solving), self._of_round)
        else:
            before = known and known.solution
            written = np.repeat(self.scene.written[self.scene.polygon_object[self.patches.polygon]], 2)
            # The inside of a lamp's shade may get most of all light; nobody asks for it, yet rays must find it.
            if settings.side != "lit":
                written[int(settings.side == "front") :: 2] = False
            points = self._points_foreseen()
            owner = np.repeat(self.scene.polygon_object[self.patches.polygon], 2) if settings.per_object else None
            solving = solve(
                self.patches, self.surfaces, self.sky, self.cells, settings, self.survey, before, written, points, owner
            )
            self.solution = yield from each(self.clock.watch(solving), self._of_round)
            if before:  # its control points read another light
                self.solution = known.with_rows(self.solution)
                self._known = replace(known, traced=known.traced and Traced(rounds=known.traced.rounds), doubt=inf)
        self.clock.lap("transport")

    def _points_foreseen(self):
        """About how many points there will be."""
        if self._place:
            return PLACED
        scene = self.scene
        corner = np.repeat(scene.written[scene.polygon_object], np.diff(scene.polygon_start))
        return int(np.count_nonzero(np.bincount(scene.corner_vertex[corner])))

    def pilot(self):
        """The first replicates at all points, and a first look at their error."""
        yield from self.take_up()
        yield from self.gather()
        while len(self.gathering.gathered.replicates) < PILOT:
            self.ask([(self.settings.pilot_rays, None)])
            yield from self.gather()
        if len(self.points) and self.control is None:
            each = self.settings.per_object
            count = control_count(len(np.unique(self.points.object)) if each else 0)
            yield from self._smooth()
            drawn = draw_control(self._counted(), self._light(), self._tight(), count, each)
            traced = Traced(rounds=self._known.traced.rounds) if self._known and self._known.traced else None
            self.control = self._control(drawn, traced)
        yield from self.look()
        self.clock.lap("survey")

    def _tight(self):
        """(P,) whether points lie where there is little room before them, as the pilot's rays tell, but not in corners."""
        found = self.gathering.gathered
        nearness = found.replicates[0].nearness / self.scene.diagonal
        return tight_places(nearness, np.sqrt(self.patches.area[self.side >> 1])) & self._free

    def take_up(self):
        """Find the points, and what is known of their light."""
        known = self._known
        self.solution = self.solution or known.solution
        yield from self._find_points()
        self._fit(len(self.patches), len(self.points))
        self.gathering = self._gathering(self.points, self.side, known and known.gathered)
        if known:
            self._bounds, self._doubt = list(known.bounds), known.doubt
        if known and known.openness and known.openness[0] == self.settings.occlusion:
            self.openness = known.openness[1]
        if known:
            self.averaged = known.averaged
        if known and known.control is not None and known.each_object >= self.settings.per_object:
            self.control = self._control(known.control, known.traced)

    def _control(self, drawn, traced):
        """The Control at points that were drawn, which goes on from what was traced."""
        more = self._group_count, traced, self._further
        return Control(self.points, *drawn, self.cells, self.settings, *more)

    def _gathering(self, points, side, gathered=None):
        """A Gathering at points, (P,) on patch sides."""
        near = goes_on(self.settings), self.settings.per_object
        self.cells.start(light_arrays(points, self.solution, self.surfaces, self.sky, side, *near))
        start = partial(patch_light, side, self.solution)
        return Gathering(
            points, len(self.solution.direct), start, self.cells, self.settings, self._group_count, gathered
        )

    def ask(self, wanted):
        """Ask for replicates of the light at the points: (rays, ids of points or None) of each."""
        for rays, ids in wanted:
            self.gathering.ask(rays, ids, self._test_rays(rays, ids))
        self._bounds += [self.solution.bound] * len(wanted)
        self._doubt = inf

    def _test_rays(self, rays, ids):
        """With how many of the rays of another replicate test rays go: all, where it is not known what noise is allowed."""
        if self.estimate is None or ids is not None or self._timed or self.settings.gather_rays is not None:
            return rays
        goal = noise_wanted(self.estimate, self.settings.error)
        so_far = sum(r.test_rays for r in self.gathering.gathered.replicates)
        return rays_tested(self._direct_noise(), so_far, goal, rays)

    def _direct_noise(self):
        """Square of the noise of direct light, as a share of all light."""
        return share_of_light(self.gathering.direct_noise(), self._counted(), self._light(), self._free)

    @cached_property
    def _reflecting(self):
        return reflecting_polygons(self.scene)

    def _seen(self):
        """(P,) bool, points on what reflects light, or lets it through; all, if none is."""
        seen = self._reflecting[self.patches.polygon[self.side >> 1]] | (self.side < 0)
        return seen if seen.any() else ~seen

    def _counted(self):
        """The Points, without area where they do not count in the error, as on lamps that only glow: nobody sees what arrives
        there. Between a tube and its tray a few centimeters above it that may be half of all, on a 250th of the area."""
        return replace(self.points, area=np.where(self._seen(), self.points.area, 0.0))

    @property
    def _free(self):
        """(P,) bool, points that do not lie in a corner."""
        return self.gathering.gathered.closest > CROWDED

    def gather(self):
        """Gather the replicates that were asked for."""
        while self.gathering.next is not None:
            begun, before = perf_counter(), self.gathering.mean_rays
            count = int(self.gathering.gathered.replicates[self.gathering.next].asked.sum())
            timed = begun if self.price else None  # while the pilot runs nobody knows how much there is to do
            yield from each(self.gathering.gather(), partial(self._of_points, count=count, begun=timed))
            self._gather_seconds += perf_counter() - begun
            self._gather_rays += self.gathering.mean_rays - before

    def prices(self, errors=PRICED):
        """A tuple of Price for each of the errors, after the pilot."""
        if self.estimate is None:
            return ()
        used, control = self.clock.cells(), self.control
        return price_list(
            Pilot(
                scene=self.scene,
                settings=self.settings,
                survey=self.survey,
                estimate=self.estimate,
                points=len(self.points),
                patches=len(self.patches),
                rays=int(self.gathering.rays.max(initial=0)),
                replicates=len(self.gathering.gathered.replicates),
                control_rays=control.rays,
                control_points=len(control.ids),
                control_rate=self._control_seconds / max(self._control_rays, 1),
                seconds=self._seconds(),
                parts=self.clock.parts(),
                solve=self.clock.watched,
                pace=self.clock.pace(),
                memory_mb=used["host_mb"] + sum(used["cells_mb"]),
                direct=self._direct_noise(),
            ),
            errors,
        )

    def _seconds(self):
        """{phase: seconds} spent so far, also by the bake that is carried on; "replicates": on `rays` gather rays."""
        now = {**self.clock.seconds(), "replicates": self._gather_seconds, "rays": self._gather_rays}
        return {name: value + self._before.get(name, 0.0) for name, value in now.items()}

    def look(self):
        """Find the error as it stands; as much is spent on it as the error asked for needs."""
        if self.control is None:
            return
        if self.control.under_way:
            yield from self._trace(self.control.complete())
        short = control_rays(self.settings, self.survey) - self.control.rays
        if short > 0:
            yield from self._trace(self.control.trace(short))
        yield from self._smooth()
        self._estimate()
        # More rays where the control itself is in doubt, as long as they help; above all before rays are spent at all
        # points against what may be chance.
        while more := self._more_control():
            if self._narrow():  # by what the rays so far have seen: as many others must have a look too
                more = self.control.rays
            self._doubt = self.estimate.doubt * sqrt(sqrt(self.control.rays))
            yield from self._trace(self.control.trace(more))
            self._estimate()

    def _narrow(self):
        """Let the control go on with fewer points, if it has many that had their first rays, and they are not there for single
        objects; returns whether it has had. What is off for certain differs from point to point: it takes all of them."""
        control, many = self.control, self.control.rays >= SURE_RAYS and len(self.control.ids) > FEW
        if self.settings.per_object or not many or self.estimate.shared > 0:
            return False
        control.narrow(shared_by_replicates(self._light(), control))
        self._estimate()
        return True

    def _trace(self, tracing):
        """Trace rays of the control, and count what they take."""
        begun, before, count = perf_counter(), self.control.rays, len(self.control.ids)
        yield self._of_control(next(tracing))
        yield from self._smooth()
        yield from each(tracing, self._of_control)
        self._control_seconds += perf_counter() - begun
        self._control_rays += (self.control.rays - before) * count

    def _more_control(self):
        """How many more control rays are to be traced, 0 for none."""
        wanted = self._rays_wanted() * len(self.points)
        spent = self.control.rays * len(self.control.ids)
        return more_control(self.estimate, self.settings, self.control.rays, self._doubt, wanted / max(spent, 1))

    def _smooth(self):
        """Find the light as it stands, which is then known."""
        yield from each(self.gathering.smoothing(self.scene.diagonal), lambda _: self._of_control(0.0))

    def _estimate(self, more=0.0):
        self.estimate = estimate_error(self._counted(), self._light(), self.control, self._free, self._bound(), more)

    def _bound(self):
        """The certified bound of the transport that the replicates have read, of all together."""
        if len(set(self._bounds)) == 1:
            return self._bounds[0]
        weights = [r.weight.sum() for r in self.gathering.gathered.replicates]
        return sum(w * b for w, b in zip(weights, self._bounds)) / sum(weights)

    @property
    def _group_count(self):
        return len(self.groups.names) if self.groups else 1

    def _light(self):
        """The Light of all groups together, as it stands."""
        light = self.gathering.light(self.scene.diagonal)
        return weighted(light, self.groups) if self.groups else light

    @property
    def _error(self):
        """The error that was asked for: of the whole, or of the object that is furthest off."""
        worst = self.estimate.worst() if self.settings.per_object else None
        return max(self.estimate.furthest, worst[1] if worst else 0.0)

    @property
    def _timed(self):
        return self.settings.seconds is not None

    def wanted(self):
        """The replicates that are needed next: (rays, ids of points) of each; ids None for all points."""
        if not len(self.points):
            return []
        if rays := self._rays_wanted():
            return [(rays, None)]
        settings = self.settings
        if not settings.per_object or self.estimate is None or self._timed or settings.gather_rays is not None:
            return []
        if len(self.gathering.gathered.replicates) >= MOST_REPLICATES or self._stalls():
            return []
        owner, so_far = self.points.object, np.zeros(len(self.estimate.objects))
        np.maximum.at(so_far, owner, self.gathering.rays)
        more = rays_by_object(self.estimate, so_far, settings.error)[owner]
        return [(int(rays), np.flatnonzero(more == rays)) for rays in np.unique(more[more > 0])]

    def _rays_wanted(self):
        """How many more rays every point needs, 0 if it has enough."""
        so_far = int(self.gathering.rays.max(initial=0))
        if self.settings.gather_rays is not None:
            return max(self.settings.gather_rays - so_far, 0)
        if self.estimate is None:
            return 0
        if self._timed:
            left = self.settings.seconds - self.clock.total()
            seconds = self._seconds()
            rays = int(IN_TIME * left * seconds["rays"] / max(seconds["replicates"], 1e-9))
            return min(rays, MOST_RAYS) if rays >= PILOT * self.settings.pilot_rays else 0
        if self._coarse and self.estimate.averaged >= self.settings.error:
            return 0
        if len(self.gathering.gathered.replicates) >= MOST_REPLICATES or self._stalls():
            return 0
        return rays_wanted(self.estimate, so_far, self.settings.error)

    def _stalls(self):
        """Whether noise does not fall, however many rays there are, in replicates of all points."""
        whole = [r for r in self.gathering.gathered.replicates if r.asked.all()]
        if self._stalled[0] != len(whole):
            rays = np.cumsum([r.rays for r in whole])
            self._stalled = len(whole), stalls(rays, lambda count: self._noise_of(whole[:count]))
        return self._stalled[1]

    def _noise_of(self, replicates):
        """The noise of some replicates, with the filter's blur."""
        light = self.gathering.of(replicates).light(self.scene.diagonal)
        light = weighted(light, self.groups) if self.groups else light
        return sqrt(
            max(share_of_light(light.variance.sum(axis=0) + light.blurred, self._counted(), light, self._free), 0.0)
        )

    def result(self, solution=None):
        """The Bake as it stands; solution: of a transport that is not at its end."""
        phase = "transport" if solution is not None else "gather" if self.price else "survey"
        if solution is None:
            light = self.gathering.light(self.scene.diagonal)
            if self.averaged:
                light = self.averaged.in_light(light, self.gathering.sampled(self.averaged.ids))
        else:
            light = patch_light(self.side, solution)
        points, solution, error = self.points, solution or self.solution, self.settings.error
        reached = self.estimate is not None and self._error <= error
        more = (*thin_findings(self.scene, points), *self._coarse_findings(), *self._memory_findings(solution))
        light = by_group = refill(points, light)
        return Bake(
            self.written,
            self.settings,
            with_costs(
                self.survey.after(self.scene, self.patches, solution, error, self.cells.note, more), self._work()
            ),
            self.patches,
            points,
            solution,
            weighted(light, self.groups) if self.groups else light,
            estimate=self.estimate,
            converged=solution.converged and (reached or self.settings.gather_rays is not None or self._timed),
            floor=reached and len(self.gathering.gathered.replicates) <= PILOT,
            price=self.price,
            seconds=self.clock.seconds(phase),
            rays=self.clock.rays(),
            cells=self.clock.cells(),
            groups=self.groups,
            by_group=by_group if self.groups else None,
            openness=self.openness,
            seen=self._seen(),
            state=self.state,
        )

    @cached_property
    def _usual(self):
        """Patches, and rays of a row, as they would be without the ease of a room where nothing casts a shadow."""
        if not shadowless(self.survey) or eased(self._asked, self.survey) == self._asked:
            return len(self.patches), self.settings.row_rays
        (count,) = count_patches(self.scene, [patch_size(self.scene, self._asked)])
        return count, self._asked.row_rays

    def _work(self):
        """The Work that has been done."""
        settings = self.settings
        return Work(
            cpu=self.clock.seconds()["cpu"],
            solve=self.clock.watched,
            parts=self.clock.parts(),
            rays=self.clock.rays(),
            points=len(self.points),
            patches=len(self.patches),
            row_rays=settings.row_rays,
            usual=self._usual,
            pilot_rays=PILOT * settings.pilot_rays,
            sources=len(self.sources),
            shadowed=int(self.sources.shadows.sum()),
            reflects=reflects(self.scene),
        )

    def _coarse_findings(self):
        """A Finding if the patches of the known state are longer than those that would have been made."""
        if self._coarse and self.estimate:
            yield Finding(
                "patches",
                f"those of the state are longer, or their rows shorter, than {100 * self.settings.error:.3g} % asks for",
                f"they were kept: {100 * self.estimate.patches:.2g} % of the error is theirs; without the state they are finer",
            )

    def _memory_findings(self, solution):
        """Findings if memory did not hold the rows that the error asks for, or not even the host."""
        settings, rows = self.settings, solution.rows
        if settings.row_rays < self._row_rays:
            yield Finding(
                "memory",
                f"rows of {self._row_rays} rays for {len(self.patches)} patches do not fit",
                f"they have {settings.row_rays}: the light of patches has more noise, which more --memory would take away",
            )
        elif settings.schedule == "dynamic" and solution.rounds and solution.rounds[-1].shots > len(rows.sides):
            yield Finding(
                "memory",
                f"{len(rows.sides)} form-factor rows fit, there is light for more",
                "the others were found anew whenever light came back to them; more --memory would keep them",
            )
        if (now := memory_now()) > 1e-6 * settings.memory:
            yield Finding(
                "memory",
                f"this process takes {now:.0f} MB, {1e-6 * settings.memory:.0f} MB may be used",
                "no cells worked beside it; what holds the scene, and Blender, takes what it takes",
            )

    def state(self):
        """The State as it stands: of what is known what has not come about again, and all that has."""
        known = self._known or State(scene_prints(self.scene), self.settings, self.survey, self.patches, self.groups)
        error = min(self.settings.error, known.settings.error)
        found = dict(
            settings=replace(self.settings, error=error),
            survey=self.survey,
            further=self._further,
            seconds=self._seconds(),
            price=self.price,
        )
        if self.solution is not None:
            found.update(solution=self.solution, solved=self._solved)
        elif self._round is not None:
            rows = known.with_rows(self._round.solution())
            found.update(solution=replace(known.solution, rows=rows.rows) if known.solved < inf else rows)
        if self._places is not None:
            found.update(places=self._places, side=self.side)
        if self.gathering is not None:
            found.update(gathered=self.gathering.gathered, bounds=tuple(self._bounds), doubt=self._doubt)
        if self.control is not None:
            found.update(control=(self.control.ids, self.control.weight), traced=self.control.traced)
            found.update(each_object=self.settings.per_object or known.each_object)
        if self.openness is not None:
            found.update(openness=(self.settings.occlusion, self.openness))
        if self.averaged is not None:
            found.update(averaged=self.averaged)
        return replace(known, **found)

    def finish(self, average=None):
        """What is asked for beside the light; average: see `bake`."""
        if self.settings.occlusion is not None and self.openness is None:
            finding = find_openness(self.points, self.settings.occlusion, self.cells, self.settings.seed)
            self.openness = yield from each(finding, lambda done: self._of_points(done[0]))
        if average:
            yield from self._average(average)

    def _average(self, average):
        """Find the light of whole surfaces around points, at so many places that it is not what keeps the bake from its
        error; see `bake`. What was decided on the way knows nothing of it."""
        while places := places_wanted(self.averaged, self._counted(), self._light(), self.settings.error):
            light = self.gathering.light(self.scene.diagonal)
            averaging = average(self.points, light, self.cells, self.settings.seed, places)
            found = yield from each(averaging, lambda done: self._of_points(*done))
            self.averaged = Averages(*found, places)
        if self.control is not None:
            self._estimate(self.averaged.variances(len(self.points)))

    def _show_early(self):
        """Make points to show the light of an unfinished transport at, if they can be known before its end."""
        if self.points is None and not self._place and self.settings.side != "lit":
            self.points, self.side = self._make_points(self.settings.side)

    def _make_points(self, side):
        known = self._known
        if known and known.places is not None:
            self._places = known.places
            return from_arrays(Points, "points", known.places), known.side
        cells = self.cells if obstructed(self.survey) else None
        points = make_points(self.scene, self._flipped(side), cells)
        self._places = to_arrays("points", points)
        return points, sides_of(points, self.cells)

    def _find_points(self):
        """Make the points, if they are not there."""
        if self._place:
            known, flipped = self._known, self._flipped(self.settings.side)
            kept = known.places if known else self._places
            placing = self._place(self.scene, flipped, self.cells, self._rough_light, kept)
            self.written, self.points, places = yield from placing
            placed = known and known.places is not None
            self.side = known.side if placed else sides_of(self.points, self.cells)
            self._places = places
        elif self.points is None:
            self.points, self.side = self._make_points(self.settings.side)

    def _rough_light(self, points):
        """(P,) what points get, roughly: a generator."""
        gathering = self._gathering(points, sides_of(points, self.cells))
        gathering.ask(ROUGH_RAYS)
        yield from each(gathering.gather(), lambda done: self._of_points(done, len(points)))
        return gathering.light(self.scene.diagonal).total.mean(axis=0)

    def _flipped(self, side):
        """(P,) bool: polygons whose back side's light is asked for."""
        scene = self.scene
        if side != "lit":
            return np.full(len(scene.polygon_material), side == "back")
        # The patch at the middle of every triangle tells which side of its polygon gets more.
        triangle = np.flatnonzero(scene.usable)
        third = np.full(len(triangle), 1 / 3, np.float32)
        patch = patch_of_hit(self.patches, scene.vertices, scene.triangles, triangle, third, third)
        light = (
            self.solution.irradiance.sum(axis=0).reshape(-1, 2)[patch] * scene.triangle_normal_area[1][triangle, None]
        )
        polygon, count = scene.triangle_polygon[triangle], len(scene.polygon_material)
        front, back = (np.bincount(polygon, light[:, k], count) for k in range(2))
        return back > front

    def _of_round(self, done):
        """Progress of the transport: the bound falls about evenly in its logarithm."""
        share = min(log(max(done.bound, 1e-12)) / log(self.settings.error / 10), 1.0) if done.bound < 1 else 0.0
        take, self._round = None, done
        self._show_early()
        if self.points is not None and not (self._known and self._known.gathered):
            take = lambda: self.result(done.solution())
        return self._progress("transport", float(share), round=done.number, bound=done.bound, take=take)

    def _of_points(self, done, count=None, begun=None):
        """Progress of the gather; begun: when it did, for a guess at the seconds left."""
        share = done / max(count or len(self.points), 1)
        left = None if begun is None else (perf_counter() - begun) * (1 - share) / max(share, 1e-9)
        error = self.estimate and self.estimate.furthest
        return self._progress("gather", share, points=done, left=left, error=error, take=self.gathering and self.result)

    def _of_control(self, share):
        return self._progress("error", share, take=self.result)

    def _progress(self, phase, done, **more):
        return Progress(phase, done, self.clock.total(), self.clock.rays(), state=self.state, **more)


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


def each(generator, progress):
    """Yield `progress` of all that a generator yields; returns what it returns."""
    try:
        while True:
            yield progress(next(generator))
    except StopIteration as end:
        return end.value
    finally:
        generator.close()
