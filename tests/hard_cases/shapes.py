"""Hard cases of shape: surfaces that touch, overlap, are broken, too small, too large or too far away."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from cases import case, findings, gray, nearest, of, off, total, twin_off

from scenes import Lamp, Mesh, World, box, box_corners, icosphere, join_meshes, sheet

LAMP = Lamp("point", (1.0, 0.8, 0.6), (0.4, 0.6, 0.8), radius=0.02)
FURNACE = 2.0  # E / (1 - rho) of gray(0.5, 1.0), everywhere in a closed room


def furnace(meshes):
    return join_meshes(meshes, [gray(0.5, 1.0)])


def room(*meshes, n=6, **fields):
    """A closed room with things in it, lit by a small lamp."""
    return join_meshes([box("room", n=n), *meshes], [gray(0.6), gray(0.0, 3.0)], [LAMP], **fields)


def with_vertices(mesh, vertices):
    return replace(mesh, vertices=np.asarray(vertices, float))


def added(mesh, vertices, polygons):
    """A mesh with more polygons, of its own material 0."""
    first = len(mesh.vertices)
    old = np.split(mesh.corner_vertex, mesh.polygon_start[1:-1])
    more = [[first + k for k in p] for p in polygons]
    return Mesh.of_polygons(
        mesh.name, np.concatenate([mesh.vertices, vertices]), [*map(list, old), *more],
        [*mesh.polygon_material, *[0] * len(more)],
    )  # fmt: skip


@case(within=2e-3)
def sheets_that_only_touch(bake):
    """A room of six separate sheets is a closed furnace: H = E / (1 - rho) at every point, corners too."""
    sheets = [sheet(f, c, 4, 4) for f, c in box_corners().items()]
    return off(total(bake(furnace(sheets))), FURNACE)


@case(within=1e-6)
def perpendicular_patches(bake):
    """A wall beside a glowing floor: at every point the textbook's factor from an element to a perpendicular rectangle."""
    floor = sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 4, 4, 1)
    wall = sheet("wall", [(0, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1)], 6, 6)
    baked = bake(join_meshes([floor, wall], [gray(0.0), gray(0.0, 1.0)]))
    mine = of(baked, "wall")
    _, y, z = baked.points.position[mine].T

    def half(width):  # of a floor 1 deep, seen from above its corner
        reach = np.sqrt(z * z + 1)
        return (np.arctan2(width, z) - z / reach * np.arctan2(width, reach)) / (2 * np.pi)

    return off(total(baked)[mine][:, 0], half(y) + half(1 - y))


@case(within=0.02)
def opposed_patches_close_together(bake):
    """Two unit squares 1e-4 apart are infinite plates: H2 = E1 / (1 - rho1 rho2), away from the rim."""
    low = sheet("low", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 6, 6)
    high = sheet("high", [(0, 0, 1e-4), (0, 1, 1e-4), (1, 1, 1e-4), (1, 0, 1e-4)], 6, 6, 1)
    baked = bake(join_meshes([low, high], [gray(0.5, 1.0), gray(0.8)]))
    inner = (np.abs(baked.points.position[:, :2] - 0.5) < 0.4).all(axis=1)
    return off(total(baked)[of(baked, "high") & inner], 1 / (1 - 0.4))


def sliver_room(aspect):
    """A room whose floor is a fan of triangles with sides of up to `aspect` to 1."""
    widths = np.concatenate([[0], np.geomspace(1 / aspect, 1, 12)])
    vertices = [(1, 0, 0), (0, 0, 0), *((x, 1, 0) for x in widths)]
    return [
        box("room", n=3, faces="xXyYZ"),
        Mesh.of_polygons(
            "floor", vertices, [(0, 2 + k, 1) if k < 0 else (1, 3 + k, 2 + k) for k in range(12)] + [(0, 14, 1)]
        ),
    ]


