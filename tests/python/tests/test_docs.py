"""`docs/python.md` is run: its Python as one script, its commands of the ground as they stand, its reference as it is made."""

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


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


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
