"""Take the README's pictures of the extension in Blender's window: before, during and after a bake of the hall, and with
the lights of the sunlit room changed.

BLENDER in the environment names the program; the zip is in dist/. Needs Xvfb, xdotool and import, as the window's tests do.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tests"))

from real_blender import EXTENSION, PROGRAM, RealBlender  # noqa: E402
from window import Window  # noqa: E402

VIEW = (0, 28, 1058, 800)  # what is kept of the screen: the 3D view with the panel, and the status bar
SESSION = f"__import__('sys').modules['{EXTENSION}.addon.session'].Session"


def keep(window, name):
    """Take a picture, in all its colors: with fewer, smooth light looks like noise."""
    Image.fromarray(window.picture()).crop(VIEW).save(ROOT / "docs" / f"window_{name}.png", optimize=True)


def choose(window, preset, error):
    """Choose an accuracy in the panel."""
    window.ask(
        f"s = bpy.context.scene.radiosity; s.preset, s.error = {preset!r}, {error};"
        "[a.tag_redraw() for a in window.screen.areas]"
    )


def main():
    with tempfile.TemporaryDirectory(prefix="radiosity-") as folder:
        blender = RealBlender(Path(folder))
        window = Window(PROGRAM, folder, blender.environment)
        try:
            window.open(ROOT / "sample_scenes" / "hall.blend")
            choose(window, "fine", 0.5)
            time.sleep(1)
            keep(window, "before")
            choose(window, "error", 0.2)  # which takes long enough
            time.sleep(1)
            window.click(*window.find_button())
            window.until(f"getattr({SESSION}.running, 'light_error', None) is not None", wait=300)
            time.sleep(3)
            keep(window, "during")
            window.press("Escape")
            window.until(f"{SESSION}.running is None", wait=300)
            choose(window, "error", 1.0)
            time.sleep(1)
            window.click(*window.find_button())
            window.until(f"{SESSION}.running is not None")
            window.until(f"{SESSION}.running is None", wait=300)
            time.sleep(8)  # until the report in the status bar has gone
            keep(window, "after")
            window.open(ROOT / "sample_scenes" / "sunlit_room.blend")
            choose(window, "error", 1.0)
            window.ask("s.groups = 'lamp'")
            time.sleep(1)
            window.click(*window.find_button())
            window.until(f"{SESSION}.running is not None")
            window.until(f"{SESSION}.running is None", wait=300)
            window.ask("sun, sky = s.result.groups; sun.strength, sky.strength, sky.color = 0.15, 2.5, (0.5, 0.7, 1.0)")
            window.scroll()
            time.sleep(8)
            keep(window, "lights")
        finally:
            window.close()


if __name__ == "__main__":
    main()
