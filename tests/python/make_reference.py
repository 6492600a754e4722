"""Writes the reference at the end of `docs/python.md` from the package's own signatures and documentation."""

from __future__ import annotations

import inspect
from pathlib import Path

import plumbline
from plumbline import errors

MANUAL = Path(__file__).parents[2] / "docs" / "python.md"
BEGIN = "<!-- made by tests/python/make_reference.py -->"
CLASSES = ("Ground", "Vehicle", "Control", "Live", "Flight", "Flights", "Experiment")


def _signature(name: str, call: object) -> str:
    text = str(inspect.signature(call)).replace("'", "")  # type: ignore[arg-type]
    for long in ("models.", "plumbline.", "pandas.", "polars."):
        text = text.replace(long, "")
    return name + text.replace("(self, ", "(").replace("(self)", "()").split(" -> None")[0]


def _first(thing: object) -> str:
    return (inspect.getdoc(thing) or "").split("\n\n")[0].replace("\n", " ")


def reference() -> str:
    """The text behind the mark."""
    lines = [BEGIN, "", f"`plumbline.{_signature('connect', plumbline.connect)}`", "", f"{inspect.getdoc(plumbline.connect)}"]
    for name in CLASSES:
        kind = getattr(plumbline, name)
        lines += ["", f"### {name}", "", _first(kind), "", "| | |", "|---|---|"]
        for member, value in vars(kind).items():
            if member.startswith("_") or member == "path" or not (inspect.isfunction(value) or isinstance(value, property)):
                continue
            shown = member if isinstance(value, property) else _signature(member, value)
            lines.append(f"| `{shown.replace('|', chr(92) + '|')}` | {_first(value)} |")
    lines += ["", "### Errors", "", "All are `PlumblineError`; what the ground refuses is a `Problem`.", "", "| | |", "|---|---|"]
    own = [kind for kind in vars(errors).values() if inspect.isclass(kind) and issubclass(kind, errors.PlumblineError)]
    lines += [f"| `{kind.__name__}` | {_first(kind)} |" for kind in own]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    text = MANUAL.read_text()
    MANUAL.write_text(text.split(BEGIN)[0] + reference())
