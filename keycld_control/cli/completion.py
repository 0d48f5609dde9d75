"""Print the completion of all commands and options for a shell."""

from dataclasses import dataclass
from typing import Literal

from tyro.conf import Positional

FILES = {
    "bash": ('COMPREPLY=($(compgen -f -- "$cur"))', "COMPREPLY=()"),
    "zsh": ('if [[ "$completions" == "__TYRO', 'if [[ -z "$completions" || "$completions" == "__TYRO'),
    "fish": (
        'if test "$results" = __TYRO',
        'set -l word (commandline -ct)\n    if not string match -q -- "$word*" $results; or test "$results" = __TYRO',
    ),
}
"""Shell -> (how tyro's script completes paths, what stands in its place, for words that nothing completes as well)."""
REGISTERED = """
# What is no command, option or choice is a file, which bash completes by itself.
_keycld() {
  _tyro_keycld "$@"
  [[ -n "${COMPREPLY[*]}" ]] || COMPREPLY=()
}
complete -o bashdefault -o default -F _keycld keycld"""
"""End of the script for bash."""


@dataclass(frozen=True)
class Args:
    """Print the completion of all commands, options, choices and files for a shell.

    bash: keycld completion bash > ~/.local/share/bash-completion/completions/keycld

    zsh: keycld completion zsh > FOLDER/_keycld, with FOLDER in $fpath

    fish: keycld completion fish > ~/.config/fish/completions/keycld.fish

    Attributes:
        shell: Whose completion.
        json: Print one JSON object, with the script in it.
    """

    shell: Positional[Literal["bash", "zsh", "fish"]]
    json: bool = False


def run(args: Args) -> None:
    """Print the script."""
    from keycld_control.cli._output import print_result

    text = script(args.shell)
    if args.json:
        print_result({"shell": args.shell, "script": text}, as_json=True)
    else:
        print(text)


def script(shell: str) -> str:
    """The completion of the whole `keycld`, as tyro writes it for one program with a subcommand for each command.

    Tyro completes files behind options only; here, also where a command takes them without an option.
    """
    import contextlib
    import importlib
    import io

    import tyro

    from keycld_control.cli import command_names

    commands = {name: importlib.import_module(f"keycld_control.cli.{name}").Args for name in command_names()}
    written = io.StringIO()
    with contextlib.redirect_stdout(written), contextlib.suppress(SystemExit):
        tyro.extras.subcommand_cli_from_dict(
            commands,
            prog="keycld",
            args=["--tyro-print-completion", shell],
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes),
        )
    text = written.getvalue().strip().replace(*FILES[shell])
    return text + "\n" + REGISTERED if shell == "bash" else text
