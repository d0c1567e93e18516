"""The user interface without a window: settings, words, the preflight, and what the buttons do to a file."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

import cell_radiosity
from cell_radiosity import addon
from cell_radiosity.addon import panels, translations
from cell_radiosity.addon.job import Options
from cell_radiosity.addon.preflight import preflight
from cell_radiosity.addon.read_scene import read_scene
from cell_radiosity.addon.running import Running
from cell_radiosity.addon.session import Session
from cell_radiosity.addon.translations import VALUE, tr, tr_message
from cell_radiosity.addon.translations_de import GERMAN
from cell_radiosity.core.bake import bake, run
from cell_radiosity.core.baked import Progress
from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.effects import survey
from cell_radiosity.core.layers import layer_colors
from cell_radiosity.core.settings import EFFECTS, Settings

from blender_scenes import bake_ours, colors, cube, diffuse, empty, glowing, lamp, plane

sys.path.insert(0, str(Path(__file__).parent.parent))

from tools import effects_table

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


NUMBER = re.compile(r"(?<!\w)'[^']*'(?!\w)|\d+(?:[.,]\d+)*")  # or a quoted name


def test_every_word_has_its_german_one():
    missing = sorted(word for word in words() if NUMBER.sub("{}", word) not in GERMAN and word not in GERMAN)
    assert not missing
    for word, german in GERMAN.items():
        assert sorted(VALUE.findall(word)) == sorted(VALUE.findall(german)), word


REFUSING = (
    "export.py",
    "job.py",
    "outputs.py",
    "write_result.py",
    "atlas.py",
    "errors.py",
)  # whose refusals the panel shows ...
COMMAND = re.compile("state file|--strict|its layers")  # ... but for these


def sentences():
    """What the code says of effects and objects, what is done about it, and why it refuses, with {} for what it puts in."""
    found = set()
    for path in (*ADDON.glob("*.py"), *ADDON.with_name("core").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            name = isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", ""))
            if name in ("Finding", "say"):
                found.update(map(sentence, node.args[1:]))
            elif name == "Effect":
                found.update(map(sentence, node.args[2:3]))
            elif name == "append" and ast.unparse(node.func).endswith("ignored.append"):
                found.update(map(sentence, getattr(node.args[0], "elts", ())[1:]))
            elif name == "append" and ast.unparse(node.func).endswith("notes.append"):
                found.add("{}: " + sentence(node.args[0]))
            elif name in ("Refused", "NoUnwrapper") and path.name in REFUSING and not COMMAND.search(ast.unparse(node)):
                found.update(map(sentence, node.args[:1]))
    return found - {None}


def sentence(node):
    """A text or a formatted text, with {} for its values; None for anything else."""
    if isinstance(node, ast.Constant):
        return NUMBER.sub("{}", node.value)
    if isinstance(node, ast.JoinedStr):
        return NUMBER.sub("{}", "".join(v.value if isinstance(v, ast.Constant) else "{}" for v in node.values))


def test_every_sentence_has_its_german_words():
    known = "\n".join(VALUE.sub("{}", word) for word in GERMAN)
    missing = [
        said for said in sentences() if not re.search("^" + re.escape(said).replace(r"\{\}", ".*") + "$", known, re.M)
    ]
    assert len(sentences()) > 100
    assert not sorted(missing)


@pytest.fixture
def german(monkeypatch):
    """German words are found, whether this Blender knows the language or not."""
    monkeypatch.setattr(translations, "_look_up", lambda text: GERMAN.get(text, text))


ENGLISH = set(
    re.findall(r"\w+", "the of a and with is are was it its faces light rays that can none at most front back to")
)


@pytest.mark.parametrize("forced", [False, True])
def test_reasons_of_effects_are_told_in_german(forced, german):
    for scene in effects_table.scenes().values():
        names = {word for name in (*scene.objects, *(m.name for m in scene.materials)) for word in name.split()}
        for effect in survey(scene, Settings(force=EFFECTS if forced else ())).effects:
            told = tr_message(effect.reason)
            assert told != effect.reason
            assert not (ENGLISH - names) & set(re.findall(r"\w+", told)), told


def test_sentences_within_sentences_keep_their_values(german):
    assert tr_message("Tea, pot reflects 80 %: up to 1 bounce can matter at the 2 % asked for").startswith(
        "Tea, pot wirft 80 %"
    )
    assert tr_message("2 area, 1 spot") == "2 Fläche, 1 Spot"
    told = tr_message(
        "forced; not needed: 2 parts cannot see one another (A, front; B, back): each has a stop of its own"
    )
    assert "(A, vorn; B, hinten)" in told
    told = tr_message("a red one reflects 9 %: up to 3 bounces can matter at the 2 % asked for; rays are guided to 7 bright"
                      " sides of patches, which they would seldom meet by chance")  # fmt: skip
    assert told.startswith("a red one wirft 9 % zurück")
    assert "7 hellen Seiten" in told
    assert tr_message("3 faces emit light, of A, B, C and 4 more objects").endswith(
        "von A, B, C und 4 weiteren Objekten"
    )
    assert tr_message("2 faces emit light, of there is no lamp") == "2 Flächen leuchten, von there is no lamp"
    told = tr_message("its light is written to a copy, 'cube 7_radiosity'")
    assert told == "sein Licht wird in eine Kopie geschrieben, 'cube 7_radiosity'"
    assert tr_message("the last slot's material was taken, as Blender does").startswith("das Material")
    assert tr_message("one, two") == "one, two"
    assert tr_message("nobody says 3 of this") == "nobody says 3 of this"


def test_words_are_looked_up_in_the_users_language():
    view = bpy.context.preferences.view
    former = view.language
    if "de_DE" not in bpy.app.translations.locales:
        pytest.skip("this Blender has no translations")
    try:
        view.language, view.use_translate_interface = "de_DE", True
        assert tr("Objects: {}, face corners: {}", 3, 12) == "Objekte: 3, Flächenecken: 12"
        assert tr_message("3 faces are lit from behind") == "3 Flächen werden von hinten beleuchtet"
    finally:
        view.language = former
    assert tr("Objects: {}, face corners: {}", 3, 12) == "Objects: 3, face corners: 12"


def test_settings_say_what_the_command_line_says_by_default(room):
    room.radiosity.chosen = -1
    assert room.radiosity.preset == "good"
    options = room.radiosity.options(bpy.context)
    assert options == Options()
    room.radiosity.per_object = room.radiosity.selected = True
    assert room.radiosity.options(bpy.context).per_object
    for o in room.objects:
        o.select_set(o.name == "cube")
    assert room.radiosity.options(bpy.context).objects == ("cube",)


def test_the_button_gives_the_bits_of_the_command_and_of_the_core(room, cells):
    bake_ours(cells, error=0.1)
    expected = {m.name: colors(m, "Radiosity") for m in bpy.data.meshes}
    scene, targets = read_scene(bpy.context)
    core = run(bake(scene, Options(error=0.1).settings(scene), LocalCells()))
    for target in targets:
        own = layer_colors(core, "Radiosity")[target.first : target.last].astype(np.float32)
        assert np.array_equal(own, expected[target.object][target.corner])
    bpy.ops.radiosity.clear()
    assert not any(m.color_attributes for m in bpy.data.meshes)
    assert bpy.ops.radiosity.bake() == {"FINISHED"}
    assert all(np.array_equal(colors(m, "Radiosity"), expected[m.name]) for m in bpy.data.meshes)
    result = room.radiosity.result
    assert result.points == 16 * 4 - 39 + 24
    assert result.seconds > 0
    assert {e.name for e in result.effects} >= {"lamps", "emission", "sky"}


def prices_of(room):
    return [(p.error, p.seconds, p.memory) for p in room.radiosity.prices]


def test_prices_are_found_without_a_bake_and_chosen_from(room):
    settings = room.radiosity
    assert bpy.ops.radiosity.price() == {"FINISHED"}
    assert not any(m.color_attributes for m in bpy.data.meshes)
    errors, seconds, memory = zip(*prices_of(room))
    assert errors == pytest.approx([0.1, 0.05, 0.02, 0.01, 0.005])
    assert list(seconds) == sorted(seconds)
    assert min(seconds) > 0
    assert min(memory) > 0
    assert settings.prices_hold(bpy.context)
    bpy.ops.radiosity.choose(error=errors[3])
    assert settings.options(bpy.context).error == pytest.approx(0.01)
    assert [settings.buys(p) for p in settings.prices] == [False, False, False, True, False]
    settings.preset = "fine"
    assert [settings.buys(p) for p in settings.prices] == [False, False, False, False, True]
    settings.preset = "time"
    for seconds, row in ((0.1, None), (3.0, 2), (1000.0, 4)):
        settings.time = seconds
        for k, price in enumerate(settings.prices):
            price.seconds = (0.2, 1.0, 3.0, 9.0, 27.0)[k]
        assert [settings.buys(p) for p in settings.prices] == [k == row for k in range(5)]


def test_a_bake_brings_the_prices_its_pilot_has_found(room):
    """They hold until something changes, whatever the bake itself has written."""
    bpy.ops.radiosity.bake()
    assert len(prices_of(room)) == 5
    assert room.radiosity.prices_hold(bpy.context)
    room.radiosity.exposure = 1.0
    bpy.ops.radiosity.show_layer(layer="Lighting")
    bpy.ops.radiosity.set_up_materials(kind="EMISSION")
    bpy.ops.radiosity.take_out_of_materials()
    bpy.ops.radiosity.clear()
    bpy.context.view_layer.update()
    assert room.radiosity.prices_hold(bpy.context)


CHANGES = {
    "an object is moved": lambda: setattr(bpy.data.objects["cube"], "location", (0.5, 0.0, 0.6)),
    "a mesh is edited": lambda: (setattr(bpy.data.meshes["cube"].vertices[0], "co", (2, 0, 0)),
                                 bpy.data.meshes["cube"].update()),
    "a modifier is added": lambda: bpy.data.objects["cube"].modifiers.new("Subdivision", "SUBSURF"),
    "a lamp is brighter": lambda: setattr(bpy.data.lights[0], "energy", 7.0),
    "a material is changed": lambda: setattr(
        next(n for n in bpy.data.materials["gray"].node_tree.nodes if n.type == "BSDF_DIFFUSE").inputs["Color"],
        "default_value", (0.1, 0.2, 0.3, 1.0)),
    "a material is taken away": lambda: setattr(bpy.data.objects["plane"].material_slots[0], "material", None),
    "the world is changed": lambda: setattr(bpy.data.worlds[0], "color", (0.5, 0.5, 0.5)),
    "an object is hidden": lambda: bpy.data.objects["cube"].hide_set(True),
    "an object is not rendered": lambda: setattr(bpy.data.objects["cube"], "hide_render", True),
    "an object is added": lambda: cube("more"),
    "an object is removed": lambda: bpy.data.objects.remove(bpy.data.objects["cube"]),
    "another side is asked for": lambda: setattr(bpy.context.scene.radiosity, "side", "lit"),
    "lightmaps are asked for": lambda: setattr(bpy.context.scene.radiosity, "target", "lightmap"),
    "an animated object is elsewhere": lambda: bpy.context.scene.frame_set(10),
}  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_prices_are_known_to_be_old(room, change):
    bpy.data.objects["cube"].keyframe_insert("location", frame=1)
    bpy.data.objects["cube"].location.z = 1.0
    bpy.data.objects["cube"].keyframe_insert("location", frame=20)
    bpy.ops.radiosity.price()
    bpy.context.view_layer.update()
    assert room.radiosity.prices_hold(bpy.context)
    CHANGES[change]()
    bpy.context.view_layer.update()
    assert not room.radiosity.prices_hold(bpy.context)
    assert len(prices_of(room)) == 5  # they are kept
    bpy.ops.radiosity.price()
    assert room.radiosity.prices_hold(bpy.context)


def test_prices_hold_whatever_does_not_matter(room, tmp_path):
    bpy.ops.radiosity.price()
    eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    for change in (
        lambda: bpy.data.objects["cube"].select_set(True),
        lambda: setattr(bpy.context.view_layer.objects, "active", bpy.data.objects["plane"]),
        lambda: setattr(room.radiosity, "preset", "fine"),
        lambda: setattr(room.radiosity, "layers", {"Direct"}),
        lambda: setattr(room.render, "resolution_x", 123),
        lambda: setattr(eye, "location", (1.0, 2.0, 3.0)),
        lambda: setattr(room.cursor, "location", (1.0, 2.0, 3.0)),
    ):
        change()
        bpy.context.view_layer.update()
        assert room.radiosity.prices_hold(bpy.context)
    path = str(tmp_path / "priced.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=path)
    bpy.context.view_layer.update()
    assert len(prices_of(bpy.context.scene)) == 5
    assert bpy.context.scene.radiosity.prices_hold(bpy.context)


def test_an_accuracy_is_an_error_or_a_time(room):
    settings = room.radiosity
    settings.preset, settings.error, settings.time = "error", 3.0, 7.0
    assert settings.options(bpy.context).error == pytest.approx(0.03)
    assert settings.options(bpy.context).time is None
    settings.preset = "time"
    assert settings.options(bpy.context).time == 7.0
    assert settings.options(bpy.context).error == Options().error  # as on the command line
    settings.time = 0.5
    bpy.ops.radiosity.bake()
    timed = settings.result.error
    settings.preset = "draft"
    bpy.ops.radiosity.bake()
    draft = settings.result.error
    assert 0 < timed < draft
    settings.preset = "time"
    bpy.ops.radiosity.bake(error=10.0)  # an error in place of what the panel has
    assert settings.result.error == draft


def test_the_next_error_that_is_worth_it(room):
    result = room.radiosity.result
    for error, converged, partial, asked, goal in (
        (0.08, True, False, 0.1, 0.05),
        (0.014, True, False, 0.02, 0.005),
        (0.0145, True, False, 0.02, 0.01),
        (0.0005, True, False, 0.001, None),  # there is none
        (0.08, False, False, 0.02, None),  # rays are of no use
        (-1.0, True, False, 0.02, None),  # nothing is known
        (-1.0, False, True, 0.02, 0.02),  # what was broken off
        (0.08, False, True, 0.02, 0.02),
    ):
        result.error, result.converged, result.partial, result.asked = error, converged, partial, asked
        found = result.goal()
        assert found is None if goal is None else found == pytest.approx(goal), (error, converged, partial)
    result.clear()


class Drawn:
    """A layout that only notes what is drawn: texts, and the properties that buttons are given."""

    def __init__(self):
        self.texts, self.buttons = [], []

    def operator(self, name, text="", **_):
        self.texts.append(text)
        self.buttons.append(SimpleNamespace(name=name))
        return self.buttons[-1]

    def label(self, *_, text="", **__):
        self.texts.append(text)

    progress = prop = label

    def panel(self, *_, **__):
        return self, self

    def column(self, **_):
        return self

    row = box = split = column


def drawn(panel=panels.RADIOSITY_PT_main):
    layout = Drawn()
    panel.draw(SimpleNamespace(layout=layout), bpy.context)
    return layout


def test_the_panel_shows_prices_and_the_way_on(room):
    settings = room.radiosity
    assert [b.name for b in drawn().buttons] == ["radiosity.price", "radiosity.bake"]
    bpy.ops.radiosity.bake()
    settings.result.error, settings.result.converged = 0.014, True
    settings.prices[3].seconds, settings.prices[4].seconds = 14.2, 100.0
    look = drawn()
    assert "1 % error: 14 s, " in " ".join(look.texts)
    assert look.texts[-1] == "To reach 0.5 %: about 100 s more"
    assert look.buttons[-1].error == pytest.approx(0.5)
    assert "radiosity.price" not in [b.name for b in look.buttons]  # it is known
    bpy.data.lights[0].energy *= 2
    bpy.context.view_layer.update()
    look = drawn()
    assert "The scene or the settings have changed" in " ".join(look.texts)
    assert look.texts[-1] == "To reach 0.5 %"  # nobody knows how long
    assert "radiosity.price" in [b.name for b in look.buttons]


def test_effects_are_shown_with_what_they_have_cost(room):
    bpy.ops.radiosity.find_effects()
    assert "s of work" not in " ".join(drawn(panels.RADIOSITY_PT_effects).texts)
    bpy.ops.radiosity.bake()
    room.radiosity.result.effects["lamps"].seconds = 12.3
    texts = " ".join(drawn(panels.RADIOSITY_PT_effects).texts)
    assert "Lamps: 1 point (12 s of work)" in texts
    assert "Sky: the world is black (" not in texts


def test_while_it_runs_the_panel_shows_how_far_it_is(room, monkeypatch):
    running = Running(None, None, expected=20.0)
    monkeypatch.setattr(Session, "running", running)
    assert drawn().texts[:1] == ["Reading the scene"]
    running.phase = "work"
    running.progress = Progress("transport", 0.4, 4.0, rays=2_000_000)
    running.bound, running.light_error = 0.031, 0.0123
    texts = drawn().texts
    for part in (
        "Light between patches  40 %",
        "Error so far: 1.2 %",
        "at most 3.1 %",
        "About 16 s left",
        "2.0 million",
    ):
        assert any(part in text for text in texts), part
    running.progress = Progress("gather", 0.4, 4.0, left=7.0)
    assert any("About 7 s left" in text for text in drawn().texts)
    running.waiting = "Go to Object Mode to see the result"
    texts = drawn().texts
    assert texts[0] == "Waiting"
    assert not any("left" in text for text in texts)
    running.waiting, running.phase = "", "write"
    assert not any("left" in text for text in drawn().texts)
    running.phase = "work"
    running.cancel()
    assert not any("left" in text for text in drawn().texts)


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
    assert look().copies.count == 1
    assert any(text == "Copies of shared meshes: 1, 0.1 MB" for text in drawn().texts)
    room.radiosity.shared = "skip"
    assert look().copies.count == 0
    room.radiosity.shared = "copy"
    scarce = Options(memory=100.0)
    assert preflight(bpy.context, scarce).problem.startswith("1 copies of shared meshes take 0.0 GB, more than")
    room.radiosity.target = "lightmap"
    assert look().copies.count == 0
    room.radiosity.target = "vertex"

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


def test_another_file_is_looked_at_anew(room, tmp_path):
    """Also if its scene is called the same, and neither file was saved."""
    path = str(tmp_path / "room.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path, copy=True)
    bpy.ops.wm.read_homefile(use_empty=True)
    assert preflight(bpy.context, Options()).problem == "There is no mesh to bake"
    bpy.ops.wm.read_homefile()
    assert preflight(bpy.context, Options()).objects == 1  # the cube of every new file
    bpy.ops.wm.open_mainfile(filepath=path)
    assert preflight(bpy.context, Options()).objects == 2


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


def test_the_views_follow_what_is_undone_and_done_again(room):
    """Blender leaves them as they are: without colors a scene in Flat shading is white."""
    shading = next(a for a in bpy.context.screen.areas if a.type == "VIEW_3D").spaces.active.shading
    look = lambda: (shading.light, shading.color_type)
    before, lit = look(), ("FLAT", "VERTEX")
    assert before != lit
    bpy.ops.ed.undo_push(message="a scene")
    bpy.ops.radiosity.bake()
    bpy.ops.ed.undo_push(message="baked")
    assert look() == lit
    bpy.ops.ed.undo()
    assert look() == before
    bpy.ops.ed.redo()
    assert look() == lit
    bpy.ops.radiosity.clear()
    bpy.ops.ed.undo_push(message="cleared")
    assert look() == before
    bpy.ops.ed.undo()
    assert look() == lit
    shading.light, shading.color_type = before  # by hand: so it stays
    bpy.ops.ed.undo_push(message="something")
    bpy.ops.ed.undo()
    assert look() == before


def sums(mesh, layer, factors):
    """What a layer is to be: the sum of its groups' layers times factors."""
    return sum(colors(mesh, f"{layer}_{group}") * np.array(factor) for group, factor in factors.items())


