"""Faces whose light is not even, as sources: what is close before them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cell_radiosity.core.bake import bake, run
from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.polygons import polygon_factor
from cell_radiosity.core.settings import Settings
from cell_radiosity.core.surfaces import Readings

from scenes import Material, join_meshes, sheet


def test_light_of_a_picture_close_before_a_wall():
    """A board of glowing stripes, as Cycles would have read it, a hand's breadth before a wall: each point of the wall behind
    it sees the stripes by themselves."""
    count, gap, size = 8, 0.03, 0.8
    wall = sheet("wall", [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0)], 40, 40)
    low, high = 1 - size / 2, 1 + size / 2
    board = sheet("board", [(low, low, gap), (high, low, gap), (high, high, gap), (low, high, gap)], 1, 1, 1)
    scene = join_meshes([wall, board], [Material("black", (0, 0, 0)), Material("board", (0, 0, 0))])
    first = int(np.flatnonzero(scene.polygon_object[scene.triangle_polygon] == 1)[0])
    u, v = (x.reshape(-1) for x in (np.indices((96, 96)) + 0.5) / 96)
    inside = u + v < 1
    u, v = u[inside], v[inside]
    triangle = np.repeat([first, first + 1], len(u))
    a, b, c = scene.corners_of(triangle)
    u, v = np.tile(u, 2)[:, None], np.tile(v, 2)[:, None]
    place = a + u * (b - a) + v * (c - a)
    stripe = np.minimum(((place[:, 0] - low) / size * count).astype(int), count - 1)
    glow = np.repeat(np.array([4.0, 1.0])[stripe % 2, None], 3, axis=1)
    dark = np.zeros_like(glow)
    read = Readings(triangle, np.hstack([u, v]), dark, glow, np.zeros(0, int), dark[:0], dark[:0])
    baked = run(bake(replace(scene, readings=read), Settings.for_error(0.02), LocalCells()))
    points = baked.points
    behind = (points.object == 0) & (np.abs(points.position[:, :2] - 1) < size / 2 - 0.02).all(axis=1)
    position, normal = points.position[behind], points.normal[behind]
    expected = np.zeros(len(position))
    for k in range(count):
        x = low + size * np.array([k, k + 1]) / count
        corners = np.array([[x[0], low, gap], [x[1], low, gap], [x[1], high, gap], [x[0], high, gap]])
        expected += [4.0, 1.0][k % 2] * polygon_factor(position, normal, corners)
    found = baked.light.direct[0][behind]
    assert np.ptp(expected) > 1.5  # the stripes can be told apart
    assert np.sqrt(((found - expected) ** 2).mean()) < 0.05 * np.sqrt((expected**2).mean())
