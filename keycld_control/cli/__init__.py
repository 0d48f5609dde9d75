"""The `keycld` command.

A command is one module of this package, named like the command, with a frozen dataclass `Args`, which becomes its
command line, and a function `run(args)`, which may return an exit code. Its module docstring is its line in
`keycld --help`. Only the module of the command in use is imported.

Exit codes: 0, 2 for input that cannot be used (one sentence on stderr), 130 after Ctrl-C, 141 if the reader of the
output has left; `diagnose` has 10 for missing physics and 11 for recordings that cannot tell, `real` 1 for a gate
that is not reached.
"""

import ast
import difflib
import errno
import importlib
import multiprocessing
import os
import pkgutil
import select
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, suppress
from importlib.util import find_spec
from io import StringIO
from types import FrameType
from typing import NoReturn

from keycld_control import __version__

REFUSED = 2
"""Exit code for input that cannot be used, of tyro as well."""
INTERRUPTED = 130
"""Exit code after Ctrl-C, 128 + SIGINT's 2."""
PATIENCE = 2.0
"""Seconds from Ctrl-C until the process ends, even if it has not cleaned up."""
SOON = 0.02
"""Seconds until an interrupt is tried again that came at a moment when it cannot be raised."""
_pressed = threading.Event()
READER_LEFT = 141
"""Exit code of a program that SIGPIPE ends, 128 + 13."""
WITHOUT_MUJOCO = ("completion", "doctor")
"""Commands that do without; `doctor` says what is wrong where it cannot be imported."""
UNWRITABLE = (
    errno.ENOENT,
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
    errno.ENOSPC,
    errno.EEXIST,
    errno.ENOTDIR,
    errno.ENAMETOOLONG,
)
"""Errors of files that another place, or room, remedies."""


def console() -> NoReturn:
    """The `keycld` program: one command, and the end of the process.

    Ctrl-C ends it with 130 within three seconds, whatever it is doing and wherever it is pressed again.
    """
    signal.signal(signal.SIGINT, _interrupt)
    sys.warnoptions.append("ignore:resource_tracker:UserWarning")  # what it gives back for processes that were ended
    try:
        code = main()
    except BaseException:  # libraries that are being imported make others of a KeyboardInterrupt
        if not _pressed.is_set():
            raise
        code = _interrupted()
    if code == INTERRUPTED or _pressed.is_set():
        _leave()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # what was asked for is done; Python would end by the signal
    sys.exit(code)


def _interrupt(_: int, frame: FrameType | None) -> None:
    """Let what is being done clean up, once; leave if that takes too long."""
    if not _pressed.is_set():
        _pressed.set()
        watch = threading.Timer(PATIENCE, lambda: (_interrupted(), _leave()))
        watch.daemon = True
        watch.start()
    if _unready(frame):
        signal.signal(signal.SIGALRM, _interrupt)
        signal.setitimer(signal.ITIMER_REAL, SOON)
        return
    for number in (signal.SIGINT, signal.SIGALRM):
        signal.signal(number, lambda *_: None)  # not SIG_IGN: Python prints a line about signals that wait
    raise KeyboardInterrupt


def _unready(frame: FrameType | None) -> bool:
    """Whether an exception would be lost, break a library, or leave a process half started."""
    while frame is not None:
        code, frame = frame.f_code, frame.f_back
        if code.co_name == "_xla_gc_callback" or code.co_filename.startswith("<frozen importlib"):
            return True
        if os.path.basename(code.co_filename).startswith("popen_"):  # of multiprocessing
            return True
    return False


def _interrupted() -> int:
    print("keycld: interrupted", file=sys.stderr)
    return INTERRUPTED


