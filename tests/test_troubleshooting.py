"""The page of error sentences: each is one that the code can say."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text()
SENTENCES = re.findall(r"^### `(.+)`$", PAGE, re.MULTILINE)
CODE = "\n".join(p.read_text() for package in ROOT.glob("keycld_*") for p in package.rglob("*.py"))
ONE_LINE = re.sub(r'"\s*\n\s*f?"', "", CODE)


def test_there_are_sentences() -> None:
    assert len(SENTENCES) >= 10


@pytest.mark.parametrize("sentence", SENTENCES)
def test_the_code_says_it(sentence: str) -> None:
    assert sentence in ONE_LINE
