"""The errors that users see."""


class Refused(Exception):
    """The bake cannot start or cannot end well; the message names the object, what was found, and what to do."""


class Usage(Exception):
    """The command line asks for what cannot be had."""
