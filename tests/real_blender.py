"""A real Blender, named in the environment as BLENDER, with the built zip installed in preferences of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parent.parent
PROGRAM = os.environ.get("BLENDER", "")
EXTENSION = "bl_ext.user_default.cell_radiosity"

READ = """
import bpy, numpy as np, sys
found = {}
for o in bpy.data.objects:
    if o.type == "MESH":
        for a in o.data.color_attributes:
            v = np.empty(4 * len(a.data), np.float32)
            a.data.foreach_get("color", v)
            found[o.name + "." + a.name] = v
np.savez(sys.argv[-1], **found)
"""


class RealBlender:
    """Runs the program. folder: one that it sees, and where it works; environment: with preferences of its own."""

    def __init__(self, folder):
        self.folder = folder
        self.environment = {**os.environ, "BLENDER_USER_RESOURCES": str(folder / "user")}
        (folder / "user").mkdir()
        (folder / "read.py").write_text(READ)
        (package,) = (ROOT / "dist").glob("*-linux_x64.zip")
        shutil.copy(package, folder / package.name)
        self("--command", "extension", "validate", folder / package.name)
        self("--command", "extension", "install-file", "-r", "user_default", "--enable", folder / package.name)

    def __call__(self, *arguments, check=True):
        """Run it to its end; check: it must succeed."""
        done = subprocess.run(
            [PROGRAM, *map(str, arguments)],
            env=self.environment, capture_output=True, text=True, cwd=self.folder, timeout=300,
        )  # fmt: skip
        assert not check or done.returncode == 0, done.stdout + done.stderr
        return done

    def layers(self, path):
        """{object.layer: values} of a file, as Blender itself reads it."""
        out = path.with_suffix(".npz")
        self("-b", path, "--python-exit-code", "7", "--python", self.folder / "read.py", "--", out)
        with np.load(out) as found:
            return dict(found)


def same(found, expected):
    """Whether two files have the same layers, bit for bit."""
    return set(found) == set(expected) and all(np.array_equal(found[k], expected[k]) for k in expected)
