"""How commands fail: the exit code, one line that says why, and nothing of the user's that is lost."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import stat
import subprocess
import sys

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from cell_radiosity.addon import command_bake, picture  # noqa: E402
from cell_radiosity.addon.command import main  # noqa: E402
from cell_radiosity.addon.errors import Refused, told  # noqa: E402
from cell_radiosity.addon.job import Job  # noqa: E402
from cell_radiosity.addon.plots import plot_price  # noqa: E402
from cell_radiosity.core.cells import LocalCells  # noqa: E402

from blender_scenes import bake_ours, colors, empty, lamp, plane  # noqa: E402

RADIOSITY = [sys.executable, "-m", "cell_radiosity"]


@pytest.fixture
def scene(tmp_path):
    """A small lit scene, saved."""
    empty()
    plane("floor", n=4)
    plane("wall", n=3, location=(1, 0, 1), rotation_euler=(0, -np.pi / 2, 0))
    lamp("POINT", 30.0, location=(-0.3, 0.2, 1.2))
    return saved(tmp_path / "room.blend")


def saved(path):
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def failing(capfd, *argv):
    """Exit code and the single line on stderr of a command that fails."""
    capfd.readouterr()
    code = main([*map(str, argv)])
    lines = capfd.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    return code, lines[0]


def test_what_exceptions_say():
    """One line each; a mistake of the program says where it is, a file that fails its name."""
    assert told(Refused("a\nb")) == "a b"
    assert told(OSError(28, "No space left on device", "/x/y")) == "/x/y: No space left on device"
    assert told(OSError("the cells are gone")) == "the cells are gone"
    assert "not enough memory" in told(MemoryError())
    try:
        LocalCells().take([3])
    except KeyError as problem:
        line = told(problem)
    assert line.startswith("KeyError: 3 (core/cells.py, line ")
    assert "please report it" in line


def test_a_task_that_fails_is_told_by_its_last_line(cells):
    number = cells.submit("gather", ids=np.arange(3))
    with pytest.raises(RuntimeError) as caught:
        cells.take([number])
    cells.clear()
    line = told(caught.value)
    assert "Traceback" not in line
    assert "(core/" in line


def test_what_nobody_foresaw_stops_one_scene_alone(scene, monkeypatch, capfd):
    other = scene.with_name("other.blend")
    shutil.copy(scene, other)
    save, out = command_bake.save_file, scene.parent / "out"

    def fail(output):
        if output == str(out / "room_radiosity.blend"):
            raise ZeroDivisionError("by chance")
        save(output)

    monkeypatch.setattr(command_bake, "save_file", fail)
    code, line = failing(capfd, "bake", scene, other, "-o", out, "--quiet")
    assert code == 1
    assert line.startswith(f"radiosity: {scene}: ZeroDivisionError: by chance (")
    assert [p.name for p in out.iterdir()] == ["other_radiosity.blend"]


def test_names_with_line_breaks_make_one_line(scene, capfd):
    bpy.data.lights[0].name = bpy.data.objects["POINT"].name = "a\nb"
    saved(scene)
    assert "no mesh matches a b" in failing(capfd, "bake", scene, "--objects", "a\nb", "--quiet")[1]
    state = scene.with_name("s")
    assert main(["bake", str(scene), "--groups", "lamp", "--state", str(state), "--quiet"]) == 0
    line = failing(capfd, "relight", state, "-o", scene.with_name("x.blend"), "--set", "c=2")[1]
    assert line.endswith("there are a b")


@pytest.mark.skipif(os.name != "posix", reason="streams are closed as a Unix shell does")
@pytest.mark.parametrize("streams", [">&-", "2>&-", ">&- 2>&- <&-", "2>/dev/full", "| true", "2>&1 | head -1"])
def test_nobody_reads(scene, streams):
    """Streams that are closed or full cost no bake."""
    if "/dev/full" in streams and not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full here")
    out = scene.with_name("out.blend")
    command = " ".join([*RADIOSITY, "bake", str(scene), "-o", str(out), "--cells", "1"])
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {command} {streams}"], capture_output=True, text=True, check=True
    )
    assert out.exists()
    assert "Traceback" not in done.stderr


def test_names_that_the_terminal_cannot_show(scene):
    out = scene.with_name("größer \U0001f4a1.blend")
    scene = scene.rename(scene.with_name("raum \udcff.blend" if os.name == "posix" else "raum.blend"))
    done = subprocess.run(
        [*RADIOSITY, "bake", str(scene), "-o", str(out), "--quiet", "--cells", "1"],
        env={**os.environ, "PYTHONIOENCODING": "ascii"}, capture_output=True, check=True,
    )  # fmt: skip
    assert out.exists()
    assert done.stderr == b""
    done = subprocess.run(
        [*RADIOSITY, "bake", str(scene), "-o", str(out)],
        env={**os.environ, "PYTHONIOENCODING": "ascii"}, capture_output=True, check=True,
    )  # fmt: skip
    assert b"points" in done.stdout


def test_ctrl_c_before_anything_has_begun(tmp_path):
    """Blender's module is still being loaded: nothing takes the interrupt for an error of its own."""
    (tmp_path / "bpy.py").write_text(
        "import os, signal, time\ntry:\n    os.kill(os.getpid(), signal.SIGINT)\n    time.sleep(20)\n"
        "except BaseException as problem:\n    print('caught', repr(problem))\n"
    )
    done = subprocess.run(
        [*RADIOSITY, "bake"], env={**os.environ, "PYTHONPATH": str(tmp_path)}, capture_output=True, text=True
    )
    assert done.returncode == 130
    assert done.stderr == "radiosity: cancelled\n"
    assert done.stdout == ""


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="Ctrl-C reaches a group of processes on Unix")
def test_ctrl_c_does_not_reach_cells_that_load():
    from cell_radiosity.core.cells import make_cells

    with make_cells(1) as cells:
        os.kill(cells._cells[0].process.pid, signal.SIGINT)
        cells.start({})
        number = cells.submit("gather", ids=np.arange(3))
        with pytest.raises(RuntimeError):  # it answers: without arrays there is nothing to gather
            cells.take([number])
        assert cells.restarted == 0


