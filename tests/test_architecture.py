"""The rules that keep the core what it is: no Blender, imports one way, the same bits everywhere."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
CORE = sorted((ROOT / "core").glob("*.py"))

# Later modules may import earlier ones, never the other way round.
CHAIN = [
    "vectors", "graphs", "sampling", "polygons", "records", "saving", "settings", "scene", "sky", "alpha", "raycast", "patches", "cuts", "surfaces", "health", "remesh", "touching", "points", "flats", "pieces", "lights", "members", "crowd", "steep", "groups",
    "guide", "kernel", "rows", "contacts", "placing", "anew", "filter", "replicates", "direct", "gather", "control", "occlusion", "subdivide", "atlas", "lightmap", "tasks", "cells", "budget", "clock", "cell", "replay", "share", "pictures", "convexity", "evidence", "effects", "costs", "accuracy", "kept", "transport", "host", "paper", "averages", "choices", "prices", "state", "layers", "compare", "knobs", "baked", "course", "bake", "experiment", "report", "picture",
]  # fmt: skip

# Functions whose last bit depends on the build of numpy (BLAS, SIMD), with what to use instead.
BANNED = {
    "dot", "matmul", "vdot", "inner", "tensordot", "linalg", "exp", "expm1", "log", "log1p", "log2", "log10", "tan",
    "arctan", "arctan2", "arccos", "arcsin", "tanh", "sinh", "cosh", "cbrt", "power", "float_power", "argpartition",
}  # fmt: skip


def test_core_runs_without_blender():
    """Every core module imports in a process where bpy cannot be imported."""
    code = "import sys; sys.modules['bpy'] = None; import importlib\n" + "\n".join(
        f"importlib.import_module('cell_radiosity.core.{path.stem}')"
        for path in CORE
        if path.stem not in ("__init__", "cell_boot")
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_core_names_no_blender():
    for path in CORE:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(name.split(".")[0] in ("bpy", "mathutils", "bmesh", "gpu") for name in names), path


def test_imports_go_one_way():
    assert sorted(CHAIN) == sorted(p.stem for p in CORE if p.stem not in ("__init__", "cell_boot"))
    for path in CORE:
        if path.stem not in CHAIN:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level == 1:
                assert CHAIN.index(node.module) < CHAIN.index(path.stem), f"{path.stem} imports {node.module}"


def test_the_readme_tells_where_to_look_by_modules_that_there_are():
    how = re.search(r"^## How it works\n.*?(?=^## )", (ROOT / "README.md").read_text(), re.MULTILINE | re.DOTALL)[0]
    named = [name for row in re.findall(r"^\|.*\|(.*)\|$", how, re.MULTILINE) for name in re.findall("`(.*?)`", row)]
    assert len(named) > 40
    assert len(set(named)) == len(named)
    assert set(named) <= set(CHAIN)


@pytest.mark.parametrize("path", CORE, ids=lambda p: p.stem)
def test_core_keeps_to_functions_with_the_same_bits_everywhere(path):
    """No BLAS, no SIMD transcendentals in the core; a picture is not light and may use what it likes."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "np":
            assert node.attr not in BANNED, f"{path.name}:{node.lineno}: np.{node.attr}"
        if isinstance(node, ast.BinOp):
            assert not isinstance(node.op, ast.MatMult), f"{path.name}:{node.lineno}: @"
            if isinstance(node.op, ast.Pow):
                squares = isinstance(node.right, ast.Constant) and node.right.value in (2, -53)
                assert squares or isinstance(node.left, ast.Constant), f"{path.name}:{node.lineno}: ** is a power"


def test_only_one_module_touches_embree():
    users = {p.stem for p in CORE if "embreex" in p.read_text()}
    assert users == {"raycast"}


def test_manifest_lists_the_pinned_wheels():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text())
    pins = dict(re.findall(r"^([\w-]+)==(\S+)", (ROOT / "wheels.txt").read_text(), re.MULTILINE))
    listed = {Path(w).name.split("-")[0]: Path(w).name.split("-")[1] for w in manifest["wheels"]}
    assert listed == pins
    assert "numpy" not in listed
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert f"embreex=={pins['embreex']}" in project["dependencies"]


def test_objects_are_not_searched_by_name():
    """Blender goes through all of them, one by one; `lookup.Lookup` does so once for all names."""
    for path in (ROOT / "addon").glob("*.py"):
        assert not re.search(r"data\.(objects|meshes)\[|\.(objects|meshes)\.get\(", path.read_text()), path


@pytest.mark.parametrize("name", ["cornell_box", "sunlit_room", "hall"])
def test_sample_scenes_open_in_the_oldest_blender(name):
    """A file of Blender 4.2 begins like this; one saved by 5.x could not be opened before 4.5."""
    with open(ROOT / "sample_scenes" / f"{name}.blend", "rb") as file:
        assert re.match(rb"BLENDER-v4\d\d", file.read(12))
