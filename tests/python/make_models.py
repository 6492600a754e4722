"""Writes `src/plumbline/models.py` from the description of the API that a running ground serves.

    python make_models.py http://127.0.0.1:4747

datamodel-code-generator, because it makes plain `TypedDict`s: bodies stay the JSON they are, an older package reads a newer
ground, and nothing is needed at run time. A test holds the file against the ground it runs with.
"""

from __future__ import annotations

import json
import sys
import tempfile
import urllib.request
from pathlib import Path

from datamodel_code_generator.__main__ import main

MODELS = Path(__file__).parent / "src" / "plumbline" / "models.py"
HEAD = '"""Bodies of the HTTP API, made by `make_models.py` from its description: not edited by hand."""'
OPTIONS = [
    "--input-file-type=openapi",
    "--output-model-type=typing.TypedDict",
    "--target-python-version=3.10",
    "--use-schema-description",
    "--use-single-line-docstring",
    "--use-union-operator",
    "--use-standard-collections",
    "--enum-field-as-literal=all",
    "--no-use-closed-typed-dict",
    "--disable-timestamp",
    "--formatters=builtin",
    f"--custom-file-header={HEAD}",
]


def models(url: str) -> str:
    """What the file has to hold for the ground at this address."""
    with urllib.request.urlopen(f"{url}/api/v1/openapi.json") as answer:
        description = json.load(answer)
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, "openapi.json"), Path(folder, "models.py")
        source.write_text(json.dumps(description))
        ended = main(["--input", str(source), "--output", str(target), *OPTIONS])
        if ended != 0:
            raise RuntimeError(f"datamodel-code-generator ended with {ended}")
        return target.read_text()


if __name__ == "__main__":
    MODELS.write_text(models(sys.argv[1].rstrip("/")))
