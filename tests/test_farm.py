"""Many files: what is done and unchanged is skipped, one failure does not stop the others; the job type for Flamenco."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

from cell_radiosity.addon.command import main  # noqa: E402

ROOT = Path(__file__).parent.parent
SCENE = ROOT / "sample_scenes" / "paper_973.blend"


@pytest.fixture
def files(tmp_path):
    """Two scenes and one that is none."""
    for name in ("a", "b"):
        shutil.copy(SCENE, tmp_path / f"{name}.blend")
    (tmp_path / "c.blend").write_bytes(b"not a blend")
    return tmp_path


def bake_all(folder, capfd, *more):
    """(exit code, lines) of baking all files of a folder."""
    names = sorted(str(path) for path in folder.glob("*.blend"))
    code = main(["bake", *names, "--keep-going", "--error", "10%", "--report", str(folder), *more])
    out, err = capfd.readouterr()
    return code, [line for line in (out + err).splitlines() if ".blend: " in line and "Read blend" not in line]


def test_what_is_done_and_unchanged_is_skipped(files, capfd):
    code, lines = bake_all(files, capfd)
    assert code == 1
    assert [line for line in lines if "c.blend" in line]
    assert {path.name for path in files.glob("*_radiosity.blend")} == {"a_radiosity.blend", "b_radiosity.blend"}
    made = {path: path.stat().st_mtime_ns for path in files.glob("*_radiosity.blend")}

    # Again: nothing is baked, and results are not taken for scenes.
    (files / "c.blend").unlink()
    code, lines = bake_all(files, capfd)
    assert code == 0
    assert sum("was baked before and is unchanged" in line for line in lines) == 2
    assert sum("is itself the result" in line for line in lines) == 2
    assert made == {path: path.stat().st_mtime_ns for path in files.glob("*_radiosity.blend")}

    # Other options, a changed file, a missing report: baked again.
    a, b = (files / f"{name}_radiosity.blend" for name in "ab")
    (files / "a.json").unlink()
    bpy.ops.wm.open_mainfile(filepath=str(files / "b.blend"))
    bpy.context.scene["changed"] = 1
    bpy.ops.wm.save_as_mainfile(filepath=str(files / "b.blend"))
    bake_all(files, capfd)
    assert a.stat().st_mtime_ns > made[a]
    assert b.stat().st_mtime_ns > made[b]
    made = {path: path.stat().st_mtime_ns for path in (a, b)}
    bake_all(files, capfd, "--seed", "1")
    assert all(path.stat().st_mtime_ns > made[path] for path in (a, b))


STUB = """
const tasks = [];
const author = {
    Task: (name, type) => ({ name, type, commands: [], addCommand(command) { this.commands.push(command); } }),
    Command: (name, parameters) => ({ name, parameters }),
};
%s
compileJob({ settings: %s, addTask: task => tasks.push(task) });
console.log(JSON.stringify({ tasks, label: JOB_TYPE.label, keys: JOB_TYPE.settings.map(s => s.key) }));
"""


def compile_job(**settings):
    script = (ROOT / "cluster" / "flamenco" / "cell_radiosity.js").read_text()
    return subprocess.run(["node", "-e", STUB % (script, json.dumps(settings))], capture_output=True, text=True)


@pytest.mark.skipif(not shutil.which("node"), reason="needs node")
def test_flamenco_job_compiles_to_one_task_for_each_file(capfd):
    done = compile_job(blendfiles="/a/x.blend; /b/y.blend;", output="/lit/", error="1%", options="--layers Lighting")
    assert not done.stderr
    job = json.loads(done.stdout)
    assert {"blendfiles", "output", "error", "options"} <= set(job["keys"])
    assert [task["type"] for task in job["tasks"]] == ["blender", "blender"]
    (command,) = job["tasks"][1]["commands"]
    p = command["parameters"]
    assert (command["name"], p["exe"], p["blendfile"]) == ("blender-render", "{blender}", "/b/y.blend")
    words = [*p["argsBefore"], p["blendfile"], *p["args"]]
    assert words[:4] == ["-b", "/b/y.blend", "--command", "radiosity"]
    assert words[words.index("-o") + 1] == "/lit/y_radiosity.blend"
    # What follows is what the command understands: everything is there but a scene, which Blender has opened.
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert main(words[4:]) == 2
    assert "no scene" in capfd.readouterr().err


@pytest.mark.skipif(not shutil.which("node"), reason="needs node")
@pytest.mark.parametrize(
    ("blendfiles", "output", "words"),
    [(" ; ", "", "no .blend file"), ("/a/x.blend;/b/x.blend", "/lit", "two files would be written to")],
)
def test_flamenco_job_that_cannot_be(blendfiles, output, words):
    done = compile_job(blendfiles=blendfiles, output=output)
    assert done.returncode
    assert words in done.stderr


def test_the_extension_does_not_carry_the_cluster():
    """Neither its code nor its packages, and nothing in the extension imports them but on demand."""
    manifest = (ROOT / "blender_manifest.toml").read_text()
    let_in = next(line for line in manifest.splitlines() if line.startswith("paths_exclude_pattern"))
    assert '"/*"' in let_in
    assert "cluster" not in let_in
    code = (
        "import sys; sys.modules['distributed'] = sys.modules['dask'] = None\n"
        "from cell_radiosity.addon.command import main\n"
        "sys.exit(main(['bake', 'x.blend', '--cluster', 'local:1']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=os.path.dirname(__file__))
    assert done.returncode == 2
    assert "cell_radiosity[cluster]" in done.stderr
