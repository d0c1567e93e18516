"""Blender's lamps in the core's units (conversions measured against Cycles, see the README's table)."""

from __future__ import annotations

import numpy as np

from ..core.scene import Lamp
from .materials import node_tree


def read_lamp(light, matrix, name, ignored):
    """The core's Lamp of an evaluated Blender light under a world matrix (4, 4); None if it gives no light.

    What cannot be simulated is added to `ignored` as (name, reason).
    """
    scale = np.sqrt((matrix[:3, :3] ** 2).sum(axis=0))
    axes = (matrix[:3, :3] / np.maximum(scale, 1e-30)).T
    power = np.array(light.color, float) * light.energy * _multiplier(light, name, ignored)
    if not power.any():
        return None
    common = dict(name=name, position=tuple(matrix[:3, 3]), axes=tuple(map(tuple, axes)), shadows=light.use_shadow)
    return KINDS[light.type](light, power, scale, common, ignored)


def read_visibility(object, ignored):
    """Whether a Blender object takes part in diffuse light, and whether it casts shadows; what of its ray visibility and
    light linking cannot be simulated is added to `ignored`."""
    name = object.name
    linking = getattr(object, "light_linking", None)
    if linking is not None and (linking.receiver_collection or linking.blocker_collection):
        ignored.append((name, "its light linking: all objects get its light and stand in its way"))
    if object.type == "LIGHT":
        return object.visible_diffuse, True
    hidden = [word for word in ("diffuse", "shadow") if not getattr(object, f"visible_{word}", True)]
    if hidden == ["diffuse", "shadow"]:
        ignored.append((name, "it is hidden from diffuse and shadow rays: it was left out of the bake"))
        return False, False
    if hidden == ["diffuse"]:
        ignored.append((name, "it is hidden from diffuse rays only: it is taken as fully there"))
    return True, hidden != ["shadow"]


def _point(light, power, scale, common, ignored):
    if not getattr(light, "normalize", True):
        power = power * 4 * np.pi * light.shadow_soft_size**2
    intensity = power / (4 * np.pi)
    return Lamp("point", tuple(intensity), radius=light.shadow_soft_size, soft=light.use_soft_falloff, **common)


def _spot(light, power, scale, common, ignored):
    lamp = _point(light, power, scale, common, ignored)
    return Lamp(
        "spot",
        lamp.strength,
        radius=lamp.radius,
        soft=lamp.soft,
        angle=light.spot_size,
        blend=light.spot_blend,
        **common,
    )


def _sun(light, power, scale, common, ignored):
    if not getattr(light, "normalize", True):
        power = power * np.pi * np.sin(light.angle / 2) ** 2
    return Lamp("sun", tuple(power), angle=light.angle, **common)


def _area(light, power, scale, common, ignored):
    ellipse = light.shape in {"DISK", "ELLIPSE"}
    size = np.array([light.size, light.size_y if light.shape in {"RECTANGLE", "ELLIPSE"} else light.size]) * scale[:2]
    area = size[0] * size[1] * (np.pi / 4 if ellipse else 1.0)
    if area <= 0:
        ignored.append((common["name"], "an area lamp without area gives no light"))
        return None
    radiance = power / np.pi if not getattr(light, "normalize", True) else power / (np.pi * area)
    spread = max(light.spread, np.radians(1.0))
    return Lamp("area", tuple(radiance), size=tuple(size), ellipse=ellipse, spread=spread, **common)


KINDS = {"POINT": _point, "SPOT": _spot, "SUN": _sun, "AREA": _area}


def _multiplier(light, name, ignored):
    """What node tree, exposure and temperature multiply a light's power by."""
    factor = np.ones(3)
    if hasattr(light, "exposure"):
        factor *= 2.0**light.exposure
    if getattr(light, "use_temperature", False):
        factor *= np.array(light.temperature_color, float)
    if tree := node_tree(light):
        output = tree.get_output_node("CYCLES")
        links = output.inputs["Surface"].links if output else ()
        node = links[0].from_node if links else None
        muted = node is not None and (node.mute or links[0].is_muted)
        if node is not None and node.type == "EMISSION" and not muted and not any(i.is_linked for i in node.inputs):
            factor *= np.array(node.inputs["Color"].default_value[:3]) * node.inputs["Strength"].default_value
        elif node is not None:
            ignored.append((name, "the light's nodes: only a constant Emission is simulated"))
        else:
            factor *= 0.0
    return factor
