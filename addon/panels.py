"""The panel in the 3D view's sidebar."""

import bpy

from .session import Session


class RADIOSITY_PT_main(bpy.types.Panel):
    """Accuracy, layers and the Bake button."""

    bl_label = "Radiosity"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Radiosity"

    def draw(self, context):
        settings = context.scene.radiosity
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column()
        column.enabled = Session.running is None
        column.prop(settings, "preset")
        if settings.preset == "error":
            column.prop(settings, "error")
        column.prop(settings, "layers")
        column.prop(settings, "domain")
        column.prop(settings, "selected")
        column.separator()
        if Session.running is None:
            layout.operator("radiosity.bake", text="Bake", icon="LIGHT_SUN")
        else:
            layout.progress(factor=max(settings.progress, 0.0), text=settings.status)


CLASSES = (RADIOSITY_PT_main,)
