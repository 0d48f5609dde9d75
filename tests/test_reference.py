"""The reference has a place for every package of public names."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")


def public() -> set[str]:
    """Modules that say what is public in them; the benchmarks may change without notice."""
    found = set()
    for package in ("keycld_envs", "keycld_model", "keycld_control"):
        for path in (ROOT / package).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            if "benchmarks" not in parts and "\n__all__ = " in path.read_text(encoding="utf-8"):
                found.add(".".join(parts).removesuffix(".__init__"))
    return found


def test_every_public_name_is_in_the_reference() -> None:
    shown = set(re.findall(r"^\.\. automodule:: (\S+)$", PAGE, re.MULTILINE))
    shown |= {name.rpartition(".")[0] for name in re.findall(r"^\.\. autoclass:: (\S+)$", PAGE, re.MULTILINE)}
    assert len(public()) > 15
    assert public() - shown == set()