@case(within=5e-3)
def slivers(bake):
    """Floors of triangles with sides of up to 1e2, 1e5 and 1e8 to 1 in a furnace: H = E / (1 - rho)."""
    return max(off(total(bake(furnace([*sliver_room(a)]))), FURNACE) for a in (1e2, 1e5, 1e8))


def broken_twin(bake, vertices, polygons, finding):
    """The deviation of a room with broken polygons from the room without them; they must be named."""
    baked = bake(
        room(added(box("block", (0.3, 0.3, 0.2), (0.6, 0.6, 0.5), 2, False), np.array(vertices, float), polygons))
    )
    found = findings(baked, finding)
    assert any(f.object == "block" for f in found), baked.survey.health
    return twin_off(baked, bake(room(box("block", (0.3, 0.3, 0.2), (0.6, 0.6, 0.5), 2, False))))


@case(within=0.0)
def faces_without_area(bake):
    """The same bits as without them, and a finding."""
    line = [(0.1, 0.1, 0.1), (0.2, 0.2, 0.2), (0.3, 0.3, 0.3), (0.9, 0.9, 0.9)]
    return broken_twin(bake, line, [(0, 1, 2), (0, 0, 0), (0, 3, 2, 1)], "area")


@case(within=0.0)
def repeated_vertices(bake):
    """The same bits as without them, and a finding."""
    return broken_twin(bake, [(0.1, 0.1, 0.1), (0.2, 0.1, 0.1)], [(0, 1, 1), (0, 1, 0, 1)], "area")


@case(within=0.0)
def vertices_that_are_no_numbers(bake):
    """The same bits as without them, and a finding."""
    corner = [(np.nan, 0.1, 0.1), (0.2, np.inf, 0.1), (0.2, 0.2, -np.inf), (0.5, 0.1, 0.1), (0.5, 0.5, 0.1)]
    return broken_twin(bake, corner, [(0, 3, 4), (1, 3, 4), (2, 3, 4), (0, 1, 2)], "finite")


@case(within=0.0)
def vertices_at_1e30(bake):
    """The same bits as without them, and a finding."""
    corner = [(1e30, 0.1, 0.1), (0.2, -1e200, 0.1), (0.2, 0.2, 1e308), (0.5, 0.1, 0.1), (0.5, 0.5, 0.1)]
    return broken_twin(bake, corner, [(0, 3, 4), (1, 3, 4), (2, 3, 4), (0, 1, 2)], "far")


@case(within=0.03)
def concave_polygons(bake):
    """A furnace in the shape of an L, floor and ceiling one concave polygon each: H = E / (1 - rho)."""
    outline = np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], float)
    vertices = np.concatenate([np.column_stack([outline, np.full(6, z)]) for z in (0, 1)])
    walls = [(k, k + 6, (k + 1) % 6 + 6, (k + 1) % 6) for k in range(6)]
    mesh = Mesh.of_polygons("L", vertices, [range(6), range(11, 5, -1), *walls])
    floor = [(0, 1, 3), (1, 2, 3), (0, 3, 5), (3, 4, 5)]
    ceiling = [(11 - k, 11 - j, 11 - i) for i, j, k in floor]
    halves = [(12 + 4 * k, 13 + 4 * k + step, 14 + 4 * k + step) for k in range(6) for step in range(2)]
    owner = [0] * 4 + [1] * 4 + [2 + k for k in range(6) for _ in range(2)]
    shaped = replace(mesh, triangle_corner=np.array(floor + ceiling + halves), triangle_polygon=np.array(owner))
    return off(total(bake(furnace([shaped]))), FURNACE)


@case(within=0.02, gather_rays=2048)
def polygons_that_cross_or_touch_themselves(bake):
    """A bow tie and a polygon that runs through one vertex twice, in a furnace: H = E / (1 - rho) on all of them."""
    tie = Mesh.of_polygons("tie", [(0.2, 0.2, 0.4), (0.8, 0.8, 0.4), (0.8, 0.2, 0.4), (0.2, 0.8, 0.4)], [(0, 1, 2, 3)])
    places = [(0.2, 0.2, 0.7), (0.5, 0.5, 0.7), (0.8, 0.2, 0.7), (0.8, 0.8, 0.7), (0.2, 0.8, 0.7)]
    touching = Mesh.of_polygons("touching", places, [(0, 1, 2, 3, 1, 4)])
    touching = replace(touching, triangle_corner=np.array([(0, 4, 5), (1, 2, 3)]), triangle_polygon=np.zeros(2, int))
    return off(total(bake(furnace([box("room", n=2), tie, touching]))), FURNACE)


