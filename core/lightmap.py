"""Lightmaps: texels as points, and what the light at them becomes in an image.

Owns which texels are baked and where on the surface each is asked, what is done with those that something covers, the mean
over texels that the edge of a shadow cuts, the matching of light across the seams between charts, and the filling of all
that no chart covers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .atlas import nearest, rasterize
from .control import direct_light
from .lights import unoccluded
from .points import Block, Points, block_arrays
from .raycast import OFFSET
from .sampling import hemisphere, lattice, morton_order, tangents
from .touching import find_touching
from .vectors import TINY, counted, cross, dot, doubled_areas, length, numbered, runs, unit

FEW, MANY = 4, 16  # rays that tell a covered texel: if all of the few meet backs, the many are cast
WAYS = 8  # directions along the surface in which a covered texel looks for the open
BEYOND = 0.1  # how far past what covers it a texel is moved, in texels
RIM = 1e-3  # a texel is on the rim of its triangle if a corner's weight is less
INSET = 0.1  # how far texels on the rim are moved toward the triangle's middle: in texels, and as a share of the way
TASK_TEXELS = 1 << 13

CUT = 0.2  # share of all light at a texel by which direct light beside it differs if a shadow's edge runs there
TESTS = 4  # test rays at each of them toward a source that gives all of the light
HALVES = 0.4  # of what two halves of the places differ by, squared, is left in the mean (1/3 at sharp edges, 1 where it is noise)
ON = 1e-9  # texels: a place so near to a triangle lies on it
TASK_PLACES = 1 << 11

ALIKE = 0.996  # cosine between shading normals of the two sides of a seam across which light goes on
STEP = 1e-4  # how far beyond an edge, and how high above, the surface of the other side is looked for, in diagonals
MATCH = 10.0  # weight of a difference across a seam against that of a change to a texel
ROUNDS, ENOUGH = 200, 1e-6  # of the conjugate gradients, and the residual at which they end
DILATE = 4  # texels around charts that repeat their neighbors; farther ones are blended from coarser images


@dataclass(frozen=True)
class Texels(Points):
    """Points that are texels of an atlas; they write no corners.

    row: (P,) int32, which of the atlas' triangles. weight: (P, 3) of its corners. image, column, line: (P,) int32 the
    texel; line 0 is at the bottom. moved: (P,) bool, lifted out of what covered it. hidden: texels left out because
    something covers them.
    """

    row: np.ndarray
    weight: np.ndarray
    image: np.ndarray
    column: np.ndarray
    line: np.ndarray
    moved: np.ndarray
    hidden: int


def make_texels(scene, atlas, flipped, cells):
    """The Texels of an Atlas whose light is to be gathered: all that a triangle touches, but those that are covered.

    A texel is asked at its center, or where its center is outside the chart, at the place in the chart nearest to it.
    flipped: (P,) bool, polygons whose back side's light is asked for. cells: started with the scene's arrays.
    """
    found = _texels(atlas)
    count = len(found["row"])
    found.update({name: np.empty((count, 3)) for name in ("position", "normal", "geometric")})
    found.update(area=np.empty(count), moved=np.empty(count, bool))
    free = np.empty(count, bool)
    parts = [slice(k, min(k + TASK_TEXELS, count)) for k in range(0, count, TASK_TEXELS)]

    def places():
        """What is asked of each block of texels, of which only a few are under way at a time."""
        for part in parts:
            *place, edge = _places(scene, atlas, flipped, found["row"][part], found["weight"][part])
            for name, values in zip(("position", "normal", "geometric", "area"), place):
                found[name][part] = values
            yield dict(position=place[0], normal=place[2], edge=edge)

    cells.start({"settle.flipped": flipped[scene.triangle_polygon]})
    for part, settled in zip(parts, cells.flow("settle", places())):
        found["position"][part], found["moved"][part], free[part] = (settled[k] for k in ("position", "moved", "open"))
    polygon = scene.triangle_polygon[atlas.triangle[found["row"]]]
    free &= ~find_touching(scene, flipped, cells, polygon, found["position"], found["geometric"])
    order = np.flatnonzero(free)
    order = order[morton_order(found["position"][order])]
    for name in found:  # one by one: of each only one is there twice
        found[name] = found[name][order]
    del order, polygon
    object = scene.polygon_object[scene.triangle_polygon[atlas.triangle]].astype(np.int32)[found["row"]]
    start, neighbor = _grid_neighbors(atlas, found["image"], found["line"], found["column"], atlas.chart[found["row"]])
    none = np.zeros(0, np.int32)
    return Texels(
        object=object, neighbor_start=start, neighbor=neighbor, corner=none, corner_point=none,
        thin=np.zeros(len(object), bool), smooth=np.ones(len(object), bool), hidden=count - len(object), **found,
    )  # fmt: skip


def _places(scene, atlas, flipped, row, weight):
    """Where on the surface rows (K,) of an atlas, with weights (K, 3) of their corners, are asked: position, normal, and
    geometric normal (K, 3); area of a texel there [m^2] and its edge [m], (K,)."""
    triangle = atlas.triangle[row]
    corner = scene.triangle_corner[triangle]
    sign = np.where(flipped[scene.triangle_polygon[triangle]], -1.0, 1.0)[:, None]
    vertices = scene.vertices[scene.triangles[triangle]]
    position = np.einsum("kv,kvd->kd", weight, vertices)
    geometric = scene.triangle_normal_area[0][triangle] * sign
    shading = unit(scene.corner_normal[corner], scene.triangle_normal_area[0][triangle][:, None])
    normal = unit(np.einsum("kv,kvd->kd", weight, shading)) * sign
    normal = np.where(
        np.isfinite(normal).all(axis=1, keepdims=True) & (dot(normal, normal) > 0)[:, None], normal, geometric
    )
    spread = np.abs(doubled_areas(atlas.place)) / 2
    size = scene.triangle_normal_area[1][atlas.triangle] / np.maximum(spread, TINY)  # of a texel [m^2]
    area = np.where(spread > 0, size, 0.0)[row]
    edge = np.sqrt(np.minimum(area, scene.diagonal**2))

    # A texel on the rim of a triangle is asked a little inside: beyond the rim another surface may begin.
    inward = vertices.mean(axis=1) - position
    share = np.minimum(INSET * edge / np.maximum(length(inward), TINY), INSET)
    position = position + np.where(weight.min(axis=1) < RIM, share, 0.0)[:, None] * inward

    return position, normal, geometric, area, edge


def _texels(atlas):
    """The texels that triangles touch: {"row" of the atlas, "image", "column", "line": (N,) int32, "weight": (N, 3) of the
    corners}.

    Of the triangles that touch a texel the one whose inside is nearest to its center has it.
    """
    parts = []
    width, height = atlas.size.max(axis=0)
    for row, column, line, weight, distance in rasterize(atlas.place, atlas.size[atlas.image]):
        key = (atlas.image[row] * height + line) * width + column
        parts.append(_first(key, distance, row, weight))
    if not parts:
        none = np.zeros(0, np.int32)
        return dict(row=none, image=none, column=none, line=none, weight=np.zeros((0, 3)))
    columns = [list(column) for column in zip(*parts)]
    del parts
    for k in range(len(columns)):  # one by one: of each only one is there twice
        columns[k] = np.concatenate(columns[k])
    key, _, row, weight = _first(*columns)
    del columns
    image, key = np.divmod(key, height * width)
    line, column = np.divmod(key, width)
    small = dict(row=row, image=image, column=column, line=line)
    return {**{name: array.astype(np.int32) for name, array in small.items()}, "weight": weight}


def _first(key, distance, row, weight):
    """Of each key the entry of least distance, and of these the one of the lowest row."""
    order = np.lexsort((row, distance, key))
    order = order[np.append(True, key[order][1:] != key[order][:-1])] if len(order) else order
    return key[order], distance[order], row[order], weight[order]


def _grid_neighbors(atlas, image, line, column, chart):
    """Where each texel's neighbors start (P + 1,), and the neighbors (E,): texels beside, above and below, of one chart."""
    width, height = atlas.size.max(axis=0) + 2
    count = len(image)
    key = (image.astype(np.int64) * height + line + 1) * width + column + 1
    order = np.argsort(key, kind="stable").astype(np.int32)
    key = key[order]
    beside = np.full((count, 4), count, np.int32)  # count stands for none
    for k, step in enumerate((1, width)):
        for part in runs(count):  # in the order of the images, where neighbors are found soon
            place = np.minimum(np.searchsorted(key, key[part] + step), count - 1)
            here, there = order[part], order[place]
            met = (key[place] == key[part] + step) & (chart[there] == chart[here])
            beside[here[met], 2 * k], beside[there[met], 2 * k + 1] = there[met], here[met]
    beside.sort(axis=1)
    known = beside < count
    start = np.append(0, np.cumsum(known.sum(axis=1))).astype(np.int32)
    return start, beside[known]


