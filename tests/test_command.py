"""The command line as programs drive it: exit codes, messages, files."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import jsonschema
import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
from PIL import Image  # noqa: E402

from cell_radiosity.addon.arguments import percent  # noqa: E402
from cell_radiosity.addon.command import main  # noqa: E402
from cell_radiosity.core.knobs import KNOBS  # noqa: E402
from cell_radiosity.core.report import SCHEMA  # noqa: E402
from cell_radiosity.core.settings import EFFECTS  # noqa: E402

from blender_scenes import colors, empty, lamp, plane  # noqa: E402

RADIOSITY = [sys.executable, "-m", "cell_radiosity"]


@pytest.fixture
def scene(tmp_path):
    """A small lit scene, saved."""
    empty()
    plane("floor", n=8)
    plane("wall", n=4, location=(1, 0, 1), rotation_euler=(0, -np.pi / 2, 0))
    lamp("POINT", 30.0, location=(-0.3, 0.2, 1.2))
    path = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def failing(capfd, *argv):
    """Exit code and the single line on stderr of a command that fails."""
    code = main(["bake", *map(str, argv)])
    lines = capfd.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    return code, lines[0]


def test_bake_writes_the_scene_the_report_and_the_picture(scene, capfd):
    before = scene.read_bytes()
    out = scene.parent / "out" / "lit.blend"
    code = main(["bake", str(scene), "-o", str(out), "--report", str(out.with_suffix(".json")),
                 "--picture", str(out.with_suffix(".png")), "--error", "5%", "--cells", "1"])  # fmt: skip
    assert code == 0
    assert scene.read_bytes() == before
    report = json.loads(out.with_suffix(".json").read_text())
    jsonschema.validate(report, SCHEMA)
    assert report["cells"] == 1
    assert report["error"]["requested"] == 0.05
    assert report["output_points"] == 81 + 25
    assert {o["name"] for o in report["objects"]} == {"floor", "wall"}
    energy = report["energy"]
    assert energy["emitted_w"] == pytest.approx(
        energy["absorbed_w"] + energy["escaped_w"] + energy["unshot_w"], rel=1e-9
    )
    picture = np.asarray(Image.open(out.with_suffix(".png")).convert("RGB"))
    assert picture.std() > 10  # something is to be seen
    bpy.ops.wm.open_mainfile(filepath=str(out))
    assert colors(bpy.data.objects["floor"].data, "Radiosity").max() > 0
    assert not [p for p in out.parent.iterdir() if p.suffix not in (".blend", ".json", ".png")]


def test_default_output_is_beside_the_scene(scene):
    assert main(["bake", str(scene), "--quiet"]) == 0
    assert (scene.parent / "room_radiosity.blend").exists()


def test_progress_in_a_log_is_plain_lines(scene):
    done = subprocess.run(
        [*RADIOSITY, "bake", str(scene), "--error", "0.5%"], capture_output=True, text=True, check=True
    )
    assert "\r" not in done.stderr
    assert "transport, round 1, bound" in done.stderr
    assert "Mrays/s" in done.stderr
    assert "s left" in done.stderr
    assert "106 points" in done.stdout.splitlines()[-1]


def test_several_scenes_go_to_folders_and_one_failure_does_not_stop_the_others(scene, tmp_path, capfd):
    other = tmp_path / "other.blend"
    shutil.copy(scene, other)
    missing = tmp_path / "missing.blend"
    out = tmp_path / "out"
    code = main(["bake", str(scene), str(missing), str(other), "-o", str(out), "--report", str(out), "--quiet"])
    assert code == 1
    assert {p.name for p in out.iterdir()} >= {
        "room_radiosity.blend",
        "other_radiosity.blend",
        "room.json",
        "other.json",
    }
    assert "missing.blend: no such file" in capfd.readouterr().err


def test_no_such_file(tmp_path, capfd):
    assert failing(capfd, tmp_path / "none.blend") == (1, f"radiosity: {tmp_path / 'none.blend'}: no such file")


@pytest.mark.parametrize("content", [b"", b"not a blend at all", b"BLENDER", b"BLENDER-v405" + bytes(100)])
def test_not_a_blend_file(tmp_path, capfd, content):
    path = tmp_path / "bad.blend"
    path.write_bytes(content)
    code, line = failing(capfd, path, "--quiet")
    assert code == 1
    assert "bad.blend" in line


def test_file_of_a_newer_blender(scene, capfd):
    """As Blender would find it whose file format it does not know yet."""
    newer = scene.parent / "newer.blend"
    newer.write_bytes(b"BLENDER17-99v0999" + scene.read_bytes()[12:])
    code, line = failing(capfd, newer, "--quiet")
    assert code == 1
    assert "newer.blend" in line


def test_no_mesh(tmp_path, capfd):
    empty()
    lamp("POINT")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "s.blend"))
    code, line = failing(capfd, tmp_path / "s.blend", "--quiet")
    assert code == 1
    assert "no mesh" in line


def test_no_light(tmp_path, capfd):
    empty()
    plane()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "s.blend"))
    code, line = failing(capfd, tmp_path / "s.blend", "--quiet")
    assert code == 1
    assert "nothing gives light" in line


def test_unwritable_output_is_found_before_the_bake(scene, capfd):
    (scene.parent / "file").write_text("")
    code, line = failing(capfd, scene, "-o", scene.parent / "file" / "x.blend", "--quiet")
    assert code == 1
    assert "cannot write" in line
    code, line = failing(capfd, scene, "--report", scene.parent, "--quiet")
    assert code == 1
    assert "it is a folder" in line


def test_objects_by_glob(scene, capfd):
    assert main(["bake", str(scene), "--objects", "wa*", "--quiet"]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(scene.parent / "room_radiosity.blend"))
    assert "Radiosity" in bpy.data.objects["wall"].data.color_attributes
    assert "Radiosity" not in bpy.data.objects["floor"].data.color_attributes
    code, line = failing(capfd, scene, "--objects", "nothing", "--quiet")
    assert code == 1
    assert "nothing" in line


def test_strict_fails_and_says_what_is_wrong(scene, capfd):
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    bpy.data.objects["wall"].data.materials.append(None)
    bpy.ops.wm.save_mainfile()
    assert main(["bake", str(scene), "--quiet"]) == 0
    capfd.readouterr()
    code, line = failing(capfd, scene, "--strict", "--quiet")
    assert code == 1
    assert "wall: 16 faces have an empty material slot" in line


@pytest.mark.parametrize(
    "argv", [["--error", "0.02"], ["--error", "x"], ["--error", "-1%"], ["--layers", "Nothing"], ["--cells", "0"],
             ["--max-patch", "-1"], ["--preset", "best"], ["--error", "1%", "--preset", "good"], ["--unknown"]]
)  # fmt: skip
def test_usage_errors_exit_with_2(scene, argv, capfd):
    assert main(["bake", str(scene), *argv]) == 2
    assert not (scene.parent / "room_radiosity.blend").exists()


def test_percentages():
    assert percent("2%") == percent("2") == 0.02
    assert percent("0.02%") == 0.0002
    assert percent("0.05") == 0.0005


def test_frame_and_scene(scene):
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    light = bpy.data.lights[0]
    light.energy = 10.0
    light.keyframe_insert("energy", frame=1)
    light.energy = 1000.0
    light.keyframe_insert("energy", frame=10)
    bpy.data.scenes.new("second")
    bpy.ops.wm.save_mainfile()
    means = []
    for frame in ("1", "10"):
        assert main(["bake", str(scene), "--frame", frame, "--scene", "Scene", "--quiet"]) == 0
        bpy.ops.wm.open_mainfile(filepath=str(scene.parent / "room_radiosity.blend"))
        means.append(colors(bpy.data.objects["floor"].data, "Lighting").mean())
    assert means[1] == pytest.approx(100 * means[0], rel=1e-6)
    assert main(["bake", str(scene), "--scene", "third", "--quiet"]) == 1


def test_ctrl_c_ends_with_130_and_keeps_what_is_there(scene):
    process = subprocess.Popen(
        [*RADIOSITY, "bake", str(scene), "--error", "0.05%", "--force-effects", "all"],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    for line in process.stderr:
        if "gather" in line:
            break
    children = subprocess.run(["pgrep", "-P", str(process.pid)], capture_output=True, text=True).stdout.split()
    assert children
    process.send_signal(signal.SIGINT)
    rest = process.stderr.read()
    assert process.wait(30) == 130
    assert "cancelled" in rest
    assert "Traceback" not in rest
    assert not list(scene.parent.glob("*.tmp*"))
    bpy.ops.wm.open_mainfile(filepath=str(scene.with_name("room_radiosity.blend")))
    kept = colors(bpy.data.objects["floor"].data, "Lighting")
    assert np.isfinite(kept).all()
    assert kept.mean() > 0
    time.sleep(0.5)
    left = subprocess.run(["ps", "-o", "stat=", "-p", ",".join(children)], capture_output=True, text=True).stdout
    assert not [state for state in left.split() if not state.startswith("Z")]


def test_the_same_bits_again_and_with_other_cells(scene):
    layers = []
    for cells in ("1", "2", "3"):
        assert main(["bake", str(scene), "--cells", cells, "--quiet"]) == 0
        bpy.ops.wm.open_mainfile(filepath=str(scene.parent / "room_radiosity.blend"))
        layers.append(colors(bpy.data.objects["floor"].data, "Lighting"))
    assert np.array_equal(layers[0], layers[1])
    assert np.array_equal(layers[0], layers[2])


@pytest.mark.parametrize("command", ["price", "effects", "cells"])
def test_commands_on_one_scene_open_it_and_fail_alike(scene, command, capfd):
    """No scene: usage. A file that is not there, or a report that cannot be written: one line, before any work."""
    bpy.ops.wm.read_homefile(use_empty=True)
    none = scene.with_name("none.blend")
    for argv, code, words in (
        ([], 2, "no scene: name a .blend file"),
        ([str(none)], 1, f"{none}: no such file"),
        ([str(scene), "--report", str(scene.parent)], 1, f"{scene}: cannot write {scene.parent}: it is a folder"),
        ([str(scene), "--scene", "third"], 1, "there is no scene 'third'"),
    ):
        assert main([command, *argv]) == code
        (line,) = capfd.readouterr().err.strip().splitlines()
        assert line.startswith("radiosity: ")
        assert words in line


def test_prices_are_listed_and_measured(scene, capfd):
    report = scene.parent / "price.json"
    assert main(["price", str(scene), "--errors", "20,10", "--measure", "--quiet", "--report", str(report)]) == 0
    rows = json.loads(report.read_text())["price"]
    assert [row["error"] for row in rows] == [0.2, 0.1]
    assert all(row["seconds_predicted"] > 0 and row["seconds_measured"] > 0 for row in rows)
    assert rows[0]["error_measured"] < 0.2
    assert rows[1]["error_measured"] is None  # nothing finer is there to measure it against
    printed = capfd.readouterr().out.splitlines()
    assert len(printed) == 3
    objects, finest = json.loads(report.read_text())["objects"]
    worst = max(objects, key=objects.get)
    assert printed[1].endswith(f"{100 * objects[worst]:.2f} %, {worst}")
    assert finest == {}


def test_each_knob_is_turned_alone_and_drawn(scene, capfd):
    """How many bakes are to come is said before; the same figures are in the table, in the report and in the plot."""
    pytest.importorskip("matplotlib")
    report, plot = scene.parent / "knobs.json", scene.parent / "knobs.png"
    asked = ["--error", "20", "--errors", "20,10", "--measure", "--report", str(report), "--plot", str(plot)]
    assert main(["price", str(scene), *asked]) == 0
    printed, found = capfd.readouterr(), json.loads(report.read_text())
    knobs = found["knobs"]
    assert list(dict.fromkeys(row["knob"] for row in knobs)) == list(KNOBS)
    assert [sum(row["chosen"] for row in knobs if row["knob"] == knob) for knob in KNOBS] == [1] * 5
    turned = [row for row in knobs if not row["chosen"]]
    assert f"2 bakes to measure, and {len(turned) + 1} to turn each knob alone" in printed.err
    assert all(row["seconds"] > 0 and row["error"] > 0 for row in knobs)
    assert len(printed.out.splitlines()) == 3 + 1 + 1 + len(turned) + (found["slope"] is not None)
    none, *_, many = [row["error"] for row in knobs if row["knob"] == "bounces"]
    assert none > 2 * many
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_make_bake_names_a_scene_that_is_there():
    root = Path(__file__).parent.parent
    assert (root / "sample_scenes" / "cornell_box.blend").exists()
    assert "sample_scenes/cornell_box.blend -o out/cornell_box.blend" in (root / "Makefile").read_text()
    assert os.access(root / "tools" / "setup.sh", os.X_OK)


def test_effects_are_told_before_any_bake(scene, capfd):
    """The table on stdout, a report of the one schema, and effects forced by name."""
    report = scene.parent / "effects.json"
    assert main(["effects", str(scene), "--report", str(report)]) == 0
    printed = capfd.readouterr().out
    found = json.loads(report.read_text())
    jsonschema.validate(found, SCHEMA)
    assert [e["name"] for e in found["effects"]] == list(EFFECTS)
    assert all(e["reason"] in " ".join(printed.split()) for e in found["effects"])
    assert found["seconds"]["survey"] < found["seconds"]["total"]
    needed = {e["name"]: e["needed"] for e in found["effects"]}
    assert needed["lamps"]
    assert not needed["color"]
    assert main(["effects", str(scene), "--quiet", "--report", str(report), "--force-effects", "color,sky"]) == 0
    assert capfd.readouterr().out == ""
    forced = {e["name"]: e["needed"] for e in json.loads(report.read_text())["effects"]}
    assert {name for name in EFFECTS if forced[name] != needed[name]} == {"color", "sky"}
    assert main(["effects", str(scene), "--force-effects", "glitter"]) == 2
    assert "effects are all, occlusion" in capfd.readouterr().err
