"""One bake of a Blender scene, from options to written layers: what the panel and the command line share."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from math import inf
from time import perf_counter

from ..core.bake import bake, price, relit, restored, run
from ..core.baked import Progress
from ..core.cells import make_cells
from ..core.effects import survey
from ..core.flats import emitting_polygons
from ..core.health import NO_LIGHT, mend
from ..core.patches import count_patches, patch_size
from ..core.report import make_report
from ..core.settings import Settings
from ..core.state import StateError
from ..core.subdivide import Fitting
from .errors import Refused, check_memory
from .lookup import Lookup
from .outputs import found_layers, grouping, make_output
from .read_scene import NOT_WRITTEN, reading_scene
from .steps import aside
from .version import version

NOTHING = ("",)  # objects that no name fits: a bake of them is refused
LEAST_EDGE, MOST_EDGE = 1e-7, 1e3  # of a patch, as a share of the scene's focus: what is beyond cuts no other way
PATCH_BYTES = 2000  # that a patch takes in host and cells
VERTEX_BYTES = 1200  # that a vertex of a finer mesh takes in the host, with its triangles


@dataclass(frozen=True)
class Options:
    """What the user asked for. objects: names or globs of the objects to write, () for all. error: relative, and
    per_object: of every object; time: seconds to take in its place, or None. cells, memory [bytes]: 0 leaves them to
    the machine. rows: None takes what the schedule goes with. force: effects that are simulated although the scene does
    not call for them. output: the file that the scene will be saved as, beside which images go.

    bytes: 8-bit copies of the layers too, sRGB of the light times 2^exposure, "auto" for one that fits. channel:
    (attribute, "R", "G", "B" or "A") that takes the first layer's brightness.

    occlusion_distance: of the layer Occlusion [m]. groups: "lamp" or "collection": layers of each light group too.

    mesh: "keep" or "subdivide"; then max_edge, min_edge [m], contrast and vertices as for the core's Fitting, None for what
    suits the scene; in_place: the objects themselves instead of copies.

    Of lightmaps: texels_per_meter, or size of the images; uv: the map to use, None to unwrap; atlas: one for each
    "object" or for the "scene"; padding: texels between charts; image: "exr" or "png".
    """

    error: float = 0.02
    time: float | None = None
    per_object: bool = False
    layers: tuple = ("Radiosity", "Lighting")
    domain: str = "CORNER"
    objects: tuple = ()
    side: str = "front"
    cells: int = 0
    seed: int = 0
    max_patch: float | str | None = None
    shared: str = "copy"
    strict: bool = False
    schedule: str = "dynamic"
    rows: str | None = None
    memory: float = 0.0
    force: tuple = ()
    output: str = ""
    target: str = "vertex"
    occlusion_distance: float = 1.0
    groups: str | None = None
    mesh: str = "keep"
    max_edge: float | None = None
    min_edge: float | None = None
    contrast: float | None = None
    vertices: int | None = None
    in_place: bool = False
    bytes: bool = False
    exposure: float | str = 0.0
    channel: tuple | None = None
    texels_per_meter: float = 16.0
    size: int | None = None
    uv: str | None = None
    atlas: str = "object"
    padding: int = 2
    image: str = "exr"

    def settings(self, scene):
        """The core's Settings for a Scene."""
        settings = Settings.for_error(
            self.error,
            per_object=self.per_object,
            seed=self.seed,
            seconds=self.time,
            side=self.side,
            force=self.force,
            schedule=self.schedule,
            rows=self.rows or ("analytic" if self.schedule == "paper" else "rays"),
            memory=self.budget,
            occlusion=self.occlusion_distance if "Occlusion" in self.layers else None,
        )
        if self.max_patch == "mesh":
            return replace(settings, patch_edge=None)
        if self.max_patch is not None:
            share = self.max_patch / max(scene.focus, 1e-300)
            return replace(settings, patch_edge=min(max(share, LEAST_EDGE), MOST_EDGE), graded=False)
        return settings

    @property
    def budget(self):
        """Memory that may be used [bytes]."""
        return self.memory or default_memory()


