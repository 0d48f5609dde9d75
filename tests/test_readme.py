"""README.md is the page of a package index too, where only whole addresses lead somewhere."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
OWN = re.compile(r"https://(?:github\.com/keycld/keycld/blob|raw\.githubusercontent\.com/keycld/keycld)/main/([^#]+)")


def test_links_are_whole_and_lead_to_files() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)\s]+)\)", text) + re.findall(r"^\[[^\]]+\]: (\S+)$", text, re.MULTILINE)
    assert [link for link in links if not link.startswith("https://")] == []
    files = [found[1] for link in links if (found := OWN.match(link))]
    assert len(files) > 5
    assert [file for file in files if not (ROOT / file).is_file()] == []