def test_lights_are_changed_after_the_bake_without_a_ray(room, tmp_path, monkeypatch):
    """Every lit layer and its 8-bit copy, as `radiosity relight` makes them; the groups' own layers stay."""
    bpy.data.objects["cube"].data.materials[0] = glowing("glow", (0.2, 1.0, 0.4), 2.0)
    cube("block", location=(1.8, 0.0, 1.1), material=bpy.data.materials["red"])
    settings = room.radiosity
    settings.groups, settings.bytes, settings.byte_automatic, settings.byte_exposure = "lamp", True, False, -1.0
    settings.layers = {"Radiosity", "Lighting", "Direct", "Indirect", "Occlusion"}
    bpy.ops.radiosity.bake()
    groups = settings.result.groups
    assert [g.name for g in groups] == ["POINT", "cube"]
    assert not settings.result.relit
    floor = bpy.data.meshes["plane"]
    before = {a.name: colors(floor, a.name) for a in floor.color_attributes}
    monkeypatch.setattr(Session, "warm_cells", None)
    groups["POINT"].strength, groups["cube"].color = 0.5, (1.0, 0.0, 0.5)
    groups["cube"].strength = 3.0
    factors = {"POINT": (0.5, 0.5, 0.5), "cube": (3.0, 0.0, 1.5)}
    for layer in ("Radiosity", "Lighting", "Direct", "Indirect"):
        now = colors(floor, layer)
        np.testing.assert_allclose(now, sums(floor, layer, factors), rtol=1e-6, atol=1e-9)
        assert np.abs(now - before[layer]).max() > 0.1 * before[layer].max()
        np.testing.assert_allclose(colors(floor, f"{layer}_8bit"), np.clip(now / 2, 0, 1), atol=0.01)
        assert np.array_equal(colors(floor, f"{layer}_cube"), before[f"{layer}_cube"])
    assert np.array_equal(colors(floor, "Occlusion"), before["Occlusion"])
    # What glows looks as bright as it is set.
    assert colors(bpy.data.meshes["cube"], "Radiosity").max(axis=0)[0] == pytest.approx(0.2 * 2 * 3, rel=0.5)
    settings.exposure = 1.0
    groups["POINT"].strength = 0.0
    factors["POINT"] = (0.0, 0.0, 0.0)
    np.testing.assert_allclose(colors(floor, "Radiosity View"), 2 * sums(floor, "Radiosity", factors), rtol=1e-6)
    assert settings.prices_hold(bpy.context)  # it is the result alone that has changed

    path = str(tmp_path / "evening.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    settings, floor = bpy.context.scene.radiosity, bpy.data.meshes["plane"]
    assert settings.result.relit
    assert "Lights have been changed since" in drawn().texts
    assert drawn(panels.RADIOSITY_PT_lights).texts == ["POINT", "", "cube", "", ""]
    bpy.ops.radiosity.reset_lights()
    assert not settings.result.relit
    for layer in ("Radiosity", "Lighting", "Direct", "Indirect"):
        np.testing.assert_allclose(colors(floor, layer), before[layer], rtol=1e-5, atol=1e-7)
    assert drawn(panels.RADIOSITY_PT_lights).texts == ["POINT", "", "cube", ""]
    bpy.ops.radiosity.clear()
    assert not panels.RADIOSITY_PT_lights.poll(bpy.context)


def test_lights_of_finer_meshes_and_of_vertex_colors_are_changed_too(room):
    """Copies hold them; what lacks a group's layer, or is in Edit Mode, stays as it is."""
    settings = room.radiosity
    settings.groups, settings.mesh, settings.domain, settings.max_edge = "lamp", "subdivide", "POINT", 0.7
    lamp("SUN", 1.0).name = "Sun"
    bpy.ops.radiosity.bake()
    copy, cube_mesh = bpy.data.objects["plane_radiosity"].data, bpy.data.objects["cube_radiosity"].data
    cube_mesh.color_attributes.remove(cube_mesh.color_attributes["Lighting_Sun"])
    before = colors(cube_mesh, "Lighting")
    settings.result.groups["Sun"].strength = 2.0
    factors = {"POINT": (1.0,) * 3, "Sun": (2.0,) * 3}
    np.testing.assert_allclose(colors(copy, "Lighting"), sums(copy, "Lighting", factors), rtol=1e-6)
    np.testing.assert_allclose(colors(cube_mesh, "Radiosity"), sums(cube_mesh, "Radiosity", factors), rtol=1e-6)
    assert np.array_equal(colors(cube_mesh, "Lighting"), before)
    bpy.context.view_layer.objects.active = bpy.data.objects["plane_radiosity"]
    bpy.ops.object.mode_set(mode="EDIT")
    settings.result.groups["Sun"].strength = 5.0
    bpy.ops.object.mode_set(mode="OBJECT")
    np.testing.assert_allclose(colors(copy, "Lighting"), sums(copy, "Lighting", factors), rtol=1e-6)
    settings.groups = "none"
    bpy.ops.radiosity.bake()
    assert not settings.result.groups


@pytest.mark.parametrize("name", ["A lamp, with a comma", "L" * 63, "Ö" * 31])
def test_groups_may_have_any_name(room, name):
    """Their layers are replaced by the next bake, and are found by the sliders, though Blender does not take so long a name."""
    bpy.data.objects["POINT"].name = name
    lamp("SUN", 1.0).name = name[:-1]
    room.radiosity.groups, room.radiosity.bytes = "lamp", True
    bpy.ops.radiosity.bake()
    mesh = bpy.data.objects["plane"].data
    names = {a.name for a in mesh.color_attributes}
    assert len(names) == 12
    bpy.ops.radiosity.bake()
    assert {a.name for a in mesh.color_attributes} == names
    before = colors(mesh, "Lighting")
    for group in room.radiosity.result.groups:
        group.strength = 2.0
    np.testing.assert_allclose(colors(mesh, "Lighting"), 2 * before, rtol=1e-5)
    bpy.ops.radiosity.clear()
    assert not mesh.color_attributes


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


def test_edit_mode_is_said_where_the_button_waits(room):
    """The mesh in the editor is elsewhere: nothing is said of modifiers that it does not have."""
    look = lambda: preflight(bpy.context, room.radiosity.options(bpy.context))
    cube = bpy.data.objects["cube"]
    corners = look().corners
    bpy.context.view_layer.objects.active = cube
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        assert [(f.object, f.finding) for f in look().findings] == [("cube", "it is in Edit Mode")]
        assert look().corners == corners
        assert "Go to Object Mode first" in " ".join(drawn().texts)
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
    assert "Go to Object Mode first" not in " ".join(drawn().texts)


def test_copies_of_the_last_bake_are_no_modifiers(room):
    """Copies that were made to show lightmaps: what is said of their originals is what was said before."""
    look = lambda: preflight(bpy.context, room.radiosity.options(bpy.context))
    before = look()
    room.radiosity.target = "lightmap"
    bpy.ops.radiosity.bake()
    assert "cube_radiosity" in bpy.data.objects
    after = look()
    assert (after.objects, after.corners, after.findings) == (before.objects, before.corners, before.findings)


def test_a_copy_is_selected_for_its_original_and_stands_for_it(room):
    """What was selected is hidden by the bake: the copy that is shown in its place is selected, and baked again."""
    cube = bpy.data.objects["cube"]
    for o in room.objects:
        o.select_set(o == cube)
    bpy.context.view_layer.objects.active = cube
    room.radiosity.selected, room.radiosity.mesh = True, "subdivide"
    for _ in range(2):
        assert bpy.ops.radiosity.bake() == {"FINISHED"}
        copy = bpy.data.objects["cube_radiosity"]
        assert bpy.context.selected_objects == [copy]
        assert bpy.context.view_layer.objects.active == copy
        assert room.radiosity.options(bpy.context).objects == ("cube",)
    bpy.ops.radiosity.clear()
    assert bpy.context.selected_objects == [cube]
    cube.select_set(False)
    with pytest.raises(RuntimeError, match="no object is selected"):
        bpy.ops.radiosity.bake()


def test_errors_that_are_next_to_nothing_are_told_as_little(room):
    room.radiosity.result.points, room.radiosity.result.error = 8, 2e-8
    assert any("Error 0.01 %" in text for text in drawn().texts)


def test_export_writes_the_layer_that_is_shown(room, tmp_path):
    """Under any of the endings, .glb without one; nothing in the file becomes another, and prices stay what they are."""
    assert not bpy.ops.radiosity.export.poll()
    bpy.ops.radiosity.bake()
    room.radiosity.shown = "Lighting"
    names, edits = sorted(o.name for o in bpy.data.objects), Session.edits
    assert bpy.ops.radiosity.export(filepath=str(tmp_path / "box")) == {"FINISHED"}
    assert bpy.ops.radiosity.export(filepath=str(tmp_path / "box.gltf")) == {"FINISHED"}
    assert {"box.glb", "box.gltf", "box.bin"} <= {p.name for p in tmp_path.iterdir()}
    assert (sorted(o.name for o in bpy.data.objects), Session.edits) == (names, edits)
    assert bpy.context.scene == room
    assert "COLOR_0" in (tmp_path / "box.gltf").read_text()
    with pytest.raises(RuntimeError, match="its name must end in"):
        bpy.ops.radiosity.export(filepath=str(tmp_path / "box.obj"))
