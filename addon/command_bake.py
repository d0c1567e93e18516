"""`radiosity bake`: bake scenes and save the lit copies."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter

import bpy

from ..core.layers import LAYERS
from ..core.report import write_json
from ..core.settings import SCHEDULES
from .arguments import add_scene_options, channel, count, exposure, layers, make_options, padding, positive, whole
from .cluster import add_cluster_options, cells_for
from .errors import Refused, Usage, told
from .export import export_scene, kind_of
from .files import check_outputs, context_of, open_file, place_for, same_file, save_file, silent
from .finished import finished, is_result, note, origin
from .job import Job
from .progress import Bar, say, summary
from .scene_command import NO_SCENE, complain, exit_code
from .state_file import Origin, state_to_go_on, write_state

OPTIONS = (  # that the command line has in the words of a Job's
    "layers", "cells", "shared", "schedule", "strict", "target", "occlusion_distance", "groups", "mesh", "max_edge",
    "min_edge", "contrast", "vertices", "in_place", "bytes", "channel", "texels_per_meter", "size", "uv", "atlas",
    "padding", "image",
)  # fmt: skip


def add(commands):
    """Add the command's parser to `commands`."""
    bake = commands.add_parser("bake", help="bake scenes", description="Bake scenes and save the lit copies.")
    bake.set_defaults(run=run_bake)
    bake.add_argument("scenes", nargs="*", metavar="SCENE.blend", help="files to bake (inside Blender: the open one)")
    bake.add_argument(
        "-o", "--output", metavar="OUT.blend", help="default: SCENE_radiosity.blend; a folder for several"
    )
    bake.add_argument("--layers", type=layers, default=("Radiosity", "Lighting"), metavar="A,B", help=", ".join(LAYERS))
    bake.add_argument("--domain", choices=("corner", "point"), default="corner", help="where colors are kept")
    bake.add_argument("--shared", choices=("copy", "skip"), default="copy", help="what to do with shared meshes")
    bake.add_argument("--cells", type=count, default=0, metavar="N", help="processes (default: one per core)")
    bake.add_argument("--schedule", choices=SCHEDULES, default="dynamic", help="how light is shot (default: dynamic)")
    bake.add_argument("--strict", action="store_true", help="fail if anything is wrong with the scene's data")
    bake.add_argument("--report", metavar="R.json", help="write a report; a folder for several scenes")
    bake.add_argument(
        "--state",
        metavar="FILE",
        help="go on from this file, and keep there what was traced; a folder for several scenes",
    )
    bake.add_argument("--picture", metavar="P.png", help="write a picture of the result; a folder for several scenes")
    bake.add_argument(
        "--keep-going", action="store_true", help="of many files, skip those that were baked before and are unchanged"
    )
    add_cluster_options(bake)
    add_scene_options(bake)
    bake.add_argument("--target", choices=("vertex", "lightmap"), default="vertex", help="colors of meshes, or images")
    bake.add_argument("--bytes", action="store_true", help="8-bit copies of the layers too (sRGB)")
    bake.add_argument("--exposure", type=exposure, metavar="EV", help="of 8-bit copies [stops], or auto (default)")
    bake.add_argument(
        "--channel", type=channel, metavar="NAME:R", help="the first layer's brightness into this channel"
    )
    bake.add_argument("--export", metavar="OUT.glb", help="write glTF or USD too; a folder for several scenes")
    bake.add_argument(
        "--occlusion-distance", type=positive, default=1.0, metavar="M", help="reach of the layer Occlusion [m]"
    )
    bake.add_argument("--groups", choices=("collection", "lamp"), help="layers of each light group too")
    bake.add_argument("--mesh", choices=("keep", "subdivide"), default="keep", help="finer where the light needs it")
    finer = bake.add_argument_group("subdivision")
    finer.add_argument("--max-edge", type=positive, metavar="M", help="longest edge left [m] (default: scene / 40)")
    finer.add_argument("--min-edge", type=positive, metavar="M", help="shortest edge made [m] (default: that / 16)")
    finer.add_argument("--contrast", type=positive, metavar="X", help="split what differs by more (default: 0.1)")
    finer.add_argument("--vertices", type=whole, metavar="N", help="the most there may be (default: a million)")
    finer.add_argument("--in-place", action="store_true", help="the objects themselves, not copies")
    maps = bake.add_argument_group("lightmaps")
    density = maps.add_mutually_exclusive_group()
    density.add_argument("--texels-per-meter", type=positive, default=16.0, metavar="N", help="density (default: 16)")
    density.add_argument("--size", type=whole, metavar="N", help="width and height of the images instead")
    maps.add_argument("--uv", metavar="NAME", help="use this UV map (default: unwrap a triangulated copy)")
    maps.add_argument(
        "--atlas", choices=("object", "scene"), default="object", help="an image for each, or one for all"
    )
    maps.add_argument("--padding", type=padding, default=2, metavar="N", help="texels between charts (default: 2)")
    maps.add_argument("--image", choices=("exr", "png"), default="exr", help="32-bit floats, or 16 bits times a scale")