def default_cells():
    """One cell per physical core, as far as the system tells."""
    try:
        cores = len(os.sched_getaffinity(0))
    except AttributeError:
        cores = os.cpu_count() or 1
    siblings = set()
    for cpu in range(os.cpu_count() or 1):
        try:
            with open(f"/sys/devices/system/cpu/cpu{cpu}/topology/thread_siblings_list") as file:
                siblings.add(file.read())
        except OSError:
            break
    return max(min(cores, len(siblings) or cores), 1)


def default_memory():
    """Half of the machine's memory [bytes]; 4 GB where the system does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2
    except (AttributeError, ValueError, OSError):
        return 4e9


def wanted_by(patterns):
    """A function of a name, whether one of the patterns (names or globs) fits it; None if there are none."""
    return (lambda name: any(fnmatchcase(name, p) for p in patterns)) if patterns else None


def check_scene(scene, targets, options):
    """Raise Refused if a bake of a Scene (mended) with Options is of no use or cannot be. targets: that can be written."""
    if not len(scene.triangles):
        raise Refused("there is no mesh to bake: no visible object with faces")
    if not scene.usable.any():
        raise Refused("there is no mesh to bake: no face has an area")
    if not targets:
        left = next((f for f in scene.health if f.action.startswith(NOT_WRITTEN)), None)
        if left:
            raise Refused(f"there is nothing to write to: {left.object}: {left.finding}; {left.action}")
        names = f"no mesh matches {', '.join(options.objects)}"
        if options.objects == NOTHING:
            names = "no object is selected"
        raise Refused(f"there is nothing to write to: {names if options.objects else 'no mesh object of its own'}")
    if not (scene.lamps or len(emitting_polygons(scene)) or scene.world.brightest > 0):
        broken = next((f for f in scene.health if f.action == NO_LIGHT), None)
        if broken:
            raise Refused(f"nothing gives light: {broken.object}: {broken.finding}; {broken.action}")
        raise Refused("nothing gives light: add a lamp, an emitting material or a world color")
    if options.max_patch not in (None, "mesh"):
        (count,) = count_patches(scene, [patch_size(scene, options.settings(scene))])
        what = f"cut to {options.max_patch:g} m, the scene is {count:.3g} patches; longer ones"
        check_memory(PATCH_BYTES * count, options.budget, what)
    if options.mesh == "subdivide" and options.target == "vertex":
        fitting = Fitting.for_scene(scene, options.max_edge, options.min_edge, options.contrast, options.vertices)
        written = scene.written[scene.polygon_object[scene.triangle_polygon]] & scene.solid
        area = float(scene.triangle_normal_area[1][written].sum())
        # Triangles are halves of squares at most; the last step makes four of each, or is not taken.
        count = min(area / max(fitting.max_edge**2, 1e-300), fitting.vertices / 4)
        what = f"with edges of up to {fitting.max_edge:g} m there are at least {count:.3g} vertices; longer ones, fewer --vertices"
        check_memory(VERTEX_BYTES * count, options.budget, what)


class Job:
    """A bake of a context's scene. Make it, drive `bake()` to its end, then call `write()`; `report()` tells all.

    Raises Refused, before any work, if there is nothing to bake or no place for the result. The window makes one with
    `read=False` and takes the same way in steps: `reading()`, `bake()` in a thread, `writing()`. state: the core's State
    of a bake to go on from.
    """

    def __init__(self, context, options, cells=None, start_seconds=0.0, read=True, state=None):
        self.options, self._state = options, state
        self._owned = cells is None
        begun = perf_counter()
        self.cells = cells or make_cells(options.cells or default_cells())
        self._start = start_seconds + perf_counter() - begun
        self._read_seconds = self._write_seconds = 0.0
        self.scene = self.result = self.survey = self.prices = None
        self.output = make_output(options)
        self.targets, self.changed, self.copies = (), (), None
        if read:
            try:
                run(self.reading(context))
            except BaseException:
                self.close()
                raise

    def reading(self, context, step=inf):
        """Read the scene: a generator that yields every `step` seconds or so, between objects."""
        begun = perf_counter()
        patterns = self.options.objects
        self.scene, self.targets = yield from reading_scene(
            context, wanted_by(patterns), self.options.shared, step=step
        )
        self.scene = yield from aside(step, mend, self.scene)
        self._refuse(self.scene.health)
        check_scene(self.scene, self.targets, self.options)
        self._check_copies(context.scene)
        self.output.read(context, self.scene, self.targets)
        self._group_of = grouping(context, self.options)
        self._read_seconds = perf_counter() - begun

    def _check_copies(self, scene):
        """Find what meshes of their own take in place of shared ones. Raises Refused if that is more than there is."""
        lookup = Lookup(scene)
        self.copies = self.output.copies([lookup.target(t) for t in self.targets if t.same])
        took = (
            f"{self.copies.largest}: {self.copies.count} copies of shared meshes take {self.copies.bytes / 1e9:.3g} GB"
        )
        check_memory(self.copies.bytes, self.options.budget, f"{took}; fewer objects, or --shared skip")

    def bake(self):
        """The core's bake: yields Progress."""
        settings = self.options.settings(self.scene)
        try:
            self.result = yield from bake(
                self.scene, settings, self.cells, self.output.place, self._group_of, self._state, self.output.average
            )
        except StateError as problem:
            raise Refused(f"the state file: {problem}") from None
        self.output.compute(self.result)
        found = self.result.survey
        findings = (*found.health, *self.output.findings)
        self.result = replace(self.result, survey=replace(found, health=findings))
        self._refuse(findings)

    def _refuse(self, findings):
        """Raise Refused for what is wrong with the data, if --strict asks for that."""
        if self.options.strict and findings:
            first = findings[0]
            raise Refused(f"{first.object}: {first.finding} ({len(findings)} findings; --strict)")

    def find_effects(self):
        """The core's survey alone, as `survey`: yields Progress."""
        yield Progress("survey", 0.0, 0.0)
        try:
            self.survey = survey(self.scene, self.options.settings(self.scene), self.cells)
        finally:
            self.cells.clear()

    def find_prices(self):
        """The core's price list alone, as `prices`: yields Progress."""
        settings = self.options.settings(self.scene)
        self.prices = yield from price(
            self.scene, settings, self.cells, place=self.output.place, group_of=self._group_of
        )

    def write(self, context):
        """Write the result into the file's meshes."""
        run(self.writing(context))

    def writing(self, context, step=inf):
        """`write` in steps of some `step` seconds: a generator that yields before each object. `changed` then holds
        Findings about objects that are no longer what was read."""
        begun = perf_counter()
        self.changed = yield from self.output.writing(context, self.targets, step)
        self._write_seconds = perf_counter() - begun

    def so_far(self, progress):
        """The core's Bake as a Progress has it, whose light is still coming; None before there is any to write."""
        bake = progress.take() if progress and progress.take else None
        return bake if bake and found_layers(self.options, bake) else None

    def relight(self, factors):
        """Take what the State that the job was made with has found for the result, with the strengths of its light groups
        times factors (G, 3)."""
        try:
            baked = run(restored(self.scene, self._state, self.output.place))
        except StateError as problem:
            raise Refused(f"the state file: {problem}") from None
        baked = relit(baked, factors)
        if not found_layers(self.options, baked):
            raise Refused(f"none of its layers ({', '.join(self.options.layers)}) can be made anew")
        self.keep(baked)

    def keep(self, bake):
        """Take a Bake that ended early for the result."""
        self.output.compute(bake)
        self.result = bake

    def seconds(self):
        """Seconds of the finished bake, without reading and writing."""
        return sum(self.result.seconds.get(k, 0.0) for k in ("survey", "patches", "transport", "gather"))

    def report(self, scene):
        """The report of the bake. scene: the file it came from."""
        return make_report(
            self.result, scene=scene, version=version(), layers=[name for name, _, _ in found_layers(self.options, self.result)],
            domain=self.output.domain,
            start=self._start, read=self._read_seconds, write=self._write_seconds,
            lightmaps=self.output.lightmaps, copies=self.copies,
        )  # fmt: skip

    def close(self):
        """End the cells, unless they were lent."""
        if self._owned:
            self.cells.stop()
