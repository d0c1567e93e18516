"""The survey: which effects of light a scene calls for, what is ignored, and what is wrong with its data.

Owns the records `Effect` and `Survey` and every decision to leave something out. A decision comes with its reason and
holds at the error asked for: an effect is left out if it cannot change the result by more than `SHARE` of that error.
Geometry decides where it can (convexity, by position); where only rays can tell, so many are cast that what none of
them has seen is too little to matter.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .cells import LocalCells
from .convexity import find_outlier, find_planes, find_sides
from .flats import emitting_polygons
from .graphs import components
from .health import Finding, audit, mend
from .kernel import cast_arrays
from .lights import lamp_outline, lamp_power
from .pieces import WELD, pieces_of
from .sampling import R2, R4, fraction, hemisphere
from .settings import EFFECTS, Settings
from .share import COMMON, face_rays, indirect_share, light_contrast
from .sky import split_sky
from .surfaces import LARGEST_REFLECTANCE
from .vectors import dot, length, runs, unit

DARK = 1e-3  # an object whose front gets less than this share of what its back gets is lit from behind
SHARE = 0.2  # of the error asked for that one effect may be worth when it is left out
SEEN = 150  # rays of the survey from each side of the faces, divided by the error asked for
MOST_SEEN = 100_000  # of these rays
SHADOWS = ("occlusion", "sky", "textures", "transparency")  # effects by which light changes within a short way
EACH = 4  # rays at least from each side of every piece of surface
ALONE = 256  # from what seems to see nothing that has light
EARLY = 8  # one in so many rays goes before the others
LAMP_RAYS = 256  # rays from each lamp
MOST_LAMPS = 64  # that send them
MOST_GLOWING = 256  # emitting faces that may be seen without obstruction; of more, some are taken to be hidden
SURE = 3.0  # what none of n rays has seen is at most SURE / n of what there is, with 95 % confidence
MOST_TESTS = 200_000_000  # of a vertex against a plane; a room of more faces than that allows is not called convex
TASK_RAYS = 1 << 16  # of one task
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
    look = _Look(scene, settings, cells)
    two_sided, reflected = _two_sided(look), _interreflection(look)
    effects = {
        "occlusion": _occlusion(look, *(e.needed or _forced(settings, e.name) for e in (two_sided, reflected))),
        "interreflection": reflected,
        "color": _color(look),
        "lamps": _lamps(scene),
        "emission": _emission(scene),
        "sky": look.sky,
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


def _forced(settings, name):
    return name in settings.force


def _force(effect, settings):
    if effect.needed or not _forced(settings, effect.name):
        return effect
    return replace(effect, needed=True, reason=f"forced; not needed: {effect.reason}")


class _Look:
    """What the survey's rays and the geometry say about a scene; each decision reads what it needs."""

    def __init__(self, scene, settings, cells):
        self.scene, self.settings = scene, settings
        self.tolerance = SHARE * settings.error
        self.usable = np.flatnonzero(scene.usable)
        self.materials = _Materials(scene)
        self.material = scene.polygon_material[scene.triangle_polygon[self.usable]]
        self.lamps = [lamp for lamp in scene.lamps if max(lamp.strength) > 0]
        self.shadowless = [lamp for lamp in self.lamps if not lamp.shadows]
        self.emitting = emitting_polygons(scene)
        cells.start(cast_arrays(scene, _forced(settings, "transparency")))
        self._cells = cells
        self._piece = pieces_of(scene)  # of each polygon
        self._cast()

    def _cast(self):
        """Cast the rays: from the lamps, from both sides of the faces, and toward the suns."""
        scene = self.scene
        pieces = int(self._piece.max(initial=-1)) + 1
        nodes = [2 * self._piece[scene.triangle_polygon], 2 * self._piece[scene.triangle_polygon] + 1]
        lit, open_to_sky = np.zeros(2 * pieces, bool), np.zeros(2 * pieces, bool)
        # Light straight from sources goes on behind what casts no shadow.
        both = (False,) if scene.shading is None else (False, True)

        def light(*rays):
            for shading in both:
                lit[_nodes_met(nodes, *self._hits(*rays, shading))] = True

        for lamp in sorted(self.lamps, key=lamp_power, reverse=True)[:MOST_LAMPS]:
            if lamp.shadows and lamp.kind != "sun":
                light(*_lamp_rays(lamp))
        if self.shadowless:  # what is turned to them is lit
            for side, turned in zip(nodes, find_sides(*self.planes(), *self.places(self.shadowless), WELD)):
                lit[side[self.usable[turned]]] = True
        glowing, number = self._glowing()
        for side in (0, 1):
            light(*face_rays(scene, glowing, number, side))
        # Both sides of what light passes through are one.
        thin = np.unique(self._piece[self.materials.thin[scene.polygon_material]])
        here, there = [2 * thin], [2 * thin + 1]

        self.rays, self.escaped, self.met = 0, np.zeros(2, int), 0
        self._sent = np.zeros(2 * pieces)  # rays that have set out from each node
        self.meets = 0.0  # the most that a face sends on which a ray has met
        suns = [np.asarray(lamp.axes[2], float) for lamp in self.lamps if lamp.kind == "sun" and lamp.shadows]
        for triangle, number in self._origins(pieces):
            self.rays += len(triangle)
            for side in (0, 1):
                position, normal, direction = face_rays(scene, triangle, number, side)
                hit, back = self._hits(position, normal, direction)
                met, node = hit >= 0, nodes[side][triangle]
                self._sent += np.bincount(node, minlength=2 * pieces)
                here.append(node[met])
                there.append(_nodes_met(nodes, hit, back))
                open_to_sky[node[~met]] = True
                self.escaped[side] += np.count_nonzero(~met)
                self.met += np.count_nonzero(met)
                for shading in both[1:]:
                    free = self._hits(position, normal, direction, shading)[0] < 0
                    open_to_sky[node[free]] = True
                    self.escaped[side] += np.count_nonzero(free & met)
                returned = self.materials.returned[scene.polygon_material[scene.triangle_polygon[hit[met]]]]
                self.meets = max(self.meets, float(returned.max(initial=0.0)))
                for toward in suns:
                    faces = np.flatnonzero((dot(normal, toward) > 0) & ~lit[node])
                    toward = np.broadcast_to(toward, (len(faces), 3))
                    free = faces[self._hits(position[faces], normal[faces], toward, both[-1])[0] < 0]
                    lit[node[free]] = True
            self._join(np.concatenate(here), np.concatenate(there), lit, open_to_sky)
            if self._settled():
                break

    def _join(self, here, there, lit, open_to_sky):
        """The parts of the scene that rays have joined, from nodes (K,) to nodes (K,): sides of pieces; lit, open_to_sky:
        (N,) bool, those that sources light, and that see the sky."""
        scene = self.scene
        self.sky = _sky(self)
        if self.sky.needed or (scene.world.brightest > 0 and _forced(self.settings, "sky")):
            lit = lit | open_to_sky
        self._label = label = components(here, there, len(lit))
        self.island = np.stack([label[2 * self._piece], label[2 * self._piece + 1]], axis=1).astype(np.int32)
        self.lit_islands = np.unique(label[lit])
        # A back side matters if its island has light.
        backs = np.flatnonzero(np.isin(self.island[scene.triangle_polygon[self.usable], 1], self.lit_islands))
        self.lit_object = _owner(scene, self.usable[backs[0]]) if len(backs) else None

    def _settled(self):
        """Whether more rays could show nothing: each effect that they may call for has been called for."""
        sky = self.sky.needed or self.scene.world.brightest <= 0
        return sky and self.meets > 0 and self.lit_object is not None and len(self.lit_islands) == 1

    def _origins(self, pieces):
        """Triangles (K,) that rays set out from and the rays' numbers (K,), in a few parts, so that what the first of them
        have seen is not looked for again: spread by area, with a few from every piece in the first."""
        scene = self.scene
        count = int(min(SEEN / self.settings.error, MOST_SEEN))
        area = scene.triangle_normal_area[1][self.usable]
        if not len(area):
            yield self.usable, self.usable
            return
        upper = np.cumsum(area)
        place = (np.arange(count) + 0.5) / count * upper[-1]
        chosen = self.usable[np.minimum(np.searchsorted(upper, place, side="right"), len(area) - 1)]
        number, some = np.arange(count), np.zeros(0, np.int64)
        if pieces * EACH <= MOST_SEEN:
            some = self._of_pieces(np.arange(pieces), EACH)
        early = number % EARLY == 0
        yield np.append(chosen[early], some), np.append(number[early], count + np.arange(len(some)))
        yield chosen[~early], number[~early]
        # What few rays have looked at may see the rest all the same.
        alone = np.flatnonzero(np.bincount(self._label, self._sent) < ALONE)
        alone = np.unique(np.flatnonzero(np.isin(self._label, np.intersect1d(alone, self.lit_islands))) // 2)
        if 0 < len(alone) * EACH <= MOST_SEEN:
            more = self._of_pieces(alone, min(ALONE, MOST_SEEN // len(alone)))
            yield more, count + len(some) + np.arange(len(more))

    def _of_pieces(self, pieces, each):
        """Triangles of pieces (K,), so many `each`."""
        piece = self._piece[self.scene.triangle_polygon[self.usable]]
        order = np.argsort(piece, kind="stable")
        first, end = (np.searchsorted(piece[order], pieces, side=side) for side in ("left", "right"))
        first, size = first[end > first], (end - first)[end > first]
        return self.usable[order[np.concatenate([first + (size * (2 * k + 1)) // (2 * each) for k in range(each)])]]

    def _glowing(self):
        """Emitting triangles (K,) that rays set out from, each as often as its area says, and the rays' numbers (K,)."""
        triangle = self.usable[np.isin(self.scene.triangle_polygon[self.usable], self.emitting)]
        if not len(triangle):
            return triangle, triangle
        upper = np.cumsum(self.scene.triangle_normal_area[1][triangle])
        count = LAMP_RAYS * min(len(self.emitting), MOST_LAMPS)
        place = (np.arange(count) + 0.5) / count * upper[-1]
        return triangle[np.minimum(np.searchsorted(upper, place, side="right"), len(triangle) - 1)], np.arange(count)

    def indirect(self):
        """Share of the light that is reflected. It is looked at only where sun or sky shine: elsewhere it is much of it."""
        scene, used = self.scene, np.unique(self.material)
        outdoors = self.sky.needed or any(lamp.kind == "sun" for lamp in self.lamps)
        unclear = self.materials.thin[used].any() or (scene.readings is not None and len(scene.readings.triangle))
        if not outdoors or unclear:
            return COMMON
        return indirect_share(scene, self.materials.returned, self._cells, self.settings.side == "back")

    def planes(self):
        """Normals (K, 3) of the planes of the usable triangles, and how far they are off the middle of the scene (K,) along
        them, in diagonals."""
        normal = self.scene.triangle_normal_area[0][self.usable]
        return normal, dot(normal, self._framed(self.scene.vertices[self.scene.triangles[self.usable, 0]]))

    def places(self, lamps, more=()):
        """Corners (L, 3) of all that lies around lamps, and more of them, from the middle of the scene in diagonals; and of
        suns the sines of their half angles and the directions to them, [(sine, (3,))]."""
        outlines = [lamp_outline(lamp) for lamp in lamps]
        corners = [np.zeros((0, 3)), *(corner for corner, direction in outlines if direction is None), *more]
        return self._framed(np.concatenate(corners)), [sun for sun in outlines if sun[1] is not None]

    def _framed(self, places):
        return (places - self.scene.bounds.mean(axis=0)) / max(self.scene.diagonal, 1e-300)

    def _hits(self, position, normal, direction, shading=False):
        """Triangle (K,), -1 where a ray escapes, and whether it met its back (K,); shading: of what casts shadows."""
        tasks = [
            self._cells.submit("cast", position=position[p], normal=normal[p], direction=direction[p], shading=shading)
            for p in runs(len(position), most=TASK_RAYS)
        ]
        found = self._cells.take(tasks)
        hit = np.concatenate([np.zeros(0, np.int32), *(f["triangle"] for f in found)])
        return hit, np.concatenate([np.zeros(0, bool), *(f["back"] for f in found)])


def _nodes_met(nodes, hit, back):
    """The nodes of the sides of triangles that rays met: hit (K,), -1 for a miss, back (K,) bool; nodes: front, back
    (T,)."""
    met = hit >= 0
    return np.where(back[met], nodes[1][hit[met]], nodes[0][hit[met]])


class _Materials:
    """Bounds on what the scene's materials do, a row for each: returned (M,) the most that one sends on, thin (M,) bool
    light passes through, tint (M,) how far from gray, as a share, and the texture's spread (M,)."""

    def __init__(self, scene):
        rows, thin, tint = [], [], []
        textures = [_texture_range(t) for t in scene.textures]
        for m in scene.materials:
            low = high = np.clip(np.asarray(m.reflectance, float), 0, LARGEST_REFLECTANCE)
            shades = [np.asarray(m.reflectance, float), np.asarray(m.translucency, float)]
            uneven = 0.0
            if m.texture is not None:
                darkest, brightest, uneven = textures[m.texture]
                low, high = low + np.asarray(m.tint) * darkest, high + np.asarray(m.tint) * brightest
                shades.append(np.asarray(m.tint, float))
            rows.append((high + np.asarray(m.translucency)).max())
            thin.append(max(m.translucency) > 0 or m.transparent)
            tint.append(max([_tint(s) for s in shades] + [uneven]))
        self.returned = np.minimum(np.nan_to_num(np.array(rows, float)), LARGEST_REFLECTANCE)
        self.thin, self.tint = np.array(thin, bool), np.array(tint, float)
        for m, own in _read_of(scene):
            self.returned[m] = min(float(scene.readings.reflectance[own].max()), LARGEST_REFLECTANCE)
            self.tint[m] = _apart(scene.readings.reflectance[own])


def _read_of(scene):
    """Materials that were read, and of each the rows (K,) of the scene's readings."""
    if scene.readings is None or not len(scene.readings.triangle):
        return []
    material = scene.polygon_material[scene.triangle_polygon[scene.readings.triangle]]
    return [(m, np.flatnonzero(material == m)) for m in np.unique(material)]


def _tint(color):
    """How far a color (..., 3) is from gray: its spread as a share of its mean."""
    color = np.asarray(color, float)
    mean = np.abs(color).mean()
    return float((color.max() - color.min()) / mean) if mean > 0 else 0.0


def _world_tint(world):
    """How far a world is from gray, as a share of its mean."""
    return _tint(world.radiance) if world.map is None else _apart(world.map)


def _apart(colors):
    """How far colors (..., 3) are from gray at most, as a share of the mean of each, or of all where that is more."""
    red, green, blue = np.moveaxis(colors, -1, 0)
    own = (red + green + blue) / 3
    mean = float(np.einsum("k->", own.reshape(-1).astype(float))) / max(own.size, 1)
    apart = np.maximum(np.maximum(red, green), blue) - np.minimum(np.minimum(red, green), blue)
    return float((apart / np.maximum(own, max(mean, 1e-30))).max(initial=0.0))


def _texture_range(texture):
    """Darkest and brightest color (3,) of a texture, and how far from gray it is anywhere, as a share of its mean."""
    pixels = texture.pixels
    return pixels.min(axis=(0, 1)), pixels.max(axis=(0, 1)), _apart(pixels)


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
    if len(look.shadowless) == len(look.lamps) and not (len(look.emitting) or distant or look.sky.needed or reflects):
        return Effect("occlusion", False, f"no lamp casts shadows: they are switched off ({names})")
    return replace(effect, reason=f"{effect.reason}; no shadow rays go to {names}")


def _bright_sky(look):
    """Bright places of the sky, if it is needed: [(sine of the half angle, direction (3,))]."""
    distant = []
    for group in split_sky(look.scene.world)[1] if look.sky.needed else ():
        middle = unit(group.directions.mean(axis=0))
        distant.append((float(length(group.directions - middle).max()) + group.spread, middle))
    return distant


def _geometric_occlusion(look, two_sided, reflects):
    """Whether anything can stand between a source and a face that it could light: nothing can if the faces that are
    turned to sources make up a convex room with the sources in it, or a block on whose outside they lie. The sky's even light
    comes from all sides: what it leaves dark counts where light is reflected."""
    scene, glowing, everywhere = look.scene, [], look.sky.needed and reflects
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
    inside = _outlier(scene, normal[planes], offset[planes], own, triangle[planes], +1)
    if inside is None and not behind.any():
        return Effect("occlusion", False, f"the faces that light reaches are convex ({len(planes)} planes), with all lamps in front of them: nothing can cast a shadow")  # fmt: skip
    everything = scene.used_vertices(look.usable)
    outside = _outlier(scene, normal[planes], offset[planes], everything, triangle[planes], -1)
    if outside is None:
        return Effect("occlusion", False, f"everything lies behind the {len(planes)} planes of the faces that light reaches: nothing can cast a shadow")  # fmt: skip
    if inside is None:
        face = _owner(scene, triangle[planes][np.flatnonzero(behind)[0]])
        return Effect(
            "occlusion", True, f"a lamp, or a part of it, is behind a face of {face} that another could light"
        )
    return Effect("occlusion", True, inside)


def _outlier(scene, normal, offset, vertices, triangle, sign):
    """What keeps vertices from lying all on or in front (sign -1: behind) of planes, in words; None if they do."""
    if not len(vertices) or len(normal) * len(vertices) > MOST_TESTS:
        return f"the faces that light could reach lie in {len(normal)} planes"
    place = (scene.vertices[vertices] - scene.bounds.mean(axis=0)) / max(scene.diagonal, 1e-300)
    found = find_outlier(normal, offset, place, sign, WELD)
    if found is None:
        return None
    plane, vertex, depth = found[0], vertices[found[1]], found[2]
    here = _owner(scene, triangle[plane])
    there = _owner(scene, int(np.flatnonzero((scene.triangles == vertex).any(axis=1))[0]))
    meters = depth * scene.diagonal
    return f"not convex: {there} reaches {meters:.3g} m behind a face of {here} that light could reach"


def _owner(scene, triangle):
    """Name of the object that a triangle belongs to."""
    return scene.objects[scene.polygon_object[scene.triangle_polygon[triangle]]]


def _interreflection(look):
    """How often light can bounce before what is left is below the error asked for."""
    most = float(look.materials.returned[np.unique(look.material)].max(initial=0.0)) if len(look.material) else 0.0
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
    brightest = look.scene.materials[int(np.argmax(np.where(_used(look), look.materials.returned, -1)))].name
    bounces = f"{bounces - 1} bounces" if bounces > 2 else "1 bounce"
    return Effect(
        "interreflection", True, f"{brightest} reflects {100 * most:.3g} %: up to {bounces} can matter {asked}"
    )


def _used(look):
    return np.isin(np.arange(len(look.scene.materials)), look.material)


def _color(look):
    """Whether channels can differ: by how much colored reflectances and lights can tint the result."""
    scene, used = look.scene, np.unique(look.material)
    shades = [(f"the material {scene.materials[m].name}", look.materials.tint[m]) for m in used]
    lights = [(f"the lamp {lamp.name}", _tint(lamp.strength)) for lamp in look.lamps]
    lights += [(f"the emission of {scene.materials[m].name}", _tint(scene.materials[m].exitance)) for m in used]
    lights += [("the world", _world_tint(scene.world))] if look.sky.needed else []
    lights += [
        (f"the emission of {scene.materials[m].name}", _apart(scene.readings.exitance[own]))
        for m, own in _read_of(scene)
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
    # What none of the rays has seen may still be SURE / n of the sky.
    area = float(scene.triangle_normal_area[1][look.usable].sum())
    missed = SURE / max(rays, 1) * np.pi * scene.world.brightest * area
    exitance = np.array([max(m.exitance) for m in scene.materials], float)
    polygon = scene.triangle_polygon[look.usable]
    faces = 2 * float((exitance[scene.polygon_material[polygon]] * scene.triangle_normal_area[1][look.usable]).sum())
    inside = faces + sum(lamp_power(lamp) for lamp in look.lamps if lamp.kind != "sun")
    if missed > look.tolerance * inside:
        return Effect("sky", True, f"0 of {rays} rays escaped, but the world is so much brighter than the rest that even {SURE:g} in {rays} could matter")  # fmt: skip
    return Effect("sky", False, f"0 of {rays} rays escaped")


def _textures(look):
    scene = look.scene
    spread = {
        scene.materials[m].name: _unevenness(scene.textures[scene.materials[m].texture])
        for m in np.unique(look.material)
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
    names = [scene.materials[m].name for m in np.unique(look.material) if scene.materials[m].transparent]
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


def _lamp_rays(lamp):
    """Position, offset normal (0) and direction (K, 3) of rays from a point, spot or area lamp."""
    number = np.arange(LAMP_RAYS) + 0.5
    u, v = number / LAMP_RAYS, fraction(number * R2[0])
    x, y, z = np.asarray(lamp.axes, float)
    position = np.broadcast_to(np.asarray(lamp.position, float), (LAMP_RAYS, 3))
    if lamp.kind == "area":
        local = hemisphere(u, v)
        a, b = fraction(number * R4[2]) - 0.5, fraction(number * R4[3]) - 0.5
        position = position + a[:, None] * lamp.size[0] * x + b[:, None] * lamp.size[1] * y
    else:
        # Evenly over the sphere, or the part of it in the cone.
        least = np.cos(lamp.angle / 2) if lamp.kind == "spot" else -1.0
        height = least + (1.0 - least) * u
        ring, turn = np.sqrt(np.maximum(1.0 - height * height, 0.0)), 2 * np.pi * v
        local = np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1)
    direction = local[:, :1] * x + local[:, 1:2] * y - local[:, 2:] * z
    return position, np.zeros_like(position), direction
