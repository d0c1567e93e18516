"""Files of the command line: opened with a clear message, written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from pathlib import Path

import bpy

from .errors import Refused


def place_for(given, source, suffix, several):
    """Where an output of `source` goes: a file, or with several scenes a file in the folder that was given."""
    if given is None:
        return None
    return os.path.join(os.path.abspath(given), Path(source).stem + suffix) if several else os.path.abspath(given)


def check_outputs(outputs, inputs=()):
    """Make the folders of outputs (paths or None). Raises Refused if one cannot be written, is also another one, or would
    overwrite one of the inputs."""
    outputs = [path for path in outputs if path]
    for number, path in enumerate(outputs):
        if any(same_file(path, other) for other in outputs[:number]):
            raise Refused(f"cannot write {path}: it is asked for as two things at once; name two files")
        if any(same_file(path, other) for other in inputs):
            raise Refused(f"cannot write {path}: it is read too, and would be lost; name another file")
        check_writable(path)


def same_file(path, other):
    """Whether two paths lead to one file."""
    return os.path.normcase(os.path.realpath(path)) == os.path.normcase(os.path.realpath(other))


def check_writable(path):
    """Make the folder of an output, and raise Refused if nothing can be written there."""
    folder = os.path.dirname(path)
    try:
        os.makedirs(folder, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise Refused(f"cannot write {path}: {error.strerror or error}") from None
    if os.path.isdir(path):
        raise Refused(f"cannot write {path}: it is a folder")


def open_file(path):
    """Open a .blend file. Raises Refused if it cannot be read."""
    if not os.path.isfile(path):
        raise Refused("no such file")
    with open(path, "rb") as file:
        head = file.read(7)
    if (
        head[:7] != b"BLENDER"
        and head[:4] not in (b"\x28\xb5\x2f\xfd", b"\x1f\x8b\x08\x00")
        and head[:2] != b"\x1f\x8b"
    ):
        raise Refused("it is not a .blend file")
    try:
        with silent():
            bpy.ops.wm.open_mainfile(filepath=path)
    except RuntimeError as error:
        raise Refused(" ".join(str(error).replace("Error:", "").split())) from None


def context_of(arguments):
    """The context to bake in, at the scene and frame that were asked for."""
    context = bpy.context
    if arguments.scene:
        if arguments.scene not in bpy.data.scenes:
            names = ", ".join(s.name for s in bpy.data.scenes)
            raise Refused(f"there is no scene {arguments.scene!r}; there are {names}")
        context.window.scene = bpy.data.scenes[arguments.scene]
    if arguments.frame is not None:
        context.scene.frame_set(arguments.frame)
    return context


def save_file(output, source):
    """Save the open file as `output`, whole or not at all."""
    temporary = f"{output[: -len('.blend')] if output.endswith('.blend') else output}.tmp{os.getpid()}.blend"
    try:
        with silent():
            bpy.ops.wm.save_as_mainfile(filepath=temporary, copy=True, check_existing=False)
        os.replace(temporary, output)
    except RuntimeError as error:
        raise Refused(f"cannot write {output}: {' '.join(str(error).split())}") from None
    finally:
        with contextlib.suppress(OSError):
            os.remove(temporary)


@contextlib.contextmanager
def silent():
    """Keep Blender's own lines on the standard output out of ours."""
    sys.stdout.flush()
    kept = os.dup(1)
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
