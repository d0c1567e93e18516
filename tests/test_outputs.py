"""What else a bake is written to: 8-bit copies, a channel of the user's own, files for engines."""

from __future__ import annotations

import json
import re
import struct
import subprocess
import sys

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
from cell_radiosity.addon import marks  # noqa: E402
from cell_radiosity.addon.command import main  # noqa: E402
from cell_radiosity.addon.errors import Refused  # noqa: E402
from cell_radiosity.addon.marks import is_made  # noqa: E402

from blender_scenes import bake_ours, colors, diffuse, empty, lamp, plane  # noqa: E402


def lit_floor():
    """A bright floor, a wall, and a plane that takes no light."""
    empty()
    plane("wall", n=3, location=(1, 0, 1), rotation_euler=(0, -np.pi / 2, 0), material=diffuse("red", (0.8, 0.1, 0.1)))
    lamp("POINT", 300.0, location=(-0.3, 0.2, 1.2), shadow_soft_size=0.05)
    return plane("floor", n=4)


def stored(mesh, name):
    """(K, 4) a color attribute as it is stored."""
    attribute = mesh.color_attributes[name]
    values = np.empty(4 * len(attribute.data), np.float32)
    attribute.data.foreach_get("color_srgb" if attribute.data_type == "BYTE_COLOR" else "color", values)
    return values.reshape(-1, 4)


