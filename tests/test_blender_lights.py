"""Lamps, emitting faces and the world, as Blender has them: exact conversions, and the same as Cycles."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
from cell_radiosity.addon.read_scene import read_scene  # noqa: E402

from blender_scenes import bake_cycles, bake_ours, colors, diffuse, empty, glowing, lamp, plane  # noqa: E402

HEIGHT = 2.0


def at_origin(values):
    """Mean of the corners at the plane's middle vertex."""
    mesh = bpy.data.objects["plane"].data
    corner = [k for k, loop in enumerate(mesh.loops) if mesh.vertices[loop.vertex_index].co.length < 1e-6]
    return values[corner].mean(axis=0)


KINDS = {
    "point": (dict(kind="POINT", shadow_soft_size=0.0), lambda p: p / (4 * np.pi) / HEIGHT**2),
    "soft point": (dict(kind="POINT", shadow_soft_size=0.3), lambda p: p / (4 * np.pi) / (HEIGHT**2 + 0.09)),
    "ball": (dict(kind="POINT", shadow_soft_size=0.3, use_soft_falloff=False), lambda p: p / (4 * np.pi) / HEIGHT**2),
    "spot": (dict(kind="SPOT", shadow_soft_size=0.0, spot_size=1.0), lambda p: p / (4 * np.pi) / HEIGHT**2),
    "sun": (dict(kind="SUN", angle=0.02), lambda p: p),
    "square": (dict(kind="AREA", shape="SQUARE", size=0.1), lambda p: p / (np.pi * HEIGHT**2)),
    "rectangle": (dict(kind="AREA", shape="RECTANGLE", size=0.1, size_y=0.05), lambda p: p / (np.pi * HEIGHT**2)),
    "disk": (dict(kind="AREA", shape="DISK", size=0.1), lambda p: p / (np.pi * HEIGHT**2)),
    "ellipse": (dict(kind="AREA", shape="ELLIPSE", size=0.1, size_y=0.2), lambda p: p / (np.pi * HEIGHT**2)),
}  # fmt: skip


@pytest.mark.parametrize("name", KINDS)
def test_lamp_overhead(cells, name):
    """Irradiance right below a lamp of 50 W, colored: the exact conversion, which agrees with Cycles to 1e-4."""
    settings, exact = KINDS[name]
    empty()
    plane(size=1.0, n=2, material=diffuse("white", (0.8, 0.8, 0.8)))
    lamp(energy=50.0, color=(1.0, 0.5, 0.25), location=(0, 0, HEIGHT), **settings)
    bake_ours(cells, layers=("Direct", "Lighting"))
    expected = exact(50.0) * np.array((1.0, 0.5, 0.25)) / np.pi
    found = at_origin(colors(bpy.data.objects["plane"].data, "Direct"))
    np.testing.assert_allclose(found, expected, rtol=2e-3 if settings["kind"] == "AREA" else 1e-4)