@case(within=0.03)
def faces_that_lie_on_one_another(bake):
    """A wall that is there three times, once turned round, is the same wall."""
    corners = box_corners()["x"]
    copies = [sheet("again", corners, 3, 3), sheet("turned", corners[::-1], 2, 2)]
    rays = dict(gather_rays=1024, row_rays=64, patch_samples=16)
    return twin_off(bake(room(*copies), **rays), bake(room(), **rays), ["room"])


@case(within=0.03)
def emitter_in_the_ceiling(bake):
    """A glowing face in the very plane of the ceiling gives what it gives in a hole of its size."""

    def lit(hole):
        ceiling = grid_floor([0, 0.3, 0.7, 1], hole)
        ceiling = Mesh.of_polygons(
            "ceiling",
            ceiling.vertices + (0, 0, 1),
            [p[::-1] for p in np.split(ceiling.corner_vertex, ceiling.polygon_start[1:-1])],
        )
        lamp = sheet("lamp", [(0.3, 0.3, 1), (0.3, 0.7, 1), (0.7, 0.7, 1), (0.7, 0.3, 1)], 2, 2, 1)
        walls = box("walls", n=6, faces="xXyYz")
        return join_meshes([walls, ceiling, lamp], [gray(0.6), gray(0.6, 3.0)])

    return twin_off(bake(lit(None), gather_rays=512), bake(lit((1, 2)), gather_rays=512), ["walls"])


@case(within=0.03)
def interpenetrating_blocks(bake):
    """Two blocks that pass through one another look like the one block that they make up."""
    first, second = ((0.2, 0.4, 0.0), (0.6, 0.6, 0.4)), ((0.4, 0.4, 0.0), (0.8, 0.6, 0.4))
    both = [box("first", *first, 4, False), box("second", *second, 4, False)]
    one = box("one", (0.2, 0.4, 0.0), (0.8, 0.6, 0.4), 4, False)
    floor = lambda p: (np.abs(p[:, 0] - 0.5) > 0.32) | (np.abs(p[:, 1] - 0.5) > 0.12) | (p[:, 2] > 1e-3)
    return twin_off(bake(room(*both), gather_rays=512), bake(room(one), gather_rays=512), ["room"], floor)


def grid_floor(xs, hole=None):
    """A floor with lines at xs in both directions; hole: (first, last) cells of both that are left out."""
    n = len(xs)
    vertices = [(x, y, 0) for y in xs for x in xs]
    inside = lambda k: hole is not None and hole[0] <= k < hole[1]
    quads = [
        (n * r + c, n * r + c + 1, n * r + c + n + 1, n * r + c + n)
        for r in range(n - 1) for c in range(n - 1) if not (inside(r) and inside(c))
    ]  # fmt: skip
    return Mesh.of_polygons("floor", vertices, quads)


def standing(floor, faces):
    """A room with a floor of its own and a block on it."""
    block = box("block", (0.31, 0.31, 0.0), (0.69, 0.69, 0.3), 4, False, faces=faces)
    return join_meshes([box("walls", n=6, faces="xXyYZ"), block, floor], [gray(0.6)], [LAMP])


