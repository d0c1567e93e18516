"""State files on the command line: written at the end and when a bake is broken off, read when they are there."""

from __future__ import annotations

import json
import signal
import subprocess
import sys

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from cell_radiosity.addon import command_bake, progress  # noqa: E402
from cell_radiosity.addon.command import main  # noqa: E402
from cell_radiosity.core import state as core_state  # noqa: E402
from cell_radiosity.core.cells import LocalCells  # noqa: E402

from blender_scenes import colors, diffuse, empty, lamp, plane  # noqa: E402


@pytest.fixture
def scene(tmp_path):
    """A small lit scene with a corner and a table, saved."""
    empty()
    plane("floor", n=8)
    plane("wall", n=4, location=(1, 0, 1), rotation_euler=(0, -np.pi / 2, 0), material=diffuse("red", (0.8, 0.2, 0.1)))
    plane("table", n=3, size=0.6, location=(0.2, 0.1, 0.3))
    lamp("POINT", 30.0, location=(-0.3, 0.2, 1.2))
    path = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def baked(scene, out, *more):
    """(exit code, report, {object.layer: values}) of a bake with one cell."""
    out = scene.parent / out
    report = out.with_suffix(".json")
    code = main(
        ["bake", str(scene), "-o", str(out), "--report", str(report), "--cells", "1", "--quiet", *map(str, more)]
    )
    if code not in (0, 130):
        return code, None, None
    bpy.ops.wm.open_mainfile(filepath=str(out))
    found = {}
    for object in bpy.data.objects:
        if object.type == "MESH":
            for layer in object.data.color_attributes:
                found[f"{object.name}.{layer.name}"] = colors(object.data, layer.name)
    for image in bpy.data.images:
        if image.get("cell_radiosity"):
            found[image.name] = np.array(image.pixels[:])
    return code, json.loads(report.read_text()), found


def equal(a, b):
    return a.keys() == b.keys() and len(a) > 0 and all(np.array_equal(a[k], b[k]) for k in a)


def test_a_bake_goes_on_from_its_state(scene, capfd):
    """The same again casts no ray; a smaller error casts fewer than it does from nothing."""
    state = scene.parent / "s"
    code, first, light = baked(scene, "a.blend", "--state", state, "--error", "5%", "--layers", "Radiosity,Occlusion")
    assert code == 0
    assert state.exists()
    code, again, same = baked(scene, "b.blend", "--state", state, "--error", "5%", "--layers", "Radiosity,Occlusion")
    assert code == 0
    assert again["rays"] == 0 < first["rays"]
    assert equal(same, light)
    assert again["error"] == first["error"]
    code, finer, _ = baked(scene, "c.blend", "--state", state, "--error", "1%")
    _, anew, _ = baked(scene, "d.blend", "--error", "1%")
    assert finer["converged"]
    assert finer["error"]["estimated"] <= 0.01
    assert 0 < finer["rays"] < anew["rays"]
    capfd.readouterr()
    assert main(["bake", str(scene), "-o", str(scene.parent / "e.blend"), "--state", str(state), "--error", "1%"]) == 0
    assert f"after what {state} held" in capfd.readouterr().out
    assert [p for p in scene.parent.iterdir() if "tmp" in p.name] == []


KINDS = {
    "vertex": (),
    "lit": ("--side", "lit"),
    "subdivide": ("--mesh", "subdivide", "--max-edge", "0.3", "--min-edge", "0.1"),
    "lightmap": ("--target", "lightmap", "--texels-per-meter", "12"),
    "groups": ("--groups", "lamp"),
}