@pytest.mark.parametrize(
    "name",
    [
        *KINDS,
        "scaled area",
        "tilted sun",
        "wide sun",
        "spot rim",
        "exposure",
        "spread",
        "narrow disk",
        "hard spot",
        "big spot",
        "temperature",
        "own units",
    ],
)
def test_lamp_like_cycles(cells, name):
    """A plane under a lamp off its axis, half in the shadow of a smaller plane."""
    tilt = (0.5, 0.3, 0.2)
    extra = {
        "scaled area": dict(kind="AREA", shape="RECTANGLE", size=0.5, size_y=1.0, scale=(2.0, 0.5, 1.0)),
        "tilted sun": dict(kind="SUN", angle=0.0, rotation_euler=(0.9, 0.2, 0.4)),
        "wide sun": dict(kind="SUN", angle=0.5, rotation_euler=(0.6, 0.2, 0.4)),
        "spot rim": dict(kind="SPOT", spot_size=0.9, spot_blend=0.8, shadow_soft_size=0.1),
        "exposure": dict(kind="POINT", exposure=1.5, shadow_soft_size=0.1),
        "spread": dict(kind="AREA", shape="RECTANGLE", size=0.6, size_y=0.3, spread=1.6),
        "narrow disk": dict(kind="AREA", shape="DISK", size=0.8, spread=0.9),
        "hard spot": dict(kind="SPOT", spot_size=1.0, spot_blend=0.0, shadow_soft_size=0.0, use_soft_falloff=False),
        "big spot": dict(
            kind="SPOT", spot_size=1.3, spot_blend=0.3, shadow_soft_size=0.4, rotation_euler=(0.3, 0.2, 0.0)
        ),
        "temperature": dict(kind="POINT", use_temperature=True, temperature=3000.0, shadow_soft_size=0.1),
        "own units": dict(kind="AREA", shape="SQUARE", size=0.4, normalize=False, energy=20.0),
    }
    settings = {
        "rotation_euler": tilt,
        "location": (0.6, -0.9, 1.8),
        **(extra[name] if name in extra else KINDS[name][0]),
    }
    for field in {"exposure", "use_temperature", "normalize"} & settings.keys():
        if field not in bpy.types.Light.bl_rna.properties:
            pytest.skip(f"this Blender's lights have no {field}")
    empty()
    ground = plane(size=3.0, n=6, material=diffuse("white", (0.8, 0.8, 0.8)))
    plane("screen", size=0.7, n=1, location=(0.4, 0.5, 0.6))
    lamp(**{"energy": 60.0 if settings["kind"] != "SUN" else 3.0, **settings})
    bake_ours(cells, layers=("Direct",), error=0.005)
    expected = bake_cycles(["plane"], 512, ["DIRECT"])["plane"]
    found = colors(ground.data, "Direct")
    # Cycles' noise in half shadow; elsewhere the two agree much better.
    assert np.sqrt(((found - expected) ** 2).mean()) < 0.02 * np.sqrt((expected**2).mean())
    assert abs(found.mean() / expected.mean() - 1) < 0.01


@pytest.mark.parametrize("name", ["soft point", "spot", "wide sun", "square"])
def test_lamp_without_shadows_like_cycles(cells, name):
    """Beside a lamp that has them, in a scene where what is lit through a screen and a lid lights the rest."""
    kind = {"wide sun": dict(kind="SUN", angle=0.5), **{k: v for k, (v, _) in KINDS.items()}}[name]
    empty()
    paint = diffuse("white", (0.8, 0.8, 0.8))
    ground = plane(size=3.0, n=6, material=paint)
    wall = plane("wall", size=3.0, n=6, material=paint, location=(0, 1.7, 1.7), rotation_euler=(np.pi / 2, 0, 0))
    plane("screen", size=0.9, n=1, location=(0.4, 0.5, 0.6), material=paint)
    plane("lid", size=3.0, n=1, location=(0.0, 0.0, 1.6), material=paint)
    power = 60.0 if kind["kind"] != "SUN" else 3.0
    shadowless = lamp(energy=power, location=(0.6, -0.9, 1.8), rotation_euler=(0.5, 0.3, 0.2), **kind)
    shadowless.data.use_shadow = False
    lamp("POINT", 20.0, location=(-0.5, -0.5, 1.2), shadow_soft_size=0.1)
    job = bake_ours(cells, layers=("Direct", "Indirect"), error=0.005)
    assert not job.result.scene.ignored
    # What Cycles reflects has 3 % of noise in single corners.
    for layer, part, off in (("Direct", "DIRECT", 0.01), ("Indirect", "INDIRECT", 0.06)):
        expected = bake_cycles(["plane", "wall"], 4096, [part])
        for one in (ground, wall):
            found = colors(one.data, layer)
            gap = np.sqrt(((found - expected[one.name]) ** 2).mean())
            assert gap < off * np.sqrt((expected[one.name] ** 2).mean()), layer
            assert abs(found.mean() / expected[one.name].mean() - 1) < 0.015, layer