def _settle(scene, position, normal, edge, flipped, cells):
    """Positions (P, 3) with covered ones moved into the open where that is less than a texel away, which ones were moved
    (P,), and which are not covered (P,). edge: (P,) of the texels [m]."""
    cells.start({"settle.flipped": flipped[scene.triangle_polygon]})
    parts = [slice(k, min(k + TASK_TEXELS, len(position))) for k in range(0, len(position), TASK_TEXELS)]
    tasks = [cells.submit("settle", position=position[p], normal=normal[p], edge=edge[p]) for p in parts]
    results = cells.take(tasks)
    position, moved, free = position.copy(), np.zeros(len(position), bool), np.ones(len(position), bool)
    for part, result in zip(parts, results):
        position[part], moved[part], free[part] = result["position"], result["moved"], result["open"]
    return position, moved, free


def average_cut(scene, atlas, flipped, texels, light, cells, seed, places):
    """Texels (K,) that the edge of a shadow cuts, their light of sampled sources (C, K), the mean over all of each that
    the chart has and nothing covers, and about the variance (K,) of that, all channels together: a generator that yields
    (places done, all places).

    light: the Light at the texels; flipped: (P,) bool, polygons whose back side's light is asked for. cells: started with
    the scene's arrays and its sources. places: in a whole texel at which it is asked for, an even number.
    """
    ids = _cut(texels, light)
    owner, half, row, weight = _parts(atlas, texels, ids, places)
    position, normal, geometric, _, _ = _places(scene, atlas, flipped, row, weight)
    _, _, free = _settle(scene, position, geometric, np.zeros(len(row)), flipped, cells)
    slot, none = (2 * owner + half)[free], np.zeros(np.count_nonzero(free))
    spots = _Places(position[free], normal[free], geometric[free], none)
    parts = [np.arange(k, min(k + TASK_PLACES, len(slot))) for k in range(0, len(slot), TASK_PLACES)]
    total, each = np.zeros((len(light.direct), 2 * len(ids))), (block_arrays(spots, p, joined=False) for p in parts)
    for part, result in zip(parts, cells.flow("parts", (dict(seed=seed, **arrays) for arrays in each))):
        for channel, values in zip(total, result["direct"]):
            channel += np.bincount(slot[part], values, 2 * len(ids))
        yield int(part[-1]) + 1, len(slot)
    total = total.reshape(len(total), len(ids), 2)
    number = np.bincount(slot, minlength=2 * len(ids)).reshape(-1, 2)
    apart = np.subtract(*np.moveaxis(total / np.maximum(number, 1), 2, 0)) / 2
    groups = len(light.direct) // len(light.variance)
    apart = apart.reshape(groups, len(light.variance), len(ids)).sum(axis=0)
    variance = HALVES * (apart * apart).sum(axis=0) * number.all(axis=1)
    known = number.any(axis=1)
    return ids[known], (total.sum(axis=2) / np.maximum(number.sum(axis=1), 1))[:, known], variance[known]