@pytest.mark.parametrize(
    ("kind", "phase", "number"),
    [("vertex", "transport", 1), ("lightmap", "transport", 1), *((kind, "gather", 2) for kind in KINDS)],
)
def test_ctrl_c_keeps_a_state_that_leads_to_the_same_result(scene, monkeypatch, kind, phase, number):
    options = (*KINDS[kind], "--error", "0.5%")
    _, whole, expected = baked(scene, "a.blend", *options)
    seen, state = [], scene.parent / "s"

    def stop(self, progress):
        seen.append(progress.phase)
        if seen.count(phase) > number and progress.phase == phase:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(progress.Bar, "show", stop)
        assert (
            main(["bake", str(scene), "-o", str(scene.parent / "x.blend"), "--state", str(state), "--quiet", *options])
            == 130
        )
    assert state.exists()
    code, rest, found = baked(scene, "b.blend", "--state", state, *options)
    assert code == 0
    assert equal(found, expected)
    assert rest["rays"] < whole["rays"]
    # And what was placed is placed again without a ray.
    code, again, found = baked(scene, "c.blend", "--state", state, *options)
    assert again["rays"] == 0
    assert equal(found, expected)


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_a_real_signal(scene, kind):
    state = scene.parent / "s"
    command = [sys.executable, "-m", "cell_radiosity", "bake", str(scene), "--error", "0.05%", "--state", str(state)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    for line in process.stderr:
        if "gather" in line:
            break
    process.send_signal(kind)
    rest = process.stderr.read()
    assert process.wait(30) == 130
    assert "Traceback" not in rest
    assert core_state.load_state(state).gathered.replicates


def test_cells_that_are_lost(scene, monkeypatch, capfd):
    """One line that says what is kept; then the bake goes on to what it would have been."""
    _, _, expected = baked(scene, "a.blend", "--error", "1%")
    state, took = scene.parent / "s", []

    def take(self, ids, take=LocalCells.take):
        took.append(ids)
        if len(took) > 12:
            raise OSError("the cells are gone")
        return take(self, ids)

    capfd.readouterr()
    with monkeypatch.context() as patch:
        patch.setattr(command_bake, "cells_for", lambda *_: LocalCells())
        patch.setattr(LocalCells, "take", take)
        assert main(["bake", str(scene), "--state", str(state), "--error", "1%", "--quiet"]) == 1
    (line,) = capfd.readouterr().err.strip().splitlines()
    assert "the cells are gone; what is finished is kept: the same command goes on from it" in line
    code, _, found = baked(scene, "b.blend", "--state", state, "--error", "1%")
    assert code == 0
    assert equal(found, expected)


def refused(capfd, *arguments):
    """The one line of a command that fails."""
    capfd.readouterr()
    assert main(["bake", *map(str, arguments), "--quiet"]) == 1
    (line,) = capfd.readouterr().err.strip().splitlines()
    return line


def test_what_does_not_fit_is_refused_before_any_work(scene, capfd):
    state = scene.parent / "s"
    assert main(["bake", str(scene), "--state", str(state), "--quiet"]) == 0
    before = state.read_bytes()
    for options, words in (
        (("--target", "lightmap"), "it was baked with --target vertex, not --target lightmap"),
        (("--objects", "floor"), "it was baked with no --objects, not --objects floor"),
        (("--seed", "3"), "the seed is 0 there, 3 was asked for"),
        (("--groups", "lamp"), "it has no light groups"),
        (("--schedule", "paper"), "keeps no rows to go on from"),
        (("--max-patch", "0.2"), "another longest edge of patches"),
    ):
        assert words in refused(capfd, scene, "--state", state, *options)
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    bpy.data.objects["table"].location.z += 0.1
    bpy.ops.wm.save_mainfile()
    line = refused(capfd, scene, "--state", state)
    assert "the geometry has changed: table is not what it was" in line
    assert "name another state file" in line
    assert state.read_bytes() == before
    state.write_bytes(before[:1000])
    assert "is not a state file, or is damaged" in refused(capfd, scene, "--state", state)
    assert state.read_bytes() == before[:1000]
    (scene.parent / "folder").mkdir()
    assert "it is a folder" in refused(capfd, scene, "--state", scene.parent / "folder")


def test_a_state_that_cannot_be_written_costs_no_result(scene, monkeypatch, capfd):
    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(command_bake, "write_state", fail)
    out = scene.parent / "lit.blend"
    line = refused(capfd, scene, "-o", out, "--state", scene.parent / "s")
    assert "No space left on device" in line
    assert f"{out} is complete" in line
    assert out.exists()


def test_several_scenes_keep_their_states_in_a_folder(scene, capfd):
    other = scene.with_name("other.blend")
    other.write_bytes(scene.read_bytes())
    folder = scene.parent / "states"
    for _ in range(2):
        assert main(["bake", str(scene), str(other), "--state", str(folder), "--quiet", "--error", "10%"]) == 0
    assert {p.name for p in folder.iterdir()} == {"room.npz", "other.npz"}


@pytest.fixture
def two_lamps(scene):
    """The scene with lamps in a collection of their own."""
    evening = bpy.data.collections.new("evening")
    bpy.context.scene.collection.children.link(evening)
    for name, place in (("left", (-0.5, 0.5, 1)), ("right", (0.3, -0.5, 1.5))):
        made = lamp("POINT", 20.0, location=place, shadow_soft_size=0.05)
        made.name = name
        bpy.context.scene.collection.objects.unlink(made)
        evening.objects.link(made)
    bpy.ops.wm.save_mainfile()
    return scene


def layers(path):
    bpy.ops.wm.open_mainfile(filepath=str(path))
    meshes = [o for o in bpy.data.objects if o.type == "MESH"]
    found = {f"{o.name}.{c.name}": colors(o.data, c.name) for o in meshes for c in o.data.color_attributes}
    images = [i for i in bpy.data.images if i.get("cell_radiosity")]
    return found | {i.name: np.array(i.pixels[:]).reshape(-1, 4)[:, :3] for i in images}


def near(a, b, share):
    assert a.keys() == b.keys()
    off, all_ = (np.sqrt(sum((x**2).sum() for x in values)) for values in ([a[k] - b[k] for k in a], b.values()))
    return off < share * all_


def changed(scene, **energies):
    """A copy of a scene file with lamps of other energy and color."""
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    for name, (factor, color) in energies.items():
        bpy.data.objects[name].data.energy *= factor
        bpy.data.objects[name].data.color = color
    path = scene.with_name("changed.blend")
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


TARGETS = [
    (),
    ("--target", "lightmap", "--texels-per-meter", "10"),
    ("--mesh", "subdivide", "--max-edge", "0.3", "--min-edge", "0.1"),
]


@pytest.mark.parametrize("target", TARGETS, ids=["vertex", "lightmap", "subdivide"])
def test_relight_by_lamp(two_lamps, monkeypatch, capfd, target):
    """As a bake of lamps that were changed, within noise; no ray is cast for it."""
    folder = two_lamps.parent
    options = (
        "--groups",
        "lamp",
        "--error",
        "1%",
        "--quiet",
        *(() if "subdivide" in target else ("--layers", "Radiosity,Lighting,Occlusion")),
        *target,
    )
    out = folder / "lit.blend"
    assert main(["bake", str(two_lamps), "-o", str(out), "--state", str(folder / "s"), *options]) == 0
    base = layers(out)
    with monkeypatch.context() as patch:
        patch.setattr(LocalCells, "submit", lambda *_, **__: pytest.fail("a task was asked for"))
        relit = folder / "relit.blend"
        assert main(["relight", str(folder / "s"), "-o", str(relit), "--set", "left=3", "--set", "right=0,0.5,1"]) == 0
        assert "left times 3, right times 0,0.5,1; no ray was cast" in capfd.readouterr().out
        same = folder / "same.blend"
        assert main(["relight", str(folder / "s"), "-o", str(same), "--quiet"]) == 0
        double = folder / "double.blend"
        assert (
            main(
                [
                    "relight",
                    str(folder / "s"),
                    "-o",
                    str(double),
                    "--quiet",
                    *(w for n in ("left", "right", "POINT") for w in ("--set", f"{n}=2")),
                ]
            )
            == 0
        )
    assert equal(layers(same), base)
    light = [k for k in base if "Occlusion" not in k]
    twice = layers(double)
    assert all(np.array_equal(twice[k], 2 * base[k] if k in light else base[k]) for k in base)
    if "subdivide" in target:  # other light, other vertices
        return
    anew = folder / "anew.blend"
    other = changed(two_lamps, left=(3, (1, 1, 1)), right=(1, (0, 0.5, 1)))
    assert main(["bake", str(other), "-o", str(anew), *options]) == 0
    # Two bakes to 1 %, corners too, which the estimate leaves out; in the sum of groups one lamp counts three times.
    assert near(layers(relit), layers(anew), 0.03)
    assert not near(base, layers(anew), 0.1)


def test_relight_by_collection(two_lamps):
    folder = two_lamps.parent
    options = ("--groups", "collection", "--error", "1%", "--quiet")
    assert main(["bake", str(two_lamps), "-o", str(folder / "lit.blend"), "--state", str(folder / "s"), *options]) == 0
    assert (
        main(["relight", str(folder / "s"), "-o", str(folder / "relit.blend"), "--set", "evening=1,0.5,0.2", "--quiet"])
        == 0
    )
    relit = layers(folder / "relit.blend")
    assert "floor.Lighting_evening" in relit
    other = changed(two_lamps, left=(1, (1, 0.5, 0.2)), right=(1, (1, 0.5, 0.2)))
    assert main(["bake", str(other), "-o", str(folder / "anew.blend"), *options]) == 0
    assert near(relit, layers(folder / "anew.blend"), 0.02)


def test_relight_says_what_is_wrong(two_lamps, capfd):
    folder, out = two_lamps.parent, two_lamps.with_name("relit.blend")

    def said(*arguments):
        capfd.readouterr()
        code = main(["relight", *map(str, arguments), "-o", str(out)])
        return code, capfd.readouterr().err.strip().splitlines()[-1]

    assert main(["bake", str(two_lamps), "--state", str(folder / "plain"), "--quiet"]) == 0
    code, line = said(folder / "plain", "--set", "left=2")
    assert code == 1
    assert "without light groups: bake with --groups lamp (or collection)" in line
    state = folder / "s"
    assert (
        main(
            ["bake", str(two_lamps), "--state", str(state), "--groups", "lamp", "--quiet", "--layers", "RadiosityError"]
        )
        == 0
    )
    assert "none of its layers (RadiosityError) can be made anew" in said(state)[1]
    assert main(["bake", str(two_lamps), "--state", str(state), "--groups", "lamp", "--quiet"]) == 0
    assert "there is no light group 'Left'; there are left, right, POINT" in said(state, "--set", "Left=2")[1]
    for wrong in ("left", "left=", "left=1,2", "left=-1", "left=x", "=2", "left=nan"):
        assert said(state, "--set", wrong)[0] == 2
    assert "cannot read" in said(folder / "none")[1]
    moved = two_lamps.rename(folder / "moved.blend")
    assert "name its .blend file after the state" in said(state)[1]
    capfd.readouterr()
    assert main(["relight", str(state), str(moved), "-o", str(out), "--quiet"]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(moved))
    bpy.data.materials["red"].node_tree.nodes["Diffuse BSDF"].inputs["Color"].default_value = (0.1, 0.8, 0.1, 1)
    bpy.ops.wm.save_mainfile()
    assert "the reflectance has changed: wall is not what it was" in said(state, moved)[1]


def test_a_layer_that_a_bake_did_not_come_to_is_left_out(scene, monkeypatch):
    """Ambient occlusion comes last: a bake that was broken off before writes what it has."""

    def stop(self, progress):
        if progress.phase == "gather":
            raise KeyboardInterrupt

    monkeypatch.setattr(progress.Bar, "show", stop)
    for kind in ((), ("--target", "lightmap", "--texels-per-meter", "8")):
        out = scene.with_name("lit.blend")
        assert main(["bake", str(scene), "-o", str(out), "--layers", "Occlusion,Lighting", "--quiet", *kind]) == 130
        found = layers(out)
        assert any("Lighting" in name for name in found)
        assert not any("Occlusion" in name for name in found)
        out.unlink()
        assert main(["bake", str(scene), "-o", str(out), "--layers", "Occlusion", "--quiet", *kind]) == 130
        assert not out.exists()