@case(within=0.03)
def block_on_an_uncut_floor(bake):
    """The floor beside a block, whose quads run on below it, is as bright as a floor with a hole that the block fills."""
    xs = [0, 0.16, 0.27, 0.37, 0.5, 0.63, 0.73, 0.84, 1]
    hole = grid_floor([0, 0.16, 0.27, 0.31, 0.69, 0.73, 0.84, 1], (3, 4))
    outside = lambda p: (
        (np.abs(p[:, :2] - 0.5) > 0.2).any(axis=1)
        & np.isin(p[:, :2].round(2), [0, 0.16, 0.27, 0.73, 0.84, 1]).all(axis=1)
    )
    whole = bake(standing(grid_floor(xs), "xXyYzZ"), gather_rays=1024)
    return twin_off(whole, bake(standing(hole, "xXyYZ"), gather_rays=1024), ["floor"], outside)


@case(within=0.03)
def floor_vertices_at_the_foot_of_a_block(bake):
    """A floor with vertices exactly below the sides of a block: outside it is as bright as with a hole for the block."""
    xs = [0, 0.16, 0.31, 0.5, 0.69, 0.84, 1]
    whole, hole = (
        bake(standing(floor, faces), gather_rays=1024)
        for floor, faces in ((grid_floor(xs), "xXyYzZ"), (grid_floor(xs, (2, 4)), "xXyYZ"))
    )
    return corners_off(whole, hole, "floor", lambda center: (np.abs(center[:, :2] - 0.5) > 0.19).any(axis=1))


def corner_light(baked, name, chosen):
    """Irradiance at the corners of an object's polygons, {(polygon's center, vertex): (C,)}. chosen: function of
    centers (P, 3), the polygons that count."""
    scene, points = baked.scene, baked.points
    polygon = np.repeat(np.arange(len(scene.polygon_object)), np.diff(scene.polygon_start))
    center = np.stack(
        [
            scene.vertices[scene.corner_vertex[a:b]].mean(axis=0)
            for a, b in zip(scene.polygon_start, scene.polygon_start[1:])
        ]
    )
    mine = (scene.polygon_object == scene.objects.index(name)) & chosen(center)
    light = total(baked)[points.corner_point]
    return {
        (*center[polygon[c]].round(6), *scene.vertices[scene.corner_vertex[c]].round(6)): light[k]
        for k, c in enumerate(points.corner) if mine[polygon[c]]
    }  # fmt: skip


def corners_off(baked, twin, name, chosen):
    """The worst deviation of corners of an object from the same ones of a twin scene."""
    mine, other = corner_light(baked, name, chosen), corner_light(twin, name, chosen)
    assert mine.keys() == other.keys()
    return off(np.array(list(mine.values())), np.array([other[k] for k in mine]))


@case(within=0.0)
def floor_vertices_inside_a_block(bake):
    """The floor below a block is black, up to its rim; a block without a bottom gives the same."""
    floor = grid_floor([0, 0.16, 0.27, 0.37, 0.5, 0.63, 0.73, 0.84, 1])
    worst = 0.0
    for faces in ("xXyYzZ", "xXyYZ"):
        baked = bake(standing(floor, faces))
        inside = (np.abs(baked.points.position[:, :2] - 0.5) < 0.185).all(axis=1) & of(baked, "floor")
        assert inside.sum() == 9
        worst = max(worst, float(total(baked)[inside].max()))
    return worst


@case(within=1e-3)
def bottoms_of_blocks_on_a_floor_under_a_sky(bake):
    """Standing on a single sheet, lifted and sunk by 1e-5, in sizes from 1e-3 to 1e3: black where the floor covers them, pi L
    beyond it."""
    worst = 0.0
    for gap, scale, half in product((0.0, 1e-5, -1e-5), (1.0, 1e-3, 1e3), (2.0, 0.3)):
        block = box("block", (-0.5, -0.5, gap), (0.5, 0.5, 1 + gap), 3, False)
        floor = sheet("floor", [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)])
        scene = join_meshes([floor, block], [gray(0.5)], world=World((1.0, 1.0, 1.0)))
        baked = bake(replace(scene, vertices=scale * scene.vertices))
        bottom = of(baked, "block") & (baked.points.normal[:, 2] < -0.9)
        covered = (np.abs(baked.points.position[bottom, :2]) < half * scale).all(axis=1)
        worst = max(worst, off(total(baked)[bottom], np.where(covered, 0.0, np.pi)[:, None], np.pi))
    return worst


