"""Form-factor rows: where the light that leaves a patch side arrives.

Owns the two estimators of a row, and the direct light of patch sides. `rays`: n cosine-distributed rays from points
over the patch; a row is its n hits, its entries sum to exactly 1 with what escaped. `analytic`: Lambert's factor from
points on the patch to every other patch that it faces, times the share of shadow rays between the two that get through;
its cost grows with the number of patches that are faced, and it has no noise where nothing stands in the way.
"""

from __future__ import annotations

import numpy as np

from .guide import GUIDED, Aim
from .lights import FLAT, SKY, SUN, patch_irradiance, unoccluded
from .patches import draw_on_patches
from .polygons import polygon_factor
from .sampling import R4, fraction, hemisphere, lattice4, scatter, tangents
from .vectors import by_coordinate, dot, length, ratio, runs

ROW, DIRECT, SHADOW, CROWD = 1, 2, 5, 0  # salts: the samples of rows and of direct light have nothing in common
UNEVEN = 8  # times as many places on patches near a source, or on the rim of its beam
CROWDED = 4  # times as many, each for one of a crowd of sources
# Gauss-Legendre nodes and weights on [0, 1].
GAUSS = {
    1: ((0.5,), (1.0,)),
    2: ((0.2113248654051871, 0.7886751345948129), (0.5, 0.5)),
    4: (
        (0.06943184420297371, 0.33000947820757187, 0.6699905217924281, 0.9305681557970263),
        (0.17392742256872692, 0.32607257743127307, 0.32607257743127307, 0.17392742256872692),
    ),
}
SHADOW_RAYS = 4  # between a shooter and every patch that it faces
SHADOW_MORE = 12  # where some of them got through and some did not


def trace_rows(kernel, sides, rays, seed):
    """{"hits": (K, rays) int32} sides met by rays from patch sides (K,), -1 where a ray escaped."""
    hits = np.empty((len(sides), rays), np.int32)
    for part in runs(len(sides), rays):
        position, normal, direction = _row_rays(kernel, sides[part], rays, seed)
        origin = kernel.caster.start(position, normal).reshape(-1, 3)
        hits[part] = kernel.hits(origin, direction.reshape(3, -1).T).side.reshape(-1, rays)
    return {"hits": hits}


def guide_rows(kernel, sides, rays, seed, light):
    """{"guided": (C, K)} irradiance [W/m^2] that light (C, G) of the sides that rays are guided to gives patch sides
    (K,), by so many rays over the hemisphere and as many guided ones."""
    guided = np.empty((len(light), len(sides)))
    light = np.column_stack([light[:, kernel.guide.order], np.zeros(len(light))])  # of all others
    for part in runs(len(sides), 2 * rays):
        own = sides[part]
        position, normal, direction = _row_rays(kernel, own, rays, seed)
        aim = Aim(kernel.guide, kernel.patches.centroid[own >> 1], normal[:, 0])
        pick, a, b, _ = _shifted(own, rays, seed, GUIDED)
        direction = np.concatenate([direction, aim.rays(position, pick, a, b)], axis=2)
        position = np.concatenate([position, position], axis=1)
        normal = np.concatenate([normal, normal], axis=1) if normal.shape[1] > 1 else normal
        origin = kernel.caster.start(position, normal).reshape(-1, 3)
        hit = kernel.hits(origin, direction.reshape(3, -1).T)
        weight = aim.weights(hit, direction, normal, rays)
        number = kernel.guide.numbers(hit.side).reshape(weight.shape)
        for channel, result in zip(light, guided):
            np.einsum("kn,kn->k", weight, np.take(channel, number, mode="wrap"), out=result[part])
    return {"guided": guided}


def analytic_rows(kernel, sides, seed):
    """Rows of patch sides (K,) as what they send to whom: "start" (K + 1,), "target" (Z,) int32 sides and "share" (Z,)."""
    targets, shares = zip(*(_analytic_row(kernel, side, seed) for side in sides))
    start = np.concatenate([[0], np.cumsum([len(t) for t in targets])])
    return {"start": start, "target": np.concatenate(targets).astype(np.int32), "share": np.concatenate(shares)}


