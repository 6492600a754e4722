"""What systemd is told by both programs where it starts them: that they are ready, and then that they go on."""

from __future__ import annotations

import os
import socket
import subprocess
import time
from pathlib import Path

import pytest
from conftest import BINARIES, ROOT

GROUND = ["plumbline-ground", "--listen", "127.0.0.1:0", "--agent-listen", "127.0.0.1:0", "--data", "data"]
AGENT = ["plumbline-agent", "--vehicle", "sim", "--ground", "none", "--log", "log", "--identity", "identity", "--scenario"]


@pytest.mark.parametrize("command", [GROUND, [*AGENT, str(ROOT / "tests/scenarios/altitude_step.toml")]])
def test_it_says_that_it_is_ready_and_that_it_goes_on(command: list[str], tmp_path: Path) -> None:
    address = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(address)
        systemd.settimeout(20)
        # Three times in this time it has to say that it goes on.
        environment = {**os.environ, "NOTIFY_SOCKET": address, "WATCHDOG_USEC": "900000"}
        child = subprocess.Popen([BINARIES / command[0], *command[1:]], cwd=tmp_path, env=environment)
        try:
            assert systemd.recv(100).strip() == b"READY=1"
            heard = [time.monotonic()]
            for _ in range(4):
                assert systemd.recv(100).strip() == b"WATCHDOG=1"
                heard.append(time.monotonic())
            assert max(b - a for a, b in zip(heard, heard[1:])) < 0.9
        finally:
            child.terminate()
            child.wait(30)
