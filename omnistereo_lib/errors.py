"""The one error that the library raises for bad input."""


class OmnistereoError(ValueError):
    """Bad input, said so that a person can act on it.

    The message names what was given (the file, where there is one), what was found in it, what was expected and what
    to do. The command line prints it as one plain line; everything else that escapes is a bug.
    """