def asked_for_wrongly(folder, scene):
    """Command lines whose outputs are in the way of one another or of what they read, and words of the complaint."""
    lit, state = folder / "lit.blend", folder / "s"
    yield ["bake", scene, "-o", lit, "--report", scene], "it is read too"
    yield ["bake", scene, "-o", lit, "--picture", folder / "." / scene.name], "it is read too"
    yield ["bake", scene, "-o", lit, "--state", scene], "it is read too"
    yield ["bake", scene, "-o", lit, "--report", lit], "two things at once"
    yield ["bake", scene, "-o", scene, "--picture", scene], "two things at once"
    yield ["bake", scene, "--state", folder / "room_radiosity.blend"], "two things at once"
    yield ["bake", scene, "--report", folder / "x", "--picture", folder / "x"], "two things at once"
    yield ["price", scene, "--report", scene], "it is read too"
    yield ["price", scene, "--plot", folder / "p.png", "--report", folder / "p.png"], "two things at once"
    yield ["effects", scene, "--report", scene], "it is read too"
    yield ["relight", state, "-o", state], "it is read too"


def contents(folder):
    """{path in a folder: bytes of a file, None of a folder}."""
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in folder.rglob("*")}


def test_nothing_that_is_read_is_overwritten(scene, capfd):
    folder = scene.parent
    assert main(["bake", str(scene), "--groups", "lamp", "--state", str(folder / "s"), "--quiet"]) == 0
    os.remove(folder / "room_radiosity.blend")
    before = contents(folder)
    for argv, words in asked_for_wrongly(folder, scene):
        code, line = failing(capfd, *argv)
        assert code == 1
        assert words in line
        assert contents(folder) == before


