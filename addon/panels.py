"""The panels in the 3D view's sidebar and in the scene's properties: what will be baked, the bake, and what came of it."""

from __future__ import annotations

import textwrap

import bpy

from .job import default_cells
from .material_setup import any_set_up
from .preferences import preference
from .preflight import preflight
from .running import percent, phase_text
from .session import Session
from .translations import CONTEXT, tr, tr_message
from .viewport import has_result, layer_names

LETTER = 6.2  # pixels of a letter at a resolution scale of 1, about
WORTH_SAYING = 0.05  # seconds of work: less would be told as none
SHOWN = 12  # findings that a list shows; of the rest only the number is told


class _Panel:
    """Where a panel stands: the sidebar of a 3D view or, in a twin, the scene's properties."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Radiosity"
    bl_translation_context = CONTEXT


class RADIOSITY_PT_main(_Panel, bpy.types.Panel):
    """What will be baked, accuracy, layers, the Bake button, and the result."""

    bl_label = "Radiosity"
    bl_idname = "RADIOSITY_PT_main"

    def draw(self, context):
        settings, layout = context.scene.radiosity, self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        if Session.running is not None:
            _draw_running(layout, Session.running)
            return
        ready = _draw_preflight(layout, context, settings)
        holds = settings.prices_hold(context)
        _draw_accuracy(layout, settings, holds, ready)
        column = layout.column()
        column.prop(settings, "layers")
        column.prop(settings, "target")
        if settings.target == "vertex":
            column.prop(settings, "domain")
            column.prop(settings, "mesh")
        else:
            column.prop(settings, "sizing")
            column.prop(settings, "texels_per_meter" if settings.sizing == "density" else "size")
            column.prop(settings, "atlas")
        column.prop(settings, "selected")
        row = layout.row()
        row.scale_y = 1.6
        row.enabled = ready
        row.operator("radiosity.bake", text=tr("Bake"), icon="LIGHT_SUN")
        _draw_result(layout, settings, holds)


def _draw_running(layout, running):
    """The bar and Cancel, which keep their places, and how far the light is."""
    progress = running.progress
    column = layout.column()
    column.progress(factor=min(max(progress.done, 0.0), 1.0) if progress else 0.0, text=phase_text(running))
    row = column.row()
    row.scale_y = 1.4
    row.enabled = not running.cancelled
    row.operator("radiosity.cancel", text=tr("Cancel"), icon="CANCEL")
    if running.waiting:
        _paragraph(layout, tr(running.waiting), "INFO")
    if progress is None:
        return
    figures = column.column(align=True)
    figures.label(text=tr("{} s so far, {} million rays", f"{progress.seconds:.1f}", f"{progress.rays / 1e6:.1f}"))
    if running.light_error is not None:
        figures.label(text=tr("Error so far: {} %", percent(running.light_error)))
    if running.bound is not None:
        figures.label(text=tr("Light still missing: at most {} %", percent(running.bound)))
    if running.left is not None and not running.waiting:
        figures.label(text=tr("About {} s left", f"{running.left:.0f}"))


def _draw_preflight(layout, context, settings):
    """What will be baked, and what needs a word first; returns whether a bake can start."""
    look = preflight(context, settings.options(context))
    row = layout.row()
    row.label(text=tr("Objects: {}, face corners: {}", look.objects, look.corners), icon="MESH_DATA")
    if look.problem:
        _paragraph(layout, tr_message(look.problem), "ERROR")
    elif context.mode != "OBJECT":
        _paragraph(layout, tr("Go to Object Mode first: colors are written there"), "INFO")
    elif look.copies.count:
        megabytes = max(look.copies.bytes / 1e6, 0.1)
        text = tr("Copies of shared meshes: {}, {} MB", look.copies.count, f"{megabytes:.1f}")
        layout.label(text=text, icon="DUPLICATE")
    if look.findings:
        header, body = layout.panel("radiosity_preflight", default_closed=True)
        header.label(text=tr("Notes before the bake: {}", len(look.findings)), icon="INFO")
        if body:
            _list(body, [(f.object, f.finding, f.action) for f in look.findings])
    return not look.problem


def _draw_accuracy(layout, settings, holds, ready):
    """The accuracy and, below it, what each costs. holds: the price list does so still; ready: a bake can start."""
    row = layout.row()
    row.use_property_split = False
    row.prop(settings, "preset", expand=True)
    if settings.preset in ("error", "time"):
        layout.prop(settings, settings.preset)
    costs = layout.column(align=True)
    if settings.prices:
        prices = costs.column(align=True)
        prices.active = holds
        for price in settings.prices:
            text = tr(
                "{} % error: {} s, {} MB", f"{100 * price.error:.2g}", _seconds(price.seconds), f"{price.memory:.0f}"
            )
            prices.operator("radiosity.choose", text=text, depress=settings.buys(price)).error = price.error
        if not holds:
            _paragraph(costs, tr("The scene or the settings have changed since"), "ERROR")
    if not (settings.prices and holds):
        row = costs.row()
        row.enabled = ready
        row.operator("radiosity.price", icon="PREVIEW_RANGE")


def _draw_result(layout, settings, holds):
    """What the last bake has reached, and the way on. holds: the price list does so still."""
    result = settings.result
    if result.points < 0:
        return
    box = layout.box().column()
    if result.error >= 0:
        text = tr("Error {} %, in {} s", percent(result.error), _seconds(result.seconds))
    else:
        text = tr("Baked in {} s", _seconds(result.seconds))
    box.label(text=text, icon="ERROR" if result.partial else "CHECKMARK")
    if result.partial:
        box.label(text=tr("Cancelled: this is the light so far"))
    elif result.error >= 0 and not result.converged:
        _paragraph(box, tr("{} % was asked for and could not be reached", f"{100 * result.asked:.2g}"), "INFO")
    if result.relit:
        box.label(text=tr("Lights have been changed since"))
    if result.worst:
        box.label(text=tr("Least exact: {}, {} %", result.worst, percent(result.worst_error)))
    goal = result.goal()
    if goal is not None:
        seconds = settings.price_of(goal) if holds else None
        text = tr("To reach {} %", f"{100 * goal:g}")
        if seconds is not None:
            text = tr("To reach {} %: about {} s more", f"{100 * goal:g}", _seconds(seconds))
        box.operator("radiosity.bake", text=text).error = 100 * goal


class RADIOSITY_PT_view(_Panel, bpy.types.Panel):
    """Which layer is shown, how bright, and in materials."""

    bl_label = "Result"
    bl_idname = "RADIOSITY_PT_view"
    bl_parent_id = "RADIOSITY_PT_main"

    @classmethod
    def poll(cls, context):
        return Session.running is None and has_result(context.scene)

    def draw(self, context):
        settings, layout = context.scene.radiosity, self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        names = settings.result.layers.split(",") if settings.result.layers else layer_names(context.scene)
        if names:
            flow = layout.grid_flow(columns=2, align=True)
            for name in names:
                flow.operator("radiosity.show_layer", text=name, depress=name == settings.shown).layer = name
            row = layout.row(align=True)
            row.prop(settings, "exposure")
            row.operator("radiosity.expose", text="", icon="LIGHT_DATA")
            column = layout.column(align=True)
            kinds = ("EMISSION", "Show as Emission", "MATERIAL"), ("BASE_COLOR", "Use as Base Color", "SHADING_TEXTURE")
            for kind, text, icon in kinds:
                column.operator("radiosity.set_up_materials", text=tr(text), icon=icon).kind = kind
            if any_set_up():
                column.operator("radiosity.take_out_of_materials", icon="LOOP_BACK")
        row = layout.row(align=True)
        if names:
            row.operator("radiosity.export", icon="EXPORT")
        row.operator("radiosity.clear", icon="TRASH")


class RADIOSITY_PT_lights(_Panel, bpy.types.Panel):
    """The light groups of the result, to be made stronger, weaker or of another color without a bake."""

    bl_label = "Lights"
    bl_idname = "RADIOSITY_PT_lights"
    bl_parent_id = "RADIOSITY_PT_main"

    @classmethod
    def poll(cls, context):
        return Session.running is None and len(context.scene.radiosity.result.groups) > 0

    def draw(self, context):
        result, layout = context.scene.radiosity.result, self.layout
        column = layout.column(align=True)
        column.enabled = context.mode == "OBJECT"
        for group in result.groups:
            row = column.row(align=True).split(factor=0.8, align=True)
            row.prop(group, "strength", text=group.name, translate=False, slider=True)
            row.prop(group, "color", text="")
        if result.relit:
            layout.operator("radiosity.reset_lights", icon="LOOP_BACK")


class RADIOSITY_PT_effects(_Panel, bpy.types.Panel):
    """The effects of light that the scene calls for, with reasons."""

    bl_label = "Effects"
    bl_idname = "RADIOSITY_PT_effects"
    bl_parent_id = "RADIOSITY_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return Session.running is None

    def draw(self, context):
        result, layout = context.scene.radiosity.result, self.layout
        layout.operator("radiosity.find_effects", icon="VIEWZOOM")
        for effect in result.effects:
            icon = "CHECKBOX_HLT" if effect.needed else "CHECKBOX_DEHLT"
            text = f"{tr(effect.name.capitalize())}: {tr_message(effect.reason)}"
            known = effect.seconds >= WORTH_SAYING
            told = "{} s of work" if effect.needed else "about {} s of work spared"
            cost = f" ({tr(told, _seconds(effect.seconds))})" if known else ""
            _paragraph(layout, text + cost, icon)
        if result.ignored:
            layout.label(text=tr("Not simulated:"))
            _list(layout, [(row.name, row.finding, "") for row in result.ignored])


class RADIOSITY_PT_health(_Panel, bpy.types.Panel):
    """What was found wrong with the scene's data, and what was done about it."""

    bl_label = "Health"
    bl_idname = "RADIOSITY_PT_health"
    bl_parent_id = "RADIOSITY_PT_main"

    @classmethod
    def poll(cls, context):
        return Session.running is None and len(context.scene.radiosity.result.health) > 0

    def draw(self, context):
        _list(self.layout, [(r.name, r.finding, r.action) for r in context.scene.radiosity.result.health])