@case(within=1e-3)
def two_sheets_for_a_wall(bake):
    """A house of two boxes in one place, one turned in and one out, no lamp: pi L outside, and nothing inside."""
    scene = join_meshes([box("in", n=3), box("out", n=2, inward=False)], [gray(0.5)], world=World((1.0, 1.0, 1.0)))
    baked = bake(scene)
    return off(total(baked), np.where(of(baked, "out"), np.pi, 0.0)[:, None], np.pi)


@case(within=0.0)
def thin_wall_lit_on_one_side(bake):
    """A wall without thickness between two rooms, on vertices of floor and ceiling: the dark room stays black."""
    wall = sheet("wall", [(0.5, 0, 0), (0.5, 1, 0), (0.5, 1, 1), (0.5, 0, 1)], 6, 6)
    lamp = Lamp("point", (1, 1, 1), (0.25, 0.5, 0.6))
    baked = bake(join_meshes([box("room", n=6), wall], [gray(0.6)], [lamp]))
    dark = corner_light(baked, "room", lambda center: center[:, 0] > 0.5)
    bright = corner_light(baked, "room", lambda center: center[:, 0] < 0.5)
    least = min(value.min() for value in bright.values())
    return float(max(value.max() for value in dark.values())) if least > 0 else 1.0


@case(within=2e-3)
def t_junctions(bake):
    """A furnace whose faces are cut 1, 2, 3, 5, 7 and 11 times, so that no edge meets its neighbor's: H = E / (1 - rho)."""
    faces = [sheet(f, c, n, n) for n, (f, c) in zip((1, 2, 3, 5, 7, 11), box_corners().items())]
    return off(total(bake(furnace(faces))), FURNACE)


@case(within=0.02, gather_rays=2048)
def edges_with_many_faces(bake):
    """Five sheets that share one edge in a furnace: H = E / (1 - rho) on both sides of each."""
    turn = 2 * np.pi * np.arange(5) / 5
    vertices = [
        (0.5, 0.5, 0.3),
        (0.5, 0.5, 0.7),
        *((0.5 + 0.3 * np.cos(t), 0.5 + 0.3 * np.sin(t), z) for t in turn for z in (0.3, 0.7)),
    ]
    fan = Mesh.of_polygons("fan", vertices, [(0, 2 + 2 * k, 3 + 2 * k, 1) for k in range(5)])
    scene = furnace([box("room", n=2), fan])
    return max(off(total(bake(scene, side=side)), FURNACE) for side in ("front", "lit"))


@case(within=0.03, light_samples=4.0)
def flipped_normals(bake):
    """A furnace with every second face turned round: H = E / (1 - rho) on the sides that are lit more."""
    mesh = box("room", n=3)
    polygons = [p[::-1] if k % 2 else p for k, p in enumerate(np.split(mesh.corner_vertex, mesh.polygon_start[1:-1]))]
    return off(total(bake(furnace([Mesh.of_polygons("room", mesh.vertices, polygons)]), side="lit")), FURNACE)


@case(within=0.01)
def a_hole_in_a_sphere(bake):
    """A sphere with reflectance rho and a hole of the share h: wall light H = E (1 - h) / (1 - rho (1 - h)) in the mean."""
    whole = icosphere("sphere", splits=2)
    low = whole.vertices[whole.corner_vertex.reshape(-1, 3)].mean(axis=1)[:, 2] < 0.6
    polygons = whole.corner_vertex.reshape(-1, 3)[low]
    baked = bake(join_meshes([Mesh.of_polygons("sphere", whole.vertices, polygons.tolist())], [gray(0.8, 1.0)]))
    area = lambda p: np.sqrt(
        (np.cross(*(whole.vertices[p[:, k]] - whole.vertices[p[:, 0]] for k in (1, 2))) ** 2).sum(-1)
    ).sum()
    h = 1 - area(polygons) / area(whole.corner_vertex.reshape(-1, 3))
    mean = (baked.points.area * total(baked)[:, 0]).sum() / baked.points.area.sum()
    return abs(mean / ((1 - h) / (1 - 0.8 * (1 - h))) - 1)


