"""Command lines by chance, each in a folder of its own: done with whole outputs, or not with one line and nothing changed."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from hypothesis import HealthCheck, Phase, given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402

from cell_radiosity.addon import command, command_bake, command_cells, command_price  # noqa: E402
from cell_radiosity.core.cells import LocalCells  # noqa: E402
from cell_radiosity.core.state import load_state  # noqa: E402

from blender_scenes import empty, lamp, plane  # noqa: E402

LIMIT = 1.0  # seconds, then the command is told to end
GOOD = {
    "error": ["20%", "100%", "5"], "time": ["0.1s", "1e-300"], "layers": ["Radiosity", "Direct,Indirect", "Occlusion,Lighting"],
    "objects": ["floor", "*", "[f]loor", "wall"], "max_patch": ["mesh", "0.1", "1e300"], "force_effects": ["all", "sky,color"],
    "memory": ["1G", "10M"], "seed": ["7", "-3"], "frame": ["1", "-5"], "scene": ["Scene"], "cells": ["1"], "exposure": ["auto", "1"],
    "channel": ["Col:A"], "occlusion_distance": ["0.5"], "max_edge": ["0.05"], "min_edge": ["0.01"], "contrast": ["0.5"],
    "vertices": ["100"], "texels_per_meter": ["40", "1e-9"], "size": ["16"], "uv": ["UVMap"], "padding": ["1"],
    "errors": ["20", "50,20"], "counts": ["1"], "schedule": ["paper", "dynamic"], "layer": ["Radiosity", "Lighting"],
    "set": ["POINT=2", "POINT=1,0.5,0"], "points": ["100"],
}  # fmt: skip
NONSENSE = [
    "", " ", "nan", "inf", "-inf", "-1", "0", "-0.0", "1e400", "1e-400", "9" * 40, "-" + "9" * 40, "2%%", "%", ",", ",,1", "=", ":",
    "a=b=c", "-", "--", "²", "٣", "1_0", "0x10", "1,2,3", "*", "[", "[!a", "é\u202e\U0001f4a1", "\udcff", "two\nlines", "None", "\t2",
]  # fmt: skip
FILES = {
    "output": "lit.blend", "report": "r.json", "picture": "p.png", "export": "x.usda", "state": "new.npz", "plot": "p.png",
    "reference": "reference.npz",
}  # fmt: skip
PLACES = [  # of files, where there is one or not, that can be written or not
    "room.blend", "cut.blend", "nothing.blend", "noise.blend", "none.blend", "link.blend", "folder", "folder/new/f", "room.blend/f", "state",
    "cut", "old.json", "to nowhere", "two\nlines.json", "ü \udcff", "n" * 300, "/proc/f", "/dev/full", "./../f/./old.json", "", ".", "-",
]  # fmt: skip
COMMANDS = ["bake"] * 8 + ["price", "effects", "relight", "relight", "export", "export", "cells"]
EXCLUDED = ("help", "cluster", "allow_mixed")  # machines, which are not there


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    """A folder with a scene, baked and with a state, and files that are none."""
    folder = tmp_path_factory.mktemp("fuzz") / "prepared"
    folder.mkdir()
    empty()
    floor = plane("floor", size=0.2, n=2)
    floor.data.color_attributes.new("Col", "FLOAT_COLOR", "CORNER")
    floor.data.uv_layers.new(name="UVMap")
    lamp("POINT", 1.0, location=(0, 0, 0.2))
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "room.blend"))
    argv = [
        "bake",
        folder / "room.blend",
        "--error",
        "20%",
        "--state",
        folder / "state",
        "--groups",
        "lamp",
        "--quiet",
        "--cells",
        "1",
    ]
    assert command.main([*map(str, argv), "-o", str(folder / "baked.blend")]) == 0
    for name in ("room.blend", "state"):
        data = (folder / name).read_bytes()
        (folder / f"cut{Path(name).suffix}").write_bytes(data[: len(data) // 2])
    (folder / "nothing.blend").write_bytes(b"")
    (folder / "noise.blend").write_bytes(b"BLENDER" + np.random.default_rng(1).bytes(1000))
    np.savez(folder / "reference.npz", floor=np.ones(9))
    (folder / "old.json").write_text("before")
    (folder / "folder").mkdir()
    (folder / "link.blend").symlink_to("room.blend")
    (folder / "to nowhere").symlink_to("there is none")
    return folder


def parsers():
    """{name of a command: its parser}."""
    (found,) = (a for a in command._parser()._actions if isinstance(a, argparse._SubParsersAction))
    return found.choices


@st.composite
def command_lines(draw):
    """A command line with options of one command, most of them right."""
    name = draw(st.sampled_from(COMMANDS))
    actions = [a for a in parsers()[name]._actions if a.dest not in EXCLUDED]
    options, argv, first = [a for a in actions if a.option_strings], [], []
    some = draw(st.lists(st.sampled_from(options), max_size=5, unique_by=lambda a: a.dest))
    for action in [a for a in options if a.required and a not in some] + some:
        option = draw(st.sampled_from(action.option_strings))
        if action.nargs == 0:
            argv.append(option)
            continue
        if action.dest in FILES:
            right, wrong = ["x.usda" if name == "export" else FILES[action.dest]], PLACES
        else:
            right, wrong = list(action.choices or GOOD[action.dest]), NONSENSE
        value = draw(st.sampled_from(right if draw(st.integers(0, 7)) else wrong))
        argv += [f"{option}={value}"] if option.startswith("--") and draw(st.booleans()) else [option, value]
    for action in [a for a in actions if not a.option_strings]:
        right = {"state": "state", "scene_file": "baked.blend" if name == "export" else "room.blend"}.get(
            action.dest, "room.blend"
        )
        least = 0 if action.dest == "moved" else draw(st.sampled_from([0] + [1] * 9))
        # Not two with --export: that would be glTF, whose exporter leaves a thread behind.
        most = 2 if action.nargs == "*" and not any("--export" in a for a in argv) else 1
        first += draw(st.lists(st.sampled_from([right] * 60 + PLACES), min_size=least, max_size=most, unique=True))
    return [name, *first, *argv, "--quiet"] if draw(st.booleans()) else [name, *argv, *first, "--quiet"]


@contextlib.contextmanager
def limited():
    """For a while, after which the program is told to end, as Ctrl-C does."""

    def end(*_):
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, LIMIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)


def contents(folder):
    """{path in a folder: bytes of a file, where a link leads, or None of a folder}."""
    return {
        str(p.relative_to(folder)): os.readlink(p) if p.is_symlink() else p.read_bytes() if p.is_file() else None
        for p in folder.rglob("*")
    }


def check_whole(path):
    """That a file has its end."""
    data = path.read_bytes()
    if data.startswith(b"BLENDER"):
        assert b"ENDB" in data[-100:]
    elif data.startswith(b"\x89PNG"):
        assert data[-8:-4] == b"IEND"
    elif data.startswith(b"PK"):
        load_state(path)
    elif data.startswith(b"#usda"):
        assert data.rstrip().endswith(b"}")
    elif data.startswith((b"\x76\x2f\x31\x01", b"%PDF", b"<?xml")):
        pass
    else:
        json.loads(data)


@pytest.mark.heavy
@pytest.mark.skipif(os.name != "posix", reason="names of files, alarms and devices of Unix")
def test_command_lines_by_chance(prepared, tmp_path, monkeypatch):
    for module in (command_bake, command_price, command_cells):
        monkeypatch.setattr(module, "cells_for", lambda *_: LocalCells())
    ends = dict.fromkeys((0, 1, 2, 130), 0)

    @settings(
        max_examples=400, deadline=None, database=None, derandomize=True, phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(argv=command_lines())
    def one(argv):
        folder = tmp_path / "f"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(prepared, folder, symlinks=True)
        bpy.ops.wm.read_factory_settings(use_empty=True)
        before, err = contents(folder), io.StringIO()
        with (
            contextlib.chdir(folder),
            contextlib.redirect_stderr(err),
            contextlib.redirect_stdout(io.StringIO()),
            limited(),
        ):
            code = command.main(argv)
        check(argv, code, err.getvalue().splitlines(), folder, before)
        ends[code] += 1

    one()
    print(ends)
    assert ends[0] > 50
    assert ends[1] > 50


def check(argv, code, lines, folder, before):
    """The property that must hold of a command line that has been run in a folder."""
    after = contents(folder)
    new = [p for p in after if after[p] is not None and after[p] != before.get(p)]
    assert not [p for p in after if ".tmp" in p]
    assert not before.keys() - after.keys()
    told = "\n".join(lines)
    assert "Traceback" not in told
    assert "mistake of Cell Radiosity" not in told
    for path in new:
        if not (folder / path).is_symlink():
            check_whole(folder / path)
    scenes = sum(a in PLACES for a in argv[1:])
    if code == 0:
        assert not lines
    elif code == 130:
        assert lines[-1] == "radiosity: cancelled"
    elif code == 2:
        assert not new
        assert lines[-1].startswith("radiosity")
        assert "error: " in lines[-1] or len(lines) == 1
    else:
        assert code == 1
        assert 1 <= len(lines) <= max(scenes, 1)
        assert all(line.startswith("radiosity: ") for line in lines)
        if argv[0] != "bake" or scenes < 2:
            assert not new
