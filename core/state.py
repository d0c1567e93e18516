"""State files: all that a bake has found, to carry it on from, and to light its scene anew.

Owns the record `State`, its file, and the judgment whether a state is of a scene. A state holds what rays have found:
survey, patches, rows and light of the transport, points, the replicates of their light, control points. What needs no ray
is made again from the scene, of which a state keeps only prints, one for each object and lamp: they tell what changed.
"""

from __future__ import annotations

import json
import zipfile
from dataclasses import asdict, dataclass, field, fields, replace
from hashlib import blake2b
from io import BytesIO
from math import inf

import numpy as np

from .anew import Edges
from .averages import Averages
from .control import Traced
from .effects import Effect, Survey
from .gather import Gathered
from .groups import Groups
from .guide import Guide
from .health import Finding
from .kept import ENDLESS, AnalyticRows, RayRows, joined_rows
from .patches import Patches
from .prices import Price
from .records import from_arrays, to_arrays
from .replicates import Replicate
from .saving import written_whole
from .settings import Settings
from .transport import Round, Solution

FORMAT = 11  # of the file; higher when samples of the same seed become others
ANEW = "name another state file to bake it anew"
DAMAGED = f"it is not a state file, or is damaged: {ANEW}"


class StateError(ValueError):
    """A state cannot be used; the message says why, and what to do."""


@dataclass(frozen=True)
class State:
    """What a bake has found so far, of what there is at all.

    prints: of the scene, see `scene_prints`.
    settings: its knobs; their error is the least that the survey and the solution were made for.
    solution: perhaps unfinished. solved: the error that it was finished for, infinite before.
    places: arrays from which points are made again without a ray, {name: array}. side: (P,) the patch side of each.
    gathered: replicates. bounds: of the transport that each of them has read.
    further: how many times more than once rays of the control go on.
    control: ids and weights of control points. each_object: they are drawn from each object. traced: their truths.
    doubt: of the estimate before they were last traced, since the last replicate, times the fourth root of their rays.
    openness: (distance, (P,)). averaged: Averages of light over surfaces around points.
    price: the list that the pilot foretold.
    seconds: {phase: spent so far}, and "replicates" those on `rays` gather rays.
    note: whoever asked for the bake may leave one.
    """

    prints: dict
    settings: Settings
    survey: Survey
    patches: Patches
    groups: Groups | None = None
    solution: Solution | None = None
    solved: float = inf
    places: dict | None = None
    side: np.ndarray | None = None
    gathered: Gathered | None = None
    bounds: tuple = ()
    further: int = 0
    control: tuple | None = None
    each_object: bool = False
    traced: Traced | None = None
    doubt: float = inf
    openness: tuple | None = None
    averaged: Averages | None = None
    price: tuple = ()
    seconds: dict = field(default_factory=dict)
    note: str = ""

    def check(self, scene, settings, groups):
        """Raise StateError unless a bake of a scene (mended) may go on from here: if the scene, its light groups (Groups or
        None), or settings that samples depend on are others."""
        self.check_scene(scene)
        mine = self.settings
        usual = Settings.for_error(settings.error, per_object=settings.per_object)
        for name, words in (
            ("seed", "the seed"), ("rows", "the estimator of rows"), ("side", "the side of faces"), ("schedule", "the schedule"),
        ):  # fmt: skip
            if getattr(settings, name) != getattr(mine, name):
                what = f"{words} is {getattr(mine, name)} there, {getattr(settings, name)} was asked for"
                raise StateError(f"{what}: ask for the same, or {ANEW}")
        for name, words in (("patch_edge", "longest edge of patches"), ("row_rays", "number of rays of a row")):
            asked, there = getattr(settings, name), getattr(mine, name)
            if asked not in (there, getattr(usual, name)):
                raise StateError(f"another {words} was asked for than it has: leave that out, or {ANEW}")
        for effect in settings.force:
            if not self.survey.needs(effect):
                raise StateError(f"the effect {effect} was left out in it: do not force it, or {ANEW}")
        if (self.groups is None) != (groups is None):
            there = "has light groups" if groups is None else "has no light groups"
            raise StateError(f"it {there}: ask for {'them' if groups is None else 'none'}, or {ANEW}")
        if groups is not None and not _same_groups(self.groups, groups):
            raise StateError(
                f"its light groups are {', '.join(self.groups.names)}, not {', '.join(groups.names)}: ask for the same, or {ANEW}"
            )

    def check_scene(self, scene):
        """Raise StateError if a scene (mended) is not the one of this state; the message names what changed."""
        now = scene_prints(scene)
        for kind, remedy in (
            ("geometry", f"what rays met is no longer true: {ANEW}"),
            ("reflectance", f"light has to be gathered anew: {ANEW}"),
            ("lights", f"{ANEW}; with light groups, `radiosity relight` changes their strength without a new bake"),
            ("written", f"ask for the same objects, or {ANEW}"),
        ):
            change = _change(self.prints[kind], now[kind])
            if change:
                raise StateError(f"{KINDS[kind]}: {change}: {remedy}")

    def agrees(self, survey):
        """Raise StateError if a survey of the scene calls for an effect that was left out here."""
        for effect in survey.effects:
            if effect.needed and not self.survey.needs(effect.name):
                raise StateError(
                    f"a bake to {100 * self.settings.error:.3g} %, as in it, can leave out {effect.name}, this one cannot"
                    f" ({effect.reason}): {ANEW}"
                )

    def knobs(self, settings):
        """Settings that were asked for, with the patches and rows that are here."""
        mine = self.settings
        kept = {name: getattr(mine, name) for name in ("patch_edge", "row_rays", "patch_samples")}
        return replace(settings, **kept, force=tuple(dict.fromkeys((*mine.force, *settings.force))))

    def with_rows(self, solution):
        """A Solution, of which some rows may be known here, with all of them."""
        if self.solution is None:
            return solution
        mine, theirs = self.solution.rows, solution.rows
        more = mine.sides[~theirs.kept[mine.sides]]
        return (
            replace(solution, rows=joined_rows(theirs, theirs.sides, more, [mine.of_sides(more)]))
            if len(more)
            else solution
        )


