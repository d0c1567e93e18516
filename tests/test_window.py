"""The extension in a window, as people use it: buttons are clicked, keys pressed, the screen looked at."""

from __future__ import annotations

import os
import time

import numpy as np
import pytest

from real_blender import EXTENSION, same
from window import Window, missing

pytestmark = [
    pytest.mark.blender,
    pytest.mark.skipif(bool(missing()), reason=f"a window needs {', '.join(missing())}"),
]

SESSION = f"__import__('sys').modules['{EXTENSION}.addon.session'].Session"
RUNNING = f"({SESSION}.running is not None)"
IDLE = f"({SESSION}.running is None)"
FIRST_LIGHT = f"bool({SESSION}.running is None or any('Radiosity' in m.color_attributes for m in bpy.data.meshes))"
SETTINGS = "bpy.context.scene.radiosity"
CELLS = f"[c.process.pid for c in {SESSION}.cells._cells] if {SESSION}.cells else []"
LAYERS = "sorted({a.name for m in bpy.data.meshes for a in m.color_attributes})"
PRESS_BAKE = (
    "with bpy.context.temp_override(window=window, area=area, region=region): bpy.ops.radiosity.bake('INVOKE_DEFAULT')"
)


@pytest.fixture(scope="module")
def window(blender, folder):
    made = Window(os.environ["BLENDER"], folder, blender.environment)
    yield made
    made.close()


@pytest.fixture
def box(window, folder):
    """The window with the Cornell box in it."""
    window.open(folder / "box.blend")
    return window


@pytest.fixture
def hall(window, folder):
    """The window with the hall in it, and a bake under way that takes its time."""
    window.open(folder / "hall.blend")
    window.ask(f"{SETTINGS}.preset = 'error'; {SETTINGS}.error = 0.1; {SETTINGS}.exposure = 0.0")
    window.ask(PRESS_BAKE)
    window.until(f"{SESSION}.running.phase == 'work'")
    return window


def alive(pids):
    return [
        pid for pid in pids if os.path.exists(f"/proc/{pid}") and "Z" not in open(f"/proc/{pid}/stat").read().split()[2]
    ]


def test_one_click_bakes_and_shows_the_light_with_the_same_bits(box, blender, folder, expected):
    before = box.picture()
    box.click(*box.find_button())
    box.until(RUNNING)
    box.until(IDLE)
    out = folder / "clicked.blend"
    box.ask(f"bpy.ops.wm.save_as_mainfile(filepath={str(out)!r}, copy=True)")
    assert same(blender.layers(out), expected)
    # The light is on the screen: the red wall glows, which in plain Solid shading is dark.
    wall = (slice(300, 500), slice(290, 360))
    assert box.picture()[wall][..., 0].mean() > 1.5 * before[wall][..., 0].mean()
    assert box.ask(f"answer = [{SETTINGS}.result.points, {SETTINGS}.shown]") == [8363, "Radiosity"]


def test_undo_takes_a_bake_back_whole(box):
    color = "area.spaces.active.shading.color_type"
    before = box.ask(f"answer = {color}")
    box.ask(PRESS_BAKE)
    box.until(RUNNING)
    box.until(IDLE)
    assert box.ask(f"answer = [{LAYERS}, {color}]") == [["Lighting", "Radiosity"], "VERTEX"]
    box.press("ctrl+z")
    box.until(f"{LAYERS} == []")
    assert box.ask(f"answer = {color}") == before != "VERTEX"
    assert box.ask(f"answer = {SETTINGS}.result.points") == -1
    box.press("ctrl+shift+z")
    box.until(f"{LAYERS} == ['Lighting', 'Radiosity']")
    assert box.ask(f"answer = {color}") == "VERTEX"


def test_prices_are_found_beside_the_window(box):
    """They hold through a bake and its light on the screen, and are old once an object has moved."""
    box.ask(PRESS_BAKE.replace("radiosity.bake", "radiosity.price"))
    assert box.ask(f"answer = {RUNNING}")  # the window goes on
    box.until(IDLE)
    state = f"answer = [len({SETTINGS}.prices), {SETTINGS}.prices_hold(bpy.context), {LAYERS}]"
    assert box.ask(state) == [5, True, []]
    box.ask(f"{SETTINGS}.preset = 'draft'")
    box.ask(PRESS_BAKE)
    box.until(RUNNING)
    box.until(IDLE)
    time.sleep(0.5)
    assert box.ask(state) == [5, True, ["Lighting", "Radiosity"]]
    box.ask("bpy.data.objects['room'].location.x += 0.1")
    box.until(f"not {SETTINGS}.prices_hold(bpy.context)")