def srgb(x):
    x = np.clip(x, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("domain", ["CORNER", "POINT"])
def test_8_bit_copies_hold_the_light_under_the_stated_curve(cells, domain):
    floor = lit_floor()
    bake_ours(cells, bytes=True, exposure=-2.0, domain=domain)
    for layer in ("Radiosity", "Lighting"):
        light, coded = colors(floor.data, layer), floor.data.color_attributes[f"{layer}_8bit"]
        assert coded.data_type == "BYTE_COLOR"
        assert coded.domain == domain
        if domain == "CORNER":  # elsewhere what is clipped is clipped before it is averaged
            np.testing.assert_allclose(stored(floor.data, coded.name)[:, :3], srgb(light / 4), atol=0.6 / 255)
    assert floor.data["cell_radiosity_exposure"] == -2.0
    bake_ours(cells, bytes=True, exposure="auto")
    exposure = floor.data["cell_radiosity_exposure"]
    light = np.concatenate([colors(bpy.data.objects[n].data, "Radiosity").max(axis=1) for n in ("floor", "wall")])
    assert (light * 2**exposure <= 1.0001).mean() > 0.95
    assert (light * 2**exposure).max() > 0.98


def test_writing_to_many_objects_looks_for_copies_once(cells, monkeypatch):
    """Looking at all objects for each of them would take minutes for ten thousand."""
    empty()
    lamp("POINT", 300.0, location=(0, 0, 2))
    made = [plane(f"tile {k}", location=(0.1 * k, 0, 0), scale=(0.05, 0.05, 1)) for k in range(40)]
    made[0].modifiers.new("split", "TRIANGULATE")  # its light goes to a copy
    bake_ours(cells)
    looks = []
    monkeypatch.setattr(marks, "is_made", lambda o: looks.append(o) or is_made(o))
    bake_ours(cells, bytes=True)
    assert len(looks) <= 10 * len(made)
    copies = [o for o in bpy.context.scene.objects if is_made(o)]
    assert [o["cell_radiosity_of"] for o in copies] == ["tile 0"]
    assert all("Radiosity_8bit" in o.data.color_attributes for o in (*made[1:], *copies))


@pytest.mark.parametrize("kind", ["FLOAT_COLOR", "BYTE_COLOR"])
def test_one_channel_of_the_users_own_attribute(cells, kind):
    """The light's brightness goes there; the other channels keep every bit."""
    floor = lit_floor()
    own = floor.data.color_attributes.new("own", kind, "CORNER")
    values = np.random.default_rng(5).integers(0, 256, 4 * len(own.data)) / np.float32(255)
    own.data.foreach_set("color_srgb" if kind == "BYTE_COLOR" else "color", values)
    before = stored(floor.data, "own")
    bake_ours(cells, objects=("floor",), channel=("own", "G"), exposure=-3.0)
    after = stored(floor.data, "own")
    assert np.array_equal(after[:, [0, 2, 3]], before[:, [0, 2, 3]])
    light = colors(floor.data, "Radiosity") @ (0.2126, 0.7152, 0.0722) / 8
    np.testing.assert_allclose(after[:, 1], srgb(light) if kind == "BYTE_COLOR" else light, atol=0.6 / 255)
    with pytest.raises(Refused, match=r"wall: it has no color attribute 'own' \(it has: none\)"):
        bake_ours(cells, channel=("own", "G"))


def radiosity(*arguments):
    """Run the command in a process of its own, which must end: Blender's glTF exporter leaves a thread behind."""
    command = [sys.executable, "-m", "cell_radiosity", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


def exported(path, layer="Radiosity"):
    """Export the open file; returns the scale that was said."""
    bpy.ops.wm.save_as_mainfile(filepath=str(path.with_suffix(".blend")), copy=True)
    done = radiosity("export", path.with_suffix(".blend"), "-o", path, "--layer", layer)
    assert done.returncode == 0, done.stderr
    return float(re.search(r"divided by (\S+)", done.stdout)[1])


def read_glb(path):
    """The JSON of a .glb file and a function that gives an accessor's values."""
    data = path.read_bytes()
    size = struct.unpack("<I", data[12:16])[0]
    tree, binary = json.loads(data[20 : 20 + size]), data[28 + size :]

    def values(number):
        accessor = tree["accessors"][number]
        view = tree["bufferViews"][accessor["bufferView"]]
        kind = {5126: np.float32, 5123: np.uint16, 5121: np.uint8, 5125: np.uint32}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        read = np.frombuffer(binary, kind, accessor["count"] * width, start).reshape(-1, width)
        return read / np.iinfo(kind).max if accessor.get("normalized") else read

    return tree, values


def test_gltf_read_back_is_the_light(cells, tmp_path):
    """COLOR_0 is within 0..1; times the scale in the extras it is the layer, vertex for vertex."""
    floor = lit_floor()
    floor.location = (1, 2, 3)
    bpy.data.objects["POINT"].location = (0.7, 2.2, 4.2)
    bake_ours(cells)
    scale = exported(tmp_path / "lit.glb")
    assert scale > 1
    tree, values = read_glb(tmp_path / "lit.glb")
    assert tree["scenes"][0]["extras"]["radiosity_scale"] == pytest.approx(scale, rel=1e-5)
    nodes = {n["name"]: n for n in tree["nodes"]}
    assert set(nodes) == {"floor", "wall"}
    assert nodes["floor"]["extras"]["radiosity_scale"] == pytest.approx(scale, rel=1e-5)
    (primitive,) = tree["meshes"][nodes["floor"]["mesh"]]["primitives"]
    light, at = values(primitive["attributes"]["COLOR_0"]), values(primitive["attributes"]["POSITION"])
    assert light.min() >= 0
    assert light.max() <= 1
    vertex = [loop.vertex_index for loop in floor.data.loops]
    place = np.array([floor.data.vertices[k].co[:] for k in vertex])
    written = colors(floor.data, "Radiosity")
    for color, (x, y, z) in zip(light[:, :3], at):
        nearest = np.abs(place - (x, -z, y)).sum(axis=1).argmin()  # glTF's y is up
        np.testing.assert_allclose(color * scale, written[nearest], rtol=1e-4, atol=scale / 60000)
    assert max(values(p["attributes"]["COLOR_0"]).max() for m in tree["meshes"] for p in m["primitives"]) > 0.99


def test_usd_read_back_is_the_light(cells, tmp_path):
    floor = lit_floor()
    bpy.data.objects.remove(bpy.data.objects["wall"])
    bake_ours(cells)
    scale = exported(tmp_path / "lit.usda", "Lighting")
    text = (tmp_path / "lit.usda").read_text()
    assert float(re.search(r"userProperties:radiosity_scale = (\S+)", text)[1]) == pytest.approx(scale, rel=1e-5)
    block = re.search(r"color\w+\[\] primvars:displayColor = \[(.*?)\]", text, re.DOTALL)[1]
    read = np.array(re.findall(r"\(([^)]*)\)", block))
    read = np.array([[float(x) for x in row.split(",")[:3]] for row in read])
    np.testing.assert_allclose(read * scale, colors(floor.data, "Lighting"), rtol=1e-4, atol=1e-5)


def test_export_commands(tmp_path, capfd):
    lit_floor()
    scene = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(scene))
    out = tmp_path / "out" / "lit.blend"
    glb = out.with_suffix(".glb")
    assert radiosity("bake", scene, "-o", out, "--export", glb, "--bytes", "--quiet").returncode == 0
    assert {p.name for p in out.parent.iterdir()} == {"lit.blend", "lit.glb"}
    assert radiosity("export", out, "-o", glb.with_suffix(".gltf"), "--layer", "Lighting", "--quiet").returncode == 0
    assert json.loads(glb.with_suffix(".gltf").read_text())["meshes"]
    capfd.readouterr()
    for arguments, message in (
        (["export", str(scene), "-o", str(glb)], "no mesh of this scene has a baked layer 'Radiosity'"),
        (["export", str(out), "-o", str(out.with_suffix(".obj"))], "its name must end in .glb"),
        (["bake", str(scene), "--target", "lightmap", "--export", str(glb)], "--export writes vertex colors"),
    ):  # fmt: skip
        assert main(arguments) == 1
        assert message in capfd.readouterr().err


def test_layers_of_light_groups(cells):
    """A layer for each lamp, or for each collection with lights in it; they add up to the whole."""
    floor = lit_floor()
    evening = bpy.data.collections.new("evening")
    bpy.context.scene.collection.children.link(evening)
    for name, place in (("left", (-0.5, 0.5, 1)), ("right", (0.3, -0.5, 1.5))):
        made = lamp("POINT", 100.0, location=place)
        made.name = name
        bpy.context.scene.collection.objects.unlink(made)
        evening.objects.link(made)
    job = bake_ours(cells, groups="lamp", layers=("Lighting",))
    names = {"Lighting", "Lighting_POINT", "Lighting_left", "Lighting_right"}
    assert {a.name for a in floor.data.color_attributes} == names
    assert set(job.report("x")["layers"]) == names
    parts = [colors(floor.data, name) for name in names - {"Lighting"}]
    np.testing.assert_allclose(sum(parts), colors(floor.data, "Lighting"), rtol=1e-5)
    assert all(part.max() > 0.1 for part in parts)
    evening_light = colors(floor.data, "Lighting_left") + colors(floor.data, "Lighting_right")
    bake_ours(cells, groups="collection", layers=("Lighting",))
    assert "Lighting_Scene Collection" in floor.data.color_attributes
    # What rows are off by is taken out of each group by itself.
    np.testing.assert_allclose(colors(floor.data, "Lighting_evening"), evening_light, rtol=5e-3)
    bake_ours(cells, groups="collection", layers=("Lighting",), target="lightmap", texels_per_meter=8)
    assert {"floor_Lighting_evening", "wall_Lighting_evening", "floor_Lighting"} <= set(bpy.data.images.keys())
