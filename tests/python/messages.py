"""Makes `plumbline.v1`, the messages of the contract with their types, from `proto/schema` when the wheel is built."""

from __future__ import annotations

import shutil
import tempfile
from importlib.resources import files
from pathlib import Path
from typing import Any

from grpc_tools import protoc
from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "plumbline/v1"


def schema(root: Path) -> Path:
    """The schema beside an unpacked source distribution, or in the repository."""
    for folder in (root / "schema", root.parent.parent / "proto" / "schema"):
        if (folder / PACKAGE).is_dir():
            return folder
    raise FileNotFoundError(f"no schema ({PACKAGE}/*.proto) beside {root} or in proto/schema")


def compile_messages(source: Path, target: Path) -> None:
    """Writes a module and its types for each file of the schema, and one that has all of them."""
    names = sorted(path.stem for path in (source / PACKAGE).glob("*.proto"))
    known = files("grpc_tools") / "_proto"
    arguments = ["protoc", f"-I{source}", f"-I{known}", f"--python_out={target}", f"--pyi_out={target}"]
    if protoc.main([*arguments, *(f"{PACKAGE}/{name}.proto" for name in names)]) != 0:
        raise RuntimeError(f"protoc refuses the schema in {source}")
    for types in (target / PACKAGE).glob("*.pyi"):
        # protoc leaves the types of a message given as a mapping open, which a strict reader refuses.
        text = types.read_text().replace(", _Mapping]", ", _Mapping[str, _Any]]")
        types.write_text("from typing import Any as _Any\n" + text)
    lines = [f"from plumbline.v1.{name}_pb2 import *" for name in names]
    text = '"""The messages of the contract, made from its schema."""\n\n' + "\n".join(lines) + "\n"
    (target / PACKAGE / "__init__.py").write_text(text)


class CustomBuildHook(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the messages to the wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        self.made = Path(tempfile.mkdtemp())
        compile_messages(schema(Path(self.root)), self.made)
        build_data["force_include"][str(self.made / PACKAGE)] = PACKAGE

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        shutil.rmtree(self.made, ignore_errors=True)
