"""Blender's world as what the core knows: one color, or a map of all directions, and suns.

A world that varies is read by Cycles itself: an ENVIRONMENT bake of a mesh of single points gives what the background is
in the direction of each, for any nodes, without a render that would replace the user's. A sun's disc is taken out of the
map and becomes a lamp: sharp shadows need its exact place and power.
"""

from __future__ import annotations

import contextlib

import bpy
import numpy as np

from ..core.scene import Lamp, World
from ..core.sky import cell_directions, solid_angles
from .cycles_read import CannotRead, one_sample_scene
from .materials import NotConstant, check_plain, node_color, node_tree, node_value

SIZE = 256  # cells of a side of the map
PER_CELL = 2  # samples of a cell along each of its sides
SUN = 0.05  # half extent within which what is bright is a sun [rad]
SUN_ABOVE = 300.0  # radiance of a sun, as a multiple of the mean of the map
ZOOM = 128  # samples of a side of the square about a sun
NO_RAY = {"Is Diffuse Ray": 1.0, "Is Reflection Ray": 1.0, "Ray Depth": 1.0, "Diffuse Depth": 1.0}


def read_world(context, world, ignored):
    """The core's World of a Blender world (or None), and its suns as Lamps; what is left out goes to `ignored`."""
    tree = node_tree(world) if world else None
    output = tree.get_output_node("CYCLES") if tree else None
    if world is None or (tree and output is None) or not _lights(world):
        return World(), ()
    if tree is None:
        return World(tuple(world.color)), ()
    if output.inputs["Volume"].is_linked:
        ignored.append((world.name, "the world's volume is left out"))
    links = output.inputs["Surface"].links
    if not links:
        return World(), ()
    try:
        check_plain(tree)
        return World(tuple(_background(links[0].from_node))), ()
    except NotConstant:
        pass
    try:
        return _read_map(context, world)
    except CannotRead as problem:
        ignored.append((world.name, f"the world varies and could not be read ({problem}): its viewport color lights the scene evenly"))  # fmt: skip
        return World(tuple(world.color)), ()


def _lights(world):
    """Whether a world shines on surfaces: its ray visibility may say that it does not."""
    visibility = getattr(world, "cycles_visibility", None)
    return visibility is None or visibility.diffuse


def _background(node):
    """Radiance (3,) of a Background of one color."""
    if node.type == "BACKGROUND":
        return np.maximum(node_color(node.inputs["Color"]) * node_value(node.inputs["Strength"]), 0.0)
    raise NotConstant(node.bl_label)


def _read_map(context, world):
    """The World and suns of a world that varies."""
    with _copy(world) as plain:
        skies = [n for n in plain.node_tree.nodes if n.type == "TEX_SKY" and getattr(n, "sun_disc", False)]
        discs = [n for n in skies if n.sky_type not in {"PREETHAM", "HOSEK_WILKIE"}]
        for node in discs:
            node.sun_disc = False
        fine = SIZE * PER_CELL
        radiance = _radiance(context, plain, cell_directions(fine))
        suns = []
        for node in discs:
            node.sun_disc = True
            suns.append(_sun_of_sky(context, plain, node))
            node.sun_disc = False
        suns.append(_sun_of_map(context, plain, radiance))
    cell = radiance.reshape(SIZE, PER_CELL, SIZE, PER_CELL, 3).mean(axis=(1, 3))
    return World(map=cell.astype(np.float32)), tuple(sun for sun in suns if sun)


@contextlib.contextmanager
def _copy(world):
    """A copy of a world for as long as it is read, as rays that leave surfaces see it."""
    copy = world.copy()
    try:
        for node in copy.node_tree.nodes:
            if node.type == "LIGHT_PATH":
                for socket in node.outputs:
                    for target in [link.to_socket for link in socket.links]:
                        _set(copy.node_tree, target, NO_RAY.get(socket.name, 0.0))
        yield copy
    finally:
        bpy.data.worlds.remove(copy)


def _set(tree, socket, value):
    """Unlink a socket and give it a value."""
    for link in list(socket.links):
        tree.links.remove(link)
    socket.default_value = (
        value if not hasattr(socket.default_value, "__len__") else (value,) * len(socket.default_value)
    )