class RADIOSITY_PT_advanced(_Panel, bpy.types.Panel):
    """Settings that few need."""

    bl_label = "Advanced"
    bl_idname = "RADIOSITY_PT_advanced"
    bl_parent_id = "RADIOSITY_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return Session.running is None

    def draw(self, context):
        settings, layout = context.scene.radiosity, self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        for name in _of_target(settings):
            layout.prop(settings, name)
        for name in ("per_object", "side", "shared", "whole", "patch", "schedule", "rows", "force", "seed"):
            row = layout.row()
            row.enabled = name != "patch" or not settings.whole
            row.prop(settings, name)
        layout.label(text=tr("Cells: {}, see the extension's preferences", preference("cells") or default_cells()))


def _of_target(settings):
    """Names of the settings that few need of what the light is written to."""
    common = ["groups", *(["occlusion_distance"] if "Occlusion" in settings.layers else [])]
    if settings.target == "lightmap":
        return [*common, "uv", "padding", "image"]
    names = ["max_edge", "min_edge", "contrast", "vertices", "in_place"] if settings.mesh == "subdivide" else []
    names += common
    names += ["bytes", *(["byte_automatic"] if settings.bytes else [])]
    names += ["channel_of", *(["channel"] if settings.channel_of else [])]
    fixed = (settings.bytes and not settings.byte_automatic) or (settings.channel_of and not settings.bytes)
    return [*names, "byte_exposure"] if fixed else names


