"""The one exception that a user can cause and repair."""


class InputError(ValueError):
    """Something the user handed in cannot be used.

    The message is one sentence that names the file or field and the remedy. Every layer raises it;
    the command line prints it without a traceback and exits with code 2.
    """