@dataclass(frozen=True)
class Places:
    """The files of one bake, as absolute paths or None: the source is read, the state read and written, the others are
    written. opened: whether the source is open already."""

    source: str
    opened: bool
    output: str
    report: str | None
    picture: str | None
    export: str | None
    state: str | None

    @classmethod
    def of(cls, path, arguments, several):
        """Those of a scene (None: the open one) of a command line, one of several or not."""
        source = os.path.abspath(bpy.data.filepath if path is None else path)
        output = place_for(arguments.output, source, "_radiosity.blend", several)
        return cls(
            source=source,
            opened=path is None,
            output=output or os.path.splitext(source)[0] + "_radiosity.blend",
            report=place_for(arguments.report, source, ".json", several),
            picture=place_for(arguments.picture, source, ".png", several),
            export=place_for(arguments.export, source, ".glb", several),
            state=place_for(arguments.state, source, ".npz", several),
        )

    @property
    def written(self):
        """All that are written."""
        return [p for p in (self.output, self.report, self.picture, self.export, self.state) if p]

    def check(self, before, others):
        """Raise Refused if what is written cannot be, or would overwrite what is read (that the output may be the source is
        the user's word), what was written for the Places baked before, or the source of others."""
        inputs = () if same_file(self.output, self.source) else (self.source,)
        check_outputs(self.written, inputs, devices=[self.report])
        for path in self.written:
            for other in before:
                if any(same_file(path, p) for p in other.written):
                    raise Refused(f"cannot write {path}: {other.source} is baked to it; rename one of the two scenes")
            if any(same_file(path, other.source) for other in others):
                raise Refused(
                    f"cannot write {path}: it is one of the scenes to bake; name a folder with -o, or bake it alone"
                )


@exit_code
def run_bake(arguments):
    """Bake every scene of the command line; returns the exit code."""
    if not arguments.scenes and not bpy.data.filepath:
        raise Usage(NO_SCENE)
    scenes = [Places.of(path, arguments, len(arguments.scenes) > 1) for path in arguments.scenes or [None]]
    begun = perf_counter()
    with cells_for(arguments, arguments.cells) as cells:
        return _bake_files(scenes, arguments, cells, perf_counter() - begun)


def _bake_files(scenes, arguments, cells, start_seconds):
    """Bake files (Places) one after another with the same cells; returns the exit code. One that fails does not stop the
    others."""
    failed = 0
    for number, places in enumerate(scenes):
        try:
            # To keep going, results among the scenes are written, not baked.
            others = () if arguments.keep_going else (*scenes[:number], *scenes[number + 1 :])
            places.check(scenes[:number], others)
            _bake_file(places, arguments, cells, start_seconds)
        except Exception as problem:
            failed += 1
            complain(problem, places.source)
        start_seconds = 0.0  # they are warm then
    return 1 if failed else 0