class _Places(NamedTuple):
    """Places on surfaces, their normals and geometric normals (N, 3), and area (N,), of places none."""

    position: np.ndarray
    normal: np.ndarray
    geometric: np.ndarray
    area: np.ndarray


def _cut(texels, light):
    """(K,) texels beside which direct light is another."""
    here, there = np.repeat(np.arange(len(texels)), np.diff(texels.neighbor_start)), texels.neighbor
    direct = light.direct.sum(axis=0)
    total = direct + light.indirect.sum(axis=0)
    differs = np.abs(direct[here] - direct[there]) > CUT * np.maximum(total[here], total[there])
    return np.flatnonzero(np.bincount(here, differs, len(texels)))


def _parts(atlas, texels, ids, places):
    """So many places within texels ids (K,), as far as their charts have them: which of the ids (N,), which half of its
    places (N,), row of the atlas (N,), and weights (N, 3) of its corners."""
    width, height = atlas.size.max(axis=0)
    key = (texels.image[ids].astype(np.int64) * height + texels.line[ids]) * width + texels.column[ids]
    order = np.argsort(key)
    chart = atlas.chart[texels.row[ids]]
    found = [(np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 3)))]
    step = np.stack(lattice(places), axis=1)
    for row, column, line, _, _ in rasterize(atlas.place, atlas.size[atlas.image]) if len(ids) else ():
        own = (atlas.image[row] * height + line) * width + column
        at = order[np.minimum(np.searchsorted(key[order], own), len(ids) - 1)]
        met = np.flatnonzero((key[at] == own) & (chart[at] == atlas.chart[row]))
        row, at = np.repeat(row[met], places), np.repeat(at[met], places)
        place = np.stack([column[met], line[met]], axis=1)[:, None] + step
        weight, distance = nearest(atlas.place[row], place.reshape(-1, 2))
        inside = distance < ON
        number = (at * places + np.tile(np.arange(places), len(met)))[inside]
        found.append(_first(number, distance[inside], row[inside], weight[inside]))
    number, _, row, weight = _first(*(np.concatenate(part) for part in zip(*found)))
    return number // places, number % places % 2, row, weight