def _analytic_row(kernel, side, seed):
    """Sides (Z,) that a side sends light to, and the share (Z,) that each gets. Never more than 1 in all."""
    patches = kernel.patches
    shooter, normal = side >> 1, patches.normal[side >> 1] * (1 - 2 * (side & 1))
    center, size = patches.centroid[shooter], np.sqrt(patches.area[shooter])
    corners, owner = kernel.element_corners
    facing = (dot(corners - center, normal) > 1e-6 * size).any(axis=1)
    facing &= owner != shooter
    element = np.flatnonzero(facing)

    # Lambert's factor at points on the shooter, more the closer the receiver is; where a smaller receiver is close,
    # at points on the receiver, by reciprocity: a strip beside a wide floor is seen from few points of the floor.
    middle = corners[element].mean(axis=1)
    reach = length(corners[element] - middle[:, None]).max(axis=1)
    distance = np.maximum(length(middle - center) - reach, 0.0) / size
    area = patches.element_area[element]
    swap = (distance < 2.0) & (area < patches.area[shooter])
    factor = np.zeros(len(element))
    for order, near in ((1, distance >= 5.8), (2, (distance >= 1.3) & (distance < 5.8)), (4, distance < 1.3)):
        chosen = np.flatnonzero(near & ~swap)
        if len(chosen):
            factor[chosen] = _factor_from(kernel, shooter, normal, corners[element[chosen]], order)
    chosen = np.flatnonzero(swap)
    if len(chosen):
        factor[chosen] = _factor_to(kernel, shooter, normal, element[chosen]) * area[chosen] / patches.area[shooter]
    share = np.bincount(owner[element], factor, len(patches))
    receiver = np.flatnonzero(share > 0)
    behind = dot(center - patches.centroid[receiver], patches.normal[receiver]) < 0

    # The visible share, by rays between the two patches; more of them where they disagree.
    seen, weight = _passing(kernel, side, receiver, behind, 0, SHADOW_RAYS, seed)
    mixed = np.flatnonzero((seen > 0) & (seen < weight))
    if len(mixed):
        more = _passing(kernel, side, receiver[mixed], behind[mixed], SHADOW_RAYS, SHADOW_MORE, seed)
        seen[mixed] += more[0]
        weight[mixed] += more[1]
    share = share[receiver] * ratio(seen, weight)
    if kernel.coverage is not None:  # the rest goes on to what lies behind
        share *= kernel.coverage[receiver]
    sent = np.flatnonzero(share)
    return 2 * receiver[sent] + behind[sent], share[sent] / max(share.sum(), 1.0)


def _factor_from(kernel, shooter, normal, corners, order):
    """(K,) form factors from a patch to polygons (K, 4, 3): Lambert's, averaged over order^2 Gauss points on it."""
    node, weight = GAUSS[order]
    a, b = (x.reshape(1, -1) for x in np.meshgrid(node, node))
    places, _ = draw_on_patches(kernel.patches, np.array([shooter]), a, b)
    up = np.broadcast_to(normal, (len(corners), 3))
    factor = np.zeros(len(corners))
    for place, w in zip(places[0], np.multiply.outer(weight, weight).reshape(-1)):
        factor += w * polygon_factor(np.broadcast_to(place, (len(corners), 3)), up, corners)
    return factor


def _factor_to(kernel, shooter, normal, element):
    """(K,) form factors from elements (K,) to a patch, on the side of it that `normal` is of."""
    corners, owner = kernel.element_corners
    node, weight = GAUSS[4]
    frame, square = kernel.patches.element_frame[element], kernel.patches.element_square[element]
    facing = kernel.patches.normal[owner[element]]
    toward = kernel.patches.centroid[shooter] - corners[element].mean(axis=1)
    facing = np.where(dot(toward, facing)[:, None] < 0, -facing, facing)
    factor = np.zeros(len(element))
    for a, wa in zip(node, weight):
        for b, wb in zip(node, weight):
            fold = ~square & (a + b > 1.0)
            u, v = np.where(fold, 1 - a, a)[:, None], np.where(fold, 1 - b, b)[:, None]
            place = frame[:, 0] + u * frame[:, 1] + v * frame[:, 2]
            seen = dot(place - kernel.patches.centroid[shooter], normal) > 0
            for e in range(*kernel.patches.element_start[shooter : shooter + 2]):
                factor += wa * wb * seen * polygon_factor(place, facing, corners[e])
    return factor


def _passing(kernel, side, receiver, behind, first, rays, seed):
    """Sums of the weights (K,) of the rays `first` to `first + rays` from a side to patches (K,), seen from their back
    or front (K,) bool: of those that get through, and of all. A weight is cos cos' / r^2."""
    number = first + np.arange(rays)
    shift = scatter((receiver[:, None] + np.int64(side) * len(kernel.patches)) * 4 + np.arange(4), SHADOW + 8 * seed)
    a, b, c, d = (fraction(number * R4[k] + shift[:, k, None]) for k in range(4))
    start, up = _places(kernel, np.full(len(receiver), side), a, b)
    stop, facing = _places(kernel, 2 * receiver + behind, c, d)
    toward = stop - start
    square = dot(toward, toward)
    weight = np.maximum(dot(toward, up), 0.0) * np.maximum(-dot(toward, facing), 0.0)
    weight = ratio(weight, square * square)
    ends = (kernel.caster.start(x, n).reshape(-1, 3) for x, n in ((start, up), (stop, facing)))
    free = ~kernel.caster.blocked(*ends).reshape(-1, rays)
    return np.einsum("kn->k", weight * free), np.einsum("kn->k", weight)


