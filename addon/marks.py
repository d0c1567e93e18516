"""Marks on what a bake makes, so that the next bake replaces it and never reads it as scene."""

KEY = "cell_radiosity"


def mark(thing):
    """Mark an object or image as made by a bake."""
    thing[KEY] = True


def is_made(thing):
    """Whether a bake made it."""
    return bool(thing.get(KEY, False))


def mark_layers(mesh, names):
    """Note on a mesh which of its attributes bakes have written."""
    mesh[KEY] = ",".join(sorted(set(names) | made_layers(mesh)))


def made_layers(mesh):
    """Names of a mesh's attributes that bakes have written."""
    text = mesh.get(KEY, "")
    return set(text.split(",")) - {""} if isinstance(text, str) else set()