def light_parts(kernel, seed, **places):
    """{"direct": (C, K)} light of sampled sources at the places of a Block, parts of texels, see `average_cut` [W/m^2]."""
    places = Block(**places)
    each = range(len(kernel.sources))
    factor = [unoccluded(kernel.sources, s, places.position, places.normal) for s in each]
    factor = np.stack(factor, axis=1) if factor else np.zeros((len(places), 0))
    return {"direct": direct_light(kernel, places, factor, TESTS, 1, seed)}


def settle_points(kernel, position, normal, edge):
    """{"position" (K, 3), "moved" (K,), "open" (K,)} of surface points: those from which nothing but backs of faces can be
    seen, so that they lie inside something, are moved along the surface past what covers them, if that is near."""
    result = position.copy()
    covered = np.flatnonzero(_covered(kernel, position, normal, FEW))
    covered = covered[_covered(kernel, position[covered], normal[covered], MANY)]
    t1, t2 = tangents(normal[covered])
    best, target = np.full(len(covered), np.inf), position[covered]
    scale = kernel.caster.frame[1]
    for k in range(WAYS):
        turn = 2 * np.pi * (k + 0.5) / WAYS
        way = np.cos(turn) * t1 + np.sin(turn) * t2
        triangle, _, _, distance, back = kernel.caster.hits(
            kernel.caster.start(position[covered], normal[covered]), way.astype(np.float32)
        )
        far = distance.astype(float) / scale
        met = (triangle >= 0) & _backs(kernel, triangle, back) & (far < 1.5 * edge[covered]) & (far < best)
        past = np.where(met, far, 0.0) + BEYOND * edge[covered] + 2 * OFFSET / scale
        place = position[covered] + past[:, None] * way
        met = np.flatnonzero(met)
        met = met[~_covered(kernel, place[met], normal[covered[met]], MANY)]
        best[met], target[met] = far[met], place[met]
    moved, open_ = np.zeros(len(position), bool), np.ones(len(position), bool)
    moved[covered], open_[covered] = np.isfinite(best), np.isfinite(best)
    result[covered] = target
    return {"position": result, "moved": moved, "open": open_}


