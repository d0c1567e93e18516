"""The scenes that errors are measured on: the samples and those of the tests, each with a reference of its light."""

from __future__ import annotations

import sys
import zlib
from pathlib import Path

import bpy
import numpy as np

from cell_radiosity.addon.files import silent
from cell_radiosity.addon.read_scene import read_scene

ROOT = Path(__file__).parent.parent.parent
sys.path.insert(0, str(ROOT / "tests"))

import light_scenes  # noqa: E402

from scenes import Lamp, Material, Settings, bake, box, join_meshes, run, sheet  # noqa: E402

__all__ = ["Lamp", "Material", "Settings", "bake", "box", "join_meshes", "run", "sheet"]

REFERENCES = ROOT / "tests" / "references"
SAMPLES = light_scenes.SAMPLES
OPEN = ("courtyard",)  # all others are interiors,
SUNLIT = ("sunlit_room", "window", "shaft")  # of which these are lit by a sun through openings
NAMES = tuple(n for n in (*SAMPLES, *light_scenes.SCENES) if (REFERENCES / f"{n}.npz").exists())


def kind_of(name):
    """Where a scene's light comes from, in a word."""
    return "open" if name in OPEN else "sunlit" if name in SUNLIT else "lamps"


def opened(name):
    """The core's Scene of one of NAMES, which becomes Blender's open file."""
    with silent():
        light_scenes.open_scene(name)
        return read_scene(bpy.context)[0]


def reference_of(name):
    """The arrays of a scene's reference, see core.compare."""
    return dict(np.load(REFERENCES / f"{name}.npz"))


def mark_of(name):
    """A number that tells a scene's reference from another one of the same name."""
    return zlib.crc32((REFERENCES / f"{name}.npz").read_bytes())
