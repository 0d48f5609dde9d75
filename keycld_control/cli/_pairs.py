"""Options of the form NAME=VALUE, given once for each name."""

from collections.abc import Iterable

from keycld_envs.errors import InputError


def pairs(option: str, words: Iterable[str], value: str = "COLUMN", example: str = "hinge=angle") -> dict[str, str]:
    """NAME=VALUE words as a dictionary.

    Raises:
        InputError: if a word is no pair, or a name is there twice.
    """
    out: dict[str, str] = {}
    for word in words:
        name, equals, given = word.partition("=")
        if not (name and equals and given):
            raise InputError(f"{option} {word!r} is not NAME={value}; write, for instance, {option} {example}.")
        if name in out:
            raise InputError(f"{option} names {name!r} twice; name each once.")
        out[name] = given
    return out