@pytest.mark.parametrize("name", ["soft point", "wide sun", "square"])
def test_object_without_shadow_like_cycles(cells, name):
    """Light straight from a lamp goes through it, and what is reflected meets it."""
    kind = {"wide sun": dict(kind="SUN", angle=0.5), **{k: v for k, (v, _) in KINDS.items()}}[name]
    empty()
    paint = diffuse("white", (0.8, 0.8, 0.8))
    ground = plane(size=3.0, n=6, material=paint)
    plane("screen", size=1.2, n=1, location=(0.2, 0.3, 0.6), material=paint).visible_shadow = False
    plane("other", size=0.5, n=1, location=(-0.8, -0.5, 0.5), material=paint)
    lamp(
        energy=60.0 if kind["kind"] != "SUN" else 3.0, location=(0.6, -0.9, 1.8), rotation_euler=(0.5, 0.3, 0.2), **kind
    )
    job = bake_ours(cells, layers=("Direct", "Indirect"), error=0.005)
    assert not job.result.scene.ignored
    for layer, part, off in (("Direct", "DIRECT", 0.02), ("Indirect", "INDIRECT", 0.06)):
        expected, found = bake_cycles(["plane"], 4096, [part])["plane"], colors(ground.data, layer)
        assert np.sqrt(((found - expected) ** 2).mean()) < off * np.sqrt((expected**2).mean()), layer
        assert abs(found.mean() / expected.mean() - 1) < 0.015, layer


def test_lamps_and_meshes_are_placed_in_double_precision():
    """Whatever a Blender's matrices are made of: the axes of a turned lamp are unit vectors, at right angles, to 1e-15."""
    empty()
    sun = lamp("SUN", rotation_euler=(0.3, 0.5, 0.7), scale=(0.7, 0.7, 0.7))
    plane(size=1.0, location=(0.1, 0.2, 0.3), rotation_euler=(0.3, 0.5, 0.7))
    bpy.context.view_layer.update()
    scene, _ = read_scene(bpy.context)
    axes = np.array(scene.lamps[0].axes)
    assert np.abs((axes * axes).sum(axis=1) - 1).max() < 1e-15
    matrix = np.array([list(row) for row in bpy.data.objects["plane"].matrix_world])
    local = np.array([list(v.co) for v in bpy.data.meshes["plane"].vertices])
    exact = np.einsum("ij,kj->ki", matrix[:3, :3], local) + matrix[:3, 3]
    assert np.abs(scene.vertices - exact).max() < 1e-15
    assert sun.name in [each.name for each in scene.lamps]


def test_light_nodes_multiply(cells):
    empty()
    plane(size=1.0, n=2)
    data = lamp("POINT", 50.0, location=(0, 0, HEIGHT), shadow_soft_size=0.0).data
    data.use_nodes = True
    data.node_tree.nodes["Emission"].inputs["Strength"].default_value = 3.0
    bake_ours(cells, layers=("Direct",))
    found = at_origin(colors(bpy.data.objects["plane"].data, "Direct"))
    np.testing.assert_allclose(found, 3 * 50 / (4 * np.pi) / HEIGHT**2 / np.pi, rtol=1e-4)


def test_light_nodes_that_are_muted_are_named():
    empty()
    plane(size=1.0, n=2)
    data = lamp("POINT", 50.0, location=(0, 0, HEIGHT)).data
    data.use_nodes = True
    data.node_tree.nodes["Emission"].inputs["Strength"].default_value = 3.0
    data.node_tree.nodes["Emission"].mute = True
    bpy.context.view_layer.update()
    ((name, reason),) = read_scene(bpy.context)[0].ignored
    assert name == "POINT"
    assert "the light's nodes" in reason


