"""Atlases: where the surface of a scene lies in images.

Owns the charts of triangles that have no UV map, their packing (by xatlas), the reading of UV maps that exist, and
the check of both: what overlaps, what lies outside, what has no area.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil, sqrt
from time import perf_counter

import numpy as np

from .graphs import components, linked
from .points import group_corners
from .records import from_arrays
from .vectors import TINY, counted, dot, numbered, unit

LARGEST = 16384  # texels along an image's side
SMOOTH_EDGE = 0.766044443118978  # cosine of 40 degrees: charts go on across an edge that bends less
CLEAR = 1e-3  # how far inside two triangles [texels] a texel's center lies if they overlap
OUTSIDE = 1e-4  # by how much a UV map may leave the unit square
NO_AREA = 1e-9  # of the unit square, or of a texel
MOST_CHECKED = 1e6  # texels that are looked at in all, if the images have no more
CHECKED = 1024  # least size of the grid on which overlaps are looked for
FINE = 20_000  # triangles of a scene from which xatlas' own charts would take longer than the bake
NEARLY = 3e-4  # 1 - cosine between neighbors that xatlas takes for one plane, however far the surface bends in all
EXACTLY = 1e-7  # the same, if they are one plane
VOTES = 2  # rounds in which single triangles join the side that their neighbors face


class NoUnwrapper(Exception):
    """xatlas is not there; the message says what to do."""


@dataclass(frozen=True)
class Atlas:
    """The places of K triangles of a scene in I images, in texels; the origin is an image's bottom left corner.

    names: (I,) objects, or ("atlas",). size: (I, 2) int64 width and height. triangle: (K,) of the scene. image: (K,).
    chart: (K,) numbered through all images. place: (K, 3, 2) float64 the triangles' corners. unwrapped: the charts were
    made here, not read from a UV map. seconds: that this took. findings: (object, finding, action) of what is wrong.
    """

    names: tuple
    size: np.ndarray
    triangle: np.ndarray
    image: np.ndarray
    chart: np.ndarray
    place: np.ndarray
    unwrapped: bool
    seconds: float = 0.0
    findings: tuple = ()

    @property
    def texels(self):
        """About how many texels hold surface."""
        return float(np.abs(_signed_areas(self.place)).sum())

    @property
    def uv(self):
        """(K, 3, 2) the places as shares of the images' sizes, as in a UV map."""
        return self.place / self.size[self.image][:, None]


def make_atlas(scene, density=16.0, size=None, together=False, padding=2):
    """An Atlas of the scene's written objects, unwrapped by xatlas.

    density: texels per meter; size: of square images [texels], in place of a density. together: one image for all.
    padding: texels between charts. Raises NoUnwrapper without xatlas, ValueError if an image would be too large.
    """
    begun = perf_counter()
    xatlas = _xatlas()
    triangle, owner, names = _mapped(scene, together)
    flat, chart = np.zeros((len(triangle), 3, 2)), np.zeros(len(triangle), np.int64)
    object = scene.polygon_object[scene.triangle_polygon[triangle]]
    for number in np.unique(object):
        mine = np.flatnonzero(object == number)
        flat[mine], own = _charts(xatlas, scene, triangle[mine], len(triangle) > FINE)
        chart[mine] = own + chart.max(initial=-1) + 1
    place, sizes = np.zeros_like(flat), np.ones((len(names), 2), np.int64)
    for number in range(len(names)):
        mine = np.flatnonzero(owner == number)
        if len(mine):
            place[mine], sizes[number] = _pack(xatlas, flat[mine], chart[mine], density, size, padding, names[number])
    atlas = _checked(scene, Atlas(names, sizes, triangle, owner, chart, place, True))
    return replace(atlas, seconds=perf_counter() - begun)