def light_patches(kernel, sides, samples, seed):
    """{"direct": (C, K)} mean irradiance [W/m^2] that the sources give patch sides (K,), from `samples` places each, and
    UNEVEN times as many where they do not all get the same, for a source is near or its beam ends there; and which of them
    a source lights in part: "partly" (E,), with the other fields "source", "mean" and "whole" of the Edges."""
    direct = np.zeros((kernel.sources.strength.shape[1], len(sides)))
    uneven, turned = np.zeros(len(sides), bool), _turned(kernel, sides)
    edges = np.full(len(sides), -1, np.int16), np.zeros(len(sides)), np.zeros(len(sides))

    def light(chosen, samples):
        found, uneven[chosen], edge = _light(kernel, sides[chosen], samples, seed)
        direct[:, chosen] = found.T
        for values, new in zip(edges, edge):
            values[chosen] = new

    for part in runs(len(turned), samples):
        light(turned[part], samples)
    again = np.flatnonzero(uneven)
    for part in runs(len(again), UNEVEN * samples):
        light(again[part], UNEVEN * samples)
    if kernel.crowd is not None:
        for part in runs(len(sides), CROWDED * samples):
            direct[:, part] += _crowd(kernel, sides[part], CROWDED * samples, seed)
    there = np.flatnonzero(edges[0] >= 0)
    return {
        "direct": direct,
        "partly": sides[there],
        **dict(zip(("source", "mean", "whole"), (e[there] for e in edges))),
    }


def _turned(kernel, sides):
    """Those of patch sides (K,), as numbers from 0 to K - 1, that are turned to one of the sources. To tell takes a tenth of
    the time of places on them, and two sides in five of a bake are turned away from all; of patches that are not all in one
    plane nobody knows."""
    patches, sources, own = kernel.patches, kernel.sources, sides >> 1
    normal = by_coordinate(np.take(patches.normal, own, axis=0) * np.where(sides & 1, -1.0, 1.0)[:, None])
    centroid = by_coordinate(np.take(patches.centroid, own, axis=0))
    turned = np.diff(patches.element_start)[own] > 1
    for s in range(len(sources)):
        if sources.kind[s] in (SUN, SKY):
            turned |= unoccluded(sources, s, centroid, normal) > 0
            continue
        corners = sources.polygon(s) if sources.kind[s] == FLAT else sources.position[s : s + 1]
        for corner in corners:
            turned |= dot(corner - centroid, normal) > -sources.radius[s]
    return np.flatnonzero(turned)


def _light(kernel, sides, samples, seed):
    """What `patch_irradiance` says of patch sides (K,)."""
    a, b, *place = _shifted(sides, samples, seed, DIRECT)
    position, normal = _places(kernel, sides, *place)
    centroid = kernel.patches.centroid[sides >> 1]
    return patch_irradiance(kernel.sources, kernel.caster, centroid, position, normal, a, b, kernel.shadowed)


def _crowd(kernel, sides, samples, seed):
    """(C, K) mean irradiance of patch sides (K,) by a crowd of sources, of which one is picked for each of so many
    places."""
    a, b, *place = _shifted(sides, samples, seed, CROWD)
    position, normal = _places(kernel, sides, *place)
    center, normal = kernel.patches.centroid[sides >> 1], np.broadcast_to(normal, position.shape)
    extent = length(position - center[:, None]).max(axis=1)
    return kernel.crowd.on_patches(kernel.caster, center, extent, position, normal, a, b, kernel.occluded)


def _row_rays(kernel, sides, rays, seed):
    """Where the rays of rows start, (K, n, 3) float64, the normals there (K, 1 or n, 3), and their directions (3, K, n)
    float32."""
    u, v, a, b = _shifted(sides, rays, seed, ROW)
    position, normal = _places(kernel, sides, a, b)
    local = hemisphere(u, v).astype(np.float32)
    t1, t2, up = (axis.astype(np.float32) for axis in (*tangents(normal), normal))
    direction = np.empty((3, *u.shape), np.float32)
    for k in range(3):
        direction[k] = t1[..., k] * local[..., 0]
        direction[k] += t2[..., k] * local[..., 1]
        direction[k] += up[..., k] * local[..., 2]
    return position, normal, direction


def _shifted(sides, count, seed, salt):
    """(4, K, count) lattice points in the unit 4-cube, shifted for each side."""
    keys = np.asarray(sides, np.int64)[:, None] * 4 + np.arange(4)
    shift = scatter(keys, salt + 8 * seed)
    return fraction(lattice4(count)[:, None, :] + shift.T[:, :, None])


def _places(kernel, sides, a, b):
    """Positions (K, n, 3) of places on patch sides, given by a, b (K, n), and the sides' normals there (K, 1 or n, 3)."""
    position, normal = draw_on_patches(kernel.patches, sides >> 1, a, b)
    return position, np.where((sides & 1)[:, None, None] == 1, -normal, normal)
