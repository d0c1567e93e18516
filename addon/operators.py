"""The buttons: a bake that runs beside Blender's window, and the same bake to its end for scripts; and what is done with
its result."""

from __future__ import annotations

import os
from dataclasses import replace
from time import perf_counter

import bpy
from bpy.props import EnumProperty, FloatProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from . import material_setup
from .errors import Refused
from .export import KINDS, export_scene
from .lookup import Lookup
from .marks import made_layers, stand_ins, unmark_layers
from .running import percent
from .session import Session, writing
from .shown import forget_others
from .steps import in_steps
from .translations import tr, tr_message
from .viewport import (
    baked_meshes,
    has_result,
    layers_of,
    middle_exposure,
    restore_views,
    show,
    show_in_views,
)  # fmt: skip
from .work import STEP, Idle, Work
from .write_result import remove_copies

REFRESH = 0.5  # seconds between two updates of the light in the viewport ...
SHARE = 10  # ... and at least so many times as long as one takes


class RADIOSITY_OT_bake(Work, bpy.types.Operator):
    """Bake the light of the scene; Esc ends it early and keeps the light that is there"""

    bl_idname = "radiosity.bake"
    bl_label = "Bake Radiosity"
    bl_options = {"UNDO"}

    error: FloatProperty(
        name="Error",
        description="Relative error to reach, in percent; 0 takes the accuracy chosen in the panel",
        default=0.0, min=0.0, max=100.0, options={"SKIP_SAVE"},
    )  # fmt: skip
    keeps = "ends it and keeps the light"

    def _options(self, context):
        options = super()._options(context)
        return replace(options, error=self.error / 100, time=None) if self.error else options

    def _expected(self, context, options):
        settings = context.scene.radiosity
        if options.time is not None:
            return options.time
        return settings.price_of(options.error) if settings.prices_hold(context) else None

    def _work(self, job):
        return job.bake()

    def _watch(self, context):
        """Show the light while it comes."""
        running = self._running
        next_light = 0.0
        while not running.done:
            yield
            if perf_counter() < next_light or running.cancelled:
                continue
            running.want_light()
            preview = running.take_light()
            if preview is None or self._hindrance(context) or self._gone():
                continue
            spent = 0.0
            painting = in_steps(self._paint(context, preview), STEP)
            while True:
                begun = perf_counter()
                done = next(painting, self) is self
                spent += perf_counter() - begun
                if done or self._hindrance(context):
                    break
                yield
            show_in_views(context, force=next_light == 0)
            next_light = perf_counter() + max(REFRESH, SHARE * max(spent, running.cost))

    def _paint(self, context, preview):
        """Show the light so far, object by object."""
        job = self._running.job
        yield from job.output.painting(context, job.targets, preview, STEP)
        exposure = context.scene.radiosity.exposure
        if exposure:
            show(context.scene, job.options.layers[0], exposure)

    def _finish(self, context, job, partial=False):
        """Write the light, show it, keep what was found and reached, and say so; returns the operator's result."""
        yield from job.writing(context, STEP)
        settings, lightmaps = context.scene.radiosity, job.options.target == "lightmap"
        settings.shown = "" if lightmaps else job.options.layers[0]
        if settings.shown and settings.exposure:
            show(context.scene, settings.shown, settings.exposure)
        show_in_views(context, force=True, images=lightmaps)
        result = settings.result
        result.clear()
        result.note_survey(job.result.survey, job.changed)
        result.points, result.seconds, result.partial = len(job.result.points), job.seconds(), partial
        result.note_estimate(job.result)
        if job.result.price:
            settings.note_prices(job.result.price, self._key, Session.changes != self._changes)
        result.layers = "" if lightmaps else ",".join(job.options.layers)
        result.note_groups(None if lightmaps else job.result.groups)
        if partial:
            text = tr("Bake ended early: the light so far was kept")
        else:
            text = tr("Baked {} points in {} s", result.points, f"{result.seconds:.1f}")
        if result.error >= 0:
            text += ", " + tr("error {} %", percent(result.error))
        count = len(result.health)
        if count:
            self.report({"WARNING"}, text + ". " + tr("Findings: {}, see Health in the panel", count))
        else:
            self.report({"INFO"}, text)
        return "FINISHED"


