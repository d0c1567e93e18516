"""`radiosity relight`: lights made stronger, weaker or of another color after the bake, without a ray."""

from __future__ import annotations

import os

import numpy as np

from ..core.cells import LocalCells
from .arguments import change
from .errors import Refused
from .files import check_outputs, context_of, open_file, save_file, silent
from .job import Job
from .progress import say
from .scene_command import exit_code
from .state_file import read_state


def add(commands):
    """Add the command's parser to `commands`."""
    relight = commands.add_parser(
        "relight", help="change lights after a bake",
        description="Writes what `bake --groups ... --state STATE` has found, with other strengths of its light groups.",
    )  # fmt: skip
    relight.set_defaults(run=run_relight)
    relight.add_argument("state", metavar="STATE", help="a state file of a bake with --groups")
    relight.add_argument("moved", nargs="?", metavar="SCENE.blend", help="the scene, if it is not where it was")
    relight.add_argument("-o", "--output", required=True, metavar="OUT.blend", help="the file to write")
    relight.add_argument(
        "--set", type=change, action="append", default=[], metavar="NAME=F[,G,B]", help="a group's strength times this"
    )
    relight.add_argument("--quiet", action="store_true", help="say nothing")


@exit_code
def run_relight(arguments):
    """Write the scene of a state with other strengths of its lights."""
    output = os.path.abspath(arguments.output)
    check_outputs([output], inputs=[arguments.state])
    state, origin = read_state(arguments.state)
    try:
        factors = factors_of(state.groups, arguments.set)
    except Refused as problem:
        raise Refused(f"{arguments.state}: {problem}") from None
    source = os.path.abspath(arguments.moved or origin.path)
    if not os.path.isfile(source):
        raise Refused(
            f"{arguments.state}: there is no scene at {source} any more: name its .blend file after the state"
        )
    open_file(source)
    context = context_of(origin)
    with silent():
        job = Job(context, origin.options_for(output), LocalCells(), state=state)
    try:
        job.relight(factors)
        with silent():
            job.write(context)
        save_file(output)
    finally:
        job.close()
    if not arguments.quiet:
        told = ", ".join(
            f"{name} times {','.join(f'{f:g}' for f in dict.fromkeys(factor))}" for name, factor in arguments.set
        )
        say(f"{os.path.basename(output)}: {told or 'as it was baked'}; no ray was cast")


def factors_of(groups, changes):
    """(G, 3) by which the strengths of light groups are multiplied, from changes (name, (r, g, b)). Raises Refused if there
    are no groups, or none of a name."""
    if groups is None:
        raise Refused(
            "it was baked without light groups: bake with --groups lamp (or collection) to change lights later"
        )
    factors = np.ones((len(groups.names), 3))
    for name, factor in changes:
        if name not in groups.names:
            raise Refused(f"there is no light group {name!r}; there are {', '.join(groups.names)}")
        factors[groups.names.index(name)] *= factor
    return factors
