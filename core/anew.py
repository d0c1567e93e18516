"""Light that a hit reflects, sampled anew: not as its patch has it, but as it is at that very place.

A patch has one radiosity; where shadows and contacts are finer than it, rays that ask for the truth go on: with a test
ray to one source, and one more ray, and a guided one if there are any, whose hits then read the patches.
"""

from __future__ import annotations

import numpy as np

from .guide import Aim
from .lights import from_one_test, likely_light, test_rays
from .sampling import hemisphere, tangents
from .scene import normal_and_area
from .vectors import by_coordinate, take


def reflect_anew(kernel, hit, chosen, x):
    """(C, K) light [W/m^2] that the chosen hits (K,) of Hits reflect: of a source picked for each, and of one more ray, with
    a guided one beside it.

    x: (5, K) samples in [0, 1): which source, or side that rays are guided to, a place on it, and the direction of the ray.
    """
    triangle, back = hit.triangle[chosen], hit.back[chosen]
    corners = np.take(kernel.triangles, triangle, axis=0).T
    a, b, c = (by_coordinate(np.take(kernel.vertices, corner, axis=0)) for corner in corners)
    u, v = hit.u[chosen, None].astype(float), hit.v[chosen, None].astype(float)
    position = a + u * (b - a) + v * (c - a)
    normal = normal_and_area(a, b, c)[0] * np.where(back, -1.0, 1.0)[:, None]
    start = kernel.caster.start(position, normal)
    arriving = _one_source(kernel, position, normal, start, x[0], x[1], x[2])
    local = hemisphere(x[3], x[4])
    t1, t2 = tangents(normal)
    direction = (local[:, :1] * t1 + local[:, 1:2] * t2 + local[:, 2:] * normal).astype(np.float32)
    if kernel.guide:
        aim = Aim(kernel.guide, position, normal)
        more = aim.rays(position[:, None], *x[:3, :, None])
        direction = np.concatenate([direction.T[:, :, None], more], axis=2)
        far = kernel.hits(np.repeat(start, 2, axis=0), direction.reshape(3, -1).T)
        weight = aim.weights(far, direction, normal[:, None], 1)
    else:
        far, weight = kernel.hits(start, direction), np.ones((len(start), 1))
    for name in ("gather.reflected", "gather.found"):
        light = read_light(kernel.arrays[name], far.side).reshape(len(arriving), *weight.shape)
        arriving += np.einsum("ckn,kn->ck", light, weight)
    own = hit.side[chosen]
    reflected = kernel.arrays["gather.reflectance"][:, own] * arriving
    through = kernel.arrays["gather.through"]
    return reflected + through[:, own] if through.size else reflected


def first_light(kernel, position, normal, samples):
    """{"light": (K,)} irradiance [W/m^2], the mean of the channels, at places on surfaces with normals (K, 3) from one source
    each; samples: (3, K) in [0, 1)."""
    start = kernel.caster.start(position, normal)
    return {"light": _one_source(kernel, position, normal, start, *samples).mean(axis=0)}


def _one_source(kernel, position, normal, start, pick, a, b):
    """(C, K) direct irradiance at points (K, 3) [W/m^2] from one source each, picked by what it may give, over the
    probability of the pick. pick, a, b: (K,) in [0, 1)."""
    sources = kernel.sources
    light = np.zeros((sources.strength.shape[1], len(position)))
    if not len(sources):
        return light
    likely = np.stack([likely_light(sources, s, position, normal) for s in range(len(sources))])
    upto = np.cumsum(likely, axis=0)
    picked = (upto <= pick * upto[-1]).sum(axis=0)
    order = np.argsort(picked, kind="stable")
    ends = np.searchsorted(picked[order], np.arange(len(sources) + 1))
    position, normal, start = take(position, order), take(normal, order), take(start, order)
    picked, a, b = picked[order], a[order], b[order]
    over = upto[-1, order] / likely[picked, order]
    for s in np.unique(picked):
        mine = slice(*ends[s : s + 2])
        place, up = position[mine], normal[mine]
        _weight, seen = test_rays(sources, s, kernel.caster, place, up, up, start[mine], a[mine], b[mine])
        factor = from_one_test(sources, s, place, up, seen, a[mine])
        light[:, order[mine]] = sources.strength[s][:, None] * (factor * over[mine])
    return light


def read_light(light, side):
    """(C, K) light (C, 2 N + 1) of the sides (K,) that rays met; 0 where there is no such light at all."""
    if not light.size:
        return np.zeros((len(light), len(side)))
    return np.stack([np.take(channel, side, mode="wrap") for channel in light])
