"""What would be uploaded: a wheel with everything that is needed, and an sdist of which the same wheel is built."""

import hashlib
import os
import re
import subprocess
import sys
import tarfile
import zipfile
from email import message_from_bytes
from email.message import Message
from importlib.metadata import version
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("keycld_envs", "keycld_model", "keycld_control")
NEEDED = [
    *(f"{package}/py.typed" for package in PACKAGES),
    *(f"keycld_model/weights/{system}/weights.safetensors" for system in ("acrobot", "cartpole", "pendulum")),
    "keycld_envs/assets/acrobot.xml",
    "keycld_envs/assets/NOTICE",
    "keycld_model/diagnosis/output/page/templates/page.html",
    "keycld_control/benchmarks/real/gates/G1.toml",
]
RUN = """
import keycld_envs, keycld_model
from keycld_control.cli import main
print(keycld_envs.__file__)
keycld_model.WorldModel.load("pendulum")
assert main(["--version"]) == 0
assert main(["systems", "--json"]) == 0
"""

pytest.importorskip("build")
pytest.importorskip("hatchling")


def build(source: Path, out: Path, kind: str) -> Path:
    """Build a "wheel" or "sdist" with the packages that are installed."""
    command = [sys.executable, "-m", "build", "--no-isolation", f"--{kind}", "--outdir", str(out), str(source)]
    subprocess.run(command, check=True, capture_output=True)
    (built,) = out.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return built


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(ROOT, tmp_path_factory.mktemp("wheel"), "wheel")


def metadata(wheel: Path) -> Message:
    with zipfile.ZipFile(wheel) as archive:
        return message_from_bytes(archive.read(f"keycld-{version('keycld')}.dist-info/METADATA"))


def test_wheel_holds_the_packages_and_nothing_else(wheel: Path) -> None:
    names = [name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name]
    assert set(NEEDED) <= set(names)
    listed = subprocess.run(["git", "ls-files", "-z", *PACKAGES], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode == 0:
        assert sorted(names) == sorted(name for name in listed.stdout.split("\0") if name)


def test_wheel_carries_both_licences(wheel: Path) -> None:
    folder = f"keycld-{version('keycld')}.dist-info/licenses"
    with zipfile.ZipFile(wheel) as archive:
        for name in ("LICENSE", "keycld_envs/assets/NOTICE"):
            assert archive.read(f"{folder}/{name}") == (ROOT / name).read_bytes()


@pytest.mark.long
def test_sdist_builds_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    sdist = build(ROOT, tmp_path, "sdist")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path, filter="data")
    again = build(tmp_path / sdist.name.removesuffix(".tar.gz"), tmp_path / "again", "wheel")
    assert again.name == wheel.name
    assert hashlib.sha256(again.read_bytes()).digest() == hashlib.sha256(wheel.read_bytes()).digest()


def test_extras_that_messages_name_exist(wheel: Path) -> None:
    sources = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    text = "\n".join(path.read_text(encoding="utf-8") for path in sources)
    named = {*re.findall(r"keycld\[(\w+)\]", text), *re.findall(r'optional\("[\w.]+", "(\w+)"', text)}
    assert {"sindy", "sysid"} <= named
    assert named <= set(metadata(wheel).get_all("Provides-Extra", []))


@pytest.mark.long
def test_wheel_runs_without_the_clone(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "site")}
    done = subprocess.run(
        [sys.executable, "-c", RUN], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    imported, named = done.stdout.splitlines()[:2]
    assert Path(imported).is_relative_to(tmp_path / "site")
    assert named == f"keycld {metadata(wheel)['Version']}"
