"""The words of the user interface in other languages, through Blender's own translation system.

Names and tooltips of properties, operators and panels are looked up by Blender itself. Sentences with values in them are
looked up by `tr`, with {} in place of each value; those that come from the core are written with their numbers and names in
quotes, which `tr_message` takes out to look them up, and puts back.
"""

from __future__ import annotations

import re

from bpy.app import translations

from .translations_de import GERMAN

CONTEXT = "Cell Radiosity"  # of words that Blender says otherwise elsewhere
VALUE = re.compile(r"(?<!\w)'[^']*'(?!\w)|\d+(?:[.,]\d+)*")


def tr(text, *values):
    """A text of the user interface in the user's language, with values in place of its {}."""
    found = _look_up(text)
    return found.format(*values) if values else found


def _look_up(text):
    found = translations.pgettext_iface(text, CONTEXT)
    return translations.pgettext_iface(text) if found == text else found


def tr_message(text):
    """A sentence with numbers and quoted names in it in the user's language; as it is, if it is not known there."""
    values = VALUE.findall(text)
    pattern = VALUE.sub("{}", text)
    found = _look_up(pattern)
    return text if found == pattern else found.format(*values)


def register():
    """Give Blender the words."""
    languages = {"de_DE": GERMAN, "de": GERMAN}
    translations.register(
        __package__,
        {code: {(context, text): word for text, word in words.items() for context in ("*", "Operator", CONTEXT)}
         for code, words in languages.items()},
    )  # fmt: skip


def unregister():
    """Take the words back."""
    translations.unregister(__package__)
