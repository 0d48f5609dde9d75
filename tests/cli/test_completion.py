"""Completion of all commands, as a shell runs it."""

import json
import os
import pty
import shutil
import subprocess
from pathlib import Path

import pytest

from keycld_control.cli import command_names, main
from keycld_control.cli.completion import FILES, script

BASH = """source {script}
COMP_WORDS=({words}); COMP_CWORD=$(( ${{#COMP_WORDS[@]}} - 1 )); COMPREPLY=(); _tyro_keycld; echo "${{COMPREPLY[*]}}"
"""


@pytest.fixture(scope="module")
def bash(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("completion") / "keycld.bash"
    path.write_text(script("bash"))
    return path


def completed(path: Path, words: str) -> set[str]:
    if shutil.which("bash") is None:
        pytest.skip("there is no bash")
    code = BASH.format(script=path, words=words)
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_bash_completes_commands_options_and_choices(bash: Path) -> None:
    assert completed(bash, 'keycld ""') >= set(command_names())
    assert completed(bash, "keycld co") == {name for name in command_names() if name.startswith("co")}
    assert completed(bash, "keycld collect acrobot --ep") == {"--episodes"}
    assert completed(bash, 'keycld collect acrobot --render-quality ""') == {"fast", "full"}
    assert completed(bash, "keycld delan tr") == {"train"}


def typed(path: Path, line: str) -> list[str]:
    """The words that an interactive bash runs `keycld` with, after the line and Tab have been typed."""
    if shutil.which("bash") is None:
        pytest.skip("there is no bash")
    shown, terminal = pty.openpty()
    environment = {"PATH": os.environ["PATH"], "PS1": "", "TERM": "dumb", "INPUTRC": "/dev/null"}
    code = f"source {path}; keycld() {{ printf '%s\\n' \"$@\" >words; exit; }}\n{line}\t\n"
    with subprocess.Popen(
        ["bash", "--norc", "--noprofile", "-i"],
        **dict.fromkeys(("stdin", "stdout", "stderr"), terminal),
        cwd=path.parent,
        env=environment,
        start_new_session=True,
    ) as shell:
        os.write(shown, code.encode())
        shell.wait(timeout=60)
    os.close(terminal)
    os.close(shown)
    return (path.parent / "words").read_text().splitlines()


def test_bash_completes_files(bash: Path) -> None:
    for name in ("pendulum log.csv", "my_arm.py", "zen/data_set", "runs_of_mine"):
        (bash.parent / name).mkdir(parents=True)
    assert typed(bash, "keycld import pe") == ["import", "pendulum log.csv/"]
    assert typed(bash, "keycld check my") == ["check", "my_arm.py/"]
    assert typed(bash, "keycld export zen/d") == ["export", "zen/data_set/"]
    assert typed(bash, "keycld runs --json r") == ["runs", "--json", "runs_of_mine/"]
    assert typed(bash, "keycld import x.csv --out pe") == ["import", "x.csv", "--out", "pendulum log.csv/"]
    assert typed(bash, "keycld collect acrobot --ep") == ["collect", "acrobot", "--episodes"]
    assert typed(bash, "keycld compl") == ["completion"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_words_that_nothing_completes_are_files(shell: str) -> None:
    before, after = FILES[shell]
    assert before not in script(shell)
    assert script(shell).count(after) >= 1


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_have_every_command(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell, "--json"]) == 0
    written = json.loads(capsys.readouterr().out)["script"]
    assert all(name in written for name in command_names())
    assert "render-quality" in written