def test_an_output_that_is_the_input_is_taken_at_its_word(scene):
    assert main(["bake", str(scene), "-o", str(scene), "--quiet"]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    assert "Radiosity" in bpy.data.objects["floor"].data.color_attributes


def test_scenes_that_would_share_an_output(scene, capfd):
    """The first keeps it; a scene that another one would be baked to is not overwritten."""
    folder, out = scene.parent, scene.parent / "out"
    (folder / "b").mkdir()
    twin = folder / "b" / "room.blend"
    shutil.copy(scene, twin)
    code, line = failing(capfd, "bake", scene, twin, "-o", out, "--quiet")
    assert code == 1
    assert f"{twin}: cannot write {out / 'room_radiosity.blend'}: {scene} is baked to it" in line
    shutil.copy(scene, folder / "room_radiosity.blend")
    before = contents(folder)
    for order in (1, -1):
        scenes = (scene, folder / "room_radiosity.blend")[::order]
        code, line = failing(capfd, "bake", *scenes, "--quiet")
        assert f"{scene}: cannot write {folder / 'room_radiosity.blend'}: it is one of the scenes to bake" in line
        assert {**contents(folder), **before} == contents(folder)
        os.remove(folder / "room_radiosity_radiosity.blend")


@pytest.mark.parametrize("name", ["room", "room.blend1", "room.v2.blend", "room.BLEND", ".blend"])
def test_the_name_of_the_output_is_that_of_the_scene(scene, name):
    folder = scene.parent / "here"
    folder.mkdir()
    shutil.copy(scene, folder / name)
    assert main(["bake", str(folder / name), "--quiet"]) == 0
    stem = name.removesuffix(".blend1").removesuffix(".BLEND")
    stem = stem if name == ".blend" else stem.removesuffix(".blend")
    assert {p.name for p in folder.iterdir()} == {name, f"{stem}_radiosity.blend"}
    assert list(scene.parent.glob("*_radiosity.blend")) == []


@pytest.mark.parametrize("command", ["bake", "price", "effects"])
def test_no_name_is_no_scene(command, capfd):
    """As a shell gives it whose variable is not set: the file that is open is not meant."""
    code, line = failing(capfd, command, "")
    assert code in (1, 2)
    assert "no such file" in line or "no scene" in line


@pytest.mark.parametrize(
    "options",
    ["--frame 2000000", "--frame x", "--memory infG", "--memory 1e300T", "--max-patch inf", "--cells 5000", "--cells ²",
     "--error 2%%", "--mesh subdivide --vertices 0", "--vertices " + 30 * "9", "--padding " + 20 * "9"],
)  # fmt: skip
def test_numbers_that_cannot_be_are_usage_errors(scene, options, capfd):
    assert main(["bake", str(scene), *options.split()]) == 2
    assert not scene.with_name("room_radiosity.blend").exists()


@pytest.mark.parametrize(
    "options",
    ["--max-patch 1e300", "--layers Occlusion --occlusion-distance 1e300", "--layers Occlusion --occlusion-distance 1e-300",
     "--target lightmap --size 1", "--target lightmap --size 1 --per-object", "--target lightmap --texels-per-meter 1e-9",
     "--time 1e-300", "--error 100%", "--seed " + 30 * "9"],
)  # fmt: skip
def test_numbers_at_the_edge_of_sense_make_a_bake(scene, options, capfd):
    assert main(["bake", str(scene), "--quiet", *options.split()]) == 0
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("options", "words"),
    [("--max-patch 1e-300", "patches"), ("--max-patch 1e-5", "patches"),
     ("--max-patch 0.001 --memory 1G", "cut to 0.001 m, the scene is 8e+06 patches; longer ones, or a --memory of 16G"),
     ("--target lightmap --size 1000000", "16384 a side are the most"),
     ("--target lightmap --texels-per-meter 1e9", "16384 a side are the most"),
     ("--mesh subdivide --max-edge 1e-5 --vertices 1000000000 --memory 1G", "2.5e+08 vertices; longer ones, fewer --vertices, or"),
     ("--target lightmap --size 2000 --memory 500M", "texels of surface; fewer --texels-per-meter, a smaller --size, or")],
)  # fmt: skip
def test_what_memory_cannot_hold_is_refused_before_it_is_tried(scene, options, words, capfd):
    code, line = failing(capfd, "bake", scene, "--quiet", *options.split())
    assert code == 1
    assert words in line


def test_edges_that_vertices_do_not_suffice_for(scene):
    report, out = scene.with_name("r.json"), scene.with_name("out.blend")
    options = ["--mesh", "subdivide", "--max-edge", "1e-9", "--vertices", "500", "--quiet", "--in-place"]
    assert main(["bake", str(scene), "-o", str(out), "--report", str(report), *options]) == 0
    (finding,) = json.loads(report.read_text())["health"]
    assert "are left, longer than 1e-09 m" in finding["finding"]
    assert "500 vertices were the most" in finding["action"]
    bpy.ops.wm.open_mainfile(filepath=str(out))
    assert 125 < sum(len(bpy.data.objects[name].data.vertices) for name in ("floor", "wall")) <= 500