def read_atlas(scene, corner_uv, density=16.0, size=None, together=False):
    """An Atlas of a UV map that is there. corner_uv: (C, 2) of the scene's corners. The others as for `make_atlas`; with
    a density, the images get as many texels as give it on average."""
    begun = perf_counter()
    triangle, owner, names = _mapped(scene, together)
    corner = scene.triangle_corner[triangle]
    uv = corner_uv[corner]
    uv = np.where(np.isfinite(uv), uv, 0.0)
    sizes = np.ones((len(names), 2), np.int64)
    shape = _signed_areas(uv)
    for number, name in enumerate(names):
        mine = owner == number
        covered = np.abs(shape[mine]).sum()
        area = scene.triangle_normal_area[1][triangle[mine]].sum()
        side = size or ceil(density * sqrt(area / covered) if covered > NO_AREA else 1)
        sizes[number] = _limited(side, side, name)
    key = numbered(np.column_stack([owner.repeat(3), corner_uv_keys(scene, corner, uv)]))
    chart = components(*linked(np.arange(len(triangle)).repeat(3), key), len(triangle))
    place = uv * sizes[owner][:, None]
    atlas = _checked(scene, Atlas(names, sizes, triangle, owner, chart, place, False))
    return replace(atlas, seconds=perf_counter() - begun)


def unpacked_atlas(prefix, arrays):
    """The Atlas that `records.to_arrays` packed."""
    atlas = from_arrays(Atlas, prefix, arrays)
    return replace(
        atlas,
        names=tuple(map(str, atlas.names)),
        unwrapped=bool(atlas.unwrapped),
        seconds=float(atlas.seconds),
        findings=tuple(tuple(map(str, finding)) for finding in atlas.findings),
    )


def corner_uv_keys(scene, corner, uv):
    """(3 K, 3) numbers that corners of triangles (K, 3) share if they are one vertex at one place of a UV map."""
    vertex = scene.corner_vertex[corner].reshape(-1)
    return np.column_stack([vertex, np.rint(uv.reshape(-1, 2) * (1 << 20)).astype(np.int64)])


def _xatlas():
    try:
        import xatlas
    except ImportError:
        raise NoUnwrapper(
            "xatlas, which unwraps meshes, is not there for this Python: give the objects a UV map and name it with "
            "--uv, or use Blender from blender.org"
        ) from None
    return xatlas


def _mapped(scene, together):
    """The usable triangles (K,) of written objects, the image (K,) of each, and the images' names."""
    object = scene.polygon_object[scene.triangle_polygon]
    triangle = np.flatnonzero(scene.usable & scene.written[object])
    if together:
        return triangle, np.zeros(len(triangle), np.int64), ("atlas",)
    present, owner = np.unique(object[triangle], return_inverse=True)
    return triangle, owner.reshape(-1), tuple(scene.objects[o] for o in present)


def _charts(xatlas, scene, triangle, fine):
    """Charts of one object's triangles (K,): their corners in the plane (K, 3, 2) [m], and the chart (K,) of each.
    fine: the scene has too many triangles for xatlas to find them."""
    normal = scene.corner_normal[scene.triangle_corner[triangle]].reshape(-1, 3)
    facing = scene.triangle_normal_area[0][triangle]
    normal = unit(normal, facing.repeat(3, axis=0))
    vertex = scene.triangles[triangle].reshape(-1)
    group = group_corners(vertex, normal, SMOOTH_EDGE)
    count = int(group.max(initial=-1)) + 1
    index = group.reshape(-1, 3)
    first, second = _edges(index)
    bend = 1.0 - dot(facing[first], facing[second])
    projected = (facing, first, second)
    if fine or ((bend > EXACTLY) & (bend < NEARLY)).any():
        return _projected(scene, triangle, *projected)

    position = np.zeros((count, 3))
    edge = np.sqrt(scene.triangle_normal_area[1][triangle].max())
    meter = _near(edge)
    position[group] = (scene.vertices[vertex] - scene.vertices[vertex[0]]) / meter
    mean = unit(np.stack([np.bincount(group, normal[:, k], count) for k in range(3)], axis=1))
    atlas = xatlas.Atlas()
    atlas.add_mesh(position.astype(np.float32), index.astype(np.uint32), mean.astype(np.float32))
    charting, packing = xatlas.ChartOptions(), xatlas.PackOptions()
    charting.normal_seam_weight = 1001.0  # from 1000 on no chart goes across a sharp edge
    packing.texels_per_unit = 64.0 * meter / edge  # so fine that the snapping to texels does not matter
    atlas.generate(charting, packing)
    _, index, uv = atlas[0]
    flat = uv[index].astype(float) * (atlas.width, atlas.height) / atlas.texels_per_unit
    if not np.isfinite(flat).all():  # slivers beyond what its numbers hold
        return _projected(scene, triangle, *projected)
    chart = components(*linked(np.arange(len(triangle)).repeat(3), index.reshape(-1)), len(triangle))
    # Charts come snapped to whole texels: back to the size of their surface.
    area, covered = scene.triangle_normal_area[1][triangle], np.abs(_signed_areas(flat))
    scale = np.sqrt(np.bincount(chart, area) / np.maximum(np.bincount(chart, covered), TINY))
    return flat * scale[chart][:, None, None], chart


