"""A real Blender with a window on a screen of its own (Xvfb), that can be asked, clicked, typed to and looked at."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

PROGRAMS = ("Xvfb", "xdotool", "import")
SIZE = (1280, 800)

# Inside Blender: runs what is put into the file `ask` from a timer, and answers with the JSON of its `answer`.
INSIDE = """
import bpy, json, os, traceback
bpy.context.preferences.view.show_splash = False
bpy.context.preferences.use_preferences_save = False
bpy.context.preferences.inputs.use_mouse_continuous = False
names = {"bpy": bpy}
def listen():
    ask = os.path.join(FOLDER, "ask")
    if os.path.exists(ask):
        with open(ask) as file:
            code = file.read()
        os.remove(ask)
        names["answer"] = None
        try:
            window = bpy.context.window_manager.windows[0]
            area = next((a for a in window.screen.areas if a.type == "VIEW_3D"), window.screen.areas[0])
            names.update(window=window, area=area, region=next(r for r in area.regions if r.type == "WINDOW"))
            exec(code, names)
            reply = {"answer": names["answer"]}
        except Exception:
            reply = {"error": traceback.format_exc()}
        with open(os.path.join(FOLDER, "reply.part"), "w") as file:
            json.dump(reply, file)
        os.replace(os.path.join(FOLDER, "reply.part"), os.path.join(FOLDER, "reply"))
    return 0.02