@pytest.mark.parametrize("command", ["bake", "price", "cells"])
def test_scenes_of_which_no_bake_makes_sense(tmp_path, command, capfd):
    def line():
        return failing(capfd, command, saved(tmp_path / "s.blend"), "--quiet")[1]

    empty()
    assert "no mesh to bake" in line()
    plane("floor", n=2)
    assert "nothing gives light: add a lamp" in line()
    lamp("SUN", float("nan"))
    assert "nothing gives light: SUN: a lamp with values that are no numbers" in line()
    bpy.data.objects.remove(bpy.data.objects["SUN"])
    lamp("SUN", 3.0)
    assert "no mesh matches table" in failing(capfd, command, tmp_path / "s.blend", "--objects", "table")[1]
    bpy.data.objects["floor"].scale = (0, 0, 0)
    assert "no face has an area" in line()
    bpy.data.objects["floor"].scale = (float("nan"), 1, 1)
    assert "no face has an area" in line()


def test_why_an_object_that_is_named_cannot_be_written(tmp_path, capfd):
    empty()
    plane("table", n=2)
    library = saved(tmp_path / "library.blend")
    empty()
    lamp("SUN", 3.0)
    with bpy.data.libraries.load(str(library), link=True) as (_, here):
        here.objects = ["table"]
    bpy.context.scene.collection.objects.link(here.objects[0])
    code, line = failing(capfd, "bake", saved(tmp_path / "s.blend"), "--objects", "ta*", "--quiet")
    assert code == 1
    assert "table: its mesh is linked from another file; its light was not written: make it local" in line


def test_references_that_are_none(scene, capfd):
    reference = scene.with_name("r.npz")

    def line():
        return failing(capfd, "price", scene, "--errors", "20", "--quiet", "--reference", reference)[1]

    assert "r.npz: No such file" in line()
    for content in (b"", b"PK\3\4", b"nothing", scene.read_bytes()):
        reference.write_bytes(content)
        assert "it is not a file of arrays (.npz), or is damaged" in line()
    np.save(reference.open("wb"), np.zeros(3))
    assert "it is not a file of arrays" in line()
    np.savez(reference, **{"floor.A": np.ones(3), "floor.mask": np.ones(3, bool)})
    assert "the reference does not fit" in line()


def test_light_beyond_what_blender_can_hold_is_cut_off(scene, capfd):
    state, out = scene.with_name("s"), scene.with_name("out.blend")
    bpy.data.lights[0].energy = 1e12
    saved(scene)
    assert main(["bake", str(scene), "--groups", "lamp", "--state", str(state), "--quiet"]) == 0
    capfd.readouterr()
    assert main(["relight", str(state), "-o", str(out), "--set", "POINT=1e30", "--quiet"]) == 0
    assert capfd.readouterr().err == ""
    bpy.ops.wm.open_mainfile(filepath=str(out))
    assert np.isfinite(colors(bpy.data.objects["floor"].data, "Radiosity")).all()
    assert main(["relight", str(state), "-o", str(out), "--set", "POINT=1e300", "--quiet"]) == 2


def test_files_that_were_saved_in_edit_mode(scene):
    """Blender opens them so: the mesh is elsewhere until the mode is left."""
    for name in ("floor", "wall"):
        bpy.data.objects[name].select_set(True)
    bpy.context.view_layer.objects.active = bpy.data.objects["floor"]
    bpy.ops.object.mode_set(mode="EDIT")
    out = saved(scene).with_name("out.blend")
    assert main(["bake", str(scene), "-o", str(out), "--quiet"]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(out))
    for name in ("floor", "wall"):
        assert colors(bpy.data.objects[name].data, "Radiosity").mean() > 0


@pytest.mark.skipif(os.name != "posix", reason="needs permissions of Unix")
def test_who_may_read_and_write_a_file_stays_as_it_was(scene, capfd):
    """A file that is marked read-only is not written, though another could be put in its place; the light of one that is its
    owner's alone is read by nobody else."""
    os.chmod(scene, 0o444)
    before = contents(scene.parent)
    code, line = failing(capfd, "bake", scene, "-o", scene, "--quiet")
    assert code == 1
    assert line == f"radiosity: {scene}: cannot write {scene}: it is read-only"
    assert contents(scene.parent) == before
    os.chmod(scene, 0o600)
    assert main(["bake", str(scene), "-o", str(scene), "--quiet"]) == 0
    assert stat.S_IMODE(os.stat(scene).st_mode) == 0o600