def _leave() -> NoReturn:
    """End at once: libraries that are still drawing or reckoning in threads crash when Python takes them down."""
    for child in multiprocessing.active_children():
        child.kill()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(INTERRUPTED)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: the words after `keycld`; None reads them from the shell.

    Returns:
        The exit code.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        try:
            return _run(words)
        finally:
            sys.stdout.flush()
    except KeyboardInterrupt:
        return _interrupted()
    except BrokenPipeError:
        if not _reader_left():
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what Python writes when it ends
        return READER_LEFT
    except SystemExit as end:  # so Rich ends where its output finds no reader
        if not isinstance(end.__context__, BrokenPipeError):
            raise
        return READER_LEFT


def command_names() -> list[str]:
    """All commands: the public modules of this package."""
    return sorted(m.name for m in pkgutil.iter_modules(__path__) if not m.name.startswith("_"))


def _run(words: list[str]) -> int:
    name = words[0] if words else "--help"
    if name in ("-h", "--help"):
        print(_overview())
        return 0
    if name == "--version":
        print(f"keycld {__version__}")
        return 0
    if name not in command_names():
        similar = difflib.get_close_matches(name, command_names(), n=1)
        hint = f"did you mean {similar[0]!r}?" if similar else f"there are {', '.join(command_names())}."
        print(f"keycld: There is no command {name!r}; {hint}", file=sys.stderr)
        return REFUSED
    if (here := os.getcwd()) not in sys.path:
        sys.path.append(here)  # where modules with systems of one's own lie
    import tyro  # not above: until then, Ctrl-C is not yet handled

    command = importlib.import_module(f"{__name__}.{name}")
    with _in_one_sentence(name, words[1:]):
        args = tyro.cli(command.Args, prog=f"keycld {name}", args=words[1:], config=(tyro.conf.FlagCreatePairsOff,))
    try:
        if name not in WITHOUT_MUJOCO:
            importlib.import_module("keycld_envs")  # chooses an OpenGL that is there, before others import MuJoCo
            importlib.import_module("mujoco").set_mju_user_warning(lambda _: None)  # our own sentence follows
        code = command.run(args)
    except _input_errors() as error:
        print(f"keycld: {error}", file=sys.stderr)
        return REFUSED
    except OSError as error:
        if error.errno not in UNWRITABLE:
            raise
        print(f"keycld: {_why_not_written(error)}", file=sys.stderr)
        return REFUSED
    return code or 0


@contextmanager
def _in_one_sentence(name: str, options: Sequence[str]) -> Iterator[None]:
    """What tyro has to say of options that it refuses."""
    from keycld_control.cli._usage import sentence, unbroken

    said, refused = StringIO(), False
    try:
        with unbroken(options), redirect_stderr(said):
            yield
    except SystemExit as end:
        refused = end.code == REFUSED
        raise
    finally:
        text = said.getvalue()
        print(f"keycld: {sentence(text, f'keycld {name}')}\n" if refused else text, end="", file=sys.stderr)


def _why_not_written(error: OSError) -> str:
    """What has gone wrong with a file, and the remedy."""
    if error.errno == errno.ENOENT and error.filename is None:
        return "The folder that this command was started in is not there any more; change to another."
    what = f"{error.filename or 'The disk'} cannot be written: {error.strerror}"
    return f"{what}; name another place, or make room there."


def _reader_left() -> bool:
    """Whether nobody reads stdout any more, as after `| head`; a pipe to another process may have broken instead."""
    poll = select.poll()
    poll.register(sys.stdout, 0)
    return bool(poll.poll(0))


def _input_errors() -> tuple[type[Exception], ...]:
    """`InputError`, if a command got so far as to import it; `doctor` works where keycld_envs does not."""
    errors = sys.modules.get("keycld_envs.errors")
    return (errors.InputError,) if errors else ()


def _overview() -> str:
    lines = ["usage: keycld COMMAND [OPTIONS]", ""]
    for name in command_names():
        spec = find_spec(f"{__name__}.{name}")
        assert spec is not None and spec.origin is not None
        with open(spec.origin, encoding="utf-8") as file:
            doc = ast.get_docstring(ast.parse(file.read())) or ""
        lines.append(f"  {name:<10} {doc.splitlines()[0]}")
    return "\n".join([*lines, "", "keycld COMMAND --help explains the options of a command."])