KINDS = {
    "geometry": "the geometry has changed", "reflectance": "the reflectance has changed", "lights": "the lights have changed",
    "written": "other objects are to be written",
}  # fmt: skip


def scene_prints(scene):
    """{kind: [(name, print)]} of all that light depends on in a scene: "geometry" and "reflectance" of objects,
    "lights" (lamps, what objects emit, the world), and "written", the objects whose light is asked for."""
    count = len(scene.objects)
    polygon = np.searchsorted(scene.polygon_object, np.arange(count + 1))
    corner = scene.polygon_start[polygon].astype(np.int64)
    triangle = np.searchsorted(scene.triangle_polygon, polygon)
    shades = [_print(m.reflectance, m.translucency, m.alpha, *_image(scene, m)) for m in scene.materials]
    glows = [_print(m.exitance) for m in scene.materials]
    textured = np.array([m.texture is not None or m.alpha_texture is not None for m in scene.materials], bool)
    geometry, reflectance, lights = [], [], [(lamp.name, _of_lamp(lamp)) for lamp in scene.lamps]
    for o, name in enumerate(scene.objects):
        p, c, t = (slice(*bounds[o : o + 2]) for bounds in (polygon, corner, triangle))
        vertex, material = scene.corner_vertex[c], scene.polygon_material[p]
        shape = (
            scene.vertices[vertex], vertex - vertex[:1].sum(), np.diff(scene.polygon_start[polygon[o] : polygon[o + 1] + 1]),
            scene.corner_normal[c], scene.triangle_corner[t] - corner[o], scene.left_out[p], scene.double[p],
            scene.shading is None or scene.shading[o],
        )  # fmt: skip
        geometry.append((name, _print(*shape)))
        used, which = np.unique(material, return_inverse=True)
        uv = scene.corner_uv[c] if scene.corner_uv is not None and textured[used].any() else ()
        reflectance.append((name, _print(which, uv, *(shades[m] for m in used))))
        if any(max(scene.materials[m].exitance) > 0 for m in used):
            lights.append((name, _print(which, *(glows[m] for m in used))))
    if scene.readings is not None:
        names = [f.name for f in fields(scene.readings)]
        shades, glows = ([n for n in names if not n.endswith(other)] for other in ("exitance", "reflectance"))
        for prints, own in ((reflectance, shades), (lights, glows)):
            prints.append(("what Cycles read", _print(*(getattr(scene.readings, n) for n in own))))
    lights.append(("World", _print(scene.world.radiance, () if scene.world.map is None else scene.world.map)))
    written = [(name, "") for name, own in zip(scene.objects, scene.written) if own]
    return {"geometry": geometry, "reflectance": reflectance, "lights": lights, "written": written}


