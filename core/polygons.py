"""Flat polygons seen from a point: clipping, and Lambert's factor.

The arctangent is our own: numpy's differs in the last bit from build to build, and the light must not.
"""

from __future__ import annotations

import numpy as np

from .vectors import TINY, runs

# Rational approximation of (arctan(t) - t) / t^3 in t^2, |t| < 0.66, from the Cephes library (Moshier 1989).
_P = (-8.750608600031904122785e-1, -1.615753718733365076637e1, -7.500855792314704667340e1,
      -1.228866684490136173410e2, -6.485021904942025371773e1)  # fmt: skip
_Q = (1.0, 2.485846490142306297962e1, 1.650270098316988542046e2, 4.328810604912902668951e2,
      4.853903996359136964868e2, 1.945506571482613964425e2)  # fmt: skip


AT_ONCE = 2048  # points at a time, so that what is found of them stays in the cache
HORIZON = 1e-6  # sine of the elevation below which a corner counts as level with the element
BITS = 1e-12  # the same, in units of how far the farthest corner is
PLANE = 1e-9  # height above a polygon, in units of how far a corner is, below which an element lies in its plane


def angle(sine, cosine):
    """Angle in [0, pi] of a sine >= 0 and a cosine with any common factor, float64; 0 where both are 0."""
    size = np.abs(cosine)
    t = np.minimum(sine, size)
    t /= np.maximum(np.maximum(sine, size), TINY)
    steep = t > 0.41421356237309503  # tan(pi / 8)
    t = np.where(steep, (t - 1.0) / (t + 1.0), t)
    z = t * t
    p, q = _P[0] * z, _Q[0] * z
    for k in range(1, 4):
        p += _P[k]
        p *= z
    for k in range(1, 5):
        q += _Q[k]
        q *= z
    p += _P[4]
    q += _Q[5]
    p /= q
    p *= z
    p *= t
    result = t + p
    result += np.where(steep, np.pi / 4, 0.0)
    result = np.where(sine > size, np.pi / 2 - result, result)
    return np.where(cosine < 0, np.pi - result, result)


def clip_polygons(polygon, sides, value):
    """The part of convex polygons on which `value` is positive.

    polygon: (K, V, D) corners, the first sides (K,) of them in use; value: (K, V) a linear function at the corners.
    Returns polygons (K, V + 1, D) and their sides (K,); 0 sides where nothing is left.
    """
    count = polygon.shape[1]
    slot = np.arange(count)
    used = slot < sides[:, None]
    following = np.where(slot + 1 < sides[:, None], slot + 1, 0)
    next_value = np.take_along_axis(value, following, axis=1)
    keep = used & (value >= 0)
    cross = used & ((value >= 0) != (next_value >= 0))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(cross, value / (value - next_value), 0.0)[..., None]
    between = polygon + share * (np.take_along_axis(polygon, following[..., None], axis=1) - polygon)
    both = np.stack([polygon, between], axis=2).reshape(len(polygon), 2 * count, polygon.shape[2])
    wanted = np.stack([keep, cross], axis=2).reshape(len(polygon), 2 * count)
    order = np.argsort(~wanted, axis=1, kind="stable")[:, : count + 1]
    return np.take_along_axis(both, order[..., None], axis=1), wanted.sum(axis=1)


def polygon_factor(points, normals, polygon):
    """Form factor (K,) from surface elements to a convex polygon, 0..1: the share of their light that meets it.

    points, normals: (K, 3). polygon: (V, 3) or (K, V, 3). Clipped at each element's horizon; the polygon's winding
    does not matter. Lambert's formula: F = 1/(2 pi) sum over edges of gamma_k n . (R_k x R_k+1) / |R_k x R_k+1|.
    """
    factor = np.empty(len(points))
    for part in runs(len(points), most=AT_ONCE):
        corners = np.moveaxis(polygon[part] if polygon.ndim == 3 else polygon, -2, 0)
        # Coordinate by coordinate: arrays (V, K) take a third of the time of (K, V, 3).
        ray = [corners[..., d].reshape(len(corners), -1) - points[part, d] for d in range(3)]
        factor[part] = _seen(ray, normals[part].T)
    return np.clip(np.abs(factor), 0.0, 1.0)


