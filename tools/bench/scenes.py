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

from scenes import Lamp, Material, Mesh, Settings, bake, box, box_corners, grid, join_meshes, run  # noqa: E402

__all__ = ["Lamp", "Material", "Mesh", "Settings", "bake", "box", "box_corners", "grid", "join_meshes", "run"]

REFERENCES = ROOT / "tests" / "references"
SAMPLES = light_scenes.SAMPLES
INDOORS = " indoors"  # ends the name of a scene of which only the inside is baked: nearly all light is outside
OUTSIDE = {
    "sunlit_room": ("ground", "shell", "window wall"),
    "shaft": ("roof", "outer walls"),
    "window": ("shell", "outer wall"),
}
OPEN = ("courtyard", *OUTSIDE)
NAMES = (
    *(n for n in (*SAMPLES, *light_scenes.SCENES) if (REFERENCES / f"{n}.npz").exists()),
    *(n + INDOORS for n in OUTSIDE),
)


def kind_of(name):
    """Where the light of what is baked comes from: "lamps", "sun" (through openings), "open" (sun and sky, outdoors)."""
    return "open" if name in OPEN else "sun" if name.endswith(INDOORS) else "lamps"


def baked_of(name):
    """A function of an object's name: whether its light is asked for; None: of all."""
    if not name.endswith(INDOORS):
        return None
    left_out = OUTSIDE[name.removesuffix(INDOORS)]
    return lambda name: name not in left_out


def opened(name):
    """The core's Scene of one of NAMES, which becomes Blender's open file."""
    with silent():
        light_scenes.open_scene(name.removesuffix(INDOORS))
        return read_scene(bpy.context, baked_of(name))[0]


def _reference_file(name):
    return REFERENCES / f"{name.removesuffix(INDOORS)}.npz"


def reference_of(name):
    """The arrays of a scene's reference, see core.compare."""
    return dict(np.load(_reference_file(name)))


def mark_of(name):
    """A number that tells a scene's reference from another one of the same name."""
    return zlib.crc32(_reference_file(name).read_bytes())
