"""Run the tests that know Blender in the modules of several Blenders, and compare the bits of bakes between them.

Each module gets an environment of its own in build/versions. Names of versions as arguments choose among them.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parent.parent
PLACE = ROOT / "build" / "versions"
# The Python of each, and the numpy that it comes with in Blender itself.
BLENDERS = {"4.2.23": ("3.11", "1.24.3"), "4.5.15": ("3.11", "1.26.4"), "5.2.3": ("3.13", "2.3.4")}
SCENES = ("cornell_box", "sunlit_room")  # whose bits are compared: emitting faces; sun, sky and many objects
TESTS = ("test_blender_*.py", "test_command.py", "test_panels.py", "test_steps.py")

# The module of Blender 4.2 crashes at its very end if a property with a callback was registered, whosever it is.
TEST = "import os, sys, pytest; code = pytest.main(sys.argv[1:]); sys.stdout.flush(); os._exit(code)"

BAKE = """
import os, sys
import bpy, numpy as np
import cell_radiosity
cell_radiosity.register()
found = {}
for scene in sys.argv[2:]:
    bpy.ops.wm.open_mainfile(filepath=scene)
    bpy.ops.radiosity.bake()
    for o in bpy.data.objects:
        if o.type == "MESH":
            for a in o.data.color_attributes:
                v = np.empty(4 * len(a.data), np.float32)
                a.data.foreach_get("color", v)
                found[".".join((os.path.basename(scene), o.name, a.name)).replace("/", "_")] = v
np.savez(sys.argv[1], **found)
cell_radiosity.unregister()
os._exit(0)
"""


def find_python(version):
    """A Python of a version that can make environments, or None."""
    candidates = [shutil.which(f"python{version}"), *Path.home().glob(f".pyenv/versions/{version}.*/bin/python")]
    code = f"import sys, venv, ensurepip; sys.exit('%d.%d' % sys.version_info[:2] != {version!r})"
    for candidate in filter(None, candidates):
        if subprocess.run([candidate, "-c", code], capture_output=True).returncode == 0:
            return str(candidate)
    return None


def environment(version):
    """The Python of an environment with a Blender module and this package, or None if no Python fits."""
    folder, (wanted, numpy) = PLACE / version, BLENDERS[version]
    made = folder / "bin" / "python"
    if not (folder / ".ready").exists():
        python = find_python(wanted)
        if python is None:
            return None
        print(f"{version}: installing (some 400 MB) ...", flush=True)
        shutil.rmtree(folder, ignore_errors=True)
        subprocess.run([python, "-m", "venv", folder], check=True)
        pip = [made, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, f"bpy=={version}", f"numpy=={numpy}", "--editable", f"{ROOT}[test]"], check=True)
        (folder / ".ready").touch()
    return made


def main():
    wanted = sys.argv[1:] or list(BLENDERS)
    layers, failed = {}, False
    files = sorted(str(f) for pattern in TESTS for f in (ROOT / "tests").glob(pattern))
    for version in wanted:
        python = environment(version)
        if python is None:
            print(f"{version}: left out, there is no Python {BLENDERS[version][0]}", flush=True)
            continue
        code = "import bpy, numpy; print(bpy.app.version_string, 'with numpy', numpy.__version__)"
        print(
            subprocess.run([python, "-c", code], capture_output=True, text=True).stdout.strip().splitlines()[-1],
            flush=True,
        )
        failed |= subprocess.run([python, "-c", TEST, "-p", "no:cacheprovider", *files], cwd=ROOT).returncode != 0
        out = PLACE / f"{version}.npz"
        scenes = [ROOT / "sample_scenes" / f"{name}.blend" for name in SCENES]
        quiet = dict(stdout=subprocess.DEVNULL, env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"})
        subprocess.run([python, "-c", BAKE, out, *scenes], check=True, **quiet)
        with np.load(out) as found:
            layers[version] = dict(found)
    first = next(iter(layers), None)
    for version, found in layers.items():
        same = set(found) == set(layers[first]) and all(np.array_equal(v, layers[first][k]) for k, v in found.items())
        print(
            f"{version}: {len(found)} layers of {len(SCENES)} scenes, {'the same bits as' if same else 'NOT THE BITS OF'} {first}"
        )
        failed |= not same
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
