"""Options that cannot be understood, in one sentence in place of tyro's box."""

import ast
import difflib
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

WIDE = 100_000
"""Columns of the terminal that tyro is told of where it explains nothing, so that no line of its box is broken."""
KINDS = {"INT": ("a whole number", "whole numbers"), "FLOAT": ("a number", "numbers")}
"""What tyro calls values, and one and several of them in words."""
SIMILAR = 0.8
"""Likeness of two options, 0 to 1, from which on one may be meant by the other; so does tyro."""
COLOURS = re.compile(r"\x1b\[[0-9;]*m")
HELP = ("-h", "--help")


@contextmanager
def unbroken(words: Sequence[str]) -> Iterator[None]:
    """Without line breaks in what tyro complains of; its help keeps the width of the terminal."""
    if any(word in HELP for word in words):
        yield
        return
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = str(WIDE)
    try:
        yield
    finally:
        del os.environ["COLUMNS"]
        if before is not None:
            os.environ["COLUMNS"] = before


def sentence(box: str, command: str) -> str:
    """What is wrong with the options, what they take, and where that is explained.

    Args:
        box: what tyro has printed, with unbroken lines.
        command: `keycld` and the name of the command.
    """
    lines = _inside(box)
    pointed = re.findall(r"(keycld[\w ]*) --help$", "\n".join(lines), re.MULTILINE)
    command = pointed[-1] if pointed else command
    text = lines[0] if lines else "The options cannot be understood"
    for pattern, said in _SAID:
        if match := re.match(pattern, text):
            text = said(match, lines)
            break
    return f"{text.rstrip('.')}; see `{command} --help`."


def _inside(box: str) -> list[str]:
    """Lines of the box without its border, its rules and its colours; those of a list keep their indent."""
    lines = [line[2:-2].rstrip() for line in COLOURS.sub("", box).splitlines()[1:-1]]
    return [line for line in lines if line.strip("─- ")]


def _value(match: re.Match[str], lines: list[str]) -> str:
    """A value of another type: `--episodes two`."""
    name, reason = match.groups()
    given = re.search(r"instantiated from (\[.*\])\.$", reason)
    last = re.search(r": ('[^']*'|\"[^\"]*\")$", reason)
    values = ast.literal_eval(given[1]) if given else [ast.literal_eval(last[1])] if last else []
    at = lines.index("Argument helptext:") if "Argument helptext:" in lines else len(lines)
    taken = lines[at + 1].split(maxsplit=1)[-1] if at + 1 < len(lines) else ""
    return f"{name} takes {_in_words(taken)}" + (f", not {' '.join(values)!r}" if values else "")


def _in_words(taken: str) -> str:
    """`{None}|{FLOAT FLOAT}` as two numbers."""
    taken = taken.removeprefix("{None}|")
    kinds = taken.strip("{}[] .").replace("[", "").split()
    if not kinds or set(kinds) - KINDS.keys() or len(set(kinds)) > 1:
        return taken or "other values"
    one, several = KINDS[kinds[0]]
    if "[" in taken:
        return several
    return one if len(kinds) == 1 else f"{len(kinds)} {several}"


def _choice(match: re.Match[str], _: list[str]) -> str:
    """A word that is none of those that are known: `--to nothing`."""
    value, name, choices = match.groups()
    known = sorted(choice for choice in ast.literal_eval(choices) if choice != "None")
    return f"{name} takes {_alternatives(known)}, not {value}"


def _no_value(match: re.Match[str], _: list[str]) -> str:
    """The line ends where a value is expected: `--out`."""
    name, number = match.groups()
    return f"{name} needs {'a value' if number == '1' else f'{number} values'}"


def _subcommand(match: re.Match[str], _: list[str]) -> str:
    return f"A subcommand is missing: {_alternatives(match[1].split(', '))}"


def _missing(_: re.Match[str], lines: list[str]) -> str:
    """Options that are required, and beside them those that there are not."""
    rule = lines.index("Unrecognized options:") if "Unrecognized options:" in lines else len(lines)
    needed: list[str] = []
    for line in lines[:rule]:
        if line.startswith(" " * 8) and not needed[-1].startswith("-"):  # a value without a name: what it is
            needed[-1] += f" ({line.strip().removesuffix(' (required)').rstrip('.')})"
        elif line.startswith(" " * 4) and not line.startswith(" " * 8) and not line.strip().startswith("keycld "):
            needed.append(line.strip())
    text = f"{_alternatives(needed, 'and')} {'is' if len(needed) == 1 else 'are'} missing"
    unknown = [line.strip() for line in lines[rule + 1 :] if not line.strip().startswith(("keycld ", "For full "))]
    if unknown:
        names = [name.split()[0] for name in needed]
        similar = {word: difflib.get_close_matches(word, names, n=1, cutoff=SIMILAR) for word in unknown}
        text += f"; {_unknown(unknown, similar)}"
    return text


def _unrecognized(match: re.Match[str], lines: list[str]) -> str:
    """Options that there are not, and those that may have been meant."""
    words = match[1].split(", ")
    similar: dict[str, list[str]] = {}
    about = ""
    for line in lines[1:]:
        if line == "Perhaps you meant:":
            about = next(word for word in words if word.startswith("--"))
        elif of := re.match(r"Arguments similar to (.*):$", line):
            about = of[1]
        elif re.match(r" {4}-", line):
            similar.setdefault(about, []).append(line.split()[0].rstrip(","))
        elif known := re.match(r"Available subcommands: (.*)$", line):
            return f"There is no subcommand {words[0]!r}; there are {_alternatives(known[1].split(', '), 'and')}"
    return _unknown(words, similar).replace("there", "There", 1)


def _unknown(words: list[str], similar: dict[str, list[str]]) -> str:
    """Options among words that were not understood; their values are among them, too."""
    options = [word for word in words if re.match(r"--?[a-zA-Z]", word)]
    if not options:
        return f"there is no use for {' '.join(words)!r}"
    hints = [f"{w} (did you mean {_alternatives(similar[w])}?)" if similar.get(w) else w for w in options]
    return f"there is no option {_alternatives(hints)}"


def _alternatives(words: Sequence[str], link: str = "or") -> str:
    return f" {link} ".join(filter(None, (", ".join(words[:-1]), words[-1])))


_SAID: tuple[tuple[str, Callable[[re.Match[str], list[str]], str]], ...] = (
    (r"Error parsing ([^:]+): (.*)", _value),
    (r"invalid choice ('.*') for argument '(.*?)'\. Expected one of (\(.*\))", _choice),
    (r"Missing value for argument '(.*)'\. Expected (\d+) values", _no_value),
    (r"Expected one of \{(.*)\}", _subcommand),
    (r"Missing from ", _missing),
    (r"Unrecognized options: (.*)", _unrecognized),
)
"""What the first line of tyro's box looks like, and who makes a sentence of it; another stands as it is."""
