"""What is refused, and how it is told: every code of the ground is an exception of its own."""

from __future__ import annotations

import re
import socket
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest
from conftest import PASSWORD, ROOT, Guarded, System

import plumbline
from plumbline import errors


def test_every_code_of_the_ground_is_an_exception() -> None:
    text = (ROOT / "ground" / "src" / "api" / "error.rs").read_text()
    codes = set(re.findall(r'\(StatusCode::\w+, "(\w+)"\)', text))
    assert len(codes) >= 15 and codes == set(errors.BY_CODE)


def test_a_refusal_has_code_detail_and_number(ground: plumbline.Ground) -> None:
    with pytest.raises(plumbline.NotFound) as missing:
        ground.flight("none")
    assert missing.value.status == 404 and "none" in missing.value.detail and missing.value.request_id
    with pytest.raises(plumbline.NotFound, match="iris-9"):
        ground.vehicle("iris-9")
    with pytest.raises(plumbline.Invalid, match="colour"):
        ground.flights(sort="colour")
    with pytest.raises(plumbline.Invalid, match="line|TOML|expected"):
        ground.size("no plan")
    with ground.vehicle().control() as fly:
        with pytest.raises(plumbline.Invalid, match="sideways"):
            fly.mode("sideways")
        with pytest.raises(plumbline.Invalid, match="no field"):
            fly.setpoint()
        with pytest.raises(plumbline.Rejected) as refused:
            fly.mode("hold")
        assert refused.value.command_id


def test_nobody_there(system: System) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        with pytest.raises(plumbline.Unreachable, match="127.0.0.1"):
            plumbline.connect(f"http://127.0.0.1:{free.getsockname()[1]}", timeout_s=2)
    for odd in ("iris", "ftp://127.0.0.1", "http://", "http://127.0.0.1:1/api"):
        with pytest.raises(ValueError, match="no address of a ground"):
            plumbline.connect(odd)
    with pytest.raises(ValueError, match="not served by TLS"):
        plumbline.connect(system.url, fingerprint="00")


def test_another_server_is_no_ground() -> None:
    class Other(BaseHTTPRequestHandler):
        status = 200

        def do_GET(self) -> None:
            self.send_response(self.status)
            self.send_header("Content-Type", "application/problem+json")
            self.end_headers()
            self.wfile.write(b"<html>")

        def log_message(self, format: str, *args: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Other) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}"
        with pytest.raises(plumbline.Unreachable, match="no ground"):
            plumbline.connect(url)
        Other.status = 502
        with pytest.raises(plumbline.Problem, match="502") as odd:
            plumbline.connect(url)
        assert odd.value.status == 502
        server.shutdown()


def test_accounts_roles_and_tokens(guarded: Guarded) -> None:
    with pytest.raises(plumbline.SignInNeeded):
        plumbline.connect(guarded.url, fingerprint=guarded.fingerprint)
    with pytest.raises(plumbline.SignInNeeded, match="wrong"):
        plumbline.connect(guarded.url, fingerprint=guarded.fingerprint, name="ann", password="not this one")
    with plumbline.connect(guarded.url, fingerprint=guarded.fingerprint, name="ann", password=PASSWORD) as ground:
        assert ground.session()["name"] == "ann" and ground.session()["role"] == "admin"
        with plumbline.connect(guarded.url, certificate=guarded.certificate, token=ground.token) as same:
            assert same.session()["name"] == "ann"
            same.sign_out()
        with pytest.raises(plumbline.SignInNeeded):
            ground.info()
    with plumbline.connect(guarded.url, fingerprint=guarded.fingerprint, name="vic", password=PASSWORD) as viewer:
        with pytest.raises(plumbline.Forbidden, match="viewer"):
            viewer.run("name = 'x'")


def test_another_certificate_is_not_spoken_to(guarded: Guarded) -> None:
    with pytest.raises(plumbline.Untrusted, match="shows the certificate"):
        plumbline.connect(guarded.url, fingerprint="AA:" * 31 + "AA", name="ann", password=PASSWORD)
    with pytest.raises(plumbline.Unreachable, match="(?i)certificate"):
        plumbline.connect(guarded.url, name="ann", password=PASSWORD)