def _radiance(context, world, directions):
    """(K, 3) radiance of a world in directions (K, 3)."""
    places = np.concatenate([directions, directions[: -len(directions) % 3]])
    mesh = bpy.data.meshes.new("radiosity world")
    mesh.from_pydata(places, [], np.arange(len(places)).reshape(-1, 3).tolist())
    layer = mesh.color_attributes.active_color = mesh.color_attributes.new("radiosity read", "FLOAT_COLOR", "CORNER")
    object = bpy.data.objects.new(world.name, mesh)
    try:
        with one_sample_scene(context, [object]) as scene:
            scene.world = world
            bpy.ops.object.bake(type="ENVIRONMENT", target="VERTEX_COLORS")
        values = np.empty(4 * len(places), np.float32)
        mesh.color_attributes[layer.name].data.foreach_get("color", values)
        return np.nan_to_num(values.reshape(-1, 4)[: len(directions), :3].astype(float))
    finally:
        bpy.data.meshes.remove(mesh)


def _sun_of_sky(context, world, node):
    """The Lamp of a sky texture's sun disc, which is on; None if it is not seen. (While it is on, the texture has no
    vector input: nothing turns it.)"""
    elevation, turn = node.sun_elevation, node.sun_rotation
    toward = np.array([np.sin(turn) * np.cos(elevation), np.cos(turn) * np.cos(elevation), np.sin(elevation)])
    return _zoom(context, world, toward, 0.75 * node.sun_size, node.sun_size, "sun of the world")


def _sun_of_map(context, world, radiance):
    """The Lamp of a sun that is part of an image, which is taken out of the map's radiance (K, 3); None if there is
    none."""
    size = SIZE * PER_CELL
    level, directions, angle = radiance.mean(axis=1), cell_directions(size), solid_angles(size)
    mean = float((level * angle).sum() / angle.sum())
    bright = np.flatnonzero(level > SUN_ABOVE * mean) if mean > 0 else np.zeros(0, int)
    if not len(bright):
        return None
    toward = np.einsum("k,kd->d", level[bright], directions[bright])
    toward /= np.linalg.norm(toward)
    distance = np.linalg.norm(directions - toward, axis=1)
    reach = float(distance[bright].max()) + 3.0 / size
    if reach > SUN:
        return None  # several, or something wide: they stay in the map
    around = (distance > reach) & (distance < reach + 6.0 / size)
    sun = _zoom(context, world, toward, reach, None, "sun of the world", radiance[around].mean(axis=0))
    radiance[distance <= reach] = radiance[around].mean(axis=0)
    return sun


def _zoom(context, world, toward, reach, angle, name, behind=None):
    """The Lamp of what is in the directions within `reach` [rad] about `toward` (3,), over what lies `behind` (3,) it
    (None: what is there at its rim). angle: full angle of its disk, None to take it from its area."""
    toward = toward / np.linalg.norm(toward)
    x = np.cross(toward, (0.0, 0.0, 1.0) if abs(toward[2]) < 0.9 else (1.0, 0.0, 0.0))
    x /= np.linalg.norm(x)
    y = np.cross(toward, x)
    u, v = (k.reshape(-1, 1) for k in (np.indices((ZOOM, ZOOM)) + 0.5) * (2 * reach / ZOOM) - reach)
    places = toward + u * x + v * y
    square = (places * places).sum(axis=1)
    solid = (2 * reach / ZOOM) ** 2 / (square * np.sqrt(square))
    radiance = _radiance(context, world, places / np.sqrt(square)[:, None])
    ring = np.sqrt(u * u + v * v)[:, 0]
    if behind is None:
        behind = np.median(radiance[ring > 0.95 * reach], axis=0)
    light = np.maximum(radiance - behind, 0.0) * (ring <= reach)[:, None]
    irradiance = np.einsum("kc,k->c", light, solid)
    if not irradiance.max() > 0:
        return None
    level = light.mean(axis=1)
    middle = np.einsum("k,kd->d", level * solid, places)
    middle /= np.linalg.norm(middle)
    if angle is None:
        angle = 2 * np.sqrt(solid[level > 0.5 * level.max()].sum() / np.pi)
    return Lamp("sun", tuple(irradiance), axes=(tuple(x), tuple(np.cross(middle, x)), tuple(middle)), name=name, angle=float(angle))  # fmt: skip