def moved(scene, scale, offset):
    """A scene scaled and moved, its lamps so that the light stays the same."""
    lamps = (
        replace(
            lamp,
            position=tuple(scale * np.array(lamp.position) + offset),
            radius=scale * lamp.radius,
            strength=tuple(scale**2 * np.array(lamp.strength)),
        )
        for lamp in scene.lamps
    )
    return replace(scene, vertices=scene.vertices * scale + np.array(offset), lamps=tuple(lamps))


def moved_off(bake, moves):
    """The worst deviation of a scene's light after moves (scale, offset) from that of the scene itself."""
    scene = room(box("block", (0.3, 0.3, 0.2), (0.6, 0.6, 0.5), 2, False))
    moves = [(scale, np.asarray(offset)) for scale, offset in moves]
    far = [bake(moved(scene, *move), gather_rays=512) for move in moves]
    plain, worst = bake(scene, gather_rays=512), 0.0
    for (scale, offset), baked in zip(moves, far):
        back = (baked.points.position - offset) / scale
        match = nearest(plain.points, back, baked.points.normal)
        assert len(np.unique(match)) == len(plain.points)
        worst = max(worst, off(total(baked), total(plain)[match]))
    return worst


FAR = np.array((1e8, -1e8, 1e8))


@case(within=1e-3)
def scales_from_1e_minus_6_to_1e6(bake):
    """The same light as at scale 1."""
    return moved_off(bake, [(s, np.zeros(3)) for s in (1e-6, 1e6, 1e-3, 1e3)])


@case(within=0.03)
def offset_of_1e8_sizes(bake):
    """The same light as at the origin: places are rounded to 1e-8 of the scene there, and no more is lost."""
    return moved_off(bake, [(1.0, FAR)])


@case(within=0.03)
def scale_and_offset_at_once(bake):
    """1e-6 in size at 100 m, and 1e6 in size at 1e14 m: the same light as in size 1 at the origin."""
    return moved_off(bake, [(s, s * FAR) for s in (1e-6, 1e6)])


@case(within=0.01)
def huge_floor_and_tiny_lamp(bake):
    """A floor of 10 km and a glowing square of 1 cm, 1 m above it: H = M A cos^4 / (pi h^2) on the floor around it."""
    xs = np.concatenate([-np.geomspace(5000, 0.25, 12), [0], np.geomspace(0.25, 5000, 12)])
    s = 0.005
    lamp = sheet("lamp", [(-s, -s, 1), (-s, s, 1), (s, s, 1), (s, -s, 1)], 1, 1, 1)
    baked = bake(join_meshes([grid_floor(xs), lamp], [gray(0.5), gray(0.0, 1000.0)]))
    assert any(f.object == "lamp" for f in findings(baked, "large"))
    mine = of(baked, "floor")
    square = (baked.points.position[mine, :2] ** 2).sum(axis=1)
    near = square < 5
    return off(total(baked)[mine][near, 0], (1000 * 1e-4 / np.pi / (1 + square) ** 2)[near])


@case(within=0.0)
def no_size_at_all(bake):
    """All vertices in one place, one triangle, nothing: a bake that ends, with nothing to write or a black triangle."""
    empty = [Mesh.of_polygons("empty", np.zeros((0, 3)), []), Mesh.of_polygons("dot", np.zeros((4, 3)), [(0, 1, 2, 3)])]
    triangle = Mesh.of_polygons("triangle", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    worst = 0.0
    for meshes in (empty[:1], empty[1:], empty, [triangle]):
        baked = bake(join_meshes(meshes, [gray(0.5)], [Lamp("point", (1, 1, 1), (0, 0, -1))]))
        worst = max(worst, total(baked).max(initial=0.0))
    return worst
