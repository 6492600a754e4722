"""The docs are run. `docs/python.md`: its Python as one script, its commands of the ground as they stand, its reference as it is
made. Each chapter of the book: its commands and its Python in their order, in one folder."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import BINARIES, ROOT, System

sys.path.insert(0, str(ROOT / "tests" / "python"))
import make_reference  # noqa: E402

TEXT = (ROOT / "docs" / "python.md").read_text()


BOOK = ROOT / "docs" / "book"
CHAPTERS = sorted(BOOK.glob("*.md"))
LINK = re.compile(r"\]\(([^)#\s]+)(#[^)\s]+)?\)")
# `cargo xtask` builds everything, which whoever runs this test has done: its arguments are read, and it ends there.
CARGO = """#!/bin/sh
test "$1" = xtask || { echo "cargo $*: not of the book" >&2; exit 1; }
shift
exec "$XTASK" "$@" --help >/dev/null
"""


def fences(text: str) -> list[tuple[str, str]]:
    return re.findall(r"^```(\w+)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def blocks(language: str) -> list[str]:
    return [block for found, block in fences(TEXT) if found == language]


def test_the_python_of_the_manual_runs(system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = blocks("python")
    assert len(found) >= 5
    names: dict[str, object] = {}
    for block in found:
        exec(compile(block.replace("http://127.0.0.1:4747", system.url), "docs/python.md", "exec"), names)


def test_the_commands_of_the_manual_run(system: System, tmp_path: Path) -> None:
    (tmp_path / "data").symlink_to(system.data)
    lines = [line for block in blocks("sh") for line in block.splitlines() if line.startswith("plumbline-ground")]
    assert lines
    for line in lines:
        program, *arguments = shlex.split(line, comments=True)
        ran = subprocess.run([BINARIES / program, *arguments], cwd=tmp_path, env=os.environ, capture_output=True, text=True)
        expected = 1 if "restore" in arguments else 0
        assert ran.returncode == expected, f"{line}: {ran.stdout}{ran.stderr}"
        # The ground runs: it is refused, and says why.
        assert not expected or "in use by another ground" in ran.stderr


def test_the_reference_is_that_of_the_package() -> None:
    assert make_reference.reference() in TEXT, "run: python tests/python/make_reference.py"


@pytest.mark.parametrize("chapter", CHAPTERS, ids=lambda chapter: chapter.stem)
def test_a_chapter_of_the_book_runs(
    chapter: Path, system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    tools = tmp_path / ".tools"
    tools.mkdir()
    (tools / "cargo").write_text(CARGO)
    (tools / "cargo").chmod(0o755)
    path = os.pathsep.join(map(str, (tools, BINARIES.resolve(), Path(sys.executable).parent, os.environ["PATH"])))
    environment = os.environ | {"PATH": path, "XTASK": str(BINARIES.resolve() / "xtask")}
    names: dict[str, object] = {}
    for language, block in fences(chapter.read_text()):
        block = block.replace("http://127.0.0.1:4747", system.url)
        if language == "python":
            exec(compile(block, str(chapter), "exec"), names)
        elif language == "sh":
            command = ["bash", "-euo", "pipefail", "-c", block]
            ran = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
            assert ran.returncode == 0, f"{chapter.name}:\n{block}\n{ran.stdout}{ran.stderr}"


def test_a_command_that_fails_would_be_seen(system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for wrong in ("cargo xtask run --no-such-option", "plumbline-agent estimate --no-such-option", "cargo build"):
        chapter = tmp_path / "wrong.md"
        chapter.write_text(f"```sh\n{wrong}\n```\n")
        folder = tmp_path / wrong.replace(" ", "-")
        folder.mkdir()
        with pytest.raises(AssertionError, match="wrong.md"):
            test_a_chapter_of_the_book_runs(chapter, system, folder, monkeypatch)


def anchors(page: Path) -> set[str]:
    heads = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads]
    return {f"#{head}" for head in plain}


def test_every_page_and_picture_that_the_docs_name_is_there() -> None:
    pages = [ROOT / "README.md", ROOT / "ARCHITECTURE.md", *(ROOT / "docs").glob("*.md"), *CHAPTERS]
    for page in pages:
        for target, anchor in LINK.findall(page.read_text()):
            if "://" in target:
                continue
            there = page.parent / target
            assert there.exists(), f"{page.relative_to(ROOT)} names {target}"
            if anchor and there.suffix == ".md":
                assert anchor in anchors(there), f"{page.relative_to(ROOT)} names {target}{anchor}"
    contents = (BOOK / "README.md").read_text()
    assert all(chapter.name in contents for chapter in CHAPTERS if chapter.name != "README.md"), "the contents lack a chapter"
