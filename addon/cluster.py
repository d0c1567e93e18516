"""Cells of a command line: processes of this machine, or the workers of a cluster."""

from __future__ import annotations

from ..core.cells import make_cells
from .errors import Usage
from .job import default_cells


def add_cluster_options(parser):
    """Options that choose other cells than this machine's."""
    parser.add_argument(
        "--cluster", metavar="ADDRESS", help="Dask scheduler, like tcp://host:8786; local:N starts N workers here"
    )
    parser.add_argument(
        "--allow-mixed",
        action="store_true",
        help="accept workers of other versions; results may differ in the last bits",
    )


def cells_for(arguments, count=0):
    """Cells as a command line asks for them: a cluster's, or `count` processes (0: one per core).

    Raises Usage where the cluster's packages are missing, OSError if the cluster cannot be used.
    """
    if not arguments.cluster:
        return make_cells(count or default_cells())
    try:
        from ..cluster.cells import connect
    except ImportError:
        raise Usage(
            "--cluster needs the package of the command line, with its cluster part: pip install 'cell_radiosity[cluster]'"
        ) from None
    return connect(arguments.cluster, arguments.allow_mixed)
