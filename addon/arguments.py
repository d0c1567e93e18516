"""What the commands' options mean: their types, and the options that all commands share."""

from __future__ import annotations

import argparse

from ..core.layers import LAYERS
from ..core.settings import EFFECTS, PRESETS
from .job import Options

LAST_FRAME = 1048574  # Blender's own limit
MOST_CELLS = 1024
MOST_PADDING = 1024
MOST_FACTOR = 1e30  # of a light's strength


def percent(text):
    """A relative error from a command line: "2%" and "2" are 0.02; below 0.05 the sign must be there."""
    try:
        value = float(text.removesuffix("%"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a percentage, like 2%") from None
    if not 0 < value <= 100:
        raise argparse.ArgumentTypeError(f"{text!r} is not between 0 and 100 %")
    if value < 0.05 and not text.endswith("%"):
        raise argparse.ArgumentTypeError(f"{text} means {text} %: write {text}% if that is what you want")
    return value / 100


def layers(text):
    """Names of layers from a list with commas."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    unknown = [name for name in names if name not in LAYERS]
    if unknown or not names:
        raise argparse.ArgumentTypeError(f"{', '.join(unknown) or 'nothing'}: layers are {', '.join(LAYERS)}")
    return names


def effects(text):
    """Names of effects from a list with commas, or "all"."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if names == ("all",):
        return EFFECTS
    unknown = [name for name in names if name not in EFFECTS]
    if unknown or not names:
        raise argparse.ArgumentTypeError(f"{', '.join(unknown) or 'nothing'}: effects are all, {', '.join(EFFECTS)}")
    return names


def patch_edge(text):
    """A length in meters, or "mesh"."""
    if text == "mesh":
        return text
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is neither a length in meters nor 'mesh'")
    return value


def exposure(text):
    """Stops, or "auto"."""
    if text == "auto":
        return text
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < 64:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a number of stops nor 'auto'")
    return value


def channel(text):
    """A channel of an attribute: "NAME:R"."""
    name, _, letter = text.rpartition(":")
    if not name or letter.upper() not in ("R", "G", "B", "A"):
        raise argparse.ArgumentTypeError(f"{text!r} is not an attribute and a channel, like Col:A")
    return name, letter.upper()


def change(text):
    """A change of a light's strength: "NAME=FACTOR" or "NAME=R,G,B", as (name, (r, g, b))."""
    name, _, factors = text.rpartition("=")
    try:
        values = tuple(float(part) for part in factors.split(","))
    except ValueError:
        values = ()
    if not name or len(values) not in (1, 3) or not all(0 <= value <= MOST_FACTOR for value in values):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a name and one or three factors from 0 to {MOST_FACTOR:g}, like Lamp=2 or Lamp=1,0.5,0"
        )
    return name, values * (3 // len(values))


def positive(text):
    """A number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0")
    return value


def whole(text, most=10**9):
    """A whole number from 1 to `most`."""
    value = int(text) if text.isdecimal() and len(text) < 20 else 0
    if not 1 <= value <= most:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 to {most}")
    return value


def frame(text):
    """A frame that Blender has."""
    try:
        value = int(text)
    except ValueError:
        value = LAST_FRAME + 1
    if abs(value) > LAST_FRAME:
        raise argparse.ArgumentTypeError(f"{text!r} is not a frame from -{LAST_FRAME} to {LAST_FRAME}")
    return value


def seconds(text):
    """A time [s]: "20s", "20", "2m"."""
    units = {"s": 1.0, "m": 60.0}
    try:
        value = float(text[:-1]) * units[text[-1]] if text[-1:] in units else float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a time, like 20s")
    return value


def count(text):
    """A number of cells, each of which is a process of its own."""
    return whole(text, MOST_CELLS)


def points(text):
    """A number of output points: "1e7", "10000000"."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 1 <= value <= 1e12:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of points, like 1e7")
    return int(value)


def padding(text):
    """Texels between the charts of a lightmap."""
    return whole(text, MOST_PADDING)


def memory(text):
    """An amount of memory [bytes]: "500M", "2G"."""
    units = {"K": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}
    try:
        value = float(text[:-1]) * units[text[-1].upper()] if text[-1:].upper() in units else float(text)
    except ValueError:
        value = 0.0
    if not 1e7 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not an amount of memory of 10M or more, like 2G")
    return value


def add_scene_options(parser):
    """Options about the scene and the accuracy, which all commands share."""
    accuracy = parser.add_mutually_exclusive_group()
    accuracy.add_argument("--error", type=percent, metavar="2%", help="relative error to reach")
    accuracy.add_argument("--time", type=seconds, metavar="20s", help="take so long, and make the best of it")
    accuracy.add_argument("--preset", choices=PRESETS, help="10, 2 or 0.5 %% error (default: good)")
    parser.add_argument("--per-object", action="store_true", help="reach the error in every object, dark ones too")
    parser.add_argument(
        "--objects", action="append", default=[], metavar="NAME", help="write to this one (or glob) only"
    )
    parser.add_argument("--side", choices=("front", "back", "lit"), default="front", help="the side of faces to bake")
    parser.add_argument("--max-patch", type=patch_edge, metavar="M", help="longest edge of a patch [m], or 'mesh'")
    parser.add_argument("--rows", choices=("rays", "analytic"), help="estimator of form factors (default: rays)")
    parser.add_argument(
        "--force-effects", type=effects, default=(), metavar="all|A,B", help="simulate what the scene does not call for"
    )
    parser.add_argument("--memory", type=memory, default=0.0, metavar="2G", help="memory that may be used")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of all samples")
    parser.add_argument("--frame", type=frame, metavar="N", help="take this frame")
    parser.add_argument("--scene", metavar="NAME", help="take this scene of the file")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def make_options(arguments, **others):
    """The Options of a command line."""
    return Options(
        error=arguments.error or PRESETS[arguments.preset or "good"],
        time=arguments.time,
        per_object=arguments.per_object,
        objects=tuple(arguments.objects),
        side=arguments.side,
        max_patch=arguments.max_patch,
        rows=arguments.rows,
        memory=arguments.memory,
        force=arguments.force_effects,
        seed=arguments.seed,
        **others,
    )
