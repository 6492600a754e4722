"""The package and the ground say the same."""

from __future__ import annotations

import struct
import sys

import pytest
from conftest import ROOT, System

from plumbline import live

sys.path.insert(0, str(ROOT / "tests" / "python"))
import make_models  # noqa: E402


def test_the_models_are_those_of_the_ground(system: System) -> None:
    made = make_models.models(system.url)
    assert made == make_models.MODELS.read_text(), f"run: python tests/python/make_models.py {system.url}"


def test_the_kinds_are_those_of_the_schema() -> None:
    lines = (ROOT / "proto" / "tests" / "snapshots" / "kinds.txt").read_text().split("\n")
    expected = {}
    for line in filter(None, lines):
        number, _, topic, message = line.split()
        expected[int(number)] = (topic.removesuffix("/2"), message, topic.endswith("/2"))
    ours = {number: (topic, message.DESCRIPTOR.full_name, many) for number, (topic, message, many) in live.KINDS.items()}
    assert ours == expected


def frame(kind: int, payload: bytes, length: int | None = None) -> bytes:
    return struct.pack("<HHIQQ", kind, 1, len(payload) if length is None else length, 7, 8) + payload


def test_batches_are_taken_apart_and_damaged_ones_refused() -> None:
    batch = b"\x50\x01" + frame(30, b"abc") + frame(999, b"")
    assert [(f.kind, f.sequence, f.payload) for f in live.frames(batch)] == [(30, 7, b"abc"), (999, 7, b"")]
    assert list(live.frames(b"\x50\x01")) == []
    for damaged, named in (
        (b"", "begins no batch"),
        (b"\x51\x01", "begins no batch"),
        (b"\x50\x02", "schema 2"),
        (batch[:10], "cut off"),
        (batch[:-25], "cut off"),
        (b"\x50\x01" + frame(1, b"abc", 4), "cut off"),
    ):
        with pytest.raises(ValueError, match=named):
            list(live.frames(damaged))
