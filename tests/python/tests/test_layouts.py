"""The layouts for Foxglove and PlotJuggler show what there is: every topic and field they name, by the schema."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from typing import Any

from conftest import ROOT

import plumbline
from plumbline import live

# Made by the ground of ours, in Foxglove's own schemas.
FOXGLOVES = {"/tf", "/scene", "/log"}


def message_of(topic: str) -> Any:
    """The descriptor of a topic's message, `/estimate/9` say."""
    for kind, message, many in live.KINDS.values():
        if re.fullmatch(rf"{kind}/\d+" if many else kind, topic):
            return message.DESCRIPTOR
    raise AssertionError(f"there is no topic {topic}")


def check(topic: str, path: list[str]) -> None:
    """Follows a path of fields; one in brackets needs a list."""
    descriptor = message_of(topic)
    for step in path:
        name, bracket, _ = step.partition("[")
        assert descriptor is not None and name in descriptor.fields_by_name, f"{topic} has no {'.'.join(path)}"
        field = descriptor.fields_by_name[name]
        assert bool(bracket) == field.is_repeated, f"{topic}: {step}"
        descriptor = field.message_type


def test_the_layout_of_plotjuggler() -> None:
    curves = [curve.attrib["name"] for curve in ElementTree.parse(ROOT / "docs" / "plotjuggler.xml").iter("curve")]
    assert len(curves) > 15
    for curve in curves:
        found = re.match(r"/(?:sensor/[a-z_]+/\d+|(?:estimate|residuals)/\d+|[a-z]+)", curve)
        assert found, curve
        check(found[0], curve[found.end() + 1 :].split("/"))


def test_the_layout_of_foxglove() -> None:
    layout = json.loads((ROOT / "docs" / "foxglove.json").read_text())
    panels = layout["configById"]
    shown = set(re.findall(r'"((?:3D|Plot|StateTransitions|RosOut|Parameters|CallService)![a-z]+)"', json.dumps(layout["layout"])))
    assert shown == panels.keys(), "every panel is shown once"
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    assert len(paths) > 8
    for path in paths:
        topic, _, fields = path.partition(".")
        check(topic, re.sub(r"\{[^}]*\}", "", fields).split("."))
    named = {panels["RosOut!events"]["topicToRender"], *panels["3D!vehicle"]["topics"]}
    assert named <= FOXGLOVES
    for panel in panels.values():
        if request := panel.get("requestPayload"):
            assert isinstance(json.loads(request), dict)


def test_foxglove_is_given_an_address(ground: plumbline.Ground) -> None:
    address = ground.vehicle().foxglove_address()
    assert address["url"] == f"{ground.url.replace('http', 'ws', 1)}/api/v1/vehicles/{ground.vehicle().id}/foxglove"
    assert address["valid_s"] is None, "nobody signs in"
