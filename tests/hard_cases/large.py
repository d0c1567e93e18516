"""Hard cases of size: millions of triangles, thousands of objects and of emitting faces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cases import case, gray, nearest, of, off, total

from scenes import Mesh, World, box, grid, join_meshes, sheet

SKY = (0.3, 0.6, 1.0)
FAST = dict(gather_rays=8, row_rays=8, patch_edge=1 / 70, error=0.05)


def dense(name, corners, n):
    """A sheet of n x n quads, made without a list of them."""
    vertices, quads = grid(corners, n, n)
    return Mesh(
        name, vertices, np.arange(0, 4 * len(quads) + 1, 4, dtype=np.int32), quads.reshape(-1).astype(np.int32),
        np.zeros(len(quads), np.int32),
    )  # fmt: skip


def furnace_with_floor(n):
    """A closed furnace whose floor is one object of 2 n^2 triangles."""
    floor = dense("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], n)
    return join_meshes([box("walls", n=4, faces="xXyYZ"), floor], [gray(0.5, 1.0)])


@case(within=0.02, **FAST)
def twenty_thousand_triangles_in_one_object(bake):
    """The small twin of the next: a furnace with a dense floor, H = E / (1 - rho) in the mean of it."""
    baked = bake(furnace_with_floor(100))
    mine = of(baked, "floor")
    return off(total(baked)[mine].mean(axis=0), 2.0)


@case(within=0.02, heavy=True, **FAST)
def two_million_triangles_in_one_object(bake):
    """A furnace whose floor is one object of two million triangles: H = E / (1 - rho) in the mean of it."""
    baked = bake(furnace_with_floor(1000))
    mine = of(baked, "floor")
    assert mine.sum() >= 1_000_000
    return off(total(baked)[mine].mean(axis=0), 2.0)


@case(within=1e-6, heavy=True, **FAST)
def a_million_tiny_triangles_under_a_sky(bake):
    """A rough field of a million triangles, none above the tops: a flat square over it gets pi L, to the last ray."""
    field = dense("field", [(0, 0, 0), (100, 0, 0), (100, 100, 0), (0, 100, 0)], 708)
    rough = field.vertices + np.random.default_rng(1).normal(0, 1, (len(field.vertices), 1)) * (0, 0, 0.05)
    field = Mesh(field.name, rough, field.polygon_start, field.corner_vertex, field.polygon_material)
    top = sheet("top", [(40, 40, 5), (60, 40, 5), (60, 60, 5), (40, 60, 5)], 4, 4)
    baked = bake(join_meshes([field, top], [gray(0.5)], world=World(SKY)))
    return off(total(baked)[of(baked, "top")], np.pi * np.array(SKY))


def blocks(n):
    """A floor with n x n blocks of 12 triangles, each an object, under a sky."""
    floor = sheet("floor", [(0, 0, 0), (n, 0, 0), (n, n, 0), (0, n, 0)], 4, 4)
    one = box("block", (0.2, 0.2, 0), (0.8, 0.8, 0.5), 1, False)
    many = [replace(one, name=f"block {x} {y}", vertices=one.vertices + (x, y, 0)) for y in range(n) for x in range(n)]
    return join_meshes([floor, *many], [gray(0.5)], world=World(SKY))


def tops_off(baked):
    """The worst deviation at the tops of blocks from pi times the sky's radiance."""
    top = (baked.points.normal[:, 2] > 0.9) & (baked.points.position[:, 2] > 0.4)
    return off(total(baked)[top], np.pi * np.array(SKY))


@case(within=1e-6, **FAST)
def a_hundred_objects(bake):
    """The small twin of the next: blocks of one height under a sky, pi L on all their tops."""
    return tops_off(bake(blocks(10)))


@case(within=1e-6, heavy=True, **FAST)
def ten_thousand_objects_of_12_triangles(bake):
    """Blocks of one height under a sky: pi L on all their tops."""
    return tops_off(bake(blocks(100)))


def lit_by(n):
    """A room whose ceiling is n x n glowing quads."""
    ceiling = dense("ceiling", [(0, 0, 1), (0, 1, 1), (1, 1, 1), (1, 0, 1)], n)
    ceiling = Mesh("ceiling", ceiling.vertices, ceiling.polygon_start, ceiling.corner_vertex, np.ones(n * n, np.int32))
    return join_meshes([box("room", n=6, faces="xXyYz"), ceiling], [gray(0.5), gray(0.5, 1.0)])


def many_emitters(bake, n):
    """The deviation of a room below n x n glowing quads from one below a single one, at the room's points."""
    one, many = bake(lit_by(1), gather_rays=512), bake(lit_by(n), gather_rays=512)
    mine = of(many, "room")
    match = nearest(one.points, many.points.position[mine], many.points.normal[mine])
    return off(total(many)[mine], total(one)[match])


@case(within=0.03, error=0.005)
def nine_hundred_emitting_faces(bake):
    """The small twin of the next: a ceiling of many glowing faces is a glowing ceiling."""
    return many_emitters(bake, 30)


@case(within=0.05, heavy=True, error=0.005)
def ten_thousand_emitting_faces(bake):
    """A ceiling of 10 000 glowing faces is a glowing ceiling."""
    return many_emitters(bake, 100)
