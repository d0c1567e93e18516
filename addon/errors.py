"""The one error that users see."""


class Refused(Exception):
    """The bake cannot start or cannot end well; the message names the object, what was found, and what to do."""