def test_escape_ends_the_search_for_prices(hall):
    hall.press("Escape")
    hall.until(IDLE)
    prices = f"[p.seconds for p in {SETTINGS}.prices]"
    before = hall.ask(f"answer = {prices}")
    hall.ask(PRESS_BAKE.replace("radiosity.bake", "radiosity.price"))
    hall.until(f"{SESSION}.running.phase == 'work'")
    hall.press("Escape")
    hall.until(IDLE)
    assert hall.ask(f"answer = {prices}") == before


def test_light_comes_before_the_end_and_escape_keeps_it(hall):
    hall.until(FIRST_LIGHT)
    assert hall.ask(f"answer = {RUNNING}")
    hall.press("Escape")
    hall.until(IDLE)
    assert hall.ask(f"answer = [{SETTINGS}.result.partial, {LAYERS}]") == [True, ["Lighting", "Radiosity"]]
    brightest = (
        "max(max(x.color[:3]) for m in bpy.data.meshes for x in list(m.color_attributes['Radiosity'].data)[::50])"
    )
    assert hall.ask(f"answer = {brightest}") > 0
    hall.press("ctrl+z")
    hall.until(f"{LAYERS} == []")


def test_the_cancel_button_ends_a_bake(hall):
    hall.until(FIRST_LIGHT)
    hall.click(*hall.find_button())
    hall.until(IDLE)
    assert hall.ask(f"answer = {SETTINGS}.result.partial")


def test_edit_mode_during_a_bake_loses_nothing(hall):
    hall.until(FIRST_LIGHT)
    name = "next(o.name for o in bpy.context.scene.objects if o.type == 'MESH')"
    hall.ask(f"bpy.context.view_layer.objects.active = bpy.data.objects[{name}]; bpy.ops.object.mode_set(mode='EDIT')")
    hall.press("Escape", place=(350, 400))
    hall.until(f"{SESSION}.running.waiting", wait=120)
    assert hall.ask("answer = bpy.context.mode") == "EDIT_MESH"
    hall.ask("bpy.ops.object.mode_set(mode='OBJECT')")
    hall.until(IDLE)
    assert hall.ask(f"answer = {LAYERS}") == ["Lighting", "Radiosity"]


def test_objects_deleted_and_edited_during_a_bake_are_named(hall):
    names = hall.ask(
        "a, b = [o for o in bpy.context.scene.objects if o.type == 'MESH'][:2]; answer = [a.name, b.name];"
        "bpy.data.objects.remove(a); b.data = b.data.copy(); b.data.clear_geometry()"
    )
    hall.until(FIRST_LIGHT)
    hall.press("Escape")
    hall.until(IDLE)
    found = dict(hall.ask(f"answer = [[h.name, h.finding] for h in {SETTINGS}.result.health]"))
    assert "deleted" in found[names[0]]
    assert "changed" in found[names[1]]
    assert hall.ask(f"answer = {LAYERS}") == ["Lighting", "Radiosity"]


def test_a_renamed_object_gets_its_light_and_a_removed_scene_ends_a_bake(hall):
    hall.until(FIRST_LIGHT)
    hall.ask("bpy.data.objects['floor'].name = 'ground'")
    hall.press("Escape")
    hall.until(IDLE)
    assert hall.ask(f"answer = len({SETTINGS}.result.health)") == 0
    assert "Lighting" in hall.ask("answer = [a.name for a in bpy.data.objects['ground'].data.color_attributes]")
    hall.ask("bpy.data.scenes.new('other')")
    hall.ask(PRESS_BAKE)
    hall.until(f"{SESSION}.running.phase == 'work'")
    hall.ask("old = bpy.context.scene; window.scene = bpy.data.scenes['other']; bpy.data.scenes.remove(old)")
    hall.press("Escape")
    hall.until(IDLE)
    assert hall.ask(f"answer = {SETTINGS}.result.points") == -1


def test_an_edit_during_a_bake_makes_its_prices_old(hall):
    hall.until(f"{SESSION}.running.light_error is not None")
    hall.ask("next(o for o in bpy.context.scene.objects if o.type == 'MESH').location.x += 0.1")
    time.sleep(0.5)
    hall.press("Escape")
    hall.until(IDLE)
    assert hall.ask(f"answer = [len({SETTINGS}.prices), {SETTINGS}.prices_hold(bpy.context)]") == [5, False]


def test_undo_during_a_bake_is_safe(hall):
    hall.until(FIRST_LIGHT)
    hall.ask("bpy.ops.ed.undo_push(message='something')")
    hall.press("ctrl+z")
    time.sleep(0.5)
    hall.press("Escape")
    hall.until(IDLE)
    assert hall.ask(f"answer = {LAYERS}") == ["Lighting", "Radiosity"]


