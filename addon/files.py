"""Files of the command line: opened with a clear message, written whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
import sys
import tempfile
from pathlib import Path

import bpy

from ..core.saving import written_whole
from .errors import Refused

PARTS_END = b"\xb1\xea\x92\x8f"  # of the list of a compressed file's parts
PARTLY = "only a part of it could be written; is the disk full?"
FULL = 1 << 16  # bytes that are free on a disk that is full


def place_for(given, source, suffix, several):
    """Where an output of `source` goes: a file, or with several scenes a file in the folder that was given."""
    if given is None:
        return None
    return os.path.join(os.path.abspath(given), Path(source).stem + suffix) if several else os.path.abspath(given)


def check_outputs(outputs, inputs=(), devices=()):
    """Make the folders of outputs (paths or None). Raises Refused if one cannot be written, is also another one, would
    overwrite one of the inputs, or is no ordinary file but a device or pipe and not one of `devices`, which may be."""
    outputs = [path for path in outputs if path]
    for number, path in enumerate(outputs):
        if any(same_file(path, other) for other in outputs[:number]):
            raise Refused(f"cannot write {path}: it is asked for as two things at once; name two files")
        if any(same_file(path, other) for other in inputs):
            raise Refused(f"cannot write {path}: it is read too, and would be lost; name another file")
        if os.path.isdir(path) or os.path.isfile(path) or not os.path.exists(path):
            check_writable(path)
        elif path not in devices:
            raise Refused(f"cannot write {path}: it is not an ordinary file")


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
    if (
        os.path.isfile(path) and not os.stat(path).st_mode & stat.S_IWUSR
    ):  # another could be put in its place all the same
        raise Refused(f"cannot write {path}: it is read-only")


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
        raise Refused(f"Blender cannot open it: {' '.join(str(error).replace('Error:', '').split())}") from None


def context_of(arguments):
    """The context to bake in, at the scene and frame that were asked for."""
    context = bpy.context
    if arguments.scene:
        if arguments.scene not in bpy.data.scenes:
            names = ", ".join(s.name for s in bpy.data.scenes)
            raise Refused(f"there is no scene {arguments.scene!r}; there are {names}")
        context.window.scene = bpy.data.scenes[arguments.scene]
    for object in context.view_layer.objects:
        if object.mode != "OBJECT":  # as the file was saved; its mesh is elsewhere until then
            with context.temp_override(active_object=object, object=object):
                bpy.ops.object.mode_set(mode="OBJECT")
    if arguments.frame is not None:
        context.scene.frame_set(arguments.frame)
    return context


def save_file(output):
    """Save the open file as `output`, whole or not at all."""
    with writing(output, ".blend") as temporary, silent():
        bpy.ops.wm.save_as_mainfile(filepath=temporary, copy=True, check_existing=False)


@contextlib.contextmanager
def writing(path, suffix, written=written_whole):
    """As the core's `written_whole`, or another function, for what Blender writes, in the format of a suffix. Raises
    Refused."""
    try:
        with written(path, suffix) as place:
            try:
                yield place
            except RuntimeError as error:
                if "KeyboardInterrupt" in str(error):  # that an exporter in Python was stopped by
                    raise KeyboardInterrupt from None
                raise OSError(errno.EIO, _reason(error, place)) from None
            if not (os.path.exists(place) and _is_whole(place)):  # Blender does not say so
                raise OSError(errno.EIO, PARTLY)
    except OSError as problem:
        raise Refused(f"cannot write {path}: {problem.strerror or problem}") from None


def _is_whole(path):
    """Whether a file has its end, if it is of a format of which Blender does not always notice that the disk is full: a
    .blend file has a last block, or compressed a list of its parts; PNG a last chunk; USD in words a closed block, in bytes
    a table, where its head says."""
    size, suffix = os.path.getsize(path), os.path.splitext(path)[1].lower()
    with open(path, "rb") as file:
        head = file.read(24)
        file.seek(max(size - 64, 0))
        tail = file.read()
        if suffix == ".blend":
            return b"ENDB" in tail if head.startswith(b"BLENDER") else tail.endswith(PARTS_END)
        if suffix == ".png":
            return tail[-8:-4] == b"IEND"
        if head.startswith(b"PXR-USDC"):
            table = int.from_bytes(head[16:], "little")
            file.seek(table)
            return size >= table + 8 + 32 * int.from_bytes(file.read(8), "little") > table + 8
        return tail.rstrip().endswith(b"}") or not suffix.startswith(".usd")


def _reason(error, path):
    """Why Blender could not write a file, as far as it says: it has no word for a full disk."""
    if shutil.disk_usage(os.path.dirname(path)).free < FULL:
        return os.strerror(errno.ENOSPC)
    text = str(error)
    if os.strerror(errno.ENOENT) in text:  # of the part that it has removed
        return PARTLY
    if "Traceback" in text:  # of an exporter in Python: its last line
        lines = [line for line in text.splitlines() if line and not line.startswith((" ", "Location:"))]
        text = lines[-1]
    return " ".join(text.replace("Error: ", "").split())


@contextlib.contextmanager
def silent():
    """Keep what Blender itself and its exporters in Python say on the standard streams out of ours."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()
    kept = os.dup(1), os.dup(2)
    try:
        with (
            open(os.devnull, "w") as nowhere,
            contextlib.redirect_stdout(nowhere),
            contextlib.redirect_stderr(nowhere),
        ):
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
            yield
    finally:
        for number, stream in zip((1, 2), kept):
            os.dup2(stream, number)
            os.close(stream)