def _covered(kernel, position, normal, rays):
    """(K,) bool: all of a few rays from points meet backs of faces."""
    local = hemisphere(*lattice(rays))
    t1, t2 = tangents(normal)
    frame = np.stack([t1, t2, normal], axis=1)
    direction = np.einsum("nj,kjd->knd", local, frame).reshape(-1, 3).astype(np.float32)
    origin = np.repeat(kernel.caster.start(position, normal), rays, axis=0)
    triangle, _, _, _, back = kernel.caster.hits(origin, direction)
    return ((triangle >= 0) & _backs(kernel, triangle, back)).reshape(-1, rays).all(axis=1)


def _backs(kernel, triangle, back):
    """(K,) bool: hits on the side of a face whose light is not asked for."""
    return back != kernel.arrays["settle.flipped"][triangle]


@dataclass(frozen=True)
class Seams:
    """Pairs of places in images that are one place of the surface: S of them, as weights of texels.

    left, right: (S, 4) numbers of texels among all images' (image * height + line) * width + column; left_weight,
    right_weight: (S, 4). object: (S, 2) the objects that meet; material: (S, 2) their materials there.
    """

    left: np.ndarray
    right: np.ndarray
    left_weight: np.ndarray
    right_weight: np.ndarray
    object: np.ndarray
    material: np.ndarray

    def in_one_material(self):
        """Those of the Seams where one material goes on: elsewhere a surface may look different on both sides."""
        kept = self.material[:, 0] == self.material[:, 1]
        return Seams(**{name: values[kept] for name, values in vars(self).items()})

    def differences(self, values):
        """(C, S) of values (C, N) at the texels: what the image shows on the left, less that on the right."""
        shown = (
            np.einsum("sk,csk->cs", weight, values[:, texel])
            for texel, weight in ((self.left, self.left_weight), (self.right, self.right_weight))
        )
        left, right = shown
        return left - right


def find_seams(scene, atlas, flipped, caster):
    """The Seams of an atlas: along every edge where a chart ends, the places where the surface goes on in another chart
    or object, facing the same way. caster: a RayCaster of the scene."""
    row, end = _rims(scene, atlas)
    a, b = (scene.vertices[scene.triangles[atlas.triangle[row], (end + k) % 3]] for k in (0, 1))
    run = atlas.place[row, (end + 1) % 3] - atlas.place[row, end]
    owner, number = counted(np.maximum(np.ceil(2 * np.sqrt(dot(run, run))), 1).astype(np.int64))
    share = ((number + 0.5) / np.bincount(owner, minlength=len(row))[owner])[:, None]
    row, end = row[owner], end[owner]
    position = (1 - share) * a[owner] + share * b[owner]
    facing = scene.triangle_normal_area[0][atlas.triangle[row]]
    sign = np.where(flipped[scene.triangle_polygon[atlas.triangle[row]]], -1.0, 1.0)[:, None]
    outward = unit(cross(b[owner] - a[owner], facing))
    step = STEP * scene.diagonal
    origin = position + step * (outward + sign * facing)
    triangle, u, v, distance, back = caster.hits(caster.place(origin), (-sign * facing).astype(np.float32))

    rows = np.full(len(scene.triangles), -1)
    rows[atlas.triangle] = np.arange(len(atlas.triangle))
    other = rows[triangle]
    met = (triangle >= 0) & (other >= 0) & (distance < 3.0 * step * caster.frame[1])
    met &= back == flipped[scene.triangle_polygon[triangle]]
    met &= atlas.chart[other] != atlas.chart[row]
    here = np.zeros((len(row), 3))
    here[np.arange(len(row)), end], here[np.arange(len(row)), (end + 1) % 3] = (1 - share)[:, 0], share[:, 0]
    there = np.stack([1 - u - v, u, v], axis=1).astype(float)
    met &= dot(_shading(scene, atlas, row, here), _shading(scene, atlas, other, there)) >= ALIKE
    met = np.flatnonzero(met)
    left, right = _stencils(atlas, row[met], here[met]), _stencils(atlas, other[met], there[met])
    sides = scene.triangle_polygon[atlas.triangle[np.stack([row[met], other[met]], axis=1)]]
    return Seams(left[0], right[0], left[1], right[1], scene.polygon_object[sides], scene.polygon_material[sides])