def _edges(index):
    """Pairs (first, second) of triangles (K, 3) that share an edge of two vertices."""
    ends = np.sort(np.stack([index, np.roll(index, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    key = ends[:, 0].astype(np.int64) * (int(index.max(initial=0)) + 1) + ends[:, 1]
    return linked(np.arange(len(index)).repeat(3), key)


def _projected(scene, triangle, facing, first, second):
    """Charts of a dense mesh: parts that face one of six ways, projected along it. No triangle shrinks below 0.57."""
    axis = np.abs(facing).argmax(axis=1)
    way = 2 * axis + (np.take_along_axis(facing, axis[:, None], axis=1)[:, 0] < 0)
    for _ in range(VOTES):
        ballot = np.zeros((len(triangle), 6))
        np.add.at(ballot, (np.concatenate([first, second]), way[np.concatenate([second, first])]), 1.0)
        sign = np.where(np.arange(6) % 2, -1.0, 1.0)
        slope = facing[:, np.arange(6) // 2] * sign
        ballot[slope < 0.5] = 0.0
        ballot[np.arange(len(way)), way] += 1.5
        way = ballot.argmax(axis=1)
    alike = way[first] == way[second]
    chart = components(first[alike], second[alike], len(triangle))
    corner = scene.vertices[scene.triangles[triangle]]
    across = np.array([(1, 2), (2, 1), (2, 0), (0, 2), (0, 1), (1, 0)])[way]
    return np.take_along_axis(corner, across[:, None], axis=2), chart


def _pack(xatlas, flat, chart, density, size, padding, name):
    """Places (K, 3, 2) [texels] of charts given by triangles (K, 3, 2) [m] in one image, and its width and height."""
    index = numbered(np.column_stack([chart.repeat(3), _bits(flat)]))
    place = np.zeros((index.max() + 1, 2), np.float32)
    # Charts start at 0: far from it float32 would lose their shape.
    low = np.full((chart.max() + 1, 2), np.inf)
    np.minimum.at(low, chart.repeat(3), flat.reshape(-1, 2))
    area = np.abs(_signed_areas(flat)).sum()
    meter = _near(sqrt(area))
    place[index] = (flat - low[chart][:, None]).reshape(-1, 2) / meter
    density = density if size is None else size * sqrt(0.9 / max(area, TINY))
    side = size or density * sqrt(area)
    _limited(side, side, name)
    for _ in range(200):
        atlas = xatlas.Atlas()
        atlas.add_uv_mesh(place, index.reshape(-1, 3).astype(np.uint32), chart[:, None].astype(np.uint32))
        packing = xatlas.PackOptions()
        packing.texels_per_unit, packing.resolution = density * meter, size or 0
        packing.padding, packing.bilinear = padding, True
        atlas.generate(xatlas.ChartOptions(), packing)
        if size is None or atlas.atlas_count == 1:
            break
        density *= 0.95
    if atlas.atlas_count > 1:
        raise ValueError(
            f"{name}: its charts do not fit into {size} x {size} texels; ask for a larger --size, or less --padding"
        )
    _, packed, uv = atlas[0]
    shape = _limited(size or atlas.width, size or atlas.height, name)
    place = uv[packed].astype(float) * (atlas.width, atlas.height)
    return np.where(np.isfinite(place), place, 0.0), shape  # much smaller than a texel: no numbers


def _near(length):
    """The power of two next above a length, as a unit for xatlas, which takes what is below some 1e-6 for nothing."""
    return float(np.ldexp(1.0, np.frexp(max(length, TINY))[1]))


def _bits(flat):
    """(3 K, 2) the bits of corners (K, 3, 2), as numbers that are equal where the corners are."""
    return np.ascontiguousarray(flat.reshape(-1, 2) + 0.0).view(np.int64)


def _limited(width, height, name):
    """The size of an image; raises ValueError if it is too large."""
    if max(width, height) > LARGEST:
        raise ValueError(
            f"{name}: its lightmap would be {int(width)} x {int(height)} texels, {LARGEST} a side are the most; ask for"
            " fewer --texels-per-meter, or a smaller --size"
        )
    return max(int(width), 1), max(int(height), 1)


def _signed_areas(place):
    """(K,) areas of triangles (K, 3, 2), negative where they run clockwise."""
    a, b = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def rasterize(place, size, block=1 << 16):
    """The texels that triangles (K, 3, 2) touch, however little: a generator of blocks of triangle (N,) int64, column
    and row (N,) int64, and weights (N, 3) of the corners at the place of the triangle nearest to the texel's center, with
    its distance (N,) [texels], 0 inside. size: (K, 2) width and height beyond which no texel is wanted.

    Of each row of texels, the strip's part of the triangle has a lowest and a highest x; the texels between them are
    touched, and no others.
    """
    if not len(place):
        return
    low, high = np.floor(place[..., 1].min(axis=1)), np.ceil(place[..., 1].max(axis=1))
    low, high = (
        np.maximum(low, 0.0).astype(np.int64),
        np.minimum(np.maximum(high, low + 1), size[:, 1]).astype(np.int64),
    )
    owner, step = counted(np.maximum(high - low, 0))
    row = low[owner] + step
    for part in range(0, len(owner), block >> 3):
        own, y = owner[part : part + (block >> 3)], row[part : part + (block >> 3)]
        left, right = _spans(place[own], y.astype(float))
        first, last = np.floor(left), np.ceil(right)
        last = np.minimum(np.maximum(last, first + 1), size[own, 0]).astype(np.int64)
        first = np.maximum(first, 0.0).astype(np.int64)
        count = np.maximum(last - first, 0)
        for rows in _runs(count, block):
            which, step = counted(count[rows])
            triangle, column, line = own[rows][which], first[rows][which] + step, y[rows][which]
            center = np.stack([column + 0.5, line + 0.5], axis=1)
            weight, distance = nearest(place[triangle], center)
            yield triangle, column, line, weight, distance


def _runs(count, block):
    """Slices that cut rows of so many items (R,) into blocks."""
    upto = np.cumsum(count)
    edge = np.searchsorted(upto, np.arange(block, upto[-1] + block, block), side="left") + 1
    edge = np.unique(np.concatenate([[0], np.minimum(edge, len(count))]))
    return [slice(a, b) for a, b in pairwise(edge)]


def _spans(place, y):
    """Lowest and highest x (R,) of triangles (R, 3, 2) within the strips y to y + 1 (R,)."""
    following = np.roll(place, -1, axis=1)
    left, right = np.full(len(y), np.inf), np.full(len(y), -np.inf)
    rise = following[..., 1] - place[..., 1]
    for level in (y[:, None], y[:, None] + 1.0):
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (level - place[..., 1]) / rise
            x = place[..., 0] + share * (following[..., 0] - place[..., 0])
        met = (share >= 0) & (share <= 1)
        left = np.minimum(left, np.where(met, x, np.inf).min(axis=1))
        right = np.maximum(right, np.where(met, x, -np.inf).max(axis=1))
    inside = (place[..., 1] >= y[:, None]) & (place[..., 1] <= y[:, None] + 1.0)
    left = np.minimum(left, np.where(inside, place[..., 0], np.inf).min(axis=1))
    right = np.maximum(right, np.where(inside, place[..., 0], -np.inf).max(axis=1))
    found = left <= right
    return np.where(found, left, place[:, 0, 0]), np.where(found, right, place[:, 0, 0])


def nearest(place, point):
    """Weights (N, 3) of the corners of triangles (N, 3, 2) at the place in them nearest to points (N, 2), and its distance
    (N,), 0 inside."""
    a, b = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]
    to = point - place[:, 0]
    det = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (to[:, 0] * b[:, 1] - to[:, 1] * b[:, 0]) / det
        t = (a[:, 0] * to[:, 1] - a[:, 1] * to[:, 0]) / det
    weight = np.stack([1 - s - t, s, t], axis=1)
    distance = np.zeros(len(place))
    out = np.flatnonzero(~(np.isfinite(weight).all(axis=1) & (weight.min(axis=1, initial=1.0) >= 0)))
    best = np.full(len(out), np.inf)
    for k in range(3):
        start, along = place[out, k], place[out, (k + 1) % 3] - place[out, k]
        share = np.clip(dot(point[out] - start, along) / np.maximum(dot(along, along), TINY), 0.0, 1.0)
        gap = point[out] - start - share[:, None] * along
        apart = np.sqrt(dot(gap, gap))
        closer = apart < best
        best[closer] = apart[closer]
        rows = out[closer]
        weight[rows] = 0.0
        weight[rows, k], weight[rows, (k + 1) % 3] = 1 - share[closer], share[closer]
    distance[out] = best
    return weight, distance


def _checked(scene, atlas):
    """The atlas with findings, per object, about faces that overlap, lie outside or have no area in it."""
    polygon = scene.triangle_polygon[atlas.triangle]
    object = scene.polygon_object[polygon]
    uv = atlas.uv
    outside = ((uv < -OUTSIDE) | (uv > 1 + OUTSIDE)).any(axis=(1, 2))
    empty = np.abs(_signed_areas(atlas.place)) <= NO_AREA
    overlap = np.zeros(len(polygon), bool)
    overlap[_overlapping(atlas)] = True
    findings = []
    for bad, text, action in (
        (overlap, "{} faces overlap others in the UV map", "they share texels, and show one another's light"),
        (outside, "{} faces lie outside the UV map's unit square", "their light is not in the image"),
        (empty, "{} faces have no area in the UV map", "they show the light of a single texel"),
    ):
        for o in np.unique(object[bad]):
            faces = len(np.unique(polygon[bad & (object == o)]))
            findings.append((scene.objects[o], text.format(faces), action))
    return replace(atlas, findings=tuple(findings))


def _overlapping(atlas):
    """Rows of the atlas' triangles that share the inside of a texel of a fine enough grid with another triangle."""
    fine = np.maximum(CHECKED / atlas.size.max(axis=1), 1.0)
    covered = (np.abs(_signed_areas(atlas.place)) * fine[atlas.image] ** 2).sum()
    fine = np.maximum(fine * sqrt(min(MOST_CHECKED / max(covered, 1.0), 1.0)), 1.0)
    # Faces that lie on one another many times, as those of a tiled map, are found on a coarser grid as well.
    most = max(MOST_CHECKED, float(atlas.size.prod(axis=1).sum()))
    fine *= sqrt(min(most / max((np.abs(_signed_areas(atlas.place)) * fine[atlas.image] ** 2).sum(), 1.0), 1.0))
    place = atlas.place * fine[atlas.image][:, None, None]
    size = np.ceil(atlas.size * fine[:, None]).astype(np.int64)
    width, height = size.max(axis=0)
    texel, owner = [], []
    for triangle, column, row, _, distance in rasterize(place, size[atlas.image]):
        center = np.stack([column + 0.5, row + 0.5], axis=1)
        inside = (distance == 0) & (_depth(place[triangle], center) > CLEAR)
        texel.append(((atlas.image[triangle] * height + row) * width + column)[inside])
        owner.append(triangle[inside])
    texel, owner = np.concatenate([np.zeros(0, np.int64), *texel]), np.concatenate([np.zeros(0, np.int64), *owner])
    order = np.argsort(texel, kind="stable")
    same = texel[order][1:] == texel[order][:-1]
    return np.unique(np.concatenate([owner[order[:-1][same]], owner[order[1:][same]]]))


def _depth(place, point):
    """(N,) how deep points (N, 2) lie inside triangles (N, 3, 2): the least distance from an edge."""
    along = np.roll(place, -1, axis=1) - place
    to = point[:, None] - place
    size = np.sqrt(dot(along, along))
    return (np.abs(along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]) / np.maximum(size, TINY)).min(axis=1)
