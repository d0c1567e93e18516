"""The words of the user interface in other languages, through Blender's own translation system.

Names and tooltips of properties, operators and panels are looked up by Blender itself. Sentences with values in them are
looked up by `tr`, with {} in place of each value. Those of the core come with their values in them: `tr_message` finds the
sentence that they are by what stands between its values, looks it up, and puts the values back. A sentence within another
is a value with a name, such as {text}.
"""

from __future__ import annotations

import re
from functools import cache, lru_cache

from bpy.app import translations

from .translations_de import GERMAN

CONTEXT = "Cell Radiosity"  # of words that Blender says otherwise elsewhere
VALUE = re.compile(r"\{(\w*)\}")
LISTS = "; ", ", "  # what sentences that are no more than words are put together with


def tr(text, *values):
    """A text of the user interface in the user's language, with values in place of its {}."""
    found = _look_up(text)
    return found.format(*values) if values else found


def _look_up(text):
    found = translations.pgettext_iface(text, CONTEXT)
    return translations.pgettext_iface(text) if found == text else found


def tr_message(text):
    """A sentence of the core in the user's language; as it is, if it is not known there."""
    found = _look_up(text)
    if found != text:
        return found
    for between in filter(text.__contains__, LISTS):
        parts = text.split(between)
        said = [tr_message(part) for part in parts]
        if all(one != part for one, part in zip(said, parts)):
            return between.join(said)
    sentence, values, named = _taken_apart(text)
    found = _look_up(sentence)
    return text if found == sentence else found.format(*values, **{name: tr_message(value) for name, value in named})


@lru_cache(1000)
def _taken_apart(text):
    """The sentence that a text is, with {} in place of its values, these, and ((name, value), ...) of those with names; of
    several the one that has most of its words. The text itself, if it is none."""
    for sentence, names, pattern in _sentences():
        match = pattern.fullmatch(text)
        if match:
            pairs = list(zip(names, match.groups()))
            return sentence, [v for name, v in pairs if not name], tuple((n, v) for n, v in pairs if n)
    return text, [], ()


@cache
def _sentences():
    """All sentences with values: each with the names of these, and its pattern. Those with most words come first."""
    found = []
    for sentence in filter(VALUE.search, GERMAN):
        parts = VALUE.split(sentence)
        pattern = "(.+?)".join(map(re.escape, parts[::2]))
        found.append((sum(map(len, parts[::2])), sentence, parts[1::2], re.compile(pattern, re.DOTALL)))
    return [row[1:] for row in sorted(found, key=lambda row: -row[0])]


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