def _rims(scene, atlas):
    """The edges where charts end: row of the atlas, and the number of the corner where the edge begins, (E,) each."""
    vertex = scene.triangles[atlas.triangle]
    following = np.roll(vertex, -1, axis=1)
    low, high = np.minimum(vertex, following).astype(np.int64), np.maximum(vertex, following).astype(np.int64)
    key = np.column_stack([np.repeat(atlas.chart, 3), low.reshape(-1), high.reshape(-1)])
    edge = numbered(key)
    return np.divmod(np.flatnonzero(np.bincount(edge)[edge] == 1), 3)


def _shading(scene, atlas, row, weight):
    """(K, 3) shading normals at places of the atlas' triangles."""
    corner = scene.triangle_corner[atlas.triangle[row]]
    facing = scene.triangle_normal_area[0][atlas.triangle[row]][:, None]
    return unit(np.einsum("kv,kvd->kd", weight, unit(scene.corner_normal[corner], facing)))


def _stencils(atlas, row, weight):
    """The texels (K, 4) that a bilinear look-up at places of the atlas' triangles reads, and their weights (K, 4)."""
    place = np.einsum("kv,kvd->kd", weight, atlas.place[row]) - 0.5
    low = np.floor(place).astype(np.int64)
    share = place - low
    size = atlas.size[atlas.image[row]]
    width, height = atlas.size.max(axis=0)
    texel, weights = [], []
    for right in (0, 1):
        for up in (0, 1):
            column, line = (np.clip(low[:, k] + step, 0, size[:, k] - 1) for k, step in ((0, right), (1, up)))
            texel.append((atlas.image[row] * height + line) * width + column)
            weights.append(np.abs(1 - right - share[:, 0]) * np.abs(1 - up - share[:, 1]))
    return np.stack(texel, axis=1), np.stack(weights, axis=1)


def make_images(atlas, texels, values, seams=None):
    """A list of I images (height, width, C) float64, line 0 at the bottom, of values (C, P) at texels.

    What no texel covers is filled; across `seams` the light is matched, by the least change of texels that makes the
    differences vanish.
    """
    images, order = [np.zeros((len(values), h, w)) for w, h in atlas.size], np.argsort(texels.image, kind="stable")
    ends = np.searchsorted(texels.image[order], np.arange(len(images) + 1))
    for k, image in enumerate(images):
        own = order[slice(*ends[k : k + 2])]
        known = np.zeros(image.shape[1:], bool)
        line, column = texels.line[own], texels.column[own]
        known[line, column] = True
        for channel, light in zip(image, values):
            channel[line, column] = light[own]
            channel[:] = _filled(channel[None], known)[0]
    if seams is not None and len(seams.left):
        _match(images, seams, *atlas.size.max(axis=0))
    return [np.moveaxis(image, 0, -1) for image in images]


