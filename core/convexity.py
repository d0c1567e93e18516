"""Whether places lie all in front of planes, or all behind them: what is convex casts no shadow into itself."""

from __future__ import annotations

import numpy as np

from .sampling import scatter
from .vectors import dot, runs

MOST_HEIGHTS = 1 << 20  # of a place above a plane, found at a time
MOST_AT_ONCE = 1 << 22  # the same, where a few planes may do
FEW = 8  # planes at first, and four times as many each time that these have not found anything out


def find_planes(normal, offset):
    """The first (K,) of the faces that lie in each plane, and the plane (F,) of each face.

    normal: (F, 3), offset: (F,) of its plane from the origin, as a share of the scene's size; planes that agree to a
    millionth are one.
    """
    key = np.zeros(len(normal), np.int64)
    for axis in range(3):
        key <<= 21
        key |= ((normal[:, axis] + 1.0) * 1e6).round().astype(np.int64)
    way = np.unique(key, return_inverse=True)[1].astype(np.int64).reshape(-1)
    return np.unique((way << 22) + (offset * 1e6).round().astype(np.int64), return_index=True, return_inverse=True)[1:]


def find_heights(normal, offset, places, distant=()):
    """The least and the greatest height (K,) of places (L, 3) above planes (K,), and of what is distant its sine: pairs of
    the sine of its half angle and the direction (3,) to it."""
    least, most = np.full(len(normal), np.inf), np.full(len(normal), -np.inf)
    for part in runs(len(places), len(normal), MOST_HEIGHTS):
        height = np.einsum("pd,ld->pl", normal, places[part]) - offset[:, None]
        least, most = np.minimum(least, height.min(axis=1)), np.maximum(most, height.max(axis=1))
    for reach, direction in distant:
        rise = dot(normal, direction)
        least, most = np.minimum(least, rise - reach), np.maximum(most, rise + reach)
    return least, most


def find_outlier(normal, offset, places, sign, gap):
    """A plane, a place on its wrong side, and how far it is from there; None if all places lie on its right side.

    normal: (K, 3), offset: (K,) of the planes; places: (L, 3); sign: +1 where places are to lie on or in front of all
    planes, -1: behind them; gap: so far they may be on the wrong side.
    """
    # Few planes first, in any order: most rooms are found out by one of them.
    order = np.argsort(scatter(np.arange(len(normal)), 17), kind="stable")
    most, step, done = max(MOST_AT_ONCE, len(places)) // len(places), FEW, 0
    while done < len(order):
        part = order[done : done + min(step, most)]
        done, step = done + len(part), 4 * step
        height = sign * (np.einsum("vd,pd->pv", places, normal[part]) - offset[part][:, None])
        worst = height.min(axis=1)
        if (worst < -gap).any():
            plane = int(np.argmin(worst))
            return part[plane], int(np.argmin(height[plane])), -worst[plane]
    return None