def _seen(ray, normal):
    """Lambert's signed sum (K,) over what lies above the horizon of polygons given by rays to their corners, 3 times
    (V, K)."""
    height = _dot(ray, normal)
    # A corner on the horizon, but for the last bits, is on it: of a polygon in the element's own plane nothing is seen,
    # also where the element lies on one of its corners.
    square = _dot(ray, ray)
    np.maximum(HORIZON * HORIZON * square, BITS * BITS * square.max(axis=0), out=square)
    height[height * height <= square] = 0.0
    level, lit = height.min(axis=0) >= 0, height.max(axis=0) > 0
    result = np.zeros(height.shape[1])
    above = np.flatnonzero(level & lit)
    if len(above):
        own = ray if len(above) == len(level) else [np.take(x, above, axis=1) for x in ray]
        result[above] = _lambert(own, [_next(x) for x in own], np.take(normal, above, axis=1))
    partly = np.flatnonzero(~level & lit)
    if len(partly):
        edges = _above_horizon([np.take(x, partly, axis=1) for x in ray], np.take(height, partly, axis=1))
        result[partly] = _lambert(*edges, np.take(normal, partly, axis=1))
    return result


def _above_horizon(ray, height):
    """Starts and ends of the edges, 3 times (V + 1, K), of the part of convex polygons above the horizon, which cuts them.

    Edges below it shrink to nothing; the last one goes along the horizon, from where the outline goes down to where it
    comes up.
    """
    up, following = height >= 0, _next(height)
    cut = up != (following >= 0)
    share = np.where(cut, height, 0.0) / np.where(cut, height - following, 1.0)
    starts, ends = [], []
    for x in ray:
        after = _next(x)
        between = x + share * (after - x)
        down, rise = (np.where(cut & way, between, 0.0).sum(axis=0)[None] for way in (up, ~up))
        starts.append(np.concatenate([np.where(up, x, between), down]))
        ends.append(np.concatenate([np.where(following >= 0, after, between), rise]))
    return starts, ends


def _lambert(start, end, normal):
    """Lambert's signed sum (K,) over edges given by the rays to their starts and ends, 3 times (V, K); normal: (3, K).

    In the polygon's own plane the sum jumps from one side's to the other's, up to 1: a hemisphere that is tilted by a bit
    would see a face that the element lies on. Nothing of it is seen.
    """
    edge = [b - a for a, b in zip(start, end)]  # of small polygons far away, products of two rays hold no digit of it
    turn = [start[i] * edge[j] - start[j] * edge[i] for i, j in ((1, 2), (2, 0), (0, 1))]
    sine = np.sqrt(_dot(turn, turn))
    gamma = angle(sine, _dot(start, end))
    gamma *= _dot(turn, normal)
    gamma /= np.maximum(sine, TINY)
    total = _sum(gamma)
    total[_in_plane(start, [_sum(x) for x in turn])] = 0.0
    return total / (2 * np.pi)


def _in_plane(ray, area):
    """(K,) bool: whether elements lie in the planes of polygons, given by rays to corners, 3 times (V, K), and vector areas
    (3, K)."""
    farthest = _dot(ray, ray).max(axis=0)
    height = _dot([x[0] for x in ray], area)
    return height * height <= PLANE * PLANE * farthest * _dot(area, area)


def _sum(values):
    """(K,) sums of columns (V, K), in this order for any number of them, as a sum over an axis is not."""
    total = values[0].copy()
    for part in values[1:]:
        total += part
    return total


def _next(x):
    """What follows each of the rows of x (V, K), in the round."""
    return np.concatenate([x[1:], x[:1]])


def _dot(a, b):
    """Dot products of vectors that are given coordinate by coordinate."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
