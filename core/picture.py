"""A picture of a bake: the scene seen from a camera, drawn from the baked colors alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .raycast import RayCaster
from .sampling import lattice
from .vectors import cross, unit

LAYERS_DEEP = 32  # back sides that an outside view looks through, at most


@dataclass(frozen=True)
class View:
    """Where a picture is seen from. origin: (3,) or, of a parallel view, the middle of the frame; frame: (3, 3) world
    vectors from the origin to the frame's middle, and half its width and height. parallel: orthographic.
    through: near walls that turn their back are looked through, as into a doll's house."""

    origin: np.ndarray
    frame: np.ndarray
    width: int
    height: int
    parallel: bool = False
    through: bool = False


def outside_view(scene, width=640, height=480):
    """A View of the whole scene from above one side, through its back sides."""
    low, high = scene.bounds
    size = max(scene.diagonal, 1e-30)
    backward = unit(np.array([0.42, -0.78, 0.46]))
    right = unit(cross(np.array([0.0, 0.0, 1.0]), backward))
    up = cross(backward, right)
    origin = (low + high) / 2 + 1.6 * size * backward
    reach = 0.36
    return View(origin, np.stack([-backward, right * reach, up * reach * height / width]), width, height, through=True)


def draw(scene, colors, view, samples=4, background=(0.05, 0.05, 0.05)):
    """(height, width, 3) linear radiance, row 0 at the top. colors: (C, 3) of the scene's corners, or a function of
    triangles (K,) and weights (K, 3) of their corners that gives radiance (K, 3)."""
    caster = RayCaster(scene.vertices, scene.triangles, scene.usable)
    u, v = lattice(samples)
    picture = np.zeros((view.height, view.width, 3))
    column = np.arange(view.width)
    for y in range(view.height):
        for k in range(samples):
            across = 2 * (column + u[k]) / view.width - 1
            along = 1 - 2 * (y + v[k]) / view.height
            place = across[:, None] * view.frame[1] + along * view.frame[2]
            picture[y] += _seen(scene, caster, colors, view, place, background)
    return picture / samples


def _seen(scene, caster, colors, view, place, background):
    """(K, 3) radiance along the rays through places (K, 3) in the frame."""
    direction = np.broadcast_to(view.frame[0], place.shape) if view.parallel else view.frame[0] + place
    direction = unit(direction)
    origin = np.broadcast_to(view.origin, place.shape) + (place if view.parallel else 0.0)
    result = np.broadcast_to(np.asarray(background, float), place.shape).copy()
    left = np.arange(len(place))
    _, scale = caster.frame
    for _ in range(LAYERS_DEEP if view.through else 1):
        triangle, u, v, distance, back = caster.hits(caster.place(origin[left]), direction[left].astype(np.float32))
        shown = (triangle >= 0) & ~(back & view.through)
        weight = np.stack([1 - u[shown] - v[shown], u[shown], v[shown]], axis=1).astype(float)
        if callable(colors):
            result[left[shown]] = colors(triangle[shown], weight)
        else:
            corner = colors[scene.triangle_corner[triangle[shown]]]
            result[left[shown]] = np.einsum("kv,kvc->kc", weight, corner)
        again = (triangle >= 0) & ~shown
        further = distance[again, None].astype(float) / scale + 1e-5 / scale
        origin = origin.copy()
        left = left[again]
        origin[left] += further * direction[left]
        if not len(left):
            break
    return result
