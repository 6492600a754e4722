"""The HTTP API under schemathesis: what its own description asks and much that it does not, none of it answered by an
undocumented status, media type or body, nor by a fault of the ground's own."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from conftest import PASSWORD, Guarded, System, running

import plumbline
from plumbline._http import COOKIE, OPERATOR

# Every operation is asked a little, and then for so many seconds whatever there is time for: with the ids that there are, with any.
EXAMPLES = 1
MORE_S = (15, 5)
CHECKS = (
    "not_a_server_error,status_code_conformance,content_type_conformance,response_headers_conformance,"
    "response_schema_conformance"
)
# Done last: an account makes everybody sign in, and a flight deleted is not there any more.
LAST = ("POST /api/v1/people", "DELETE /api/v1/flights/{id}")
# Asked a little is enough: it computes for seconds.
SLOW = ("POST /api/v1/envelope",)
PLAN = """
name = "one"
repeats = 1
[scenario]
duration_s = 12
rig = { hanging_strings = { mode = "flight", height_m = 0.3 } }
script = [{ at_s = 2, do = "arm" }, { at_s = 3, do = "mode", mode = "altitude_hold" }]
"""


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    """A ground of its own: much of what is asked of it changes it."""
    yield from running(tmp_path_factory.mktemp("fuzzed"))


def run(where: tuple[str | Path, ...], folder: Path, config: str, phases: str, *options: str) -> Counter[str]:
    """Lets schemathesis loose on the description that is there, fails with what it finds, and answers how often each operation was asked."""
    folder.mkdir()
    (folder / "schemathesis.toml").write_text(config)
    report = folder / "report.ndjson"
    command: list[str | Path] = [
        sys.executable, "-c", "import schemathesis.cli, sys; sys.exit(schemathesis.cli.schemathesis())",
        "run", *where, "--checks", CHECKS,
        "--phases", phases, "--max-examples", str(EXAMPLES), "--seed", "1", "--no-shrink", "--continue-on-failure",
        "--warnings", "off", "--suppress-health-check", "all", "--request-timeout", "120",
        "--report", "ndjson", "--report-ndjson-path", report, *options,
    ]  # fmt: skip
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=400)
    assert ran.returncode == 0, f"{ran.stdout[-6000:]}{ran.stderr[-2000:]}"
    asked: Counter[str] = Counter()
    for line in report.read_text().splitlines():
        recorder = json.loads(line).get("ScenarioFinished", {}).get("recorder", {})
        asked[recorder.get("label", "")] += len(recorder.get("interactions") or {})
    return +asked


def test_no_answer_is_a_fault_or_undocumented(fuzzed: System, tmp_path: Path) -> None:
    with plumbline.connect(fuzzed.url) as ground:
        with ground.vehicle().control() as fly:
            fly.record(True)
            time.sleep(1.5)
            flight = fly.flight_id
            fly.record(False)
        assert flight is not None
        ground.flight(flight).wait_complete()
        experiment = ground.run(PLAN).wait(timeout_s=60).id
    ids = (("vehicles", fuzzed.vehicle), ("flights", flight), ("experiments", experiment))
    config = "".join(
        f'[[operations]]\ninclude-path-regex = "^/api/v1/{kind}/"\nparameters = {{ "path.id" = {json.dumps(id)} }}\n'
        for kind, id in ids
    )
    only = [part for name in LAST for part in ("--include-name", name)]
    others = [part for name in LAST for part in ("--exclude-name", name)]
    quick = [*others, *(part for name in SLOW for part in ("--exclude-name", name))]
    known, any_ids = map(str, MORE_S)
    where = (f"{fuzzed.url}/api/v1/openapi.json",)
    asked = run(where, tmp_path / "each", config, "fuzzing", *others)
    asked += run(where, tmp_path / "known", config, "coverage", "--max-time", known, *quick)
    asked += run(where, tmp_path / "any", "", "coverage,fuzzing", "--max-time", any_ids, *quick)
    asked += run(where, tmp_path / "last", config, "coverage,fuzzing", *only)
    print(f"{asked.total()} requests")
    document = httpx.get(f"{fuzzed.url}/api/v1/openapi.json").json()
    described = {f"{method.upper()} {path}" for path, methods in document["paths"].items() for method in methods}
    # The description itself was read to begin with.
    assert described - asked.keys() <= {"GET /api/v1/openapi.json"}, "operations that were not asked"


def statuses(report: Path) -> Counter[int]:
    """How often each status was answered."""
    told: Counter[int] = Counter()
    for line in report.read_text().splitlines():
        recorder = json.loads(line).get("ScenarioFinished", {}).get("recorder", {})
        for interaction in (recorder.get("interactions") or {}).values():
            told[int(interaction["response"]["status_code"])] += 1
    return told


def test_accounts_and_roles_change_no_promise(guarded: Guarded, tmp_path: Path) -> None:
    """The same where people sign in: as an administrator (whose own session and account are left alone), a viewer, nobody."""
    tokens: dict[str, str | None] = {"nobody": None}
    for name in ("ann", "vic"):
        with plumbline.connect(guarded.url, certificate=guarded.certificate, name=name, password=PASSWORD) as ground:
            tokens[name] = ground.token
    description = tmp_path / "openapi.json"
    cookie = {"Cookie": f"{COOKIE}={tokens['ann']}"}
    description.write_bytes(httpx.get(f"{guarded.url}/api/v1/openapi.json", headers=cookie, verify=False).content)
    own = ("DELETE /api/v1/session", "DELETE /api/v1/sessions/{id}", "PATCH /api/v1/people/{id}", "DELETE /api/v1/people/{id}")
    left = [part for name in (*own, *SLOW) for part in ("--exclude-name", name)]
    where = (description, "--url", guarded.url, "--tls-verify", "false")
    told = {}
    for name, token in tokens.items():
        signed = f'[auth.openapi.session]\napi_key = "{token}"\n' if token else ""
        asked = run(where, tmp_path / name, signed, "fuzzing", "--header", f"Origin: {guarded.url}", "--header", f"{OPERATOR}: {name}", *left)
        told[name] = statuses(tmp_path / name / "report.ndjson")
        print(name, asked.total(), dict(told[name]))
    # What only admins, or only people, may do is refused to the others by its documented status; nothing else tells them apart.
    assert told["vic"][403] > 20 + told["ann"][403] and told["vic"][200] > 0, told
    assert max(told["ann"][401], told["vic"][401]) < 0.1 * told["ann"].total(), told
    assert told["nobody"][401] > 0.8 * told["nobody"].total(), told
