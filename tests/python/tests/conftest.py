"""A ground with a simulated vehicle, and one with accounts and TLS: the programs that `PLUMBLINE_BINARIES` names, or target/debug."""

from __future__ import annotations

import os
import re
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

import plumbline

ROOT = Path(__file__).resolve().parents[3]
BINARIES = Path(os.environ.get("PLUMBLINE_BINARIES", ROOT / "target" / "debug"))
START_S = 20.0
PASSWORD = "a long enough password"


@dataclass
class Process:
    """A child, and the file that has what it says."""

    child: subprocess.Popen[bytes]
    log: Path

    def wait_for(self, pattern: str) -> str:
        until = time.monotonic() + START_S
        while time.monotonic() < until:
            found = re.search(pattern, self.log.read_text())
            if found:
                return found[1]
            assert self.child.poll() is None, self.log.read_text()
            time.sleep(0.02)
        raise AssertionError(f"{pattern!r} has not come:\n{self.log.read_text()}")

    def stop(self) -> None:
        self.child.terminate()
        try:
            self.child.wait(30)
        except subprocess.TimeoutExpired:
            self.child.kill()
            raise


def start(program: str, *arguments: str | Path, log: Path) -> Process:
    with log.open("wb") as output:
        child = subprocess.Popen([BINARIES / program, *arguments], stdout=output, stderr=output)
    return Process(child, log)


def read_when_there(path: Path) -> str:
    until = time.monotonic() + START_S
    while not (path.exists() and path.read_text().strip()):
        assert time.monotonic() < until, f"{path} has not appeared"
        time.sleep(0.02)
    return path.read_text().strip()


@dataclass
class System:
    """A ground with one vehicle."""

    url: str
    vehicle: str
    data: Path


@pytest.fixture(scope="session")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    yield from running(tmp_path_factory.mktemp("system"))


def running(folder: Path) -> Iterator[System]:
    """A ground and a simulated vehicle that is connected, until the iterator goes on."""
    data = folder / "ground"
    ground = start(
        "plumbline-ground", "--listen", "127.0.0.1:0", "--agent-listen", "127.0.0.1:0", "--data", data,
        log=folder / "ground.log",
    )  # fmt: skip
    url = ground.wait_for(r"Plumbline is at (http://[\d.:]+)/")
    link = ground.wait_for(r"agents connect to udp://([\d.:]+)")
    own = folder / "identity"
    trusted = read_when_there(data / "identity" / "fingerprint")
    subprocess.run(
        [BINARIES / "plumbline-agent", "identity", "--identity", own, "--trust", trusted], check=True, capture_output=True
    )
    (data / "identity" / "peers").write_text(f"{read_when_there(own / 'fingerprint')} iris-1\n")
    config = folder / "agent.toml"
    config.write_text(f'id = "iris-1"\nground = "{link}"\nidentity = "{own}"\n[log]\nfolder = "{folder / "log"}"\n')
    scenario = ROOT / "tests" / "scenarios" / "altitude_step.toml"
    agent = start(
        "plumbline-agent", "--config", config, "--vehicle", "sim", "--scenario", scenario, log=folder / "agent.log"
    )
    until = time.monotonic() + START_S
    with plumbline.connect(url) as there:
        while not any(vehicle["connected"] for vehicle in there.vehicles()):
            assert time.monotonic() < until, agent.log.read_text()
            time.sleep(0.05)
    yield System(url, "iris-1", data)
    agent.stop()
    ground.stop()


@pytest.fixture
def ground(system: System) -> Iterator[plumbline.Ground]:
    with plumbline.connect(system.url, operator="tests") as ground:
        yield ground


@dataclass
class Guarded:
    """A ground with the accounts ann (admin) and vic (viewer), by TLS."""

    url: str
    fingerprint: str
    certificate: Path


@pytest.fixture(scope="session")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    data = tmp_path_factory.mktemp("guarded")
    for name, role in (("ann", "admin"), ("vic", "viewer")):
        command: list[str | Path] = [BINARIES / "plumbline-ground", "account", "add", name, "--role", role, "--data", data]
        subprocess.run(command, input=f"{PASSWORD}\n".encode(), check=True, capture_output=True)
    ground = start(
        "plumbline-ground", "--listen", "127.0.0.1:0", "--agent-listen", "127.0.0.1:0", "--data", data, "--tls",
        log=data / "ground.log",
    )  # fmt: skip
    url = ground.wait_for(r"Plumbline is at (https://[\d.:]+)/")
    fingerprint = ground.wait_for(r"SHA-256 ([0-9A-F:]+)")
    yield Guarded(url, fingerprint, data / "tls" / "cert.pem")
    ground.stop()
