"""Time the extension in Blender's window: from the press of Bake to the first light on the screen and to a draft of a
room of 10 000 vertices, with cells that have to be started and with warm ones; and the longest that Blender waits for
us. The last bake has no 3D view to draw: what is left between two turns of ours is what the work beside the window
takes from it.

BLENDER in the environment names the program; the zip is in dist/. Needs Xvfb, xdotool and import, as the window's tests do.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tests"))

from real_blender import EXTENSION, PROGRAM, RealBlender  # noqa: E402
from window import Window  # noqa: E402

SESSION = f"__import__('sys').modules['{EXTENSION}.addon.session'].Session"

# A room with eight blocks in it under a lamp, VERTICES in all.
ROOM = """
import bmesh
bpy.ops.wm.read_homefile(use_empty=True)
bpy.context.scene.world = bpy.data.worlds.new("dark")
bpy.context.scene.world.color = (0, 0, 0)
def box(name, size, place, cuts, inward):
    mesh = bpy.data.meshes.new(name)
    made = bmesh.new()
    bmesh.ops.create_cube(made, size=1.0)
    bmesh.ops.subdivide_edges(made, edges=made.edges, cuts=cuts, use_grid_fill=True)
    bmesh.ops.scale(made, vec=size, verts=made.verts)
    if inward:
        bmesh.ops.reverse_faces(made, faces=made.faces)
    made.to_mesh(mesh)
    made.free()
    object = bpy.data.objects.new(name, mesh)
    object.location = place
    bpy.context.scene.collection.objects.link(object)
box("room", (6, 5, 3), (0, 0, 1.5), round((0.1 * VERTICES) ** 0.5) - 1, True)
for k in range(8):
    box(f"block {k}", (0.6, 0.5, 0.4 + 0.1 * k), (-2 + 1.3 * (k % 4), -1 + 2 * (k // 4), 0.25 + 0.05 * k),
        round((VERTICES / 120) ** 0.5) - 1, False)
lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "AREA"))
lamp.data.energy, lamp.data.size, lamp.location = 100, 0.8, (0.5, 0.3, 2.9)
bpy.context.scene.collection.objects.link(lamp)
eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
eye.data.lens, eye.location, eye.rotation_euler = 18, (0, -2.4, 1.6), (1.5, 0, 0)
bpy.context.scene.collection.objects.link(eye)
bpy.context.scene.camera = eye
bpy.context.scene.radiosity.preset = "draft"
answer = sum(len(o.data.vertices) for o in bpy.context.scene.objects if o.type == "MESH")
"""

# Notes when Bake was pressed, when its light was drawn first, when all of it was, and every turn that we took of Blender's.
WATCH = f"""
from time import perf_counter
session = {SESSION}
Bake = __import__('sys').modules['{EXTENSION}.addon.operators'].RADIOSITY_OT_bake
class Watch: pressed = first = ended = drawn = last = None; turns = []; gaps = []
def timed(function):
    def call(self, context, event):
        begun = perf_counter()
        if function is invoke:
            Watch.pressed, Watch.first, Watch.ended, Watch.drawn, Watch.turns, Watch.gaps = begun, None, None, None, [], []
            phase = "start"
        else:
            phase = self._running.phase
            Watch.gaps.append((begun - Watch.last, phase))
        result = function(self, context, event)
        Watch.last = perf_counter()
        Watch.turns.append((Watch.last - begun, phase))
        if not result & {{"RUNNING_MODAL", "PASS_THROUGH"}}:
            Watch.ended = Watch.last
        return result
    return call
invoke, modal = Bake.invoke, Bake.modal
Bake.invoke, Bake.modal = timed(invoke), timed(modal)
def drawn():
    now = perf_counter()
    if Watch.pressed and not Watch.first and any("Radiosity" in m.color_attributes for m in bpy.data.meshes):
        Watch.first = now
    if Watch.ended and not Watch.drawn:
        Watch.drawn = now
bpy.types.SpaceView3D.draw_handler_add(drawn, (), "WINDOW", "POST_PIXEL")
"""

PRESS = (
    "with bpy.context.temp_override(window=window, area=area, region=region): bpy.ops.radiosity.bake('INVOKE_DEFAULT')"
)
HIDE = "; area.type = 'TEXT_EDITOR'"
TELL = """
longest = lambda times: {p: max(t for t, q in times if q == p) for p in ("start", "read", "work", "write") if any(q == p for _, q in times)}
since = lambda moment: moment and moment - Watch.pressed
answer = [since(Watch.first), since(Watch.ended), since(Watch.drawn), longest(Watch.turns), longest(Watch.gaps),
          len(Watch.turns), bpy.context.scene.radiosity.result.seconds]
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--file", help="a .blend file to bake in place of the room")
    parser.add_argument("--vertices", type=int, default=10_000, help="of the room")
    parser.add_argument("--error", type=float, default=10.0, help="percent")
    parser.add_argument("--times", type=int, default=3, help="bakes with warm cells")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="radiosity-") as folder:
        blender = RealBlender(Path(folder))
        window = Window(PROGRAM, folder, blender.environment)
        try:
            if arguments.file:
                window.open(Path(arguments.file).resolve())
            else:
                print(window.ask(f"VERTICES = {arguments.vertices}{ROOM}", wait=120), "vertices")
            window.panel = window._show_panel()
            window.ask(f"s = bpy.context.scene.radiosity; s.preset, s.error = 'error', {arguments.error}")
            window.ask(WATCH)
            for cells in ("cold", *["warm"] * arguments.times, "warm, no view"):
                window.ask("bpy.ops.radiosity.clear() if bpy.ops.radiosity.clear.poll() else None")
                time.sleep(3)  # Blender draws a view that has changed some times more, to smooth it
                window.ask(PRESS + (HIDE if cells == "warm, no view" else ""))
                window.until("Watch.ended" if cells == "warm, no view" else "Watch.drawn", wait=300)
                first, ended, seen, turns, gaps, count, bake = window.ask(TELL)
                told = "  ".join(f"{phase} {1000 * t:.0f}" for phase, t in turns.items())
                between = "  ".join(f"{phase} {1000 * t:.0f}" for phase, t in gaps.items())
                light = f"first light {first:.2f} s, all of it {seen:.2f} s, " if seen else ""
                print(f"{cells}: {light}done {ended:.2f} s, the bake itself {bake:.2f} s")
                print(f"  longest of {count} turns of ours [ms]: {told};  between two of them: {between}", flush=True)
        finally:
            window.close()


if __name__ == "__main__":
    main()
