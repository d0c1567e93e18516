"""Lightmaps as Blender images and files.

`Image.save` of a float image writes values encoded for the screen; `save_render` in a scene of its own writes what is
there: linear 32-bit floats in OpenEXR, or 16-bit numbers times a scale in PNG.
"""

from __future__ import annotations

import os

import bpy
import numpy as np

from .files import writing
from .marks import KEY, is_made, mark

SUFFIX = {"exr": ".exr", "png": ".png", "byte": ".png"}
DEEPEST = 65535  # of a 16-bit number
BRIGHTEST = float(np.finfo(np.float32).max)  # that Blender's numbers hold


def make_image(name, pixels, path=None, kind="exr"):
    """A marked Blender image of pixels (height, width, 3), line 0 at the bottom, saved at `path`, or packed without one.

    Any older image of that name that a bake made is replaced. kind: "exr"; "png", which holds the light divided by
    image["scale"]; or "byte", 8 bits of what the screen shows, sRGB.
    """
    old = bpy.data.images.get(name)
    if old is not None and is_made(old):
        bpy.data.images.remove(old)
    scale = 1.0
    if kind == "png":
        scale = float(max(pixels.max(initial=0.0), 1e-30))
        pixels = np.rint(pixels * (DEEPEST / scale)) / DEEPEST
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=False, float_buffer=kind != "byte")
    # Light is taken as it is, whatever the working space.
    image.colorspace_settings.name = "sRGB" if kind == "byte" else "Non-Color"
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = np.minimum(pixels, BRIGHTEST)
    image.pixels.foreach_set(rgba.reshape(-1))
    if path is None:
        image.pack()
    else:
        _save(image, path, kind)
        image.source = "FILE"
        image.filepath = bpy.path.relpath(path) if bpy.data.filepath else path
        image.reload()
    mark(image)
    image.use_fake_user = True  # saved with the file, whether a material shows it or not
    image["scale"] = scale
    return image


def scale_of(image):
    """What the values of an image must be multiplied by to be light."""
    return float(image.get("scale", 1.0))


def file_names(names):
    """What stands for each of some names in the names of files: no two alike, whatever their case."""
    found = {}
    for name in names:
        stem = clean = bpy.path.clean_name(name)
        number = 1
        while clean.casefold() in found:
            number += 1
            clean = f"{stem}_{number}"
        found[clean.casefold()] = clean
    return list(found.values())


def image_path(output, of, layer, kind="exr"):
    """The file of a layer's lightmap beside OUT.blend: OUT_OBJECT_LAYER.exr. of: as `file_names` has it."""
    return f"{os.path.splitext(output)[0]}_{of}_{layer}{SUFFIX[kind]}"


def _save(image, path, kind):
    """Write an image's values to a file as they are, whole or not at all."""
    scene = bpy.data.scenes.new(f"{KEY} image")
    try:
        settings = scene.render.image_settings
        if hasattr(settings, "media_type"):
            settings.media_type = "IMAGE"
        if kind == "exr":
            settings.file_format, settings.color_mode = "OPEN_EXR", "RGB"
            settings.color_depth, settings.exr_codec = "32", "ZIP"
        elif kind == "png":
            settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGB", "16"
            scene.display_settings.display_device, scene.view_settings.view_transform = "sRGB", "Raw"
        with writing(path, SUFFIX[kind]) as temporary:
            if kind == "byte":
                image.filepath_raw, image.file_format = temporary, "PNG"
                image.save()
            else:
                image.save_render(temporary, scene=scene)
    finally:
        bpy.data.scenes.remove(scene)