def _bake_file(places, arguments, cells, start_seconds):
    """Bake one file. Raises exceptions that `told` puts in one clear line."""
    _check(places, arguments)
    if not places.opened:
        open_file(places.source)
    written_by = tuple(bpy.data.version)
    made_from = None
    if arguments.keep_going:
        name = os.path.basename(places.source)
        if is_result():
            say(f"{name}: is itself the result of a bake; left as it is")
            return
        made_from = origin(places.source, arguments)
        if all(map(os.path.exists, places.written)) and finished(places.output, made_from):
            say(f"{name}: was baked before and is unchanged; {places.output}")
            return

    kept, context, options = places.state, context_of(arguments), _options(arguments, places.output)
    state = state_to_go_on(kept, options) if kept else None
    keep = partial(_keep, kept, Origin(places.source, arguments.scene, arguments.frame, options)) if kept else None
    with silent():
        job = Job(context, options, cells, start_seconds, state=state)
    try:
        stopped, unkept = _bake_until_stopped(job, arguments.quiet, keep)
        _write(places, context, job, made_from if not stopped else None)
    finally:
        job.close()
    if not arguments.quiet:
        _tell(places, job.result, written_by, f" after what {kept} held" if state else "")
    if unkept:
        raise Refused(f"{unkept}; {places.output} is complete")
    if stopped:
        raise KeyboardInterrupt


def _check(places, arguments):
    """Raise Refused if what is asked for does not go together."""
    if places.state and arguments.schedule == "paper":
        raise Refused("--state: the paper's schedule keeps no rows to go on from; leave out one of the two")
    if arguments.target == "lightmap" and arguments.mesh == "subdivide":
        raise Refused("--mesh subdivide is for vertex colors: a lightmap needs no finer mesh; leave out one of the two")
    if places.export:
        kind_of(places.export)
        if arguments.target == "lightmap":
            raise Refused("--export writes vertex colors: leave out --target lightmap")


def _options(arguments, output):
    """The Options of a command line."""
    exposure = ("auto" if arguments.bytes else 0.0) if arguments.exposure is None else arguments.exposure
    same = {name: getattr(arguments, name) for name in OPTIONS}
    return make_options(arguments, **same, domain=arguments.domain.upper(), exposure=exposure, output=output)


def _write(places, context, job, made_from):
    """Write all that is asked for of a Job whose bake is done; made_from: what the output notes that it was, or None."""
    with silent():
        job.write(context)
    if made_from:
        note(made_from)
    save_file(places.output)
    if places.export:
        with silent():
            export_scene(context, places.export, job.options.layers[0])
    if places.picture:
        from .picture import save_picture

        save_picture(context, job.result, places.picture, job.output.picture(job.result))
    if places.report:
        write_json(job.report(places.source), places.report)


def _tell(places, result, written_by, went_on):
    """Say what was found, and how the bake of a file ended. written_by: the version of Blender that saved it."""
    for finding in result.survey.health:
        say(f"{finding.object}: {finding.finding}; {finding.action}")
    if bpy.app.version >= (5, 0, 0) > written_by:
        new = ".".join(map(str, bpy.app.version[:2]))
        say(f"{places.output} has the file format of Blender {new}: Blenders before 4.5 cannot open it")
    say(f"{os.path.basename(places.source)}: {summary(result)}{went_on}; saved {places.output}")


def _bake_until_stopped(job, quiet, keep):
    """Bake to the end, or until Ctrl-C; then what there is becomes the result. Returns whether it was stopped, and why the
    state could not be kept, or None. keep: see `_keep`; None keeps nothing."""
    latest, state = None, None
    try:
        with Bar(quiet=quiet) as bar:
            for progress in job.bake():
                latest, state = progress if progress.take else latest, progress.state or state
                bar.show(progress)
    except KeyboardInterrupt:
        unkept = keep and keep(state)
        so_far = job.so_far(latest)
        if so_far is None:
            raise
        job.keep(so_far)
        return True, unkept
    except Exception as problem:
        if not keep or not state:
            raise
        unkept = keep(state)
        if isinstance(problem, Refused):
            raise
        raise Refused(
            f"{told(problem)}; {unkept or 'what is finished is kept: the same command goes on from it'}"
        ) from problem
    unkept = keep and keep(job.result.state)
    job.result = replace(job.result, state=None)  # what only a state needs is in the way of what is written
    return False, unkept


def _keep(path, origin, state):
    """Keep in a file of that path the State that a function (or None) gives; returns why that failed, or None."""
    if not state:
        return None
    try:
        write_state(state(), path, origin)
    except OSError as problem:
        return f"cannot write {path}: {problem.strerror or problem}"
    return None
