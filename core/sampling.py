"""Sample points: low-discrepancy lattices, and shifts that set the points' lattices against one another.

Everything here is a pure function of ids and a seed, computed in float64 with operations that give the same bits on
every build of numpy. No state, no random generator: a sample can be drawn again anywhere, in any order.
"""

from __future__ import annotations

from math import gcd

import numpy as np

from .vectors import from_coordinates

GOLDEN = 0.6180339887498949  # 1 / golden ratio: the best step of a one-dimensional lattice
R2 = (0.7548776662466927, 0.5698402909980532)  # the same for two dimensions: 1/g and 1/g^2, g^3 = g + 1
# and for four and five: powers of 1/g, g^5 = g + 1 and g^6 = g + 1
R4 = (0.8566748838545029, 0.7338918566271260, 0.6287067210378087, 0.5385972572236101)
R5 = np.array([0.8812714616335696, 0.7766393890897682, 0.6844301295853426, 0.6031687406857283, 0.5315553977157913])


def fraction(x):
    """x less the next whole number below it, [0, 1): what x % 1.0 is, bit for bit, in a tenth of its time."""
    return x - np.floor(x)


def lattice(n):
    """The golden-ratio lattice of n points in the unit square: u (n,) = (i + 1/2) / n, v (n,) = frac((i + 1/2) golden)."""
    i = np.arange(n) + 0.5
    return i / n, fraction(i * GOLDEN)


def lattice4(n):
    """n points in the unit 4-cube, (4, n): the golden-ratio lattice for the first two axes, the R2 sequence for the others.

    The first of these is moved to whole steps of 1 / n, so that it is spread evenly too: it goes through the elements of a
    patch, and steps of R2 come back nearly to where they were after every four, so that whole columns would be left out.
    """
    u, v = lattice(n)
    i = np.arange(n) + 0.5
    step = min((k for k in range(1, n + 1) if gcd(k, n) == 1), key=lambda k: abs(k - R2[0] * n))
    return np.stack([u, v, fraction(i * step / n), fraction(i * R2[1])])


def scatter(keys, salt):
    """Numbers in [0, 1) that look unrelated for neighboring keys: float64, shape of keys (integers). salt: int.

    The mixing steps are those of the SplitMix64 generator (Steele, Lea, Flood 2014).
    """
    return _fraction(_mixed(np.asarray(keys).astype(np.uint64) + _step(salt + 1)))


def mix(keys, salt):
    """(K,) numbers in [0, 1) that look unrelated for rows of keys (K, N) that differ anywhere. keys: uint32; salt: int."""
    z = np.full(len(keys), _step(salt + 1))
    for column in keys.T:
        z = _mixed(z ^ column.astype(np.uint64)) + _step(1)
    return _fraction(z)


def ray_samples(ids, rays, chosen, salt):
    """(5, C) samples in [0, 1) for chosen ones (C,) of all rays, `rays` of each of places ids (K,): the R5 sequence, shifted by
    place."""
    shift = scatter(5 * ids.astype(np.int64)[:, None] + np.arange(5), salt)
    place, number = np.divmod(chosen, rays)
    return fraction(np.take(shift.T, place, axis=1) + R5[:, None] * number)


def _step(count):
    return np.uint64((0x9E3779B97F4A7C15 * count) & (2**64 - 1))


def _mixed(z):
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def _fraction(z):
    return (z >> np.uint64(11)).astype(np.float64) * 2.0**-53


def hemisphere(u, v):
    """Cosine-distributed directions about +z, (..., 3) float64, of u, v in [0, 1) (Malley's method)."""
    radius, angle = np.sqrt(u), 2.0 * np.pi * v
    return from_coordinates(radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - u))


def tangents(normals):
    """Two unit vectors (..., 3) that make a right-handed frame with unit normals (..., 3) (Duff et al. 2017)."""
    x, y, z = (normals[..., k] for k in range(3))
    sign = np.where(z >= 0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    first, second = np.empty_like(normals, float), np.empty_like(normals, float)
    first[..., 0], first[..., 1], first[..., 2] = 1.0 + sign * x * x * a, sign * b, -sign * x
    second[..., 0], second[..., 1], second[..., 2] = b, sign + y * y * a, -y
    return first, second


def morton_order(points):
    """(N,) order of points (N, 3) along a Morton curve through their bounding box (ties by index)."""
    if not len(points):
        return np.zeros(0, np.int64)
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum((high - low).max(), 1e-300)
    cell = np.clip((points - low) / size * 1024.0, 0, 1023).astype(np.uint64)
    for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
        cell = (cell | (cell << np.uint64(shift))) & np.uint64(mask)
    code = cell[:, 0] | (cell[:, 1] << np.uint64(1)) | (cell[:, 2] << np.uint64(2))
    return np.argsort(code, kind="stable")