@pytest.mark.parametrize("options", ["", "--target lightmap --size 32", "--mesh subdivide"])
@pytest.mark.parametrize("own", [False, True])
def test_what_overrides_another_file(scene, own, options):
    """Files keep no attributes of a mesh that overrides one of another file: it is named, and nothing is said to be written
    that the next who opens the file does not find. A mesh of the file's own in an overridden collection gets its light."""
    library = scene.with_name("library.blend")
    table = bpy.data.collections.new("set")
    table.objects.link(bpy.data.objects["wall"])
    bpy.data.libraries.write(str(library), {table}, fake_user=True)
    bpy.data.objects.remove(bpy.data.objects["wall"])
    bpy.data.collections.remove(table)
    with bpy.data.libraries.load(str(library), link=True) as (_, to):
        to.collections = ["set"]
    bpy.data.collections["set"].override_hierarchy_create(bpy.context.scene, bpy.context.view_layer)
    (wall,) = (o for o in bpy.context.scene.objects if o.override_library)
    wall.data = wall.data.copy() if own else wall.data.override_create()
    wanted = {"floor", wall.name} if own else {"floor"}
    saved(scene)
    out, report = scene.with_name("out.blend"), scene.with_name("r.json")
    assert main(["bake", str(scene), "-o", str(out), "--report", str(report), "--quiet", *options.split()]) == 0
    baked = {o["name"] for o in json.loads(report.read_text())["objects"]}
    assert baked == wanted
    named = [f for f in json.loads(report.read_text())["health"] if "another file" in f["finding"]]
    assert len(named) == (not own)
    bpy.ops.wm.open_mainfile(filepath=str(out))
    lit = {o.name.removesuffix("_radiosity") for o in bpy.context.scene.objects if o.type == "MESH"
           and (o.data.color_attributes if "lightmap" not in options else "Lightmap" in o.data.uv_layers)}  # fmt: skip
    assert lit == baked