def test_emitting_face_shines_from_both_sides(cells):
    """Exitance is pi times color times strength, on either side."""
    empty()
    plane("glow", size=0.1, n=1, material=glowing("glow", (1.0, 0.5, 0.2), 7.0), location=(0, 0, HEIGHT))
    plane(size=1.0, n=2)
    plane("above", size=1.0, n=2, location=(0, 0, 2 * HEIGHT), rotation_euler=(np.pi, 0, 0))
    bake_ours(cells, layers=("Direct",))
    expected = 7.0 * np.array((1.0, 0.5, 0.2)) * 0.01 / HEIGHT**2 / np.pi
    np.testing.assert_allclose(at_origin(colors(bpy.data.objects["plane"].data, "Direct")), expected, rtol=3e-3)
    above = colors(bpy.data.objects["above"].data, "Direct")
    np.testing.assert_allclose(above.max(axis=0), expected, rtol=3e-3)


def test_world_of_one_color(cells):
    """An unobstructed plane gets pi times the world's color; one below a black square, what the square leaves open."""
    empty(world=(0.2, 0.4, 0.8))
    black = diffuse("black", (0, 0, 0))
    plane("square", size=1.0, n=2, material=black, location=(0, 0, 1.0))
    plane(size=0.5, n=2, material=black)
    bake_ours(cells, layers=("Lighting",), objects=("square",))
    top = colors(bpy.data.objects["square"].data, "Lighting")
    np.testing.assert_allclose(top, np.tile((0.2, 0.4, 0.8), (16, 1)), rtol=1e-6)
    bake_ours(cells, layers=("Direct",), error=0.002, objects=("plane",))
    below = at_origin(colors(bpy.data.objects["plane"].data, "Direct"))
    np.testing.assert_allclose(below, (1 - 0.23945647046077) * np.array((0.2, 0.4, 0.8)), rtol=0.01)


def test_box_without_a_bottom_is_black_inside(cells):
    """A lit floor under an upturned box: no light leaks in, and the box's back sides do not read as its front."""
    empty(world=(0.5, 0.5, 0.5))
    floor = plane("floor", size=4.0, n=16)
    sides = [((-1, -1), (1, -1)), ((1, -1), (1, 1)), ((1, 1), (-1, 1)), ((-1, 1), (-1, -1))]
    vertices = [v for (a, b), (c, d) in sides for v in ((a, b, 0), (c, d, 0), (c, d, 1), (a, b, 1))]
    faces = [[4 * k + i for i in range(4)] for k in range(4)] + [[2, 6, 10, 14]]
    from blender_scenes import mesh_object

    mesh_object("box", vertices, faces, location=(0.1, 0.1, 0))
    lamp("SUN", 5.0, rotation_euler=(0.3, 0.4, 0))
    bake_ours(cells, layers=("Lighting",))
    values = colors(floor.data, "Lighting")
    place = np.array([floor.data.vertices[loop.vertex_index].co[:] for loop in floor.data.loops])
    inside = (np.abs(place[:, :2] - 0.1) < 0.95).all(axis=1)
    assert inside.sum() > 50
    assert values[inside].max() == 0.0
    assert values[(np.abs(place[:, :2] - 0.1) > 1.2).any(axis=1)].min() > 0.1


def test_ray_visibility_and_linking():
    """What gives no light to diffuse surfaces gives none; what cannot be honored is named."""
    empty()
    plane(size=1.0, n=2)
    gone = plane("gone", size=1.0, n=1, location=(0, 0, 1))
    gone.visible_diffuse = gone.visible_shadow = False
    half = plane("half", size=1.0, n=1, location=(0, 0, 3))
    half.visible_diffuse = False
    clear = plane("clear", size=1.0, n=1, location=(0, 0, 4))
    clear.visible_shadow = False
    lamp("POINT", location=(0, 0, 2)).visible_diffuse = False
    linked = lamp("SPOT", location=(0, 0, 2))
    linked.light_linking.receiver_collection = bpy.data.collections.new("some")
    bpy.context.view_layer.update()
    scene, _ = read_scene(bpy.context)
    assert dict(zip(scene.objects, scene.shading)) == {"plane": True, "half": True, "clear": False}
    assert [x.kind for x in scene.lamps] == ["spot"]
    said = dict(scene.ignored)
    assert "diffuse" in said["half"]
    assert "clear" not in said
    assert [r.split(":")[0] for o, r in scene.ignored if o == "SPOT"] == ["its light linking"]
