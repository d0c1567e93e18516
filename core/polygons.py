"""Flat polygons seen from a point: clipping, and Lambert's factor.

The arctangent is our own: numpy's differs in the last bit from build to build, and the light must not.
"""

from __future__ import annotations

import numpy as np

from .vectors import cross, dot, length, ratio

# Rational approximation of (arctan(t) - t) / t^3 in t^2, |t| < 0.66, from the Cephes library (Moshier 1989).
_P = (-8.750608600031904122785e-1, -1.615753718733365076637e1, -7.500855792314704667340e1,
      -1.228866684490136173410e2, -6.485021904942025371773e1)  # fmt: skip
_Q = (1.0, 2.485846490142306297962e1, 1.650270098316988542046e2, 4.328810604912902668951e2,
      4.853903996359136964868e2, 1.945506571482613964425e2)  # fmt: skip


HORIZON = 1e-6  # sine of the elevation below which a corner counts as level with the element


def angle(sine, cosine):
    """Angle in [0, pi] of a sine >= 0 and a cosine with any common factor, float64; 0 where both are 0."""
    low, high = np.minimum(sine, np.abs(cosine)), np.maximum(sine, np.abs(cosine))
    t = ratio(low, high)
    steep = t > 0.41421356237309503  # tan(pi / 8)
    t = np.where(steep, (t - 1.0) / (t + 1.0), t)
    z = t * t
    p, q = _P[0], _Q[0]
    for k in range(1, 5):
        p = p * z + _P[k]
    for k in range(1, 6):
        q = q * z + _Q[k]
    result = t + t * z * (p / q) + np.where(steep, np.pi / 4, 0.0)
    result = np.where(sine > np.abs(cosine), np.pi / 2 - result, result)
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
    ray = polygon - points[:, None]
    height = np.einsum("kvd,kd->kv", ray, normals)
    # A corner on the horizon, but for the last bits, is on it: of a polygon in the element's own plane nothing is seen.
    height = np.where(np.abs(height) > HORIZON * length(ray), height, 0.0)
    factor = np.zeros(len(points))
    above = (height >= 0).all(axis=1) & (height > 0).any(axis=1)
    factor[above] = _lambert(ray[above], normals[above])
    partly = np.flatnonzero(~above & (height > 0).any(axis=1))
    if len(partly):
        sides = np.full(len(partly), ray.shape[1])
        clipped, sides = clip_polygons(ray[partly], sides, height[partly])
        # Unused slots repeat the last corner used: edges of length 0 add nothing.
        slot = np.minimum(np.arange(clipped.shape[1]), np.maximum(sides - 1, 0)[:, None])
        factor[partly] = _lambert(np.take_along_axis(clipped, slot[..., None], axis=1), normals[partly])
    return np.clip(np.abs(factor), 0.0, 1.0)


def _lambert(ray, normals):
    """Lambert's signed sum (K,) over the edges of polygons given by the rays (K, V, 3) to their corners."""
    following = np.roll(ray, -1, axis=1)
    turn = cross(ray, following)
    sine = length(turn)
    gamma = angle(sine, dot(ray, following))
    along = np.einsum("kvd,kd->kv", turn, normals)
    return np.einsum("kv->k", ratio(gamma * along, sine)) / (2 * np.pi)
