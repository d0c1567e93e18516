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

from ..core.experiment import as_dictionary, decades, experiment, shots_per_decade, table
from ..core.layers import LAYERS
from ..core.report import write_json
from ..core.settings import PRESETS, SCHEDULES
from .errors import Refused, Usage
from .job import Job, Options, default_cells, wanted_by
from .plots import plot_cells, pyplot
from .progress import Bar, summary
from .read_scene import read_scene
from .version import version

LATER = {
    "--time": "a time limit", "--target": "lightmaps", "--mesh": "subdivision", "--per-object": "an error per object",
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


def _memory(text):
    units = {"K": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}
    try:
        value = float(text[:-1]) * units[text[-1].upper()] if text[-1:].upper() in units else float(text)
    except ValueError:
        value = 0.0
    if not value >= 1e7:
        raise argparse.ArgumentTypeError(f"{text!r} is not an amount of memory of 10M or more, like 2G")
    return value


def _counts(text):
    return tuple(dict.fromkeys(_count(part) for part in text.split(",")))


def _schedules(text):
    names = tuple(dict.fromkeys(text.split(",")))
    if unknown := [name for name in names if name not in SCHEDULES]:
        raise argparse.ArgumentTypeError(f"{', '.join(unknown)}: schedules are {', '.join(SCHEDULES)}")
    return names


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
    bake.add_argument(
        "--layers", type=_layers, default=("Radiosity", "Lighting"), metavar="A,B", help=", ".join(LAYERS)
    )
    bake.add_argument("--domain", choices=("corner", "point"), default="corner", help="where colors are kept")
    bake.add_argument("--shared", choices=("copy", "skip"), default="copy", help="what to do with shared meshes")
    bake.add_argument("--cells", type=_count, default=0, metavar="N", help="processes (default: one per core)")
    bake.add_argument("--schedule", choices=SCHEDULES, default="dynamic", help="how light is shot (default: dynamic)")
    bake.add_argument("--strict", action="store_true", help="fail if anything is wrong with the scene's data")
    bake.add_argument("--report", metavar="R.json", help="write a report; a folder for several scenes")
    bake.add_argument("--picture", metavar="P.png", help="write a picture of the result; a folder for several scenes")
    _add_scene_options(bake)

    cells = commands.add_parser(
        "cells", help="time against cells",
        description="The paper's experiment: time against the number of cells, measured on this machine's cores and "
        "replayed beyond them.",
    )  # fmt: skip
    cells.set_defaults(run=run_cells)
    cells.add_argument("scene_file", nargs="?", metavar="SCENE.blend", help="the file (inside Blender: the open one)")
    cells.add_argument("--counts", type=_counts, metavar="1,2,4", help="cells to measure (default: 1 up to the cores)")
    cells.add_argument("--schedule", type=_schedules, default=SCHEDULES, metavar="paper,dynamic", help="default: both")
    cells.add_argument("--report", metavar="R.json", help="write all figures")
    cells.add_argument("--plot", metavar="P.png", help="draw speed-up and losses")
    _add_scene_options(cells)
    return parser


def _add_scene_options(parser):
    """Options about the scene and the accuracy, which all commands share."""
    accuracy = parser.add_mutually_exclusive_group()
    accuracy.add_argument("--error", type=percent, metavar="2%", help="relative error to reach")
    accuracy.add_argument("--preset", choices=PRESETS, help="10, 2 or 0.5 %% error (default: good)")
    parser.add_argument(
        "--objects", action="append", default=[], metavar="NAME", help="write to this one (or glob) only"
    )
    parser.add_argument("--side", choices=("front", "back", "lit"), default="front", help="the side of faces to bake")
    parser.add_argument("--max-patch", type=_patch, metavar="M", help="longest edge of a patch [m], or 'mesh'")
    parser.add_argument("--rows", choices=("rays", "analytic"), help="estimator of form factors (default: rays)")
    parser.add_argument("--memory", type=_memory, default=0.0, metavar="2G", help="memory that may be used")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of all samples")
    parser.add_argument("--frame", type=int, metavar="N", help="take this frame")
    parser.add_argument("--scene", metavar="NAME", help="take this scene of the file")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    for option in LATER:
        parser.add_argument(option, nargs="*", action=_NotYet, help=argparse.SUPPRESS)


def _options(arguments, **others):
    """The Options of a command line."""
    return Options(
        error=arguments.error or PRESETS[arguments.preset or "good"],
        objects=tuple(arguments.objects),
        side=arguments.side,
        max_patch=arguments.max_patch,
        rows=arguments.rows,
        memory=arguments.memory,
        seed=arguments.seed,
        **others,
    )


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
    options = _options(
        arguments,
        layers=arguments.layers,
        domain=arguments.domain.upper(),
        cells=arguments.cells,
        shared=arguments.shared,
        schedule=arguments.schedule,
        strict=arguments.strict,
    )
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


def run_cells(arguments):
    """Measure and replay a scene on many cells; returns the exit code."""
    path = arguments.scene_file
    source = path or bpy.data.filepath
    try:
        if not source:
            raise Usage("no scene: name a .blend file")
        if arguments.plot:
            pyplot()
        for place in (arguments.report, arguments.plot):
            _check_writable(place and os.path.abspath(place))
        if path:
            _open(os.path.abspath(path))
        scene, _ = read_scene(_context(arguments), wanted_by(arguments.objects))
        settings = _options(arguments).settings(scene.diagonal)
        cores = default_cells()
        counts = arguments.counts or tuple(n for n in (1, 2, 4, 8, 16, 32, 64) if n < cores) + (cores,)
        replays = tuple(sorted({*counts, *(2**k for k in range(11))}))
        runs = []
        for run in experiment(scene, settings, arguments.schedule, counts, replays):
            runs.append(run)
            if not arguments.quiet:
                print(
                    f"{run.schedule}, {run.cells} cells, {run.kind}: {run.seconds:.2f} s", file=sys.stderr, flush=True
                )
        print(table(runs), flush=True)
        decade = shots_per_decade(scene, settings)
        for line in decades(runs, decade):
            print(line, flush=True)
        if arguments.report:
            write_json(as_dictionary(os.path.abspath(source), runs, decade), os.path.abspath(arguments.report))
        if arguments.plot:
            plot_cells(runs, os.path.abspath(arguments.plot), os.path.basename(source))
    except Usage as problem:
        print(f"radiosity: {problem}", file=sys.stderr)
        return 2
    except (Refused, OSError) as problem:
        print(f"radiosity: {source}: {problem}", file=sys.stderr)
        return 1
    return 0


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
