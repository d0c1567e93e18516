"""Baked layers in the 3D views: which one is shown, how bright, and how the views are drawn.

Solid shading knows no exposure: a layer that is to look brighter or darker is shown through an attribute of its own,
`Radiosity View`, that is removed again at exposure 0. The layers themselves stay what they are.
"""

from __future__ import annotations

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..core.layers import LAYERS
from .marks import made_layers, mark_layers, stand_ins
from .session import Session

VIEW = "Radiosity View"


def baked_meshes(scene):
    """The meshes of a scene that hold layers of a bake."""
    meshes = {o.data for o in scene.objects if o.type == "MESH" and o.data is not None}
    return sorted((m for m in meshes if layers_of(m)), key=lambda m: m.name_full)


def layers_of(mesh):
    """Names of the layers that bakes have written to a mesh, in their usual order."""
    made = made_layers(mesh) & {a.name for a in mesh.color_attributes}
    return [name for name in LAYERS if name in made] + sorted(made - set(LAYERS) - {VIEW})


def layer_names(scene):
    """Names of the layers that a scene's meshes hold."""
    return list(dict.fromkeys(name for mesh in baked_meshes(scene) for name in layers_of(mesh)))


def has_result(scene):
    """Whether a bake has left anything in a scene."""
    return any(o.type == "MESH" and layers_of(o.data) for o in scene.objects) or bool(stand_ins(scene))


def show(scene, layer, exposure=0.0):
    """Make a layer what Solid shading shows on all baked meshes, 2^exposure times as bright."""
    for mesh in baked_meshes(scene):
        if mesh.library is None and layer in mesh.color_attributes:
            show_on(mesh, layer, exposure)


def show_on(mesh, layer, exposure):
    """Make a layer what Solid shading shows on one mesh, 2^exposure times as bright."""
    attributes = mesh.color_attributes
    source, view = attributes[layer], attributes.get(VIEW)
    if view is not None and (exposure == 0 or (view.domain, view.data_type) != (source.domain, "FLOAT_COLOR")):
        attributes.remove(view)
        view, source = None, attributes[layer]
    if exposure != 0:
        domain = source.domain
        view = view or attributes.new(VIEW, "FLOAT_COLOR", domain)
        mark_layers(mesh, [VIEW])
        values = np.empty(4 * len(view.data), np.float32)
        attributes[layer].data.foreach_get("color", values)
        rgba = values.reshape(-1, 4)
        rgba[:, :3] *= 2.0**exposure
        attributes[VIEW].data.foreach_set("color", values)
    attributes.active_color = attributes[VIEW if exposure != 0 else layer]
    mesh.update()


def middle_exposure(scene, layer):
    """The exposure at which the light of a layer is as bright as a well-lit photograph, to a tenth of a stop: 0.18 in
    the logarithmic mean of all that is lit; 0 if nothing is."""
    logarithms, count = 0.0, 0
    for mesh in baked_meshes(scene):
        attribute = mesh.color_attributes.get(layer)
        if attribute is None:
            continue
        values = np.empty(4 * len(attribute.data), np.float32)
        attribute.data.foreach_get("color", values)
        brightness = values.reshape(-1, 4)[:, :3].mean(axis=1)
        lit = brightness[brightness > 0]
        logarithms, count = logarithms + np.log2(lit.astype(float)).sum(), count + len(lit)
    return round(float(np.log2(0.18) - logarithms / count), 1) if count else 0.0


def show_in_views(context, force=False, images=False):
    """Let the Solid 3D views show color attributes (or images) as they are; force: turn the largest view to Solid if
    none is."""
    Session.unshown = False
    views = [
        area for window in context.window_manager.windows for area in window.screen.areas if area.type == "VIEW_3D"
    ]
    solid = [area for area in views if area.spaces.active.shading.type == "SOLID"]
    if force and views and not solid:
        solid = [max(views, key=lambda area: area.width * area.height)]
        solid[0].spaces.active.shading.type = "SOLID"
    wanted = "FLAT", "TEXTURE" if images else "VERTEX"
    for area in solid:
        space = area.spaces.active
        shading = space.shading
        if (shading.light, shading.color_type) != wanted:
            Session.shading.setdefault(space.as_pointer(), (shading.light, shading.color_type))
            shading.light, shading.color_type = wanted


def restore_views(context):
    """Draw the 3D views as they were drawn before layers were shown."""
    Session.unshown = bool(Session.shading)
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                former = Session.shading.pop(area.spaces.active.as_pointer(), None)
                if former is not None:
                    area.spaces.active.shading.light, area.spaces.active.shading.color_type = former


def redraw(context):
    """Redraw the panels beside the 3D views and in the scene's properties, but not the views themselves."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions:
                if (area.type, region.type) in {("VIEW_3D", "UI"), ("PROPERTIES", "WINDOW")}:
                    region.tag_redraw()


@persistent
def _after_undo(*_):
    """Draw the 3D views, which Blender does not undo, as it goes with what was undone or done again."""
    context = bpy.context
    if Session.shading and not has_result(context.scene):
        restore_views(context)
    elif Session.unshown and has_result(context.scene):
        show_in_views(context, images=not context.scene.radiosity.shown)


@persistent
def _after_load(*_):
    """Views that stay when another file is opened are drawn as they were before the light of the last one."""
    if not has_result(bpy.context.scene):
        restore_views(bpy.context)
    Session.unshown = False


def register():
    """Let the views follow what is undone, done again, and opened."""
    for handlers, handler in _handlers():
        handlers.append(handler)


def unregister():
    """Leave the views as they are."""
    for handlers, handler in _handlers():
        handlers.remove(handler)


def _handlers():
    """(list of Blender's, our handler in it)."""
    told = bpy.app.handlers
    return (told.undo_post, _after_undo), (told.redo_post, _after_undo), (told.load_post, _after_load)
