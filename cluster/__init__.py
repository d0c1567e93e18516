"""Cells on other machines: the workers of a Dask cluster, joined by `connect`.

Not part of the extension: it needs `pip install cell_radiosity[cluster]`, on the host and on every worker.
"""
