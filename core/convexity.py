"""Whether places lie all in front of planes, or all behind them: what is convex casts no shadow into itself."""

from __future__ import annotations

import numpy as np

from .sampling import scatter
from .vectors import dot

MOST_HEIGHTS = 1 << 20  # of a place above a plane, found at a time
MOST_AT_ONCE = 1 << 22  # the same, where a few planes may do
FEW = 8  # planes or places at first, and four times as many each time that these have not found everything out


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


def find_sides(normal, offset, places, distant, gap):
    """(K,) bool: planes above which something lies, by more than a gap, and planes below which something does.

    normal: (K, 3), offset: (K,) of the planes; places: (L, 3); distant: pairs of the sine of a half angle and the direction
    (3,) to something that far out, whose height is a sine.
    """
    above, below = np.zeros((2, len(normal)), bool)
    for reach, direction in distant:
        rise = dot(normal, direction)
        above |= rise + reach > gap
        below |= rise - reach < -gap
    if not len(places):
        return above, below
    # The box of all places tells where none can lie, and a few of them, in any order, where some do: few planes are left.
    middle, half = (places.max(axis=0) + places.min(axis=0)) / 2, np.ptp(places, axis=0) / 2
    height, spread = dot(normal, middle) - offset, dot(np.abs(normal), half)
    may = height + spread > gap, height - spread < -gap
    places = places[np.argsort(scatter(np.arange(len(places)), 17), kind="stable")]
    left, step, done = np.arange(len(normal)), FEW, 0
    while done < len(places):
        left = left[(may[0] & ~above)[left] | (may[1] & ~below)[left]]
        step = min(step, max(MOST_HEIGHTS // max(len(left), 1), 1))
        height = _heights(normal[left], offset[left], places[done : done + step])
        above[left] |= (height > gap).any(axis=1)
        below[left] |= (height < -gap).any(axis=1)
        done, step = done + step, 4 * step
    return above, below


def _heights(normal, offset, places):
    """(K, L) heights of places (L, 3) above planes (K,)."""
    return np.einsum("pd,ld->pl", normal, places) - offset[:, None]


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
