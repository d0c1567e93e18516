"""Build the extension's zip files into dist/, one per platform, each with the wheels of both Pythons of Blender.

Blender's own tool builds and validates them; it comes with the bpy module.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent
LINUX = ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux2014_x86_64")
# Blender's own builds have Python 3.11 (4.2 to 5.0) or 3.13 (5.1 and 5.2); a Linux distribution may take its own.
BUILDS = [(python, names) for python in ("311", "313") for names in (LINUX, ("win_amd64",), ("macosx_13_0_arm64",))]
BUILDS.append(("314", LINUX))
MISSING = {"314": {"xatlas"}}  # packages that have no wheel for a Python


def fetch_wheels(folder):
    """Download every wheel of wheels.txt into a folder; checksums are checked by pip."""
    blocks = re.split(r"^(?=[\w-]+==)", (ROOT / "wheels.txt").read_text(), flags=re.MULTILINE)
    for python, names in BUILDS:
        wanted = [block for block in blocks if block.split("==")[0] not in MISSING.get(python, set())]
        pins = folder / f"wheels-{python}.txt"
        pins.write_text("".join(wanted))
        platforms = [word for name in names for word in ("--platform", name)]
        subprocess.run(
            [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps",
             "--only-binary=:all:", "--require-hashes", "--implementation", "cp", "--python-version", python,
             "--abi", f"cp{python}", "--abi", "none", *platforms, "-d", folder, "-r", pins],
            check=True,
        )  # fmt: skip
        pins.unlink()


def blender_tool():
    """Path of Blender's extension tool, as the bpy module brings it."""
    code = "import bpy; print(bpy.utils.system_resource('SCRIPTS'))"
    scripts = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.splitlines()[-1]
    return Path(scripts) / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"


def main():
    wheels, dist = ROOT / "wheels", ROOT / "dist"
    wheels.mkdir(exist_ok=True)
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text())
    listed = {Path(wheel).name for wheel in manifest["wheels"]}
    if listed - {f.name for f in wheels.glob("*.whl")}:
        fetch_wheels(wheels)
    for wheel in wheels.glob("*.whl"):
        if wheel.name not in listed:
            wheel.unlink()
    shutil.rmtree(dist, ignore_errors=True)
    dist.mkdir()
    tool = blender_tool()
    build = ["build", "--source-dir", ROOT, "--output-dir", dist, "--split-platforms"]
    subprocess.run([sys.executable, tool, *build], check=True)
    for package in sorted(dist.glob("*.zip")):
        subprocess.run([sys.executable, tool, "validate", package], check=True, stdout=subprocess.DEVNULL)
        print(f"{package.relative_to(ROOT)}: {package.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
