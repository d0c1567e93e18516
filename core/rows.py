"""Form-factor rows: where the light that leaves a patch side arrives.

Owns the two estimators of a row, and the direct light of patch sides. `rays`: n cosine-distributed rays from points
over the patch; a row is its n hits, its entries sum to exactly 1 with what escaped.
"""

from __future__ import annotations

import numpy as np

from .kernel import blocks
from .lights import patch_irradiance
from .patches import draw_on_patches
from .sampling import hemisphere, lattice4, scatter, tangents

ROW, DIRECT = 1, 2  # salts: the samples of rows and of direct light have nothing in common


def trace_rows(kernel, sides, rays, seed):
    """{"hits": (K, rays) int32} sides met by rays from patch sides (K,), -1 where a ray escaped."""
    hits = np.empty((len(sides), rays), np.int32)
    for part in blocks(len(sides), rays):
        side, _, _ = kernel.sides_hit(*_row_rays(kernel, sides[part], rays, seed))
        hits[part] = side.reshape(-1, rays)
    return {"hits": hits}


def light_patches(kernel, sides, samples, seed):
    """{"direct": (C, K)} mean irradiance [W/m^2] that the sources give patch sides (K,), from `samples` places each."""
    direct = np.empty((kernel.sources.strength.shape[1], len(sides)))
    for part in blocks(len(sides), samples):
        a, b, *place = _shifted(sides[part], samples, seed, DIRECT)
        position, normal = _places(kernel, sides[part], *place)
        centroid = kernel.patches.centroid[sides[part] >> 1]
        direct[:, part] = patch_irradiance(kernel.sources, kernel.caster, centroid, position, normal, a, b).T
    return {"direct": direct}


def _row_rays(kernel, sides, rays, seed):
    """Where the rays of rows start (K * rays, 3), and their directions (K * rays, 3), both float32."""
    u, v, a, b = _shifted(sides, rays, seed, ROW)
    position, normal = _places(kernel, sides, a, b)
    local = hemisphere(u, v).astype(np.float32)
    frame = np.stack([*tangents(normal), normal]).astype(np.float32)
    direction = np.stack([sum(frame[k, ..., d] * local[..., k] for k in range(3)).reshape(-1) for d in range(3)])
    return kernel.caster.start(position, normal).reshape(-1, 3), direction.T


def _shifted(sides, count, seed, salt):
    """(4, K, count) lattice points in the unit 4-cube, shifted for each side."""
    keys = np.asarray(sides, np.int64)[:, None] * 4 + np.arange(4)
    shift = scatter(keys, salt + 8 * seed)
    return (lattice4(count)[:, None, :] + shift.T[:, :, None]) % 1.0


def _places(kernel, sides, a, b):
    """Positions (K, n, 3) of places on patch sides, given by a, b (K, n), and the sides' normals there (K, 1 or n, 3)."""
    position, normal = draw_on_patches(kernel.patches, sides >> 1, a, b)
    return position, np.where((sides & 1)[:, None, None] == 1, -normal, normal)
