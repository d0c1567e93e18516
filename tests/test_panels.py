"""The user interface without a window: settings, words, the preflight, and what the buttons do to a file."""

from __future__ import annotations

import ast
from pathlib import Path

import bpy
import numpy as np
import pytest

import cell_radiosity
from cell_radiosity import addon
from cell_radiosity.addon.job import Options
from cell_radiosity.addon.preflight import preflight
from cell_radiosity.addon.session import Session
from cell_radiosity.addon.translations import NUMBER, tr, tr_message
from cell_radiosity.addon.translations_de import GERMAN

from blender_scenes import bake_ours, colors, cube, diffuse, empty, glowing, lamp, plane

ADDON = Path(addon.__file__).parent


@pytest.fixture(scope="module", autouse=True)
def registered():
    cell_radiosity.register()
    yield
    cell_radiosity.unregister()


@pytest.fixture
def room():
    """A floor and a box under a lamp."""
    empty()
    plane(size=4.0, material=diffuse("gray", (0.5, 0.5, 0.5)))
    cube(size=1.0, location=(0.0, 0.0, 0.6), material=diffuse("red", (0.8, 0.1, 0.1)))
    lamp("POINT", location=(1.0, 1.0, 3.0))
    bpy.context.scene.radiosity.preset = "draft"
    bpy.context.view_layer.update()
    return bpy.context.scene


def words():
    """All words of the user interface: of the registered classes, and those that the code looks up."""
    found = set()
    for cls in addon.CLASSES:
        rna = cls.bl_rna
        if issubclass(cls, bpy.types.Operator):
            rna = getattr(bpy.ops.radiosity, cls.bl_idname.split(".")[1]).get_rna_type()
            found.add(rna.description)
        found.add(getattr(cls, "bl_label", ""))
        for name in getattr(cls, "__annotations__", {}):
            p = rna.properties[name]
            hidden = p.is_hidden or not p.description
            found.update(() if hidden else (p.name, p.description))
            items = p.enum_items if p.type == "ENUM" and not hidden else ()
            found.update(word for item in items for word in (item.name, item.description))
    for path in ADDON.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call):
                first = node.args[0] if node.args and getattr(node.func, "id", "") in ("tr", "tr_message") else None
                texts = [k.value for k in node.keywords if k.arg == "text"] if path.name == "panels.py" else []
                found.update(n.value for n in (first, *texts) if isinstance(n, ast.Constant) and n.value)
    return {word for word in found if any(c.isalpha() for c in word)}


def test_every_word_has_its_german_one():
    missing = sorted(word for word in words() if NUMBER.sub("{}", word) not in GERMAN and word not in GERMAN)
    assert not missing
    for word, german in GERMAN.items():
        assert word.count("{}") == german.count("{}"), word


def test_words_are_looked_up_in_the_users_language():
    view = bpy.context.preferences.view
    former = view.language
    if "de_DE" not in bpy.app.translations.locales:
        pytest.skip("this Blender has no translations")
    try:
        view.language, view.use_translate_interface = "de_DE", True
        assert tr("{} objects, {} face corners", 3, 12) == "3 Objekte, 12 Flächenecken"
        assert tr_message("3 faces are lit from behind") == "3 Flächen werden von hinten beleuchtet"
        assert tr_message("nobody says 3 of this") == "nobody says 3 of this"
    finally:
        view.language = former
    assert tr("{} objects, {} face corners", 3, 12) == "3 objects, 12 face corners"


def test_settings_say_what_the_command_line_says_by_default(room):
    room.radiosity.chosen = -1
    assert room.radiosity.preset == "good"
    options = room.radiosity.options(bpy.context)
    assert options == Options()
    room.radiosity.selected = True
    for o in room.objects:
        o.select_set(o.name == "cube")
    assert room.radiosity.options(bpy.context).objects == ("cube",)


def test_the_button_gives_the_bits_of_the_command(room, cells):
    bake_ours(cells, error=0.1)
    expected = {m.name: colors(m, "Radiosity") for m in bpy.data.meshes}
    bpy.ops.radiosity.clear()
    assert not any(m.color_attributes for m in bpy.data.meshes)
    assert bpy.ops.radiosity.bake() == {"FINISHED"}
    assert all(np.array_equal(colors(m, "Radiosity"), expected[m.name]) for m in bpy.data.meshes)
    result = room.radiosity.result
    assert result.points == 16 * 4 - 39 + 24
    assert result.seconds > 0
    assert {e.name for e in result.effects} >= {"lamps", "emission", "sky"}


def test_what_bakes_have_cost_is_kept_and_chosen_from(room):
    for error in (5.0, 10.0, 5.0):
        assert bpy.ops.radiosity.bake(error=error) == {"FINISHED"}
    prices = room.radiosity.prices
    assert [round(p.error, 4) for p in prices] == [0.1, 0.05]
    assert all(p.seconds > 0 and p.memory > 0 for p in prices)
    bpy.ops.radiosity.choose(error=prices[1].error)
    assert room.radiosity.options(bpy.context).error == pytest.approx(0.05)
    bpy.ops.radiosity.clear()
    assert not prices