def test_another_file_ends_a_bake_and_its_cells(hall, folder):
    hall.until(FIRST_LIGHT)
    cells = hall.ask(f"answer = {CELLS}")
    hall.open(folder / "box.blend")
    assert hall.ask(f"answer = {IDLE}")
    assert not alive(cells)


def test_a_killed_cell_is_replaced(hall):
    hall.until(f"{SESSION}.running.progress is not None")
    cells = hall.ask(f"answer = {CELLS}")
    os.kill(cells[0], 9)
    hall.until(f"{SESSION}.cells.restarted == 1")
    hall.press("Escape")
    hall.until(IDLE)
    assert not alive(cells[:1])


def test_disabling_the_extension_during_a_bake_ends_it(hall):
    hall.until(FIRST_LIGHT)
    cells = hall.ask(f"answer = {CELLS}")
    hall.ask(f"import addon_utils; addon_utils.disable({EXTENSION!r})")
    assert not alive(cells)
    hall.ask(f"addon_utils.enable({EXTENSION!r})")
    assert hall.ask(f"answer = {IDLE}")


def test_the_exposure_leaves_the_layers_alone(box):
    box.ask(f"{SETTINGS}.preset = 'draft'")
    box.ask(PRESS_BAKE)
    box.until(RUNNING)
    box.until(IDLE)
    values = "[list(x.color) for x in list(bpy.data.meshes['room'].color_attributes['Radiosity'].data)[::500]]"
    before, dark = box.ask(f"answer = {values}"), box.picture()
    box.ask(f"{SETTINGS}.exposure = 2.0")
    floor = (slice(560, 620), slice(300, 400))
    box.until_seen(lambda picture: picture[floor].mean() > 1.3 * dark[floor].mean())
    assert box.ask(f"answer = {values}") == before
    box.ask(f"{SETTINGS}.exposure = 0.0")
    assert box.ask(f"answer = {LAYERS}") == ["Lighting", "Radiosity"]


def test_a_light_is_dimmed_with_a_slider_and_one_undo_brings_it_back(box):
    box.ask(f"{SETTINGS}.preset = 'draft'; {SETTINGS}.groups = 'lamp'")
    box.ask(PRESS_BAKE)
    box.until(RUNNING)
    box.until(IDLE)
    box.rest()  # until the panel is drawn with its sliders
    box.scroll()
    cells, strength = box.ask(f"answer = {CELLS}"), f"{SETTINGS}.result.groups[0].strength"
    values = "[list(x.color) for x in list(bpy.data.meshes['room'].color_attributes['Radiosity'].data)[::500]]"
    before, lit = box.ask(f"answer = {values}"), box.picture()
    box.drag(box.find_slider(), -200)
    box.until(f"{strength} == 0")
    floor = (slice(560, 620), slice(300, 400))
    box.until_seen(lambda picture: picture[floor].mean() < 0.3 * lit[floor].mean())
    assert box.ask(f"answer = {values}") != before
    box.press("ctrl+z")
    box.until(f"{strength} == 1")
    assert box.ask(f"answer = {values}") == before
    assert box.ask(f"answer = {CELLS}") == cells  # nothing was baked


def test_quitting_and_killing_blender_during_a_bake_leave_no_process(blender, folder):
    for end in ("quit", "kill"):
        window = Window(os.environ["BLENDER"], folder, blender.environment)
        try:
            window.open(folder / "hall.blend")
            window.ask(f"{SETTINGS}.preset = 'error'; {SETTINGS}.error = 0.1")
            window.ask(PRESS_BAKE)
            window.until(FIRST_LIGHT)
            cells = window.ask(f"answer = {CELLS}")
            assert len(alive(cells)) == len(cells) > 0
            if end == "quit":
                window.say("bpy.ops.wm.quit_blender()")
                assert window.process.wait(timeout=30) == 0
            else:
                window.process.kill()
                window.process.wait()
            until = time.monotonic() + 10
            while alive(cells) and time.monotonic() < until:
                time.sleep(0.1)
            assert not alive(cells)
        finally:
            window.close()


def test_the_panels_speak_german(box):
    words = (
        f"__import__('sys').modules['{EXTENSION}.addon.translations'].tr('Objects: {{}}, face corners: {{}}', 4, 30800)"
    )
    box.ask(
        "bpy.context.preferences.view.language = 'de_DE'; bpy.context.preferences.view.use_translate_interface = True"
    )
    try:
        assert box.ask(f"answer = {words}") == "Objekte: 4, Flächenecken: 30800"
        time.sleep(1.0)
        german = box.picture()
    finally:
        box.ask("bpy.context.preferences.view.language = 'en_US'")
    assert box.ask(f"answer = {words}") == "Objects: 4, face corners: 30800"
    time.sleep(1.0)
    left, top, right, bottom = box.panel
    assert np.any(german[top:bottom, left:right] != box.picture()[top:bottom, left:right])