bpy.app.timers.register(listen, first_interval=0.5, persistent=True)
"""


class Window:
    """One Blender window. folder: seen by Blender too; blender: the program; environment: what it runs with."""

    _screens = itertools.count(90 + os.getpid() % 400)

    def __init__(self, blender, folder, environment, *arguments):
        self.folder = Path(tempfile.mkdtemp(prefix="window-", dir=folder))
        self.display = f":{next(self._screens)}"
        quiet = dict(stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        screen = [*["-screen", "0"], "x".join(map(str, SIZE)) + "x24", "+extension", "GLX"]
        self._screen = subprocess.Popen(["Xvfb", self.display, *screen], **quiet)
        self._environment = {**environment, "DISPLAY": self.display}
        time.sleep(0.5)
        inside = self.folder / "inside.py"
        inside.write_text(f"FOLDER = {str(self.folder)!r}\n{INSIDE}")
        self.log = open(self.folder / "window.log", "w")  # noqa: SIM115
        self.process = subprocess.Popen(
            [blender, "--window-geometry", "0", "0", *map(str, SIZE), *map(str, arguments), "--python", str(inside)],
            env=self._environment, cwd=folder, stdout=self.log, stderr=subprocess.STDOUT,
        )  # fmt: skip
        self.ask("", wait=60)

    def ask(self, code, wait=30):
        """Run code inside; returns what it calls `answer`. It finds `window`, `area` and `region` of the 3D view."""
        self.say(code)
        reply = self.folder / "reply"
        until = time.monotonic() + wait
        while not reply.exists():
            assert self.process.poll() is None, f"Blender ended: {(self.folder / 'window.log').read_text()}"
            assert time.monotonic() < until, f"no answer to {code!r}: {(self.folder / 'window.log').read_text()}"
            time.sleep(0.02)
        said = json.loads(reply.read_text())
        reply.unlink()
        assert "error" not in said, said.get("error")
        return said["answer"]

    def say(self, code):
        """Run code inside without waiting for its answer."""
        part = self.folder / "ask.part"
        part.write_text(code)
        os.replace(part, self.folder / "ask")

    def open(self, path):
        """Open a file, and see it through its camera beside our panel."""
        self.ask(f"bpy.ops.wm.open_mainfile(filepath={str(path)!r}, load_ui=False)")
        self.panel = self._show_panel()

    def until(self, code, wait=60):
        """Ask for the value of an expression until it is true; returns it."""
        end = time.monotonic() + wait
        while not (value := self.ask(f"answer = {code}")):
            assert time.monotonic() < end, f"never true: {code}"
            time.sleep(0.05)
        return value

    def picture(self, path=None):
        """The screen as (height, width, 3) uint8; path: where to keep it."""
        path = path or self.folder / "screen.png"
        subprocess.run(["import", "-window", "root", path], env=self._environment, check=True)
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"))

    def until_seen(self, fits, wait=60):
        """Look at the screen until a picture fits: a busy machine draws late."""
        end = time.monotonic() + wait
        while not fits(self.picture()):
            assert time.monotonic() < end, "it was never seen"
            time.sleep(0.2)

    def rest(self, wait=60):
        """Wait until the screen stands still: what is found on it stays where it is."""
        end, before, now = time.monotonic() + wait, None, self.picture()
        while before is None or np.any(before != now):
            assert time.monotonic() < end, "the screen never stood still"
            time.sleep(1.0)
            before, now = now, self.picture()

    def click(self, x, y):
        """Click at a place on the screen."""
        self._type("mousemove", x, y)
        time.sleep(0.3)
        self._type("click", 1)

    def press(self, key, place=None):
        """Press a key, with the mouse over the 3D view."""
        x, y = place or (350, 400)
        self._type("mousemove", x, y)
        time.sleep(0.2)
        self._type("key", key)

    def _show_panel(self):
        """Open the sidebar at our panel, and look through the camera; returns the sidebar's (left, top, right, bottom)."""
        self.ask("area.spaces.active.show_region_ui = True; area.spaces.active.region_3d.view_perspective = 'CAMERA'")
        time.sleep(0.5)
        x, y, width, height = self.ask(
            "side = next(r for r in area.regions if r.type == 'UI'); side.active_panel_category = 'Radiosity';"
            "area.tag_redraw(); answer = [side.x, side.y, side.width, side.height]"
        )
        time.sleep(0.5)
        return x, SIZE[1] - y - height, x + width, SIZE[1] - y

    def find_button(self):
        """(x, y) of the tallest button of the panel, Bake or Cancel."""
        return self._find("wcol_tool", self.TALL)

    def find_slider(self):
        """(x, y) of the first slider of the panel."""
        return self._find("wcol_numslider")

    def scroll(self):
        """Scroll the panel to its end."""
        left, top, right, bottom = self.panel
        self._type("mousemove", (left + right) // 2, (top + bottom) // 2)
        time.sleep(0.2)
        self._type("click", "--repeat", 30, "--delay", 10, 5)
        self.rest()

    def drag(self, place, by):
        """Press the mouse at (x, y), and let it go so many pixels to the right."""
        self._type("mousemove", *place)
        self.rest()  # what is drawn anew takes no press
        self._type("mousedown", 1)
        for step in range(1, 6):
            self._type("mousemove", place[0] + by * step // 5, place[1])
            time.sleep(0.1)
        self._type("mouseup", 1)

    TALL = 20  # pixels that only Bake and Cancel reach

    def _find(self, kind, height=8):
        """(x, y) of the first widget of a kind in the panel that is taller than so many pixels: for a moment all of the kind
        get a color of their own."""
        color = f"bpy.context.preferences.themes[0].user_interface.{kind}.inner"
        former = self.ask(f"answer = list({color}); {color} = (1, 0, 1, 1); area.tag_redraw()")
        left, top, right, bottom = self.panel
        end = time.monotonic() + 60  # a busy machine draws late
        try:
            while time.monotonic() < end:
                time.sleep(0.3)
                part = self.picture()[top:bottom, left:right].astype(int)
                colored = (part[..., 0] > 200) & (part[..., 1] < 80) & (part[..., 2] > 200)
                rows = np.flatnonzero(colored.sum(axis=1) > (right - left) // 3)
                runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
                found = next((run for run in runs if len(run) > height), None)
                if found is not None:
                    return (left + right) // 2, int(top + found.mean())
        finally:
            self.ask(f"{color} = {former}; area.tag_redraw()")
        raise AssertionError(f"there is no such widget in the panel: {kind}")

    def close(self):
        """End Blender and its screen, whatever they are at."""
        for process in (self.process, self._screen):
            if process.poll() is None:
                process.kill()
            process.wait()
        self.log.close()

    def _type(self, *words):
        subprocess.run(["xdotool", *map(str, words)], env=self._environment, check=True)


def missing():
    """Programs that a window needs and that are not there."""
    return [name for name in PROGRAMS if not shutil.which(name)]