def _list(layout, rows):
    """Rows of (object, finding, action)."""
    column = layout.column(align=True)
    for object, finding, action in rows[:SHOWN]:
        text = f"{object}: {tr_message(finding)}"
        _paragraph(column, f"{text}; {tr_message(action)}" if action else text, "DOT")
    if len(rows) > SHOWN:
        column.label(text=tr("and {} more", len(rows) - SHOWN))


def _paragraph(layout, text, icon):
    """A text on as many lines as it needs."""
    region, scale = bpy.context.region, bpy.context.preferences.system.ui_scale or 1.0  # 0: no window
    letters = max(int((region.width if region else 300) / (LETTER * scale)) - 12, 16)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for k, line in enumerate(textwrap.wrap(text, letters)):
        column.label(text=line, icon="BLANK1" if k else icon, translate=False)


def _seconds(seconds):
    """Seconds as people say them."""
    return f"{seconds:.0f}" if seconds >= 10 else f"{seconds:.1f}"


def _twin(panel):
    """The same panel in the scene's properties."""
    names = dict(
        __doc__=panel.__doc__,
        bl_idname=panel.bl_idname.replace("_PT_", "_PT_scene_"),
        bl_space_type="PROPERTIES",
        bl_region_type="WINDOW",
        bl_context="scene",
        bl_translation_context=CONTEXT,
    )
    if hasattr(panel, "bl_parent_id"):
        names["bl_parent_id"] = panel.bl_parent_id.replace("_PT_", "_PT_scene_")
    else:
        names["bl_options"] = {"DEFAULT_CLOSED"}
    own = {k: v for k, v in vars(panel).items() if k in ("draw", "poll", "bl_label", "bl_options")}
    return type(names["bl_idname"], (bpy.types.Panel,), {**own, **names})


SIDEBAR = (
    RADIOSITY_PT_main,
    RADIOSITY_PT_view,
    RADIOSITY_PT_lights,
    RADIOSITY_PT_effects,
    RADIOSITY_PT_health,
    RADIOSITY_PT_advanced,
)
CLASSES = (*SIDEBAR, *(_twin(panel) for panel in SIDEBAR))
