"""The evidence of a survey: what rays and the geometry say about a scene, whatever follows from it.

Owns the survey's rays. They set out from the lamps, from both sides of the faces and toward the suns, and tell which
sides light reaches, which can see one another or the sky, and what reflects. So many are cast that what none of them has
seen is too little to matter at the error asked for; once more could show nothing they end.
"""

from __future__ import annotations

import numpy as np

from .convexity import find_sides
from .flats import emitting_polygons
from .graphs import components
from .kernel import cast_arrays
from .lights import lamp_outline, lamp_power
from .pieces import WELD, pieces_of
from .sampling import R2, R4, fraction, hemisphere
from .share import COMMON, face_rays, indirect_share
from .surfaces import LARGEST_REFLECTANCE
from .vectors import dot, runs

SHARE = 0.2  # of the error asked for that one effect may be worth when it is left out
SEEN = 150  # rays of the survey from each side of the faces, divided by the error asked for
MOST_SEEN = 100_000  # of these rays
EACH = 4  # rays at least from each side of every piece of surface
ALONE = 256  # from what seems to see nothing that has light
EARLY = 8  # one in so many rays goes before the others
LAMP_RAYS = 256  # rays from each lamp
MOST_LAMPS = 64  # that send them
SURE = 3.0  # what none of n rays has seen is at most SURE / n of what there is, with 95 % confidence
TASK_RAYS = 1 << 16  # of one task


class Evidence:
    """What the survey's rays and the geometry say about a scene at the error that the settings ask for. cells: that cast
    the rays.

    tolerance: share of the light that an effect may be worth when it is left out. usable: (T,) triangles; material: (T,)
    theirs. lamps: those that give light; shadowless: those of them that cast no shadows. emitting: (E,) polygons.
    rays: from each side of the faces; escaped: (2,) of them, met: those that met a face; meets: the most that such a face
    sends on. sky: whether the world's light may get to a face. island: (P, 2) int32 part of the scene that the two sides
    of polygons belong to; lit_islands: (I,) those that have light. lit_object: name of one whose backs light gets to,
    None if there is none.
    """

    def __init__(self, scene, settings, cells):
        self.scene, self.settings = scene, settings
        self.tolerance = SHARE * settings.error
        self.usable = np.flatnonzero(scene.usable)
        self.materials = _Materials(scene)
        self.material = scene.polygon_material[scene.triangle_polygon[self.usable]]
        self.used = np.flatnonzero(np.bincount(self.material, minlength=len(scene.materials)))  # materials, in order
        self.lamps = [lamp for lamp in scene.lamps if max(lamp.strength) > 0]
        self.shadowless = [lamp for lamp in self.lamps if not lamp.shadows]
        self.emitting = emitting_polygons(scene)
        cells.start(cast_arrays(scene, "transparency" in settings.force))
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
        self.sky = self._sees_sky()
        if self.sky or (scene.world.brightest > 0 and "sky" in self.settings.force):
            lit = lit | open_to_sky
        self._label = label = components(here, there, len(lit))
        self.island = np.stack([label[2 * self._piece], label[2 * self._piece + 1]], axis=1).astype(np.int32)
        self.lit_islands = np.unique(label[lit])
        # A back side matters if its island has light.
        backs = np.flatnonzero(np.isin(self.island[scene.triangle_polygon[self.usable], 1], self.lit_islands))
        self.lit_object = self.owner(self.usable[backs[0]]) if len(backs) else None

    def _sees_sky(self):
        """Whether rays have seen the world's light, or what none of them has seen may be too much of it to be left out."""
        scene, rays = self.scene, self.rays
        if scene.world.brightest <= 0:
            return False
        if self.escaped[0] or (self.settings.side != "front" and self.escaped[1]):
            return True
        area = scene.triangle_normal_area[1][self.usable]
        missed = SURE / max(rays, 1) * np.pi * scene.world.brightest * float(area.sum())
        exitance = np.array([max(m.exitance) for m in scene.materials], float)
        faces = 2 * float((exitance[self.material] * area).sum())
        inside = faces + sum(lamp_power(lamp) for lamp in self.lamps if lamp.kind != "sun")
        return bool(missed > self.tolerance * inside)

    def _settled(self):
        """Whether more rays could show nothing: each effect that they may call for has been called for."""
        sky = self.sky or self.scene.world.brightest <= 0
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
        scene, used = self.scene, self.used
        outdoors = self.sky or any(lamp.kind == "sun" for lamp in self.lamps)
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

    def owner(self, triangle):
        """Name of the object that a triangle belongs to."""
        return self.scene.objects[self.scene.polygon_object[self.scene.triangle_polygon[triangle]]]

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
    light passes through, tint (M,) how far from gray, as a share."""

    def __init__(self, scene):
        rows, thin, tinted = [], [], []
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
            tinted.append(max([tint(s) for s in shades] + [uneven]))
        self.returned = np.minimum(np.nan_to_num(np.array(rows, float)), LARGEST_REFLECTANCE)
        self.thin, self.tint = np.array(thin, bool), np.array(tinted, float)
        for m, own in read_of(scene):
            self.returned[m] = min(float(scene.readings.reflectance[own].max()), LARGEST_REFLECTANCE)
            self.tint[m] = apart(scene.readings.reflectance[own])


def read_of(scene):
    """Materials that were read, and of each the rows (K,) of the scene's readings."""
    if scene.readings is None or not len(scene.readings.triangle):
        return []
    material = scene.polygon_material[scene.triangle_polygon[scene.readings.triangle]]
    return [(m, np.flatnonzero(material == m)) for m in np.unique(material)]


def tint(color):
    """How far a color (..., 3) is from gray: its spread as a share of its mean."""
    color = np.asarray(color, float)
    mean = np.abs(color).mean()
    return float((color.max() - color.min()) / mean) if mean > 0 else 0.0


def world_tint(world):
    """How far a world is from gray, as a share of its mean."""
    return tint(world.radiance) if world.map is None else apart(world.map)


def apart(colors):
    """How far colors (..., 3) are from gray at most, as a share of the mean of each, or of all where that is more."""
    red, green, blue = np.moveaxis(colors, -1, 0)
    own = (red + green + blue) / 3
    mean = float(np.einsum("k->", own.reshape(-1).astype(float))) / max(own.size, 1)
    spread = np.maximum(np.maximum(red, green), blue) - np.minimum(np.minimum(red, green), blue)
    return float((spread / np.maximum(own, max(mean, 1e-30))).max(initial=0.0))


def _texture_range(texture):
    """Darkest and brightest color (3,) of a texture, and how far from gray it is anywhere, as a share of its mean."""
    pixels = texture.pixels
    return pixels.min(axis=(0, 1)), pixels.max(axis=(0, 1)), apart(pixels)


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
