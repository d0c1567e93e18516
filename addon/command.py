"""The command line: `radiosity bake SCENE.blend ...`, the same in a shell and as `blender --command radiosity ...`.

Exit codes: 0 done; 1 failed, with one clear line on stderr; 2 usage; 130 cancelled.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import tempfile
from pathlib import Path

import bpy

from ..core.layers import LAYERS
from ..core.report import write_json
from ..core.settings import PRESETS
from .errors import Refused
from .job import Job, Options
from .progress import Bar, summary
from .version import version

LATER = {
    "--time": "a time limit", "--target": "lightmaps", "--mesh": "subdivision", "--schedule": "another schedule",
    "--rows": "another row estimator", "--per-object": "an error per object", "--memory": "a memory limit",
    "--state": "state files", "--groups": "light groups", "--force-effects": "forced effects",
    "--texels-per-meter": "lightmaps", "--size": "lightmaps", "--uv": "lightmaps", "--max-edge": "subdivision",
    "--min-edge": "subdivision", "--contrast": "subdivision", "--vertices": "subdivision", "--in-place": "subdivision",
}  # fmt: skip


def main(argv):
    """Run the command line `argv` (without the program's name); returns the exit code."""
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)  # Blender swallows Ctrl-C otherwise
    try:
        arguments = _parser().parse_args(argv)
        return arguments.run(arguments)
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 2
    except KeyboardInterrupt:
        print("radiosity: cancelled", file=sys.stderr, flush=True)
        return 130
    finally:
        if previous is not None:  # None: a handler that is not Python's and cannot be put back
            signal.signal(signal.SIGINT, previous)


