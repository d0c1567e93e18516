"""State files of the command line: where a bake is carried on from, and what they say of the file it came from."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, fields, replace

from ..core.state import ANEW, StateError, load_state, save_state
from .errors import Refused
from .job import Options

# Options that the points of a bake depend on.
PLACING = (
    "objects", "shared", "side", "target", "mesh", "max_edge", "min_edge", "contrast", "vertices", "texels_per_meter", "size", "uv",
    "atlas", "padding",
)  # fmt: skip


@dataclass(frozen=True)
class Origin:
    """What a bake was made from: the path of a .blend file, the name of a scene and a frame (None: as it opens),
    Options."""

    path: str
    scene: str | None
    frame: int | None
    options: Options

    def options_for(self, output):
        """The Options, for another output file."""
        return replace(self.options, output=output)


def read_state(path):
    """The core's State in a file, and its Origin. Raises Refused if it cannot be used."""
    try:
        state = load_state(path)
        told = json.loads(state.note)
        known = {f.name for f in fields(Options)}
        options = {k: tuple(v) if isinstance(v, list) else v for k, v in told.pop("options").items() if k in known}
        return state, Origin(**told, options=Options(**options))
    except StateError as problem:
        raise Refused(f"{path}: {problem}") from None
    except (ValueError, TypeError, KeyError, AttributeError):
        raise Refused(f"{path}: `radiosity bake` did not write it: {ANEW}") from None
    except OSError as problem:
        raise Refused(f"cannot read {path}: {problem.strerror or problem}") from None


def state_to_go_on(path, options):
    """The State of a file for a bake with some Options to go on from; None if there is no such file. Raises Refused if its
    points are not those that the options ask for."""
    if not os.path.exists(path):
        return None
    state, origin = read_state(path)
    for name in PLACING:
        there, here = getattr(origin.options, name), getattr(options, name)
        if there != here:
            option = f"--{name.replace('_', '-')}"
            raise Refused(f"{path}: it was baked with {_said(option, there)}, not {_said(option, here)}: {ANEW}")
    return state


def write_state(state, path, origin):
    """Write a State to a file, whole or not at all. Raises OSError."""
    note = {**asdict(replace(origin, options=None)), "options": asdict(origin.options)}
    save_state(replace(state, note=json.dumps(note)), path)


def _said(option, value):
    """An option with its value, in words."""
    if value in (None, ()):
        return f"no {option}"
    return f"{option} {' '.join(map(str, value)) if isinstance(value, tuple) else value}"
