"""Vectors in arrays (..., 3) or (..., 2), and runs of items: the small steps that everything else is made of.

Written for speed as well as for brevity: numpy's own cross product and sums over a last axis of 3 take five times as
long.
"""

from __future__ import annotations

import numpy as np

TINY = 1e-300  # guards divisions by lengths that may be 0
RUN = 1 << 14  # items: their arrays stay in the processor's cache


def dot(a, b):
    """(...) dot products over the last axis, broadcast. Coordinate by coordinate: a sum of products in one step may round
    otherwise at the ends of an array, and what a cell finds at a point must not depend on the others that it looks at."""
    result = a[..., 0] * b[..., 0]
    for k in range(1, np.shape(a)[-1]):
        result += a[..., k] * b[..., k]
    return result


def cross(a, b):
    """(..., 3) cross products."""
    a, b = np.broadcast_arrays(a, b)
    result = np.empty_like(a, np.result_type(a, b))
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        result[..., k] = a[..., i] * b[..., j] - a[..., j] * b[..., i]
    return result


def length(a):
    """(...) lengths of vectors."""
    return np.sqrt(dot(a, a))


def by_coordinate(a):
    """Vectors (..., 3) as they are, but stored coordinate by coordinate: what is done to many of them then takes a
    third to a tenth of the time, and what comes of it is stored so too."""
    return np.asfortranarray(a) if a.ndim == 2 else from_coordinates(*(a[..., k] for k in range(3)))


def from_coordinates(*parts):
    """(..., 3) vectors of three arrays (...), stored so."""
    result = np.empty((3, *parts[0].shape))
    for row, part in zip(result, parts):
        row[...] = part
    return result.transpose(*range(1, result.ndim), 0)


def take(a, ids):
    """(K, 3) vectors ids (K,) of vectors (N, 3) that are stored by coordinate, as they are."""
    return np.take(a.T, ids, axis=1).T


def rows_of(a, ids):
    """Rows ids (...) of an array, as a[ids] has them, in a seventh of the time."""
    return np.take(a, ids, axis=0)


def span(ids):
    """Numbers ids (K,) in rising order, as a slice if they are all in a row: what they stand for is found in a tenth of the
    time."""
    return slice(ids[0], ids[-1] + 1) if len(ids) and ids[-1] - ids[0] == len(ids) - 1 else ids


def unit(a, otherwise=0.0):
    """Vectors divided by their lengths; `otherwise` where the length is 0 or not a number."""
    with np.errstate(invalid="ignore", over="ignore"):
        size = length(a)[..., None]
        good = (size > 0) & np.isfinite(size)
        return np.where(good, a / np.where(good, size, 1.0), otherwise)


def changes(key):
    """(K,) bool: where a sorted key (K,) has a new value."""
    return np.append(True, key[1:] != key[:-1]) if len(key) else np.zeros(0, bool)


def counted(count):
    """For counts (K,): the owner of each of sum(count) items, and its number 0, 1, ... among its owner's."""
    owner = np.repeat(np.arange(len(count)), count)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)


def runs(count, each=1, most=RUN):
    """Slices that cut `count` items into runs, so that nothing as long as all of them need be made: of at most `most`, if
    each item counts as `each`, and of one at least."""
    size = max(most // max(each, 1), 1)
    return [slice(k, min(k + size, count)) for k in range(0, count, size)]


def doubled_areas(place):
    """(K,) twice the signed areas of triangles (K, 3, 2) in the plane."""
    a, b = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def numbered(rows):
    """(K,) number of each of the rows (K, D) among the different ones, which are numbered in their order."""
    order = np.lexsort(rows.T[::-1])
    new = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    number = np.empty(len(rows), np.int64)
    number[order[:1]] = 0
    number[order[1:]] = np.cumsum(new)
    return number


def whole_runs(start):
    """Slices that cut the owners of start[k] to start[k + 1] of items each, start: (K + 1,), into runs of about so many
    items."""
    cut = np.unique(np.searchsorted(start[:-1], np.arange(start[0], max(start[-1], start[0] + 1), RUN)))
    return [slice(a, b) for a, b in zip(cut, [*cut[1:], len(start) - 1]) if a < b]


def ratio(a, b):
    """a / b where b is positive, else 0."""
    return np.divide(a, b, out=np.zeros(np.broadcast_shapes(np.shape(a), np.shape(b))), where=np.asarray(b) > 0)
