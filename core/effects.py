"""The survey: which effects of light a scene calls for, what is ignored, and what is wrong with its data.

Owns the records `Effect` and `Survey` and every decision to leave something out. A decision comes with its reason and
holds at the error asked for: an effect is left out if it cannot change the result by more than a set share of that error.
Geometry decides where it can (convexity, by position), elsewhere the rays that `evidence` casts.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .cells import LocalCells
from .convexity import find_outlier, find_planes, find_sides
from .evidence import SURE, Evidence, apart, read_of, tint, world_tint
from .flats import emitting_polygons
from .health import Finding, audit, mend
from .pieces import WELD
from .settings import EFFECTS, Settings
from .share import COMMON, light_contrast
from .sky import split_sky
from .surfaces import LARGEST_REFLECTANCE
from .vectors import length, unit

DARK = 1e-3  # an object whose front gets less than this share of what its back gets is lit from behind
SHADOWS = ("occlusion", "sky", "textures", "transparency")  # effects by which light changes within a short way
MOST_GLOWING = 256  # emitting faces that may be seen without obstruction; of more, some are taken to be hidden
MOST_TESTS = 200_000_000  # of a vertex against a plane; a room of more faces than that allows is not called convex
NAMED = 3  # names in a reason


@dataclass(frozen=True)
class Effect:
    """One effect: whether the scene needs it, and why, in words that name what decided. seconds: of CPU time that it cost,
    or about what it would have, if it was left out; None before the bake, and where that cannot be told."""

    name: str
    needed: bool
    reason: str
    seconds: float | None = None


@dataclass(frozen=True)
class Survey:
    """What a scene calls for: Effects, in the order of `EFFECTS`.

    ignored: (object, reason) of what cannot be simulated. health: findings.
    island: (P, 2) int32 number of the part of the scene that each polygon's front and back belong to: light of one
        never reaches another. islands: how many of them have light.
    indirect: share of the light that is reflected, roughly (root mean square), as far as that has been looked at.
    contrast: mean square of what sources give faces, over the square of the mean, where nothing casts a shadow; elsewhere
        nobody looks.
    """

    effects: tuple
    ignored: tuple = ()
    health: tuple = ()
    island: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.int32))
    islands: int = 1
    indirect: float = COMMON
    contrast: float = 1.0

    def needs(self, name):
        """Whether an effect is simulated."""
        return next(e.needed for e in self.effects if e.name == name)

    def after(self, scene, patches, solution, error, cells_note="", more=()):
        """The survey with what only the bake shows: objects that are lit from behind, power that is unaccounted for,
        and cells that failed. error: the relative error asked for; more: findings from elsewhere."""
        owner = scene.polygon_object[patches.polygon]
        power = patches.area[:, None] * solution.irradiance.sum(axis=0).reshape(-1, 2)
        front, back = (np.bincount(owner, power[:, k], len(scene.objects)) for k in range(2))
        behind = np.flatnonzero(scene.written & (front < DARK * back))
        faces = np.bincount(scene.polygon_object, minlength=len(scene.objects))
        dark = (
            Finding(
                scene.objects[o],
                f"{faces[o]} faces are lit from behind",
                "their front side is baked; --side back or lit takes the other",
            )
            for o in behind
        )
        cells = (Finding("cells", "the cells could not all be used", cells_note),) if cells_note else ()
        effects = self.effects
        if solution.guide is not None and len(solution.guide):
            told = f"; rays are guided to {len(solution.guide)} bright sides of patches, which they would seldom meet by chance"
            effects = tuple(
                replace(e, reason=e.reason + told) if e.name == "interreflection" else e for e in self.effects
            )
        return replace(
            self, effects=effects, health=(*self.health, *dark, *more, *audit(scene, solution, error), *cells)
        )


def survey(scene, settings=None, cells=None):
    """The Survey of a scene at the error that the settings ask for. cells: that cast its rays; None: this process."""
    scene = mend(scene)
    settings = settings or Settings()
    cells = cells or LocalCells()
    look = Evidence(scene, settings, cells)
    two_sided, reflected = _two_sided(look), _interreflection(look)
    effects = {
        "occlusion": _occlusion(look, *(e.needed or e.name in settings.force for e in (two_sided, reflected))),
        "interreflection": reflected,
        "color": _color(look),
        "lamps": _lamps(scene),
        "emission": _emission(scene),
        "sky": _sky(look),
        "textures": _textures(look),
        "two-sided": two_sided,
        "transparency": _transparency(look),
        "instances": _instances(scene),
        "islands": _islands(look),
    }
    return Survey(
        effects=tuple(_force(effects[name], settings) for name in EFFECTS),
        ignored=tuple(scene.ignored),
        health=scene.health,
        island=look.island,
        islands=len(look.lit_islands),
        indirect=look.indirect(),
        contrast=1.0 if any(effects[name].needed for name in SHADOWS) else light_contrast(scene),
    )


def simplified(scene, found):
    """The scene as transport needs it: images of one color as that color, if the survey leaves textures out."""
    if found.needs("textures") or not scene.textures:
        return scene
    return scene.but(materials=tuple(_even(m, scene.textures) for m in scene.materials))


def _even(material, textures):
    """A material with its texture as one color."""
    if material.texture is None:
        return material
    mean = textures[material.texture].mean
    color = np.asarray(material.reflectance) + np.asarray(material.tint) * mean
    return replace(material, reflectance=tuple(color), texture=None)


def _force(effect, settings):
    if effect.needed or effect.name not in settings.force:
        return effect
    return replace(effect, needed=True, reason=f"forced; not needed: {effect.reason}")


def _two_sided(look):
    """Whether the backs of faces matter: some are asked for, or rays say that light gets to them."""
    settings = look.settings
    if settings.side != "front":
        return Effect("two-sided", True, f"--side {settings.side} asks for the light on the backs of faces")
    if look.lit_object:
        return Effect("two-sided", True, f"light gets to the backs of faces, of {look.lit_object} for one")
    text = f"none of {look.rays} rays from the fronts of faces met the back of one, nor did those of lamps and sky"
    return Effect("two-sided", False, text)


def _occlusion(look, two_sided, reflects):
    """Whether anything can stand before a source, or, where light is reflected, between one surface and another. Lamps and
    objects that cast no shadow are told."""
    distant, effect = _bright_sky(look), _geometric_occlusion(look, two_sided, reflects)
    if effect.needed and look.scene.shading is not None:
        clear = [name for name, shading in zip(look.scene.objects, look.scene.shading) if not shading]
        effect = replace(effect, reason=f"{effect.reason}; no shadow falls from {_some(clear)}")
    if not effect.needed or not look.shadowless:
        return effect
    names = _some([lamp.name for lamp in look.shadowless])
    if len(look.shadowless) == len(look.lamps) and not (len(look.emitting) or distant or look.sky or reflects):
        return Effect("occlusion", False, f"no lamp casts shadows: they are switched off ({names})")
    return replace(effect, reason=f"{effect.reason}; no shadow rays go to {names}")


def _bright_sky(look):
    """Bright places of the sky, if it is needed: [(sine of the half angle, direction (3,))]."""
    distant = []
    for group in split_sky(look.scene.world)[1] if look.sky else ():
        middle = unit(group.directions.mean(axis=0))
        distant.append((float(length(group.directions - middle).max()) + group.spread, middle))
    return distant


def _geometric_occlusion(look, two_sided, reflects):
    """Whether anything can stand between a source and a face that it could light: nothing can if the faces that are
    turned to sources make up a convex room with the sources in it, or a block on whose outside they lie. The sky's even light
    comes from all sides: what it leaves dark counts where light is reflected."""
    scene, glowing, everywhere = look.scene, [], look.sky and reflects
    if len(look.emitting):
        corners = np.concatenate([np.arange(*scene.polygon_start[p : p + 2]) for p in look.emitting[:MOST_GLOWING]])
        glowing.append(scene.vertices[np.unique(scene.corner_vertex[corners])])
    places, distant = look.places(look.lamps, glowing)
    distant += _bright_sky(look)
    if not len(places) and not distant and not everywhere:
        return Effect("occlusion", False, "there is no lamp or emitting face that anything could stand before")
    if len(look.emitting) > MOST_GLOWING:
        return Effect("occlusion", True, f"{len(look.emitting)} emitting faces can shade one another")
    (normal, offset), triangle = look.planes(), look.usable
    if two_sided:
        normal, offset = np.concatenate([normal, -normal]), np.concatenate([offset, -offset])
        triangle = np.concatenate([triangle, triangle])
    plane, of_face = find_planes(normal, offset)

    lit, behind = find_sides(normal[plane], offset[plane], places, distant, WELD)
    lit |= everywhere
    if not lit.any():
        return Effect("occlusion", False, "no face is turned to a lamp")
    turned = lit[of_face]
    planes, behind = plane[lit], behind[lit]
    own = scene.used_vertices(triangle[turned])
    inside = _outlier(look, normal[planes], offset[planes], own, triangle[planes], +1)
    if inside is None and not behind.any():
        return Effect("occlusion", False, f"the faces that light reaches are convex ({len(planes)} planes), with all lamps in front of them: nothing can cast a shadow")  # fmt: skip
    everything = scene.used_vertices(look.usable)
    outside = _outlier(look, normal[planes], offset[planes], everything, triangle[planes], -1)
    if outside is None:
        return Effect("occlusion", False, f"everything lies behind the {len(planes)} planes of the faces that light reaches: nothing can cast a shadow")  # fmt: skip
    if inside is None:
        face = look.owner(triangle[planes][np.flatnonzero(behind)[0]])
        return Effect(
            "occlusion", True, f"a lamp, or a part of it, is behind a face of {face} that another could light"
        )
    return Effect("occlusion", True, inside)


def _outlier(look, normal, offset, vertices, triangle, sign):
    """What keeps vertices from lying all on or in front (sign -1: behind) of planes, in words; None if they do."""
    if not len(vertices) or len(normal) * len(vertices) > MOST_TESTS:
        return f"the faces that light could reach lie in {len(normal)} planes"
    scene = look.scene
    place = (scene.vertices[vertices] - scene.bounds.mean(axis=0)) / max(scene.diagonal, 1e-300)
    found = find_outlier(normal, offset, place, sign, WELD)
    if found is None:
        return None
    plane, vertex, depth = found[0], vertices[found[1]], found[2]
    here = look.owner(triangle[plane])
    there = look.owner(int(np.flatnonzero((scene.triangles == vertex).any(axis=1))[0]))
    meters = depth * scene.diagonal
    return f"not convex: {there} reaches {meters:.3g} m behind a face of {here} that light could reach"


def _interreflection(look):
    """How often light can bounce before what is left is below the error asked for."""
    most = float(look.materials.returned[look.used].max(initial=0.0))
    asked = f"at the {100 * look.settings.error:g} % asked for"
    if not look.meets:
        what = "met a face" if not look.met else "met a face that reflects"
        return Effect("interreflection", False, f"none of {2 * look.rays} rays from faces {what}")
    left = most / (1.0 - most)
    if left <= look.tolerance:
        return Effect("interreflection", False, f"at most {100 * left:.2g} % of the light is reflected, {asked}")
    bounces = 1
    while left > look.tolerance and bounces < 100_000:
        left *= most
        bounces += 1
    brightest = look.scene.materials[look.used[np.argmax(look.materials.returned[look.used])]].name
    bounces = f"{bounces - 1} bounces" if bounces > 2 else "1 bounce"
    return Effect(
        "interreflection", True, f"{brightest} reflects {100 * most:.3g} %: up to {bounces} can matter {asked}"
    )


def _color(look):
    """Whether channels can differ: by how much colored reflectances and lights can tint the result."""
    scene, used = look.scene, look.used
    shades = [(f"the material {scene.materials[m].name}", look.materials.tint[m]) for m in used]
    lights = [(f"the lamp {lamp.name}", tint(lamp.strength)) for lamp in look.lamps]
    lights += [(f"the emission of {scene.materials[m].name}", tint(scene.materials[m].exitance)) for m in used]
    lights += [("the world", world_tint(scene.world))] if look.sky else []
    lights += [
        (f"the emission of {scene.materials[m].name}", apart(scene.readings.exitance[own])) for m, own in read_of(scene)
    ]
    most = min(float(look.materials.returned[used].max(initial=0.0)), LARGEST_REFLECTANCE) if len(used) else 0.0
    gain = 1.0 + most / (1.0 - most)  # a change of all reflectances by a share x changes the light by up to gain x
    shades, lights = sorted(shades, key=lambda s: -s[1]), sorted(lights, key=lambda s: -s[1])
    worst = gain * (shades[0][1] if shades else 0.0), lights[0][1] if lights else 0.0
    if sum(worst) <= look.tolerance:
        count = len([light for light in lights if not light[0].startswith("the emission")])
        almost = "" if sum(worst) == 0 else f" to {100 * sum(worst):.2g} %"
        return Effect("color", False, f"all {len(used)} reflectances and {count} lights are gray{almost}: one channel is solved")  # fmt: skip
    name = (shades if worst[0] > worst[1] else lights)[0]
    return Effect("color", True, f"{name[0]} is tinted: its channels differ by {100 * name[1]:.3g} %")


def _lamps(scene):
    kinds = [lamp.kind for lamp in scene.lamps if max(lamp.strength) > 0]
    if not kinds:
        return Effect("lamps", False, "no lamp gives light" if scene.lamps else "there is no lamp")
    told = ", ".join(f"{kinds.count(k)} {k}" for k in sorted(set(kinds)))
    shadowless = [lamp.name for lamp in scene.lamps if max(lamp.strength) > 0 and not lamp.shadows]
    return Effect("lamps", True, f"{told}; without shadows: {_some(shadowless)}" if shadowless else told)


def _some(names):
    """Some of many names, in words."""
    return ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")


def _emission(scene):
    faces = len(emitting_polygons(scene))
    if not faces:
        return Effect("emission", False, "no face emits light")
    names = sorted({scene.objects[o] for o in np.unique(scene.polygon_object[emitting_polygons(scene)])})
    more = f" and {len(names) - 3} more objects" if len(names) > 3 else ""
    return Effect("emission", True, f"{faces} faces emit light, of {', '.join(names[:3])}{more}")


def _sky(look):
    """Whether the world's light gets to any face."""
    scene = look.scene
    if scene.world.brightest <= 0:
        return Effect("sky", False, "the world is black")
    escaped, rays = int(look.escaped[0]), look.rays
    if escaped:
        return Effect("sky", True, f"{escaped} of {rays} rays from the fronts of faces escaped")
    if look.settings.side != "front" and look.escaped[1]:
        return Effect("sky", True, f"{look.escaped[1]} of {rays} rays from the backs of faces escaped")
    if look.sky:
        return Effect("sky", True, f"0 of {rays} rays escaped, but the world is so much brighter than the rest that even {SURE:g} in {rays} could matter")  # fmt: skip
    return Effect("sky", False, f"0 of {rays} rays escaped")