class RADIOSITY_OT_find_effects(Work, bpy.types.Operator):
    """Find out which effects of light the scene calls for, and what is wrong with its data, without baking"""

    bl_idname = "radiosity.find_effects"
    bl_label = "Find Effects"
    bl_options = {"UNDO"}

    keeps = "ends it"

    def _work(self, job):
        return job.find_effects()

    def _finish(self, context, job, partial=False):
        context.scene.radiosity.result.note_survey(job.survey)
        yield
        return "FINISHED"


class RADIOSITY_OT_price(Work, bpy.types.Operator):
    """Find out how long bakes to several errors would take in this scene, from the first rays of one"""

    bl_idname = "radiosity.price"
    bl_label = "Find Prices"
    bl_options = {"UNDO"}

    keeps = "ends it"

    def _work(self, job):
        return job.find_prices()

    def _finish(self, context, job, partial=False):
        context.scene.radiosity.note_prices(job.prices, self._key, Session.changes != self._changes)
        yield
        return "FINISHED"


class RADIOSITY_OT_cancel(bpy.types.Operator):
    """End the running bake now, and keep the light that is there"""

    bl_idname = "radiosity.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context):
        return Session.running is not None

    def execute(self, context):
        Session.running.cancel()
        return {"FINISHED"}


class RADIOSITY_OT_choose(Idle, bpy.types.Operator):
    """Choose this accuracy for the next bake"""

    bl_idname = "radiosity.choose"
    bl_label = "Choose Accuracy"
    bl_options = {"UNDO", "INTERNAL"}

    error: FloatProperty(name="Error", description="Relative error, as a fraction", min=0.0, max=1.0)

    def execute(self, context):
        context.scene.radiosity.preset = "error"
        context.scene.radiosity.error = 100 * self.error
        return {"FINISHED"}


class _OfResult(Idle):
    """Operators on a result."""

    @classmethod
    def poll(cls, context):
        if context.mode != "OBJECT":
            cls.poll_message_set(tr("Go to Object Mode first"))
            return False
        if not has_result(context.scene):
            cls.poll_message_set(tr("Nothing is baked yet"))
            return False
        return super().poll(context)


class RADIOSITY_OT_show_layer(_OfResult, bpy.types.Operator):
    """Show this layer in the Solid 3D views"""

    bl_idname = "radiosity.show_layer"
    bl_label = "Show Layer"
    bl_options = {"UNDO"}

    layer: StringProperty(name="Layer", description="Name of the layer", default="Radiosity")

    @writing
    def execute(self, context):
        settings = context.scene.radiosity
        if not any(self.layer in layers_of(mesh) for mesh in baked_meshes(context.scene)):
            self.report({"ERROR"}, tr("No object has a layer {}", self.layer))
            return {"CANCELLED"}
        settings.shown = self.layer
        show(context.scene, self.layer, settings.exposure)
        show_in_views(context, force=True)
        return {"FINISHED"}


class RADIOSITY_OT_expose(_OfResult, bpy.types.Operator):
    """Set the exposure so that the result is neither dark nor burnt out"""

    bl_idname = "radiosity.expose"
    bl_label = "Automatic Exposure"
    bl_options = {"UNDO"}

    @writing
    def execute(self, context):
        settings = context.scene.radiosity
        settings.exposure = middle_exposure(context.scene, settings.shown or "Radiosity")
        show_in_views(context, force=True)
        return {"FINISHED"}


class RADIOSITY_OT_reset_lights(_OfResult, bpy.types.Operator):
    """Set the lights of all groups back to what they were baked with"""

    bl_idname = "radiosity.reset_lights"
    bl_label = "As Baked"
    bl_options = {"UNDO"}

    @writing
    def execute(self, context):
        settings = context.scene.radiosity
        for group in settings.result.groups:
            group.property_unset("strength")
            group.property_unset("color")
        settings.relight()
        return {"FINISHED"}