def test_preflight_names_what_stands_in_the_way(room):
    def look():
        bpy.context.view_layer.update()
        return preflight(bpy.context, room.radiosity.options(bpy.context))

    assert (look().objects, look().corners, look().findings, look().problem) == (2, 64 + 24, (), "")

    hidden, unrendered, twin = plane("hidden"), plane("unrendered"), plane("twin")
    hidden.hide_set(True)
    unrendered.hide_render = True
    twin.data = bpy.data.objects["plane"].data
    bpy.data.objects["cube"].modifiers.new("Subdivision", "SUBSURF").levels = 1
    cube("named").data.attributes.new("Radiosity", "FLOAT", "POINT")
    found = {f.object: f"{f.finding}; {f.action}" for f in look().findings}
    assert "hidden in the viewport" in found["hidden"]
    assert "not rendered" in found["unrendered"]
    assert "shared by 2 objects; it gets a mesh of its own" in found["twin"]
    assert "cube_radiosity" in found["cube"]
    assert "'Radiosity' that no bake made" in found["named"]
    assert look().objects == 4

    room.radiosity.selected = True
    bpy.ops.object.select_all(action="DESELECT")
    assert look().problem == "No object is selected"
    with pytest.raises(RuntimeError, match="nothing to write to"):
        bpy.ops.radiosity.bake()
    room.radiosity.selected = False
    bpy.data.objects.remove(bpy.data.objects["POINT"])
    for material in list(bpy.data.materials):
        bpy.data.materials.remove(material)
    room.world.node_tree.nodes.clear()
    room.world = None
    assert look().problem.startswith("Nothing gives light")


def test_layers_are_shown_and_exposed_and_cleared(room):
    bpy.ops.radiosity.bake()
    floor = bpy.data.meshes["plane"]
    before = colors(floor, "Lighting")
    assert bpy.ops.radiosity.show_layer(layer="Lighting") == {"FINISHED"}
    assert floor.color_attributes.active_color.name == "Lighting"
    room.radiosity.exposure = 1.0
    assert floor.color_attributes.active_color.name == "Radiosity View"
    assert np.allclose(colors(floor, "Radiosity View"), 2 * before)
    assert np.array_equal(colors(floor, "Lighting"), before)
    bpy.ops.radiosity.expose()
    lit = colors(floor, "Radiosity View").mean(axis=1)
    assert 0.02 < np.median(lit[lit > 0]) < 1.0
    with pytest.raises(RuntimeError, match="No object has a layer"):
        bpy.ops.radiosity.show_layer(layer="Nothing")
    room.radiosity.exposure = 0.0
    assert "Radiosity View" not in floor.color_attributes
    bpy.ops.radiosity.clear()
    assert room.radiosity.result.points == -1
    assert not any(m.color_attributes for m in bpy.data.meshes)
    assert not bpy.ops.radiosity.clear.poll()


def links(material):
    """What a material's node tree is, in comparable form."""
    tree = material.node_tree
    inputs = [(n.name, s.name, tuple(s.default_value) if s.type == "RGBA" else getattr(s, "default_value", None))
              for n in tree.nodes for s in n.inputs]  # fmt: skip
    return inputs, sorted((k.from_node.name, k.from_socket.name, k.to_node.name, k.to_socket.name) for k in tree.links)


@pytest.mark.parametrize("kind", ["EMISSION", "BASE_COLOR"])
def test_materials_show_the_light_and_are_what_they_were_again(room, kind):
    bpy.data.objects["plane"].data.materials.clear()  # this one has none
    bpy.data.materials.remove(bpy.data.materials["gray"])
    bpy.ops.radiosity.bake()
    before = {m.name: links(m) for m in bpy.data.materials}
    light = colors(bpy.data.meshes["cube"], "Radiosity")
    assert bpy.ops.radiosity.set_up_materials(kind=kind) == {"FINISHED"}
    assert len(bpy.data.materials) == len(before) + 1
    tree = bpy.data.materials["red"].node_tree
    (group,) = (n for n in tree.nodes if n.type == "GROUP")
    end = tree.get_output_node("CYCLES").inputs["Surface"]
    if kind == "EMISSION":
        assert end.links[0].from_node == group
        assert group.inputs[0].links[0].from_node.type == "BSDF_DIFFUSE"
    else:
        assert end.links[0].from_node.inputs["Color"].links[0].from_node == group

    bpy.ops.radiosity.bake()  # the light in the materials is not read as theirs
    assert np.array_equal(colors(bpy.data.meshes["cube"], "Radiosity"), light)
    assert group.outputs[0].is_linked

    bpy.ops.radiosity.set_up_materials(kind=kind)  # once is enough
    assert len([n for n in tree.nodes if n.type == "GROUP"]) == 1
    bpy.ops.radiosity.take_out_of_materials()
    assert {m.name: links(m) for m in bpy.data.materials} == before
    assert not bpy.data.node_groups
    assert not bpy.data.objects["plane"].data.materials


def test_light_in_materials_that_only_cycles_reads_is_passed_by_too(room):
    material = glowing("lamp", (1.0, 1.0, 1.0), 2.0)
    bpy.data.objects["cube"].data.materials[0] = material
    tree = material.node_tree
    noise = tree.nodes.new("ShaderNodeTexNoise")
    tree.links.new(noise.outputs["Fac"], next(n for n in tree.nodes if n.type == "EMISSION").inputs["Strength"])
    bpy.ops.radiosity.bake()
    light = colors(bpy.data.meshes["plane"], "Radiosity")
    bpy.ops.radiosity.set_up_materials(kind="EMISSION")
    bpy.ops.radiosity.bake()
    assert np.array_equal(colors(bpy.data.meshes["plane"], "Radiosity"), light)


def test_the_session_keeps_cells_warm_and_ends_them(room):
    bpy.ops.radiosity.bake()
    pids = [cell.process.pid for cell in Session.cells._cells]
    bpy.ops.radiosity.bake()
    assert [cell.process.pid for cell in Session.cells._cells] == pids
    assert len(Session.warm_cells(1)._cells) == 1
    assert len(Session.warm_cells(2)._cells) == 2
    bpy.ops.wm.read_homefile(use_empty=True)
    assert Session.cells is None