def test_an_option_of_two_dashes_is_no_value(scene, capfd):
    assert main(["bake", str(scene), "--size=--", "--quiet"]) == 2
    assert "argument --size: " in capfd.readouterr().err


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
@pytest.mark.parametrize("command", ["price", "effects"])
def test_reports_are_written_where_nobody_reads(scene, command, monkeypatch):
    report = scene.with_name("r.json")
    with open("/dev/full", "w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert main([command, str(scene), "--report", str(report)]) == 0
        monkeypatch.undo()
        with contextlib.suppress(OSError):
            full.close()
    assert json.loads(report.read_text())


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
@pytest.mark.parametrize("command", ["price --errors 20 --quiet --cells 1", "effects"])
def test_answers_that_are_lost_are_no_success(scene, command):
    """To a file on a full disk: one line and exit 1. A reader who has read enough is none of a command's business."""
    command = " ".join([*RADIOSITY, *command.split(), str(scene)])
    done = subprocess.run(["bash", "-c", f"{command} > /dev/full"], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr == f"radiosity: {scene}: standard output: No space left on device\n"
    done = subprocess.run(["bash", "-c", f"set -o pipefail; {command} | head -c 0"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_plot_of_bakes_that_are_not_off_at_all(tmp_path):
    """On a scale of powers there is no place for them."""
    pytest.importorskip("matplotlib")
    row = dict(error=0.1, seconds_predicted=1.0, seconds_measured=1.0, error_measured=0.05)
    knobs = [dict(knob="bounces", value=None, chosen=True, seconds=1.0, error=0.0, patches=1, rays=1),
             dict(knob="bounces", value=1, chosen=False, seconds=0.5, error=0.2, patches=1, rays=1)]  # fmt: skip
    plot_price([row], [], knobs, None, str(tmp_path / "p.svg"), "room")
    assert (tmp_path / "p.svg").read_text().rstrip().endswith("</svg>")


@pytest.mark.parametrize("name", ["plot", "plot.blend", "plot.xyz"])
def test_plots_of_kinds_that_there_are_not(scene, name, capfd):
    pytest.importorskip("matplotlib")
    code, line = failing(capfd, "price", scene, "--plot", scene.with_name(name), "--quiet")
    assert code == 2
    assert ".pdf" in line
    assert ".png" in line


def limited(monkeypatch, owner, name, size):
    """While a function runs, no file can grow beyond a size [bytes]: it stands for a full disk."""
    import resource

    real, (_, most) = getattr(owner, name), resource.getrlimit(resource.RLIMIT_FSIZE)

    def function(*args, **kwargs):
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, most))
        try:
            return real(*args, **kwargs)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    monkeypatch.setattr(owner, name, function)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs a limit on the size of files")
@pytest.mark.parametrize(
    ("options", "place", "owner", "function", "size"),
    [("", "lit.blend", command_bake, "save_file", 100_000), ("--report", "r.json", command_bake, "write_json", 1000),
     ("--picture", "p.png", picture, "save_picture", 3000),
     ("--state", "s", command_bake, "write_state", 30_000),
     ("--target lightmap --size 64", "lit_floor_Radiosity.exr", Job, "write", 5000),
     ("--target lightmap --size 64 --image png", "lit_floor_Radiosity.png", Job, "write", 5000)],
)  # fmt: skip
def test_a_disk_that_is_full(scene, monkeypatch, capfd, options, place, owner, function, size):
    """One line that names the file, nothing left of it, and what was there before is still there."""
    folder = scene.parent / "out"
    folder.mkdir()
    place = folder / place
    options = options.split()
    if options and options[0] != "--target":
        options.append(place)
    if function != "write_state":
        place.write_bytes(b"before")
    before = contents(folder)
    limited(monkeypatch, owner, function, size)
    code, line = failing(capfd, "bake", scene, "-o", folder / "lit.blend", "--quiet", *options)
    assert code == 1
    assert str(place) in line
    assert "Traceback" not in line
    assert "No such file" not in line  # which would send its reader to look for a folder
    after = contents(folder)
    assert {**after, **before} == after
    assert after.keys() <= before.keys() | {"lit.blend"}


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs a limit on the size of files")
@pytest.mark.parametrize("size", [1000, 8192, 20_000])
def test_a_compressed_file_on_a_disk_that_is_full(scene, monkeypatch, capfd, size):
    """Blender does not notice: the scene would be lost that the output takes the place of."""
    bpy.ops.wm.save_as_mainfile(filepath=str(scene), compress=True)
    assert main(["bake", str(scene), "-o", str(scene.with_name("lit.blend")), "--quiet"]) == 0
    assert scene.with_name("lit.blend").stat().st_size > 20_000
    scene.with_name("lit.blend").unlink()
    before = contents(scene.parent)
    limited(monkeypatch, command_bake, "save_file", size)
    code, line = failing(capfd, "bake", scene, "-o", scene, "--quiet")
    assert code == 1
    assert f"cannot write {scene}: " in line
    assert contents(scene.parent) == before


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs a limit on the size of files")
def test_exports_to_a_disk_that_is_full(scene, cells):
    """The same; in processes of their own, since Blender's glTF exporter leaves a thread behind."""
    bake_ours(cells)
    saved(scene)
    folder = scene.parent / "out"
    folder.mkdir()
    for suffix in (".glb", ".gltf", ".usda", ".usdc"):
        place = folder / f"x{suffix}"
        place.write_bytes(b"before")
        before = contents(folder)
        command = [*RADIOSITY, "export", str(scene), "-o", str(place)]
        done = subprocess.run(["bash", "-c", 'ulimit -f 1; "$@"', "", *command], capture_output=True, text=True)
        assert done.returncode == 1
        (line,) = done.stderr.splitlines()
        assert line.startswith(f"radiosity: {scene}: cannot write {place}: ")
        assert "Traceback" not in line
        assert contents(folder) == before


def test_devices_are_written_to_and_stay_what_they_are(scene, capfd):
    if not os.path.exists("/dev/null"):
        pytest.skip("no devices here")
    link = scene.with_name("link")
    os.symlink("/dev/null", link)
    assert main(["bake", str(scene), "--quiet", "--report", str(link)]) == 0
    assert main(["price", str(scene), "--errors", "20", "--quiet", "--report", "/dev/null"]) == 0
    for option in ("-o", "--picture", "--state"):
        code, line = failing(capfd, "bake", scene, option, link, "--quiet")
        assert code == 1
        assert "it is not an ordinary file" in line
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)
    assert link.is_symlink()


def test_what_a_link_leads_to_is_written(scene):
    there, link = scene.parent / "there.json", scene.parent / "r.json"
    there.write_text("before")
    os.symlink(there, link)
    assert main(["bake", str(scene), "--quiet", "--report", str(link)]) == 0
    assert link.is_symlink()
    assert json.loads(there.read_text())["layers"]
