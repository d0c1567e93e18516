"""The world as light: a map of all directions, in a part that rays find by escaping and one that is sampled.

Owns the octahedral map (directions to cells without a transcendental function, so with the same bits everywhere), and
the split of a map: what is bright enough to make rays that find it by chance noisy is taken out as a few sources, small
groups of directions of about equal power (Debevec 2005, "A Median Cut Algorithm for Light Probe Sampling").
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .vectors import unit

CELLS = 32  # of a side of the map that escaping rays read
FLAT_ENOUGH = 2.0  # mean square of radiance that such rays may find, in squares of its mean
GROUPS = 12  # of bright directions, at most
NARROW = 0.05  # extent of a group that need not be split [sine]
DIRECTIONS = 64  # that stand for a group


class Group(NamedTuple):
    """Bright directions of a sky: irradiance (3,) of a surface that faces them [W/m^2], directions (J, 3) unit vectors
    toward them, of equal power, and the sine of the angle between neighbors."""

    irradiance: np.ndarray
    directions: np.ndarray
    spread: float


def cells_of(directions, size):
    """(K,) int cells of an octahedral map of size x size that directions (K, 3) fall in, row by row."""
    x, y, z = np.moveaxis(directions, -1, 0)
    scale = 1.0 / np.maximum(np.abs(x) + np.abs(y) + np.abs(z), 1e-30)
    x, y = x * scale, y * scale
    fold = z < 0
    x, y = (
        np.where(fold, (1.0 - np.abs(y)) * np.where(x < 0, -1.0, 1.0), x),
        np.where(fold, (1.0 - np.abs(x)) * np.where(y < 0, -1.0, 1.0), y),
    )
    column, row = (np.clip((p + 1.0) * (0.5 * size), 0, size - 1).astype(np.int32) for p in (x, y))
    return row * size + column


def cell_directions(size, a=0.5, b=0.5):
    """(size^2, 3) unit vectors toward places a, b in the cells of an octahedral map."""
    row, column = (k.reshape(-1) for k in np.indices((size, size)))
    x, y = 2.0 * (column + a) / size - 1.0, 2.0 * (row + b) / size - 1.0
    z = 1.0 - np.abs(x) - np.abs(y)
    fold = z < 0
    x, y = (
        np.where(fold, (1.0 - np.abs(y)) * np.where(x < 0, -1.0, 1.0), x),
        np.where(fold, (1.0 - np.abs(x)) * np.where(y < 0, -1.0, 1.0), y),
    )
    return unit(np.stack([x, y, z], axis=1))


def solid_angles(size):
    """(size^2,) solid angles of the cells of an octahedral map [sr]; their sum is 4 pi."""
    d = cell_directions(size)
    scale = np.abs(d).sum(axis=1)  # 1 / distance of the octahedron's face in that direction
    angle = scale * scale * scale
    return angle * (4 * np.pi / angle.sum())


def split_sky(world):
    """The part of a world that escaping rays find, as radiance (M, 3) of the cells of a map, M = 1 or CELLS^2, and the
    Groups of its bright directions."""
    if world.map is None:
        return np.array([world.radiance], float), []
    pixels = np.maximum(np.nan_to_num(np.asarray(world.map, float)), 0.0)
    for axis in range(2):  # no cell of the map that escaping rays read is empty
        pixels = np.repeat(pixels, -(-CELLS // max(len(world.map), 1)), axis=axis)
    size = len(pixels)
    pixels = pixels.reshape(-1, 3)
    angle = solid_angles(size)
    level = pixels.mean(axis=1)
    mean = float((level * angle).sum() / angle.sum())
    ceiling = _ceiling(level, angle, mean)
    even = pixels * np.minimum(1.0, np.divide(ceiling, level, out=np.ones_like(level), where=level > 0))[:, None]
    cell = cells_of(cell_directions(size), CELLS)
    whole = np.bincount(cell, angle, CELLS * CELLS)
    cells = np.stack([np.bincount(cell, angle * even[:, c], CELLS * CELLS) for c in range(3)], axis=1)
    return cells / whole[:, None], _groups((pixels - even) * angle[:, None], cell_directions(size), size)


def _ceiling(level, angle, mean):
    """The largest ceiling B with E[L min(L, B)] <= FLAT_ENOUGH E[L]^2 over directions of radiance `level`."""
    most = FLAT_ENOUGH * mean * mean * angle.sum()
    low, high = 0.0, float(level.max(initial=0.0))
    if (angle * level * level).sum() <= most:
        return high
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if (angle * level * np.minimum(level, middle)).sum() <= most else (low, middle)
    return low


def _groups(power, directions, size):
    """Groups of directions (K, 3) that have power (K, 3) [W/m^2]."""
    bright = np.flatnonzero(power.sum(axis=1) > 0)
    if not len(bright):
        return []
    weight = power.sum(axis=1)
    parts = [bright]
    while len(parts) < GROUPS:
        extent = [np.ptp(directions[p], axis=0).max() for p in parts]
        worth = [weight[p].sum() * e if e > NARROW else 0.0 for p, e in zip(parts, extent)]
        widest = int(np.argmax(worth))
        if worth[widest] <= 0:
            break
        part = parts.pop(widest)
        axis = int(np.argmax(np.ptp(directions[part], axis=0)))
        part = part[np.argsort(directions[part, axis], kind="stable")]
        upper = np.cumsum(weight[part])
        cut = int(np.clip(np.searchsorted(upper, 0.5 * upper[-1]), 1, len(part) - 1))
        parts += [part[:cut], part[cut:]]
    return [_group(p, power, weight, directions, size) for p in parts]


def _group(part, power, weight, directions, size):
    upper = np.cumsum(weight[part])
    chosen = np.searchsorted(upper, (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS * upper[-1])
    return Group(power[part].sum(axis=0), directions[part[np.minimum(chosen, len(part) - 1)]], 1.0 / size)