def percent(text):
    """A relative error from a command line: "2%" and "2" are 0.02; below 0.05 the sign must be there."""
    try:
        value = float(text.rstrip("%"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a percentage, like 2%") from None
    if not 0 < value <= 100:
        raise argparse.ArgumentTypeError(f"{text!r} is not between 0 and 100 %")
    if value < 0.05 and not text.endswith("%"):
        raise argparse.ArgumentTypeError(f"{text} means {text} %: write {text}% if that is what you want")
    return value / 100


def _layers(text):
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    unknown = [name for name in names if name not in LAYERS]
    if unknown or not names:
        raise argparse.ArgumentTypeError(f"{', '.join(unknown) or 'nothing'}: layers are {', '.join(LAYERS)}")
    return names


def _patch(text):
    if text == "mesh":
        return text
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a length in meters nor 'mesh'")
    return value


def _count(text):
    if not text.isdigit() or not int(text):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of cells")
    return int(text)


class _NotYet(argparse.Action):
    def __call__(self, parser, namespace, values, option_string=None):
        parser.error(f"{option_string}: {LATER[option_string]} cannot be asked for in this version")


def _parser():
    parser = argparse.ArgumentParser("radiosity", description="Bakes interreflected light into Blender meshes.")
    parser.add_argument("--version", action="version", version=version())
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    bake = commands.add_parser("bake", help="bake scenes", description="Bake scenes and save the lit copies.")
    bake.set_defaults(run=run_bake)
    bake.add_argument("scenes", nargs="*", metavar="SCENE.blend", help="files to bake (inside Blender: the open one)")
    bake.add_argument(
        "-o", "--output", metavar="OUT.blend", help="default: SCENE_radiosity.blend; a folder for several"
    )
    accuracy = bake.add_mutually_exclusive_group()
    accuracy.add_argument("--error", type=percent, metavar="2%", help="relative error to reach")
    accuracy.add_argument("--preset", choices=PRESETS, help="10, 2 or 0.5 %% error (default: good)")
    bake.add_argument(
        "--layers", type=_layers, default=("Radiosity", "Lighting"), metavar="A,B", help=", ".join(LAYERS)
    )
    bake.add_argument("--domain", choices=("corner", "point"), default="corner", help="where colors are kept")
    bake.add_argument("--objects", action="append", default=[], metavar="NAME", help="write to this one (or glob) only")
    bake.add_argument("--side", choices=("front", "back", "lit"), default="front", help="the side of faces to bake")
    bake.add_argument("--shared", choices=("copy", "skip"), default="copy", help="what to do with shared meshes")
    bake.add_argument("--max-patch", type=_patch, metavar="M", help="longest edge of a patch [m], or 'mesh'")
    bake.add_argument("--cells", type=_count, default=0, metavar="N", help="processes (default: one per core)")
    bake.add_argument("--seed", type=int, default=0, metavar="N", help="of all samples")
    bake.add_argument("--frame", type=int, metavar="N", help="bake this frame")
    bake.add_argument("--scene", metavar="NAME", help="bake this scene of the file")
    bake.add_argument("--strict", action="store_true", help="fail if anything is wrong with the scene's data")
    bake.add_argument("--report", metavar="R.json", help="write a report; a folder for several scenes")
    bake.add_argument("--picture", metavar="P.png", help="write a picture of the result; a folder for several scenes")
    bake.add_argument("--quiet", action="store_true", help="no progress")
    for option in LATER:
        bake.add_argument(option, nargs="*", action=_NotYet, help=argparse.SUPPRESS)
    return parser


def run_bake(arguments):
    """Bake every scene of the command line; returns the exit code."""
    scenes = arguments.scenes or [None]
    if scenes == [None] and not bpy.data.filepath:
        print("radiosity: no scene: name a .blend file", file=sys.stderr)
        return 2
    failed = 0
    for path in scenes:
        try:
            _bake_file(path, arguments, several=len(scenes) > 1)
        except (Refused, OSError) as problem:
            failed += 1
            print(f"radiosity: {path or bpy.data.filepath}: {problem}", file=sys.stderr, flush=True)
    return 1 if failed else 0


def _bake_file(path, arguments, several):
    """Bake one file (None: the open one). Raises Refused or OSError with one clear line."""
    source = os.path.abspath(path or bpy.data.filepath)
    output = (
        _place(arguments.output, source, "_radiosity.blend", several) or source[: -len(".blend")] + "_radiosity.blend"
    )
    report = _place(arguments.report, source, ".json", several)
    picture = _place(arguments.picture, source, ".png", several)
    for place in (output, report, picture):
        _check_writable(place)
    if path:
        _open(source)
    written_by = tuple(bpy.data.version)
    context = _context(arguments)
    options = Options(
        error=arguments.error or PRESETS[arguments.preset or "good"], layers=arguments.layers, domain=arguments.domain.upper(),
        objects=tuple(arguments.objects), side=arguments.side, cells=arguments.cells, seed=arguments.seed,
        max_patch=arguments.max_patch, shared=arguments.shared, strict=arguments.strict,
    )  # fmt: skip
    job = Job(context, options)
    try:
        with Bar(quiet=arguments.quiet) as bar:
            for progress in job.bake():
                bar.show(progress)
        job.write(context)
        _save(output, source)
        if picture:
            from .picture import save_picture

            save_picture(context, job.result, picture)
        if report:
            write_json(job.report(source), report)
    finally:
        job.close()
    if not arguments.quiet:
        for finding in job.result.survey.health:
            print(f"{finding.object}: {finding.finding}; {finding.action}", flush=True)
        if bpy.app.version >= (5, 0, 0) > written_by:
            new = ".".join(map(str, bpy.app.version[:2]))
            print(f"{output} has the file format of Blender {new}: Blenders before 4.5 cannot open it", flush=True)
        print(f"{os.path.basename(source)}: {summary(job.result)}; saved {output}", flush=True)


def _place(given, source, suffix, several):
    """Where an output of `source` goes: a file, or with several scenes a file in the folder that was given."""
    if given is None:
        return None
    return os.path.join(os.path.abspath(given), Path(source).stem + suffix) if several else os.path.abspath(given)


def _check_writable(path):
    """Make the folder of an output, and raise Refused if nothing can be written there."""
    if path is None:
        return
    folder = os.path.dirname(path)
    try:
        os.makedirs(folder, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise Refused(f"cannot write {path}: {error.strerror or error}") from None
    if os.path.isdir(path):
        raise Refused(f"cannot write {path}: it is a folder")


def _open(path):
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
        with _silent():
            bpy.ops.wm.open_mainfile(filepath=path)
    except RuntimeError as error:
        raise Refused(" ".join(str(error).replace("Error:", "").split())) from None


def _context(arguments):
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


def _save(output, source):
    """Save the open file as `output`, whole or not at all."""
    temporary = f"{output[: -len('.blend')] if output.endswith('.blend') else output}.tmp{os.getpid()}.blend"
    try:
        with _silent():
            bpy.ops.wm.save_as_mainfile(filepath=temporary, copy=True, check_existing=False)
        os.replace(temporary, output)
    except RuntimeError as error:
        raise Refused(f"cannot write {output}: {' '.join(str(error).split())}") from None
    finally:
        with contextlib.suppress(OSError):
            os.remove(temporary)


@contextlib.contextmanager
def _silent():
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
