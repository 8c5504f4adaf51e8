"""Every public promise has a test, and every hazard a control with code and a test."""

import re
from pathlib import Path

import pytest

import promises

ROOT = Path(__file__).parents[2]
HAZARDS = (ROOT / "docs" / "hazards.md").read_text(encoding="utf-8")
_TEST = re.compile(r"`([\w/]+\.py::test_\w+)`")


def test_every_promise_stands_on_its_page_and_has_tests_that_exist():
    assert list(promises.holes()) == []


def test_a_promise_without_a_test_or_words_is_found(monkeypatch):
    wrong = [
        {"page": "README.md", "says": "glissando estimates the pose", "tests": []},
        {"page": "README.md", "says": "makes coffee", "tests": ["io/test_export.py::test_nothing"]},
    ]
    monkeypatch.setitem(promises.TABLE, "promise", wrong)
    assert [hole.rpartition(": ")[2] for hole in promises.holes()] == [
        "no test shows it",
        "these words do not stand there",
        "there is no test io/test_export.py::test_nothing",
    ]


def test_every_row_of_the_readme_and_every_page_makes_a_promise():
    said = {}
    for promise in promises.TABLE["promise"]:
        said.setdefault(promise["page"], []).append(promise["says"])
    rows = re.findall(r"^\| (?!\||-)(.*) \|$", (ROOT / "README.md").read_text(), re.M)
    assert len(rows) >= 20
    for row in rows:
        shown = any(words in row for words in said["README.md"])
        assert shown, f"tests/promises.toml has no promise of README's row {row[:60]!r}"
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    pages = set(re.findall(r"[\w./-]+\.md", navigation))
    without = set(promises.TABLE["none"])
    assert pages - said.keys() == without, "pages without a promise in tests/promises.toml"
    assert not without & said.keys()


def test_the_matrix_shows_every_promise():
    page = promises.matrix_page()
    for promise in promises.TABLE["promise"]:
        assert all(test.partition("::")[2] in page for test in promise["tests"])
    assert page.count("\n| [") == len(promises.TABLE["promise"])


@pytest.mark.slow
def test_every_hazard_has_controls_whose_code_and_tests_exist():
    assert HAZARDS.count("not a medical device") == 1
    sections = re.split(r"^## ", HAZARDS, flags=re.M)[1:]
    assert len(sections) >= 8
    for section in sections:
        rows = [line.split(" | ") for line in re.findall(r"^\| (.*) \|$", section, re.M)[1:]]
        assert len(rows) >= 4, section[:40]
        assert section.startswith("SOUP") or "*Residual risk*" in section
        for _, code, tests in rows:
            for file in re.findall(r"`([\w/]+\.py)`", code) or [f"{code} names no file"]:
                assert (ROOT / "src" / "glissando" / file).is_file(), file
            for test in _TEST.findall(tests) or [f"{tests} names no test"]:
                assert promises.is_there(test), test