def _textures(look):
    scene = look.scene
    spread = {
        scene.materials[m].name: _unevenness(scene.textures[scene.materials[m].texture])
        for m in look.used
        if scene.materials[m].texture is not None
    }
    if scene.readings is not None and len(scene.readings.triangle):
        return Effect("textures", True, f"nodes were read by Cycles at {len(scene.readings.triangle)} places")
    if not spread:
        return Effect("textures", False, "no material has an image")
    name = max(spread, key=spread.get)
    if spread[name] <= look.tolerance:
        return Effect("textures", False, f"all {len(spread)} images are of one color, to {100 * spread[name]:.2g} %")
    return Effect("textures", True, f"{len(spread)} materials have an image; that of {name} varies by {100 * spread[name]:.3g} %")  # fmt: skip


def _unevenness(texture):
    """How far a texture's pixels are apart, as a share of its mean."""
    low, high = texture.pixels.min(axis=(0, 1)), texture.pixels.max(axis=(0, 1))
    mean = float(np.einsum("hwc->", texture.pixels.astype(float))) / max(texture.pixels.size, 1)
    return float((high - low).max()) / max(mean, 1e-9)


def _transparency(look):
    """Whether rays may pass a surface."""
    scene = look.scene
    names = [scene.materials[m].name for m in look.used if scene.materials[m].transparent]
    if not names:
        return Effect("transparency", False, "every surface is opaque")
    faces = int(np.isin([m.name for m in scene.materials], names)[scene.polygon_material].sum())
    return Effect(
        "transparency", True, f"rays pass {faces} faces of {', '.join(names[:3])}{', ...' if len(names) > 3 else ''}"
    )


def _instances(scene):
    """Objects that share a mesh."""
    if scene.shared is None:
        return Effect("instances", False, "no two objects share a mesh")
    count = np.bincount(scene.shared)
    many = int((count > 1).sum())
    if not many:
        return Effect("instances", False, "no two objects share a mesh")
    return Effect(
        "instances", True, f"{int(count[count > 1].sum())} objects share {many} meshes; each is lit by itself"
    )


def _islands(look):
    count = len(look.lit_islands)
    if count < 2:
        return Effect(
            "islands", False, "all faces that light gets to can see one another, directly or by way of others"
        )
    names = []
    for k in look.lit_islands[:3]:
        polygon, side = (x[0] for x in np.nonzero(look.island == k))
        word = "back" if side else "front"
        names.append(f"{look.scene.objects[look.scene.polygon_object[polygon]]}, {word}")
    return Effect("islands", True, f"{count} parts cannot see one another ({'; '.join(names)}{'; ...' if count > 3 else ''}): each has a stop of its own")  # fmt: skip
