"""The README's table of effects: small scenes, each of which calls for one more, baked with what they need and with all
effects forced on. `make effects-table` prints it as Markdown."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from cell_radiosity.core.cells import make_cells
from cell_radiosity.core.effects import survey
from cell_radiosity.core.settings import EFFECTS
from cell_radiosity.core.sky import cell_directions
from cell_radiosity.core.surfaces import Texture

from scenes import Lamp, Material, Settings, World, bake, box, join_meshes, run, sheet

REPEATS = 3
N = 41  # 10 584 vertices, counted once for each face that they belong to
BLACK, GRAY, RED = Material("black", (0, 0, 0)), Material("gray", (0.7,) * 3), Material("red", (0.7, 0.2, 0.1))
PANEL = Lamp("area", (10.0,) * 3, position=(2.0, 2.5, 2.9), size=(1.0, 1.0), name="panel")


def room(*more, materials=(GRAY,), lamps=(PANEL,), world=World(), faces="xXyYzZ", slots=None, **fields):
    walls = box("room", high=(4, 5, 3), n=N, faces=faces, materials=slots)
    return join_meshes([walls, *more], materials, lamps, world, **fields)


def block(name="block", x=1.0, material=0):
    return box(name, (x, 1, 0), (x + 0.6, 1.8, 1.2), n=8, inward=False, materials=dict.fromkeys("xXyYzZ", material))


def scenes():
    """{what is new in it: scene}."""
    veil = sheet("veil", [(1, 1, 1.5), (3, 1, 1.5), (3, 3, 1.5), (1, 3, 1.5)], 10, 10, 1)
    checks = Texture(
        "checks", np.repeat((np.indices((8, 8)).sum(axis=0) % 2 * 0.6 + 0.2)[..., None], 3, axis=2).astype(np.float32)
    )
    image = replace(room(materials=[Material("checks", (0, 0, 0), texture=0)], textures=(checks,)))
    image = replace(image, corner_uv=image.vertices[image.corner_vertex][:, :2] / 4)
    height = cell_directions(64)[:, 2].reshape(64, 64, 1).astype(np.float32)
    blue = World(map=(np.maximum(height, 0) + 0.2) * np.array([0.2, 0.4, 0.9], np.float32))
    floor = sheet("floor", [(0, 0, 0), (4, 0, 0), (4, 5, 0), (0, 5, 0)], 100, 100)
    far = box("far room", (6, 0, 0), (10, 5, 3), n=20)
    return {
        "a floor under a lamp": join_meshes([floor], [GRAY], [PANEL]),
        "an empty black room": room(materials=[BLACK]),
        "an empty gray room": room(),
        "a tinted wall": room(materials=[GRAY, RED], slots={"x": 1}),
        "a block": room(block()),
        "a lamp of each kind": room(block(), lamps=[PANEL, Lamp("point", (5.0,) * 3, (1, 4, 2), radius=0.1), Lamp("spot", (9.0,) * 3, (3, 1, 2.5), angle=1.0, blend=0.2)]),
        "a lamp without shadows": room(block(), lamps=[replace(PANEL, shadows=False)]),
        "a glowing ceiling": room(block(), materials=[GRAY, Material("glow", exitance=(3.0,) * 3)], lamps=[], slots={"Z": 1}),
        "a window and a blue sky": room(block(), faces="xXyYz", world=blue, lamps=[]),
        "an image on the walls": image,
        "a wall seen from behind": room(sheet("screen", [(1, 2, 0), (3, 2, 0), (3, 2, 2), (1, 2, 2)], 10, 10)),
        "a veil": room(veil, materials=[GRAY, Material("veil", (0.7,) * 3, alpha=0.5)]),
        "shared blocks": room(*(block(str(k), 0.5 + k) for k in range(3)), shared=np.array([0, 1, 1, 1])),
        "a second room": room(far, lamps=[PANEL, replace(PANEL, position=(8.0, 2.5, 2.9), strength=(0.1,) * 3)]),
    }  # fmt: skip


def baked(scene, cells, **settings):
    """Least CPU seconds of a few bakes, and the irradiance (3, P) and area (P,) at the points."""
    results = [run(bake(scene, Settings.for_error(0.02, **settings), cells)) for _ in range(REPEATS)]
    light = results[0].light
    total = np.broadcast_to(light.direct + light.indirect, (3, len(results[0].points)))
    return min(r.seconds["cpu"] for r in results), total, results[0].points.area


def main():
    print("| scene | calls for | CPU s, as needed | all forced | difference |\n|---|---|---|---|---|")
    with make_cells(1) as cells:
        baked(room(), cells)
        for name, scene in scenes().items():
            needed = [e.name for e in survey(scene, Settings()).effects if e.needed]
            seconds, light, area = baked(scene, cells)
            forced, expected, _ = baked(scene, cells, force=EFFECTS)
            error = np.sqrt((area * (light - expected) ** 2).sum() / (area * expected**2).sum())
            print(f"| {name} | {', '.join(needed)} | {seconds:.2f} | {forced:.2f} | {100 * error:.2f} % |", flush=True)


if __name__ == "__main__":
    main()