def _of_lamp(lamp):
    return _print(*(getattr(lamp, f.name) for f in fields(lamp) if f.name != "name"))


def _image(scene, material):
    """What of a material's images its print depends on."""
    parts = [material.tint] if material.texture is not None else []
    for number in (material.texture, material.alpha_texture):
        texture = None if number is None else scene.textures[number]
        parts += ["-"] if texture is None else [texture.pixels, str(texture.repeat)]
    return parts


def _print(*values):
    """A short word for arrays, numbers and words, another one for others."""
    digest = blake2b(digest_size=12)
    for value in values:
        array = np.ascontiguousarray(value)
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(array.data.cast("B") if array.size and array.dtype.kind != "U" else str(value).encode())
    return digest.hexdigest()


def _change(before, now):
    """What differs between lists of (name, print), in words; None if nothing does."""
    before, now = ([tuple(x) for x in prints] for prints in (before, now))
    if before == now:
        return None
    names, old = ({name for name, _ in prints} for prints in (now, before))
    for some, others, verb in ((now, old, "is new"), (before, names, "is gone")):
        one = next((name for name, _ in some if name not in others), None)
        if one is not None:
            return f"{one} {verb}"
    if len(before) != len(now):
        return f"{len(now)} in place of {len(before)}"
    return f"{next(name for (name, p), (_, q) in zip(now, before) if p != q or name != _)} is not what it was"


def _same_groups(a, b):
    same = a.names == b.names and a.sky == b.sky
    return same and np.array_equal(a.lamp, b.lamp) and np.array_equal(a.object, b.object)


def save_state(state, path):
    """Write a State to a file, whole or not at all. Raises OSError."""
    arrays, told = _packed(state)
    told = np.frombuffer(json.dumps({**told, "arrays": list(arrays)}).encode(), np.uint8)
    with written_whole(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, array in {"told": told, **arrays}.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asanyarray(array), allow_pickle=False)


def load_state(path):
    """The State that a file holds. Raises StateError if it is none, or was written by another version; OSError if it
    cannot be read."""
    with open(path, "rb") as file:
        try:
            arrays = {}
            with zipfile.ZipFile(file) as archive:
                for name in archive.namelist():
                    data = BytesIO(archive.read(name))  # whole: only so are its bytes checked
                    arrays[name.removesuffix(".npy")] = np.lib.format.read_array(data, allow_pickle=False)
            told = json.loads(arrays.pop("told").tobytes())
            if told["format"] != FORMAT:
                raise StateError(f"another version wrote it: {ANEW}")
            if told.pop("arrays") != list(arrays):  # a damaged list of what the file holds may end early
                raise StateError(DAMAGED)
            return _unpacked(arrays, told)
        except StateError:
            raise
        except Exception:  # whatever numpy, zipfile and json make of damaged bytes
            raise StateError(DAMAGED) from None


def _packed(state):
    """Arrays {name: array} and a document for JSON that tell all of a State."""
    arrays = {"island": state.survey.island, **to_arrays("patches", state.patches)}
    survey = state.survey
    told = {
        "format": FORMAT,
        "prints": state.prints,
        "settings": asdict(state.settings),
        "effects": [asdict(e) for e in survey.effects],
        "ignored": survey.ignored,
        "health": [asdict(f) for f in survey.health],
        "islands": survey.islands,
        "indirect": survey.indirect,
        "contrast": survey.contrast,
        "solved": state.solved,
        "bounds": state.bounds,
        "doubt": state.doubt,
        "each_object": state.each_object,
        "further": state.further,
        "price": [asdict(p) for p in state.price],
        "seconds": state.seconds,
        "note": state.note,
    }
    if state.groups:
        arrays.update(to_arrays("groups", state.groups))
        del arrays["groups.names"]
        told["groups"] = state.groups.names
    if state.solution is not None:
        solution, rows = state.solution, state.solution.rows
        arrays.update({f"solution.{name}": getattr(solution, name) for name in ("reflected", "irradiance", "direct")})
        if solution.edges is not None:
            arrays.update(to_arrays("edges", solution.edges))
        if solution.guide is not None:
            arrays.update(to_arrays("guide", solution.guide), **{"solution.guided": solution.guided})
        kept = ("sides", "hits") if isinstance(rows, RayRows) else ("sides", "start", "target", "share")
        arrays.update({f"rows.{name}": getattr(rows, name) for name in kept})
        told["solution"] = {name: getattr(solution, name) for name in ("sweeps", "bound", "converged", "energy")}
        told["rounds"] = [
            {k: getattr(r, k) for k in ("number", "unshot", "bound", "shots", "seconds")} for r in solution.rounds
        ]
    if state.places is not None:
        arrays.update({f"places.{name}": array for name, array in state.places.items()}, side=state.side)
    if state.gathered is not None:
        arrays.update(closest=state.gathered.closest, links=state.gathered.links)
        for k, replicate in enumerate(state.gathered.replicates):
            arrays.update(to_arrays(f"replicate.{k}", replicate))
    if state.control is not None:
        arrays.update(zip(("control.ids", "control.weight"), state.control))
        arrays.update(to_arrays("control", state.traced))
    if state.openness is not None:
        told["distance"], arrays["openness"] = state.openness
    if state.averaged is not None:
        arrays.update(to_arrays("averaged", state.averaged))
    return arrays, told


