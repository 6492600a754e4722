"""TLS towards a ground that makes its own certificate: the one whose fingerprint it prints, and no other."""

from __future__ import annotations

import hashlib
import socket
import ssl
from pathlib import Path

from .errors import PlumblineError, Unreachable


class Untrusted(PlumblineError):
    """The ground shows another certificate than the one that is trusted."""


def _plain(fingerprint: str) -> str:
    return fingerprint.lower().removeprefix("sha256:").replace(":", "").strip()


def pinned(host: str, port: int, fingerprint: str, timeout_s: float) -> ssl.SSLContext:
    """Trusts the one certificate with this SHA-256, as `plumbline-ground` prints it at its start.

    The certificate shown now is compared, and then is the only root that later connections trust: a certificate that
    is exchanged afterwards is refused by TLS itself. Nothing is sent before the comparison.
    """
    unchecked = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    unchecked.check_hostname = False
    unchecked.verify_mode = ssl.CERT_NONE
    try:
        with socket.create_connection((host, port), timeout_s) as raw:
            with unchecked.wrap_socket(raw, server_hostname=host) as tls:
                shown = tls.getpeercert(binary_form=True) or b""
    except OSError as error:
        raise Unreachable(f"{host}:{port}: {error}") from error
    found = hashlib.sha256(shown).hexdigest()
    if found != _plain(fingerprint):
        raise Untrusted(f"{host}:{port} shows the certificate {found}, not {_plain(fingerprint)}")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    # The certificate itself is the trust: whatever names it stands for, and whoever signed it.
    context.check_hostname = False
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    context.load_verify_locations(cadata=ssl.DER_cert_to_PEM_cert(shown))
    return context


def from_file(certificate: str | Path) -> ssl.SSLContext:
    """Trusts the certificates of a PEM file, `DATA/tls/cert.pem` say, for the names they stand for."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(cafile=str(certificate))
    return context
