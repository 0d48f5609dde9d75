"""Completion of all commands, as a shell runs it."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from keycld_control.cli import command_names, main
from keycld_control.cli.completion import script

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


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_have_every_command(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell, "--json"]) == 0
    written = json.loads(capsys.readouterr().out)["script"]
    assert all(name in written for name in command_names())
    assert "render-quality" in written