def _unpacked(arrays, told):
    """The State that `_packed` told of."""
    known = {name: told[name] for name in ("prints", "solved", "doubt", "each_object", "further", "seconds", "note")}
    settings = Settings(**{**told["settings"], "force": tuple(told["settings"]["force"])})
    state = State(
        settings=settings,
        survey=Survey(
            tuple(Effect(**e) for e in told["effects"]),
            tuple(map(tuple, told["ignored"])),
            tuple(Finding(**f) for f in told["health"]),
            arrays["island"],
            told["islands"],
            told["indirect"],
            told["contrast"],
        ),
        patches=from_arrays(Patches, "patches", arrays),
        bounds=tuple(told["bounds"]),
        price=tuple(Price(**p) for p in told["price"]),
        **known,
    )
    found = {}
    if "groups" in told:
        g = from_arrays(Groups, "groups", arrays)
        found["groups"] = replace(g, names=tuple(told["groups"]), sky=int(g.sky))
    if "solution" in told:
        rows = _rows(arrays, settings, 2 * len(state.patches))
        light = {name: arrays[f"solution.{name}"] for name in ("reflected", "irradiance", "direct")}
        if "edges.sides" in arrays:
            light.update(edges=from_arrays(Edges, "edges", arrays))
        if "guide.sides" in arrays:
            light.update(guide=from_arrays(Guide, "guide", arrays), guided=arrays["solution.guided"])
        rounds = tuple(Round(**r) for r in told["rounds"])
        found["solution"] = Solution(**light, **told["solution"], rounds=rounds, rows=rows)
    if "side" in arrays:
        found.update(places=_below("places", arrays), side=arrays["side"])
    if "closest" in arrays:
        count = len({name.split(".")[1] for name in arrays if name.startswith("replicate.")})
        replicates = [from_arrays(Replicate, f"replicate.{k}", arrays) for k in range(count)]
        replicates = [replace(r, rays=int(r.rays), test_rays=int(r.test_rays)) for r in replicates]
        found["gathered"] = Gathered(replicates, arrays["closest"], arrays["links"])
    if "control.ids" in arrays:
        traced = from_arrays(Traced, "control", arrays)
        found["control"] = arrays["control.ids"], arrays["control.weight"]
        found["traced"] = replace(traced, **{name: int(getattr(traced, name)) for name in ("rounds", "asked")})
    if "openness" in arrays:
        found["openness"] = told["distance"], arrays["openness"]
    if "averaged.ids" in arrays:
        averages = from_arrays(Averages, "averaged", arrays)
        found["averaged"] = replace(averages, places=int(averages.places))
    return replace(state, **found)


def _rows(arrays, settings, count):
    """The rows of `count` sides that a file holds."""
    if settings.rows == "rays":
        rows = RayRows(count, settings.row_rays, ENDLESS)
        rows.add(arrays["rows.sides"], [{"hits": arrays["rows.hits"]}])
        return rows
    rows = AnalyticRows(count, ENDLESS)
    rows.add(arrays["rows.sides"], [{name: arrays[f"rows.{name}"] for name in ("start", "target", "share")}])
    return rows


def _below(prefix, arrays):
    """{name: array} of the arrays whose names begin with a prefix, without it."""
    return {name[len(prefix) + 1 :]: array for name, array in arrays.items() if name.startswith(prefix + ".")}
