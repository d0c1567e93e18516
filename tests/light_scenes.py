"""Scenes that are hard to light, each in its own way, as .blend files:

    python tests/light_scenes.py FOLDER [NAME ...]

References of their light lie in tests/references, made by tools/reference.py.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import bpy
import numpy as np

HERE = Path(__file__).parent
_spec = importlib.util.spec_from_file_location("sample_scenes_make", HERE.parent / "sample_scenes" / "make.py")
make = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(make)


def wall(name, corners, cell, paint, skip=None):
    """A rectangle of quads about `cell` on a side as an object; skip(u, v): cells whose middle is there are left out."""
    corners = np.array(corners, float)
    columns = max(round(np.linalg.norm(corners[1] - corners[0]) / cell), 1)
    rows = max(round(np.linalg.norm(corners[3] - corners[0]) / cell), 1)
    return make.add_mesh(name, [(*make.quad_grid(corners, columns, rows, skip), paint)])


def block(name, low, high, cell, paint, sides="xXyYZ"):
    """An axis-aligned block that stands on something."""
    return make.add_mesh(name, make.box_parts(low, high, cell, paint, sides))


def room(low, high, cell, paints, openings=None):
    """The six inner walls of a room. paints: {side: material}, openings: {side: skip(u, v)}."""
    (x, y, z), (X, Y, Z) = low, high
    corners = {
        "x": ((x, y, z), (x, Y, z), (x, Y, Z), (x, y, Z)),
        "X": ((X, Y, z), (X, y, z), (X, y, Z), (X, Y, Z)),
        "y": ((X, y, z), (x, y, z), (x, y, Z), (X, y, Z)),
        "Y": ((x, Y, z), (X, Y, z), (X, Y, Z), (x, Y, Z)),
        "z": ((x, y, z), (X, y, z), (X, Y, z), (x, Y, z)),
        "Z": ((x, Y, Z), (X, Y, Z), (X, y, Z), (x, y, Z)),
    }
    names = dict(x="west wall", X="east wall", y="south wall", Y="north wall", z="floor", Z="ceiling")
    for side, paint in paints.items():
        wall(names[side], corners[side], cell, paint, (openings or {}).get(side))


def lamp(kind, energy, place, turn=(0.0, 0.0, 0.0), **settings):
    """A lamp of the scene."""
    data = bpy.data.lights.new(kind, kind)
    data.energy = energy
    for key, value in settings.items():
        setattr(data, key, value)
    made = bpy.data.objects.new(kind, data)
    made.location, made.rotation_euler = place, turn
    bpy.context.scene.collection.objects.link(made)
    return made


def paints():
    """White, red, green and brown."""
    colors = dict(white=(0.8, 0.78, 0.74), red=(0.6, 0.12, 0.1), green=(0.15, 0.45, 0.2), brown=(0.4, 0.27, 0.16))
    return [make.material(name, color) for name, color in colors.items()]


def small_lamps():
    """A furnished room lit by three bulbs, small glowing cubes, and a narrow spot."""
    make.new_scene("Small lamps")
    white, red, green, brown = paints()
    room((0, 0, 0), (5, 4, 2.6), 0.16, dict(x=red, X=green, y=white, Y=white, z=brown, Z=white))
    bulb = make.material("bulb", emission=(1.0, 0.85, 0.6), strength=900.0)
    for k, (x, y, z) in enumerate(((1.2, 1.0, 2.2), (3.9, 3.1, 1.3), (2.6, 2.2, 2.35))):
        make.add_mesh(f"bulb {k + 1}", make.box_parts((x, y, z), (x + 0.05, y + 0.05, z + 0.05), 1.0, bulb))
    lamp("SPOT", 250.0, (4.5, 0.5, 2.4), (np.radians(35), 0.0, np.radians(50)), spot_size=np.radians(50),
         shadow_soft_size=0.03, spot_blend=0.3)  # fmt: skip
    block("table top", (1.6, 1.4, 0.7), (3.2, 2.4, 0.74), 0.12, brown, "xXyYzZ")
    for k, (x, y) in enumerate(((1.65, 1.45), (3.1, 1.45), (1.65, 2.3), (3.1, 2.3))):
        block(f"table leg {k + 1}", (x, y, 0), (x + 0.05, y + 0.05, 0.7), 0.14, brown, "xXyY")
    block("chest", (0.02, 2.6, 0), (0.6, 3.9, 0.8), 0.14, white)
    block("shelf", (4.4, 0.9, 1.1), (4.99, 2.5, 1.14), 0.12, white, "xyYzZ")


def many_emitters():
    """A gallery lit by some 600 small glowing faces: strips along the walls and a ring of pearls."""
    make.new_scene("Many emitters")
    white, red, green, brown = paints()
    room((0, 0, 0), (6, 4, 3), 0.18, dict(x=green, X=red, y=white, Y=white, z=brown, Z=white))
    cold, warm = (make.material(n, emission=c, strength=s) for n, c, s in
                  (("cold", (0.7, 0.85, 1.0), 25.0), ("warm", (1.0, 0.75, 0.45), 40.0)))  # fmt: skip
    for k, y in enumerate((0.05, 3.93)):
        corners = ((0.3, y, 2.7), (5.7, y, 2.7), (5.7, y + 0.02, 2.74), (0.3, y + 0.02, 2.74))
        make.add_mesh(f"strip {k + 1}", [(*make.quad_grid(corners, 180, 1), cold)])
    pearls = []
    for k in range(12):
        t = 2 * np.pi * k / 12
        pearls += make.ball_parts((3 + 1.1 * np.cos(t), 2 + 1.1 * np.sin(t), 2.3), 0.05, warm, 6, 4)
    make.add_mesh("pearls", pearls)
    for k in range(3):
        block(f"plinth {k + 1}", (1.0 + 1.8 * k, 1.7, 0), (1.5 + 1.8 * k, 2.2, 0.9 + 0.2 * k), 0.13, white)
        ball = make.ball_parts((1.25 + 1.8 * k, 1.95, 1.15 + 0.2 * k), 0.22, (red, white, green)[k], 20, 10)
        make.add_mesh(f"ball {k + 1}", ball, smooth=True)


def door():
    """Two rooms and a door between them that stands ajar; only the first has a lamp."""
    make.new_scene("Door")
    white, red, green, brown = paints()
    hole = lambda u, v: 1.5 < v * 4 < 2.4 and u * 2.6 < 2.1
    room((0, 0, 0), (4, 4, 2.6), 0.2, dict(x=red, y=white, Y=white, z=brown, Z=white))
    for name, x, flip in (("door wall", 4.0, False), ("door wall, far side", 4.1, True)):
        a, b, c, d = ((x, 0, 0), (x, 0, 2.6), (x, 4, 2.6), (x, 4, 0))
        part = make.quad_grid((a, b, c, d), 26, 40, hole)
        vertices, faces = part
        make.add_mesh(name, [(vertices, [f[::-1] for f in faces] if flip else faces, white)])
    for name, corners in (("jamb 1", ((4.0, 1.5, 0), (4.1, 1.5, 0), (4.1, 1.5, 2.1), (4.0, 1.5, 2.1))),
                          ("jamb 2", ((4.1, 2.4, 0), (4.0, 2.4, 0), (4.0, 2.4, 2.1), (4.1, 2.4, 2.1))),
                          ("lintel", ((4.0, 1.5, 2.1), (4.1, 1.5, 2.1), (4.1, 2.4, 2.1), (4.0, 2.4, 2.1))),
                          ("sill", ((4.0, 1.5, 0.0), (4.0, 2.4, 0.0), (4.1, 2.4, 0.0), (4.1, 1.5, 0.0)))):  # fmt: skip
        wall(name, corners, 0.1, white)
    t = np.radians(35)
    leaf = np.array(((4.1, 2.4, 0.01), (4.1 + 0.88 * np.sin(t), 2.4 - 0.88 * np.cos(t), 0.01)))
    up = np.array((0, 0, 2.07))
    wall("door leaf", (leaf[0], leaf[1], leaf[1] + up, leaf[0] + up), 0.12, brown)
    low, high = (4.1, 0, 0), (8.1, 4, 2.6)
    (x, y, z), (X, Y, Z) = low, high
    for name, corners, paint in (
        ("far wall", ((X, Y, z), (X, y, z), (X, y, Z), (X, Y, Z)), green),
        ("far south wall", ((X, y, z), (x, y, z), (x, y, Z), (X, y, Z)), white),
        ("far north wall", ((x, Y, z), (X, Y, z), (X, Y, Z), (x, Y, Z)), white),
        ("far floor", ((x, y, z), (X, y, z), (X, Y, z), (x, Y, z)), brown),
        ("far ceiling", ((x, Y, Z), (X, Y, Z), (X, y, Z), (x, y, Z)), white),
    ):
        wall(name, corners, 0.2, paint)
    block("bed", (6.5, 1.2, 0), (8.0, 3.0, 0.5), 0.18, red)
    lamp("AREA", 120.0, (1.5, 2.0, 2.5), shape="SQUARE", size=0.5)


def shaft():
    """A hall that only a deep skylight lights, by sun and sky."""
    make.new_scene("Shaft", world=(0.4, 0.6, 1.0), strength=1.2)
    white, red, green, brown = paints()
    w, d, h, top = 8.0, 6.0, 3.2, 5.2
    a, b = (3.4, 2.4), (4.6, 3.6)
    inside = lambda u, v: a[0] < u * w < b[0] and a[1] < (1 - v) * d < b[1]
    room((0, 0, 0), (w, d, h), 0.2, dict(x=red, X=green, y=white, Y=white, z=brown, Z=white), dict(Z=inside))
    (x, y), (X, Y) = a, b
    sides = (((x, y), (X, y)), ((X, Y), (x, Y)), ((x, Y), (x, y)), ((X, y), (X, Y)))
    grids = [make.quad_grid(((*p, h), (*q, h), (*q, top), (*p, top)), 12, 14) for p, q in sides]
    make.add_mesh("skylight", [(*grid, white) for grid in grids])
    make.add_mesh("roof", [(*make.quad_grid(((-1, -1, top), (w + 1, -1, top), (w + 1, d + 1, top), (-1, d + 1, top)), 50, 40,
                            lambda u, v: a[0] < u * 10 - 1 < b[0] and a[1] < v * 8 - 1 < b[1]), white)])  # fmt: skip
    make.add_mesh("outer walls", make.box_parts((-1, -1, -0.2), (w + 1, d + 1, top), 1.0, white, "xXyYz"))
    for k in range(4):
        block(f"step {k + 1}", (0.5 + 0.3 * k, 4.4, 0), (0.8 + 0.3 * k, 5.8, 0.2 * (k + 1)), 0.15, brown)
    block("plinth", (3.8, 2.8, 0), (4.2, 3.2, 1.0), 0.12, white)
    lamp("SUN", 6.0, (0, 0, 9), (np.radians(22), np.radians(8), 0.0), angle=np.radians(0.6))


def window():
    """A room that the sun lights through one window; no sky."""
    make.new_scene("Window")
    white, red, green, brown = paints()
    hole = lambda u, v: 1.2 < (1 - u) * 4.5 < 2.6 and 0.8 < v * 2.7 < 2.1
    room((0, 0, 0), (4.5, 5, 2.7), 0.18, dict(x=red, X=white, y=white, Y=green, z=brown, Z=white), dict(y=hole))
    wall("outer wall", ((0, -0.3, 0), (4.5, -0.3, 0), (4.5, -0.3, 2.7), (0, -0.3, 2.7)), 0.25, white,
         lambda u, v: 1.2 < u * 4.5 < 2.6 and 0.8 < v * 2.7 < 2.1)  # fmt: skip
    for name, corners in (("sill", ((1.2, -0.3, 0.8), (2.6, -0.3, 0.8), (2.6, 0, 0.8), (1.2, 0, 0.8))),
                          ("lintel", ((1.2, 0, 2.1), (2.6, 0, 2.1), (2.6, -0.3, 2.1), (1.2, -0.3, 2.1))),
                          ("jamb 1", ((1.2, 0, 0.8), (1.2, 0, 2.1), (1.2, -0.3, 2.1), (1.2, -0.3, 0.8))),
                          ("jamb 2", ((2.6, -0.3, 0.8), (2.6, -0.3, 2.1), (2.6, 0, 2.1), (2.6, 0, 0.8)))):  # fmt: skip
        wall(name, corners, 0.1, white)
    make.add_mesh("shell", make.box_parts((-0.3, -0.3, 2.7), (4.8, 5.3, 2.9), 0.6, white, "xXyYZ"))
    block("desk", (0.3, 2.2, 0), (1.1, 4.2, 0.75), 0.15, brown)
    block("cupboard", (3.9, 1.5, 0), (4.49, 3.0, 2.0), 0.17, white)
    lamp("SUN", 5.0, (0, 0, 9), (np.radians(52), 0.0, np.radians(-14)), angle=np.radians(0.53))


def courtyard():
    """A courtyard between houses, under sun and sky."""
    make.new_scene("Courtyard", world=(0.35, 0.5, 0.9), strength=1.0)
    white, red, green, brown = paints()
    wall("ground", ((-10, -10, 0), (10, -10, 0), (10, 10, 0), (-10, 10, 0)), 0.4, brown)
    block("north house", (-8, 6, 0), (8, 9, 6), 0.5, white)
    block("east house", (6.5, -6, 0), (9, 5, 4.5), 0.45, red)
    block("west house", (-9, -5, 0), (-6.5, 5, 5), 0.45, white)
    block("well", (-0.8, -0.8, 0), (0.8, 0.8, 1.0), 0.16, white)
    make.add_mesh("tree", make.ball_parts((3.0, 1.5, 2.5), 1.2, green, 24, 12), smooth=True)
    make.add_mesh("trunk", make.column_parts((3.0, 1.5), 0.15, 0.0, 1.4, brown, 10, 8), smooth=True)
    lamp("SUN", 4.0, (0, 0, 20), (np.radians(40), 0.0, np.radians(25)), angle=np.radians(0.53))


SCENES = {f.__name__: f for f in (small_lamps, many_emitters, door, shaft, window, courtyard)}
SAMPLES = ("cornell_box", "hall", "sunlit_room")


def open_scene(name):
    """Make one of the scenes, or one of the samples, Blender's open file."""
    if name in SAMPLES:
        bpy.ops.wm.open_mainfile(filepath=str(HERE.parent / "sample_scenes" / f"{name}.blend"))
    else:
        SCENES[name]()
        bpy.context.view_layer.update()


def main(folder, names):
    for name in names or SCENES:
        SCENES[name]()
        bpy.ops.wm.save_as_mainfile(filepath=str(Path(folder) / f"{name}.blend"), compress=True, check_existing=False)
        meshes = [o for o in bpy.data.objects if o.type == "MESH"]
        print(name, len(meshes), "objects,", sum(len(o.data.vertices) for o in meshes), "vertices", flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
