"""The one error type for what a user can cause and repair."""

LONGEST = 1000
"""Characters of a message; of a longer one, which quotes much of a damaged file, the middle is left out."""


class InputError(ValueError):
    """Something the user handed in cannot be used.

    The message is one sentence that names the file or field and the remedy. Every layer raises it;
    the command line prints it without a traceback and exits with code 2.
    """

    def __str__(self) -> str:
        text = super().__str__()
        return text if len(text) <= LONGEST else f"{text[: LONGEST // 2]} [...] {text[-LONGEST // 2 :]}"


def reason(error: BaseException) -> str:
    """What an error of another package says, in one line."""
    text = " ".join(str(error).split())
    return f"{text} is missing" if isinstance(error, KeyError) else text or type(error).__name__
