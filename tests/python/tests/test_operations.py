"""What an administrator's own tools say of a ground: promtool of its figures, systemd of the packaged units, and whether the
container file names what there is."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import httpx
import pytest
from conftest import BINARIES, ROOT, System


def test_promtool_finds_nothing_in_the_figures(system: System) -> None:
    promtool = os.environ.get("PLUMBLINE_PROMTOOL") or shutil.which("promtool")
    if not promtool:
        pytest.skip("promtool is not here: it is in Debian's package prometheus")
    figures = httpx.get(f"{system.url}/metrics").text
    for name in ("link_age_seconds", "recorder_queued_bytes", "tick", "decoder", "disk_free_bytes", "commands_waiting", "http_requests"):
        assert name in figures, f"no figure of {name}"
    checked = subprocess.run([promtool, "check", "metrics"], input=figures, capture_output=True, text=True)
    assert checked.returncode == 0 and not checked.stderr.strip(), checked.stdout + checked.stderr
    # It would have found what is wrong.
    wrong = subprocess.run([promtool, "check", "metrics"], input="a{ 1\n", capture_output=True, text=True)
    assert wrong.returncode != 0


@pytest.mark.parametrize("member", ["ground", "agent"])
def test_systemd_takes_the_packaged_unit(member: str, tmp_path: Path) -> None:
    analyze = shutil.which("systemd-analyze")
    if not analyze:
        pytest.skip("systemd-analyze is not here: it is in Debian's package systemd")
    name = f"plumbline-{member}"
    text = (ROOT / member / "package" / f"{name}.service").read_text()
    assert f"ExecStart=/usr/bin/{name} " in text and "Type=notify" in text
    unit = tmp_path / f"{name}.service"

    def said(text: str) -> str:
        unit.write_text(text.replace(f"/usr/bin/{name}", str(BINARIES.resolve() / name)))
        ran = subprocess.run([analyze, "verify", unit], capture_output=True, text=True)
        return (ran.stdout + ran.stderr).strip() + ("" if ran.returncode == 0 else f" rc {ran.returncode}")

    assert said(text) == ""
    assert "Nonsense" in said(text.replace("[Service]", "[Service]\nNonsense=1", 1)), "it would have found what is wrong"


def test_the_container_file_names_what_there_is() -> None:
    text = (ROOT / "Containerfile").read_text()
    steps = [line.split(maxsplit=1) for line in text.splitlines() if line and not line.startswith("#")]
    last = {word: rest for word, rest in steps}
    assert last["USER"] == "plumbline", "not as root"
    assert last["EXPOSE"].split() == ["4747/tcp", "4748/udp"]
    # Every option is one of the program, with the ports that are exposed.
    arguments = re.findall(r'"([^"]+)"', last["CMD"])
    help_text = subprocess.run([BINARIES / "plumbline-ground", "--help"], capture_output=True, text=True, check=True).stdout
    options = [argument for argument in arguments if argument.startswith("--")]
    assert options and all(option in help_text for option in options)
    assert {argument.rpartition(":")[2] for argument in arguments if ":" in argument} == {"4747", "4748"}
    built = re.search(r"--package (\S+)", text)
    assert built and (ROOT / built[1].removeprefix("plumbline-") / "Cargo.toml").exists()