class RADIOSITY_OT_set_up_materials(_OfResult, bpy.types.Operator):
    """Put the layer that is shown into the materials of the baked objects, with a node that can be taken out again"""

    bl_idname = "radiosity.set_up_materials"
    bl_label = "Use in Materials"
    bl_options = {"UNDO"}

    kind: EnumProperty(
        name="Into",
        description="Where the layer goes",
        items=[
            ("EMISSION", "Emission", "The material shows the baked light as it is, in place of its shader"),
            ("BASE_COLOR", "Base Color", "The baked light becomes the base color, as exporters for games expect it"),
        ],
    )

    @writing
    def execute(self, context):
        layer = context.scene.radiosity.shown or "Radiosity"
        objects = [o for o in context.scene.objects if o.type == "MESH" and layer in layers_of(o.data)]
        count = material_setup.set_up(objects, layer, self.kind)
        self.report({"INFO"}, tr("Materials that show {}: {}; Take Out of Materials undoes it", layer, count))
        return {"FINISHED"}


class RADIOSITY_OT_take_out_of_materials(Idle, bpy.types.Operator):
    """Take the baked light out of all materials again: they are as they were"""

    bl_idname = "radiosity.take_out_of_materials"
    bl_label = "Take Out of Materials"
    bl_options = {"UNDO"}

    @writing
    def execute(self, context):
        material_setup.take_out(material_setup.with_set_up())
        return {"FINISHED"}


class RADIOSITY_OT_clear(_OfResult, bpy.types.Operator):
    """Remove all that bakes have made in this scene: layers, copies, and nodes in materials"""

    bl_idname = "radiosity.clear"
    bl_label = "Clear Result"
    bl_options = {"UNDO"}

    @writing
    def execute(self, context):
        material_setup.take_out(material_setup.with_set_up())
        remove_copies(Lookup(context.scene), stand_ins(context.scene))
        for mesh in baked_meshes(context.scene):
            for name in made_layers(mesh):
                attribute = mesh.color_attributes.get(name)
                if attribute is not None:
                    mesh.color_attributes.remove(attribute)
            unmark_layers(mesh)
            mesh.update()
        forget_others(())
        settings = context.scene.radiosity
        settings.result.clear()
        settings.shown = ""
        restore_views(context)
        return {"FINISHED"}


class RADIOSITY_OT_export(_OfResult, ExportHelper, bpy.types.Operator):
    """Write the meshes as glTF or USD, with the layer that is shown as vertex colors in 0..1; times the extra radiosity_scale they are the light"""

    bl_idname = "radiosity.export"
    bl_label = "Export"

    filename_ext, check_extension = ".glb", None  # others are as good
    filter_glob: StringProperty(default=";".join(f"*{kind}" for kind in KINDS), options={"HIDDEN"})

    @writing
    def execute(self, context):
        path = bpy.path.abspath(self.filepath)
        path = path if os.path.splitext(path)[1] else path + self.filename_ext
        layer = context.scene.radiosity.shown or "Radiosity"
        try:
            scale = export_scene(context, path, layer)
        except Refused as problem:
            self.report({"ERROR"}, tr_message(str(problem)))
            return {"CANCELLED"}
        self.report({"INFO"}, tr("{}: {} divided by {}", os.path.basename(path), layer, f"{scale:.6g}"))
        return {"FINISHED"}


CLASSES = (
    RADIOSITY_OT_bake,
    RADIOSITY_OT_find_effects,
    RADIOSITY_OT_price,
    RADIOSITY_OT_cancel,
    RADIOSITY_OT_choose,
    RADIOSITY_OT_show_layer,
    RADIOSITY_OT_expose,
    RADIOSITY_OT_reset_lights,
    RADIOSITY_OT_set_up_materials,
    RADIOSITY_OT_take_out_of_materials,
    RADIOSITY_OT_clear,
    RADIOSITY_OT_export,
)
