"""The built zip in a real Blender: installed, enabled, and baking by command and by operator.

BLENDER in the environment names the program; the zip is in dist/ (make test-blender builds it).
"""

from __future__ import annotations

import json
import re

import pytest

from real_blender import same

pytestmark = pytest.mark.blender


def test_command_gives_the_same_bits_with_the_wheels_of_the_zip(blender, folder, expected):
    out = folder / "command.blend"
    blender(
        "--command",
        "radiosity",
        "bake",
        "box.blend",
        "-o",
        out,
        "--report",
        folder / "r.json",
        "--picture",
        folder / "p.png",
    )
    assert same(blender.layers(out), expected)
    assert json.loads((folder / "r.json").read_text())["cells_restarted"] == 0
    assert (folder / "p.png").stat().st_size > 10_000
    code = "import embreex; print('EMBREEX', embreex.__file__)"
    where = blender("-b", "--addons", "bl_ext.user_default.cell_radiosity", "--python-expr", code).stdout
    assert ".local" in re.search(r"EMBREEX (.*)", where).group(1)


def test_command_on_the_open_file(blender, folder, expected):
    out = folder / "open.blend"
    blender("-b", "box.blend", "--command", "radiosity", "bake", "-o", out)
    assert same(blender.layers(out), expected)


def test_operator_in_background(blender, folder, expected):
    out = folder / "operator.blend"
    code = f"import bpy; assert bpy.ops.radiosity.bake() == {{'FINISHED'}}; bpy.ops.wm.save_as_mainfile(filepath={str(out)!r})"
    blender("-b", "box.blend", "--python-exit-code", "7", "--python-expr", code)
    assert same(blender.layers(out), expected)


def test_without_user_preferences(blender, folder):
    out = folder / "factory.blend"
    blender("--factory-startup", "--addons", "bl_ext.user_default.cell_radiosity", "--command", "radiosity", "bake",
            "box.blend", "-o", out, "--error", "10%")  # fmt: skip
    assert out.exists()


def test_exit_codes(blender, folder):
    assert blender("--command", "radiosity", "bake", "none.blend", check=False).returncode == 1
    assert blender("--command", "radiosity", "bake", "--error", "x", check=False).returncode == 2
    assert blender("--command", "radiosity", "--help").returncode == 0
    (folder / "broken.blend").write_bytes(b"BLENDER")
    assert blender("-b", "broken.blend", "--command", "radiosity", "bake", check=False).returncode != 0
    assert not (folder / "broken_radiosity.blend").exists()


def test_a_killed_cell_does_not_end_blender(blender, folder, expected):
    """Blender 4.3 leaves SIGPIPE at its default, and a write to a dead cell would end it without a word."""
    out = folder / "killed.blend"
    code = f"""
import bpy, os, signal
from bl_ext.user_default.cell_radiosity.addon.job import Job, Options
job = Job(bpy.context, Options())
for progress in job.bake():
    if progress.phase == "transport" and progress.round == 2:
        os.kill(job.cells._cells[0].process.pid, signal.SIGKILL)
job.write(bpy.context)
assert job.report("x")["cells_restarted"] == 1
job.close()
bpy.ops.wm.save_as_mainfile(filepath={str(out)!r})
"""
    blender("-b", "box.blend", "--python-exit-code", "7", "--python-expr", code)
    assert same(blender.layers(out), expected)


def test_enable_and_disable_again(blender):
    code = """
import addon_utils
name = "bl_ext.user_default.cell_radiosity"
for _ in range(3):
    addon_utils.disable(name)
    addon_utils.enable(name)
import bpy
assert hasattr(bpy.context.scene, "radiosity")
addon_utils.disable(name)
assert not hasattr(bpy.context.scene, "radiosity")
"""
    blender("-b", "--python-exit-code", "7", "--python-expr", code)