def look_up(atlas, images, row, weight):
    """(K, C) what images show at places of the atlas' triangles, rows (K,) and weights (K, 3), between their texels."""
    texel, share = _stencils(atlas, row, weight)
    shown = np.empty((*texel.shape, images[0].shape[2]))
    for own, k, *place in _of_images(texel, *atlas.size.max(axis=0)):
        shown[own] = images[k][tuple(place)]
    return np.einsum("kn,knc->kc", share, shown)


def _of_images(texel, width, height):
    """Numbers of texels among all images', (...), image by image: where they are one's, its number, their lines and
    columns."""
    image, place = np.divmod(texel, height * width)
    for k in np.unique(image):
        own = image == k
        yield own, k, *np.divmod(place[own], width)


def _filled(values, known):
    """Values (C, H, W) with unknown texels filled: near known ones from their neighbors, elsewhere from coarser images."""
    values, known = np.where(known, values, 0.0), known.copy()
    if not known.any():
        return values
    for _ in range(DILATE):
        if known.all():
            return values
        total, count = np.zeros_like(values), np.zeros(known.shape)
        padded, mask = np.pad(values, ((0, 0), (1, 1), (1, 1))), np.pad(known, 1)
        for y in range(3):
            for x in range(3):
                total += padded[:, y : y + known.shape[0], x : x + known.shape[1]]
                count += mask[y : y + known.shape[0], x : x + known.shape[1]]
        new = ~known & (count > 0)
        values[:, new] = total[:, new] / count[new]
        known |= new
    return _blended(values, known.astype(float))


def _blended(values, weight):
    """Values (C, H, W) with those of weight (H, W) 0 taken from an image of half the size, and so on."""
    if (weight > 0).all() or min(weight.shape) < 2:
        mean = (values * weight).sum(axis=(1, 2), keepdims=True) / max(weight.sum(), TINY)
        return np.where(weight > 0, values, mean)
    h, w = weight.shape
    even = ((0, h % 2), (0, w % 2))
    mass = np.pad(weight, even).reshape((h + 1) // 2, 2, (w + 1) // 2, 2)
    light = np.pad(values * weight, ((0, 0), *even)).reshape(len(values), (h + 1) // 2, 2, (w + 1) // 2, 2)
    mass, light = mass.sum(axis=(1, 3)), light.sum(axis=(2, 4))
    coarse = _blended(light / np.maximum(mass, TINY), np.minimum(mass, 1.0))
    return np.where(weight > 0, values, coarse.repeat(2, axis=1).repeat(2, axis=2)[:, :h, :w])


def _match(images, seams, width, height):
    """Change images (C, H, W) as little as may be, so that the differences across the seams vanish. width, height: of the
    largest, by which the seams count their texels.

    Minimizes MATCH |D x|^2 + |x - values|^2, D the differences, by conjugate gradients.
    """
    texel, index = np.unique(np.concatenate([seams.left, seams.right], axis=1), return_inverse=True)
    index = index.reshape(len(seams.left), 8)
    weight = np.concatenate([seams.left_weight, -seams.right_weight], axis=1)

    def normal_matrix(x):
        across = np.einsum("sk,sk->s", weight, x[index])
        return x + MATCH * np.bincount(index.reshape(-1), (weight * across[:, None]).reshape(-1), len(texel))

    places = list(_of_images(texel, width, height))
    for channel in range(len(images[0])):
        x = np.empty(len(texel))
        for own, k, *place in places:
            x[own] = images[k][(channel, *place)]
        start = x.copy()
        residual = start - normal_matrix(x)
        way, size = residual.copy(), (residual * residual).sum()
        goal = ENOUGH**2 * max((start * start).sum(), TINY)
        for _ in range(ROUNDS):
            if size <= goal:
                break
            image = normal_matrix(way)
            step = size / (way * image).sum()
            x = x + step * way
            residual = residual - step * image
            before, size = size, (residual * residual).sum()
            way = residual + size / before * way
        for own, k, *place in places:
            images[k][(channel, *place)] = np.maximum(x[own], 0.0)
