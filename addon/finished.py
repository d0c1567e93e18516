"""Whether a file was baked before as it would be now: a note in the output of what it was made from."""

from __future__ import annotations

import os
from hashlib import blake2b

import bpy

from .marks import is_made, mark
from .version import version

NOTE = "cell_radiosity"  # the text in the output that holds it
# Of a command line, what does not change the result.
INDIFFERENT = (
    "run",
    "scenes",
    "output",
    "report",
    "picture",
    "quiet",
    "cells",
    "cluster",
    "allow_mixed",
    "keep_going",
    "state",
)


def origin(source, arguments):
    """What a bake of the open file depends on, as one word: the file's content, the files it refers to (by size and
    time), the options, and this version."""
    digest = blake2b(digest_size=16)
    with open(source, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    for path in sorted(bpy.utils.blend_paths(absolute=True)):
        if os.path.isfile(path):
            told = os.stat(path)
            digest.update(f"{path} {told.st_size} {told.st_mtime_ns}".encode())
    options = {name: value for name, value in sorted(vars(arguments).items()) if name not in INDIFFERENT}
    digest.update(f"{version()} {options}".encode())
    return digest.hexdigest()


def note(made_from):
    """Leave a note in the open file of what it is made from."""
    for old in [text for text in bpy.data.texts if is_made(text)]:
        bpy.data.texts.remove(old)
    text = bpy.data.texts.new(NOTE)
    mark(text)
    text.use_fake_user = True
    text.write(made_from)


def is_result():
    """Whether the open file is itself the result of a bake that left a note."""
    return any(is_made(text) for text in bpy.data.texts)


def finished(output, made_from):
    """Whether the file `output` says that it is made from just that."""
    if not os.path.isfile(output):
        return False
    try:
        with bpy.data.libraries.load(output) as (there, here):
            here.texts = [name for name in there.texts if name.startswith(NOTE)]
    except OSError:
        return False
    found = [text.as_string().strip() for text in here.texts]
    for text in here.texts:
        bpy.data.texts.remove(text)
    return made_from in found
