"""Make the sample scenes. Run with the oldest Blender that is supported (bpy 4.2), whose files all others open:

python sample_scenes/make.py [NAME ...]
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import bpy
import numpy as np

HERE = Path(__file__).parent


def material(name, color=(0.8, 0.8, 0.8), emission=None, strength=1.0):
    """A diffuse material, or with `emission` (a color) one that only shines."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    shader = nodes.new("ShaderNodeBsdfDiffuse" if emission is None else "ShaderNodeEmission")
    shader.inputs["Color"].default_value = (*(color if emission is None else emission), 1.0)
    if emission is not None:
        shader.inputs["Strength"].default_value = strength
    links.new(shader.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    made.diffuse_color = (*(np.clip(color if emission is None else emission, 0, 1)), 1.0)
    return made


def quad_grid(corners, columns, rows, skip=None):
    """Vertices and quads of a grid over four corners (counterclockwise seen from the front). skip(u, v): a cell whose
    middle is there is left out."""
    a, b, c, d = (np.asarray(p, float) for p in corners)
    u = columns if np.ndim(columns) else np.linspace(0, 1, columns + 1)
    v = rows if np.ndim(rows) else np.linspace(0, 1, rows + 1)
    uu, vv = np.meshgrid(u, v)
    uu, vv = uu.reshape(-1, 1), vv.reshape(-1, 1)
    vertices = (1 - uu) * (1 - vv) * a + uu * (1 - vv) * b + uu * vv * c + (1 - uu) * vv * d
    quads = []
    for row in range(len(v) - 1):
        for column in range(len(u) - 1):
            if skip is None or not skip((u[column] + u[column + 1]) / 2, (v[row] + v[row + 1]) / 2):
                first = row * len(u) + column
                quads.append((first, first + 1, first + len(u) + 1, first + len(u)))
    return vertices, quads


def lines(length, stops, cell):
    """Grid lines from 0 to length that run through all stops, about a cell apart."""
    stops = np.unique(np.concatenate([[0.0, length], stops]))
    parts = [np.linspace(a, b, max(round((b - a) / cell), 1) + 1)[:-1] for a, b in itertools.pairwise(stops)]
    return np.concatenate([*parts, [length]])


def add_mesh(name, parts, smooth=False):
    """An object of parts [(vertices, faces, material)], vertices at the same place joined."""
    places, faces, slots, materials = {}, [], [], []
    vertices = []
    for part_vertices, part_faces, part_material in parts:
        number = []
        for p in part_vertices:
            key = tuple(np.round(p, 6))
            if key not in places:
                places[key] = len(vertices)
                vertices.append(tuple(map(float, p)))
            number.append(places[key])
        if part_material not in materials:
            materials.append(part_material)
        for face in part_faces:
            faces.append([number[k] for k in face])
            slots.append(materials.index(part_material))
    used = sorted({v for face in faces for v in face})
    renumber = {old: new for new, old in enumerate(used)}
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([vertices[v] for v in used], [], [[renumber[v] for v in face] for face in faces])
    for m in materials:
        mesh.materials.append(m)
    mesh.polygons.foreach_set("material_index", np.array(slots, np.int32))
    mesh.polygons.foreach_set("use_smooth", np.full(len(faces), smooth))
    mesh.update()
    made = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def box_parts(low, high, cell, paint, sides="xXyYzZ"):
    """Parts of an axis-aligned box that faces outward; a capital letter is the side of the higher coordinate."""
    (x, y, z), (X, Y, Z) = low, high
    faces = {
        "x": ((x, Y, z), (x, y, z), (x, y, Z), (x, Y, Z)),
        "X": ((X, y, z), (X, Y, z), (X, Y, Z), (X, y, Z)),
        "y": ((x, y, z), (X, y, z), (X, y, Z), (x, y, Z)),
        "Y": ((X, Y, z), (x, Y, z), (x, Y, Z), (X, Y, Z)),
        "z": ((x, Y, z), (X, Y, z), (X, y, z), (x, y, z)),
        "Z": ((x, y, Z), (X, y, Z), (X, Y, Z), (x, Y, Z)),
    }
    parts = []
    for side in sides:
        corners = np.array(faces[side])
        columns = max(round(np.linalg.norm(corners[1] - corners[0]) / cell), 1)
        rows = max(round(np.linalg.norm(corners[3] - corners[0]) / cell), 1)
        parts.append((*quad_grid(corners, columns, rows), paint))
    return parts


def ball_parts(center, radius, paint, segments=32, rings=16):
    """Parts of a sphere of quads, with triangles at the poles."""
    turn = 2 * np.pi * np.arange(segments) / segments
    rise = np.pi * np.arange(1, rings) / rings
    ring = [
        [(radius * np.sin(r) * np.cos(t), radius * np.sin(r) * np.sin(t), radius * np.cos(r)) for t in turn]
        for r in rise
    ]
    vertices = np.array([(0, 0, radius), *(p for row in ring for p in row), (0, 0, -radius)]) + center
    faces, last = [], len(vertices) - 1
    for k in range(segments):
        following = (k + 1) % segments
        faces.append((0, 1 + k, 1 + following))
        faces.append((last, last - segments + following, last - segments + k))
        for row in range(rings - 2):
            first = 1 + row * segments
            faces.append((first + k, first + segments + k, first + segments + following, first + following))
    return [(vertices, faces, paint)]


def column_parts(center, radius, low, high, paint, segments=16, rings=12):
    """Parts of an upright cylinder without ends."""
    turn = 2 * np.pi * np.arange(segments) / segments
    height = np.linspace(low, high, rings + 1)
    vertices = [(center[0] + radius * np.cos(t), center[1] + radius * np.sin(t), z) for z in height for t in turn]
    faces = [
        (
            r * segments + k,
            r * segments + (k + 1) % segments,
            (r + 1) * segments + (k + 1) % segments,
            (r + 1) * segments + k,
        )
        for r in range(rings)
        for k in range(segments)
    ]
    return [(np.array(vertices), faces, paint)]


def add_camera(place, target, lens=35.0, sensor=36.0, size=(640, 480)):
    """The scene's camera, at a place, looking at a target."""
    from mathutils import Vector

    data = bpy.data.cameras.new("Camera")
    data.lens, data.sensor_width = lens, sensor
    made = bpy.data.objects.new("Camera", data)
    made.location = place
    made.rotation_euler = (Vector(target) - Vector(place)).to_track_quat("-Z", "Y").to_euler()
    scene = bpy.context.scene
    scene.collection.objects.link(made)
    scene.camera = made
    scene.render.resolution_x, scene.render.resolution_y = size


def new_scene(name, world=(0.0, 0.0, 0.0), strength=1.0):
    """An empty file with a world of one color, set to render with Cycles."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.name = name
    scene.render.engine = "CYCLES"
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    background = scene.world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (*world, 1.0)
    background.inputs["Strength"].default_value = strength


def cornell_box():
    """The Cornell box: geometry as measured by the Cornell program of computer graphics, in millimeters, and the RGB
    reflectances and emission in wide use. The lamp fills a hole in the ceiling."""
    new_scene("Cornell box")
    white = material("white", (0.885809, 0.698859, 0.666422))
    red, green = material("red", (0.570068, 0.0430135, 0.0443706)), material("green", (0.105421, 0.37798, 0.076425))
    lamp = material("lamp", emission=(1.0, 0.76072, 0.3673), strength=18.387)

    def place(*points):  # the published axes are x left, y up, z away from the camera
        return [(0.556 - x / 1000, z / 1000, y / 1000) for x, y, z in points]

    n = 34
    floor = place((552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2))
    back = place((549.6, 0, 559.2), (0, 0, 559.2), (0, 548.8, 559.2), (556, 548.8, 559.2))
    right = place((0, 0, 559.2), (0, 0, 0), (0, 548.8, 0), (0, 548.8, 559.2))
    left = place((552.8, 0, 0), (549.6, 0, 559.2), (556, 548.8, 559.2), (556, 548.8, 0))
    ceiling = place((556, 548.8, 559.2), (0, 548.8, 559.2), (0, 548.8, 0), (556, 548.8, 0))
    # Grid lines of the ceiling run along the lamp's edges: x 213..343, z 227..332.
    across = np.concatenate([np.linspace(0, 213, 14)[:-1], np.linspace(213, 343, 9)[:-1], np.linspace(343, 556, 14)])
    deep = np.concatenate(
        [np.linspace(0, 227.2, 15)[:-1], np.linspace(227.2, 332.2, 7)[:-1], np.linspace(332.2, 559.2, 15)]
    )
    u, v = across / 556, deep / 559.2
    hole = (u[13], u[21], v[14], v[20])

    def inside(a, b):
        return hole[0] < a < hole[1] and hole[2] < b < hole[3]

    add_mesh(
        "room",
        [
            (*quad_grid(floor, n, n), white),
            (*quad_grid(ceiling, u, v, inside), white),
            (*quad_grid(back, n, n), white),
            (*quad_grid(right, n, n), green),
            (*quad_grid(left, n, n), red),
        ],
    )
    add_mesh("lamp", [(*quad_grid(ceiling, u, v, lambda a, b: not inside(a, b)), lamp)])
    for name, height, outline in (
        ("short block", 165, ((130, 65), (82, 225), (240, 272), (290, 114))),
        ("tall block", 330, ((423, 247), (265, 296), (314, 456), (472, 406))),
    ):
        tops = [(x, height, z) for x, z in outline]
        parts = [(*quad_grid(place(*tops), 12, 12), white)]
        for k in range(4):
            (x0, z0), (x1, z1) = outline[k], outline[(k + 1) % 4]
            side = place((x1, 0, z1), (x0, 0, z0), (x0, height, z0), (x1, height, z1))
            parts.append((*quad_grid(side[::-1], 12, 12 if height < 200 else 22), white))
        add_mesh(name, parts)
    add_camera((0.278, -0.8, 0.273), (0.278, 0.0, 0.273), lens=35.0, sensor=25.0, size=(512, 512))


def sunlit_room():
    """A room with two windows, colored walls and some furniture, under sun and sky."""
    new_scene("Sunlit room", world=(0.35, 0.55, 1.0), strength=1.0)
    white, blue = material("plaster", (0.8, 0.8, 0.78)), material("blue wall", (0.2, 0.35, 0.65))
    ochre, wood = material("ochre wall", (0.75, 0.5, 0.18)), material("oak", (0.5, 0.32, 0.16))
    cloth, earth = material("cloth", (0.6, 0.12, 0.1)), material("ground", (0.25, 0.3, 0.15))
    w, d, h, t = 6.0, 4.5, 2.8, 0.25
    cell = 0.1

    def grid(a, b, c, e, skip=None):
        corners = np.array([a, b, c, e], float)
        columns = max(round(np.linalg.norm(corners[1] - corners[0]) / cell), 1)
        rows = max(round(np.linalg.norm(corners[3] - corners[0]) / cell), 1)
        return quad_grid(corners, columns, rows, skip)

    windows = ((1.0, 2.4), (3.6, 5.0))  # along x in the wall y = 0, from z = 0.9 to 2.3

    def opening(u, v):
        return any(a < u * w < b for a, b in windows) and 0.9 < v * h < 2.3

    add_mesh("floor", [(*grid((0, 0, 0), (w, 0, 0), (w, d, 0), (0, d, 0)), wood)])
    add_mesh("ceiling", [(*grid((0, d, h), (w, d, h), (w, 0, h), (0, 0, h)), white)])
    add_mesh("blue wall", [(*grid((0, 0, 0), (0, d, 0), (0, d, h), (0, 0, h)), blue)])
    add_mesh("ochre wall", [(*grid((w, d, 0), (w, 0, 0), (w, 0, h), (w, d, h)), ochre)])
    add_mesh("back wall", [(*grid((0, d, 0), (w, d, 0), (w, d, h), (0, d, h)), white)])
    parts = [(*grid((w, 0, 0), (0, 0, 0), (0, 0, h), (w, 0, h), lambda u, v: opening(1 - u, v)), white)]
    parts.append((*grid((0, -t, 0), (w, -t, 0), (w, -t, h), (0, -t, h), opening), white))
    for a, b in windows:
        parts.append((*grid((a, -t, 0.9), (b, -t, 0.9), (b, 0, 0.9), (a, 0, 0.9)), white))
        parts.append((*grid((a, 0, 2.3), (b, 0, 2.3), (b, -t, 2.3), (a, -t, 2.3)), white))
        parts.append((*grid((a, 0, 0.9), (a, 0, 2.3), (a, -t, 2.3), (a, -t, 0.9)), white))
        parts.append((*grid((b, -t, 0.9), (b, -t, 2.3), (b, 0, 2.3), (b, 0, 0.9)), white))
    add_mesh("window wall", parts)
    add_mesh("shell", box_parts((-t, -t, h), (w + t, d + t, h + t), 0.5, white, "xXyYZ"))
    add_mesh(
        "ground", [(*quad_grid(((-8, -14, -0.02), (14, -14, -0.02), (14, -t, -0.02), (-8, -t, -0.02)), 44, 28), earth)]
    )

    add_mesh("table top", box_parts((2.2, 1.6, 0.7), (3.8, 2.5, 0.75), 0.1, wood))
    for k, (x, y) in enumerate(((2.25, 1.65), (3.7, 1.65), (2.25, 2.4), (3.7, 2.4))):
        add_mesh(f"table leg {k + 1}", box_parts((x, y, 0), (x + 0.05, y + 0.05, 0.7), 0.1, wood, "xXyY"))
    add_mesh("sofa", box_parts((0.05, 1.2, 0), (0.85, 3.2, 0.42), 0.1, cloth, "XyYZ"))
    add_mesh("sofa back", box_parts((0.05, 1.2, 0.42), (0.25, 3.2, 0.85), 0.1, cloth, "xXyYZ"))
    add_mesh("shelf", box_parts((5.6, 1.0, 0), (6.0, 2.2, 1.9), 0.1, white, "xyYZ"))
    add_mesh("ball", ball_parts((3.1, 2.05, 0.95), 0.2, material("porcelain", (0.85, 0.85, 0.85))), smooth=True)

    sun = bpy.data.lights.new("Sun", "SUN")
    sun.energy, sun.angle, sun.color = 4.0, np.radians(0.53), (1.0, 0.93, 0.82)
    made = bpy.data.objects.new("Sun", sun)
    made.rotation_euler = (np.radians(55), 0.0, np.radians(18))
    bpy.context.scene.collection.objects.link(made)
    add_camera((5.6, 4.1, 1.6), (1.4, 0.6, 0.9), lens=20.0)


def hall():
    """A hall of some 50 objects under six ceiling panels."""
    new_scene("Hall")
    plaster, stone = material("plaster", (0.78, 0.76, 0.72)), material("stone", (0.45, 0.43, 0.4))
    wood, red, green = (
        material("oak", (0.45, 0.3, 0.17)),
        material("red", (0.6, 0.1, 0.08)),
        material("green", (0.12, 0.4, 0.2)),
    )
    panel = material("panel", emission=(1.0, 0.93, 0.84), strength=14.0)
    w, d, h = 18.0, 12.0, 5.0
    cell = 0.255

    def wall(name, a, b, c, e, paint):
        corners = np.array([a, b, c, e], float)
        columns = round(np.linalg.norm(corners[1] - corners[0]) / cell)
        rows = round(np.linalg.norm(corners[3] - corners[0]) / cell)
        add_mesh(name, [(*quad_grid(corners, columns, rows), paint)])

    wall("floor", (0, 0, 0), (w, 0, 0), (w, d, 0), (0, d, 0), stone)
    wall("west wall", (0, 0, 0), (0, d, 0), (0, d, h), (0, 0, h), red)
    wall("east wall", (w, d, 0), (w, 0, 0), (w, 0, h), (w, d, h), green)
    wall("north wall", (0, d, 0), (w, d, 0), (w, d, h), (0, d, h), plaster)
    wall("south wall", (w, 0, 0), (0, 0, 0), (0, 0, h), (w, 0, h), plaster)
    # The panels fill holes in the ceiling, whose grid lines run along their edges.
    panels = [(3.0 + 6.0 * (k % 3), 3.5 + 5.0 * (k // 3)) for k in range(6)]
    across = lines(w, [edge for x, _ in panels[:3] for edge in (x - 0.9, x + 0.9)], cell)
    deep = lines(d, [edge for y in (3.5, 8.5) for edge in (y - 0.3, y + 0.3)], cell)

    def inside(k):
        x, y = panels[k]
        return lambda u, v: abs(u * w - x) < 0.9 and abs((1 - v) * d - y) < 0.3

    corners = ((0, d, h), (w, d, h), (w, 0, h), (0, 0, h))
    u, v = across / w, 1 - deep[::-1] / d
    any_panel = lambda a, b: any(inside(k)(a, b) for k in range(6))
    add_mesh("ceiling", [(*quad_grid(corners, u, v, any_panel), plaster)])
    for k in range(6):
        add_mesh(f"panel {k + 1}", [(*quad_grid(corners, u, v, lambda a, b, k=k: not inside(k)(a, b)), panel)])
    for k in range(10):
        x, y = 2.0 + 3.5 * (k % 5), 1.5 + 9.0 * (k // 5)
        add_mesh(f"column {k + 1}", column_parts((x, y), 0.28, 0.0, h, plaster, 18, 18), smooth=True)
    for k in range(8):
        x, y = 4.0 + 3.3 * (k % 4), 4.2 + 3.4 * (k // 4)
        add_mesh(f"table {k + 1}", box_parts((x, y, 0.72), (x + 1.8, y + 0.8, 0.78), 0.15, wood))
        add_mesh(
            f"table base {k + 1}", box_parts((x + 0.7, y + 0.25, 0), (x + 1.1, y + 0.55, 0.72), 0.12, wood, "xXyY")
        )
        add_mesh(f"bench {k + 1}", box_parts((x, y - 0.7, 0), (x + 1.8, y - 0.35, 0.45), 0.15, wood, "xXyYZ"))
    for k in range(5):
        place = (4.6 + 3.3 * (k % 4), 4.6 + 3.4 * (k // 4), 0.78 + 0.16)
        add_mesh(f"ball {k + 1}", ball_parts(place, 0.16, (red, green, plaster)[k % 3], 24, 12), smooth=True)
    stairs = []
    for k in range(8):
        stairs += box_parts((15.2, 4.0 + 0.3 * k, 0.18 * k), (17.6, 4.3 + 0.3 * k, 0.18 * (k + 1)), 0.2, stone, "xXyZ")
    add_mesh("stairs", stairs)
    add_mesh("landing", box_parts((15.2, 6.4, 1.38), (17.6, 8.4, 1.44), 0.2, stone))
    add_camera((0.7, 2.9, 2.3), (11.0, 6.6, 1.0), lens=18.0)


def paper_room(n, blocks, lamps, shelf):
    """A room like those of the paper: n x n patches a wall, blocks [(low, high, columns, rows)], square lamps of k x k."""
    gray, warm, blue = (
        material("gray", (0.6, 0.6, 0.6)),
        material("warm", (0.7, 0.45, 0.3)),
        material("blue", (0.3, 0.4, 0.7)),
    )
    lamp = material("lamp", emission=(1.0, 1.0, 1.0), strength=10.0)
    w, d, h = 4.0, 4.0, 3.0
    corners = [
        ((0, 0, 0), (w, 0, 0), (w, d, 0), (0, d, 0)), ((0, d, h), (w, d, h), (w, 0, h), (0, 0, h)),
        ((0, d, 0), (w, d, 0), (w, d, h), (0, d, h)), ((w, 0, 0), (0, 0, 0), (0, 0, h), (w, 0, h)),
        ((0, 0, 0), (0, d, 0), (0, d, h), (0, 0, h)), ((w, d, 0), (w, 0, 0), (w, 0, h), (w, d, h)),
    ]  # fmt: skip
    paints = (gray, gray, gray, gray, warm, blue)
    add_mesh("room", [(*quad_grid(c, n, n), paint) for c, paint in zip(corners, paints)])
    for number, (low, high, columns, rows) in enumerate(blocks):
        sides = box_parts(low, high, 99.0, gray, "xXyYZ")
        outline = [vertices for vertices, _, _ in sides]
        add_mesh(f"block {number + 1}", [(*quad_grid(v[[0, 1, 3, 2]], columns, rows), gray) for v in outline])
    for number, (x, y, size, k) in enumerate(lamps):
        s = size / 2
        corners = ((x - s, y + s, h - 0.3), (x + s, y + s, h - 0.3), (x + s, y - s, h - 0.3), (x - s, y - s, h - 0.3))
        add_mesh(f"lamp {number + 1}", [(*quad_grid(corners, k, k), lamp)])
    if shelf:
        add_mesh("shelf", [(*quad_grid(((0.02, 1, 1.5), (0.5, 1, 1.5), (0.5, 3, 1.5), (0.02, 3, 1.5)), *shelf), warm)])
    add_camera((3.6, 0.4, 1.9), (1.6, 2.4, 1.0), lens=20.0)
    assert all(len(o.data.polygons) for o in bpy.data.objects if o.type == "MESH")


def paper_973():
    """973 patches, as many as the paper's data1 has; bake it with --max-patch mesh."""
    new_scene("Paper 973")
    paper_room(12, [((1.2, 1.6, 0.0), (2.2, 2.6, 1.1), 4, 5)], [(2.0, 2.0, 1.0, 3)], None)


def paper_1608():
    """1608 patches, as many as the paper's data2 has; bake it with --max-patch mesh."""
    new_scene("Paper 1608")
    blocks = [((0.8, 2.2, 0.0), (1.7, 3.1, 1.6), 6, 6), ((2.3, 1.0, 0.0), (3.2, 1.9, 0.8), 6, 6)]
    paper_room(14, blocks, [(x, y, 0.5, 3) for x in (1.2, 2.8) for y in (1.2, 2.8)], (6, 6))


SCENES = {
    "cornell_box": cornell_box,
    "sunlit_room": sunlit_room,
    "hall": hall,
    "paper_973": paper_973,
    "paper_1608": paper_1608,
}


def main(names):
    for name in names or SCENES:
        SCENES[name]()
        count = sum(len(o.data.vertices) for o in bpy.data.objects if o.type == "MESH")
        objects = sum(o.type == "MESH" for o in bpy.data.objects)
        bpy.ops.wm.save_as_mainfile(filepath=str(HERE / f"{name}.blend"), compress=False, check_existing=False)
        polygons = sum(len(o.data.polygons) for o in bpy.data.objects if o.type == "MESH")
        print(f"{name}: {objects} objects, {count} vertices, {polygons} polygons")


if __name__ == "__main__":
    main(sys.argv[1:])
