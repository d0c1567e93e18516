"""The picture of a bake as a PNG file: seen from the scene's camera, tone-mapped."""

from __future__ import annotations

import bpy
import numpy as np

from ..core.layers import layer_colors
from ..core.picture import View, draw, outside_view
from .files import writing

WIDEST = 960  # pixels
BRIGHT = 0.8  # share of the picture that stays below MIDDLE after exposure
MIDDLE = 0.4


def save_picture(context, bake, path, colors=None):
    """Write a PNG of a Bake's `Radiosity`, from the scene's camera or, without one, from outside. colors: as for `draw`;
    None takes those of the corners."""
    scene = context.scene
    view = _camera_view(scene) if scene.camera else outside_view(bake.scene)
    background = np.maximum(bake.scene.world.radiance, 1e-4)
    colors = layer_colors(bake, "Radiosity") if colors is None else colors
    pixels = tone_map(draw(bake.scene, colors, view, background=background))
    image = bpy.data.images.new("radiosity picture", view.width, view.height, alpha=False)
    try:
        rgba = np.ones((view.height, view.width, 4), np.float32)
        rgba[..., :3] = pixels[::-1]
        image.pixels.foreach_set(rgba.reshape(-1))
        with writing(path, ".png") as temporary:
            image.filepath_raw, image.file_format = temporary, "PNG"
            image.save()
    finally:
        bpy.data.images.remove(image)


def tone_map(radiance):
    """sRGB values 0..1 of linear radiance (..., 3): exposed for its bright parts, highlights rolled off.

    The curve is Narkowicz's fit of the ACES film curve (2015).
    """
    bright = np.quantile(radiance.mean(axis=-1), BRIGHT)
    x = np.maximum(radiance, 0.0) * (MIDDLE / max(bright, 1e-9))
    x = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def _camera_view(scene):
    """The View of a scene's camera, at its render resolution or smaller."""
    camera = scene.camera
    width = scene.render.resolution_x * scene.render.resolution_percentage / 100
    height = scene.render.resolution_y * scene.render.resolution_percentage / 100
    shrink = min(1.0, WIDEST / max(width, height, 1))
    corners = np.array(camera.data.view_frame(scene=scene), float)  # in camera space: right top first, then clockwise
    matrix = np.array(camera.matrix_world.normalized(), float)
    middle = corners.mean(axis=0)
    right, up = (corners[0] + corners[1]) / 2 - middle, (corners[0] + corners[3]) / 2 - middle
    frame = np.stack([matrix[:3, :3] @ axis for axis in (middle, right, up)])
    size = dict(width=max(round(width * shrink), 1), height=max(round(height * shrink), 1))
    return View(matrix[:3, 3], frame, parallel=camera.data.type == "ORTHO", **size)
