"""Flying, watching and reading back, on the simulator."""

from __future__ import annotations

import runpy
import tarfile
import time
from pathlib import Path

import jupytext
import nbclient
import pandas
import polars
import pytest
from conftest import System

import plumbline
from plumbline import v1

EXAMPLES = Path(__file__).parents[1] / "examples"


NOTEBOOKS = sorted(path.name for path in EXAMPLES.glob("*.py") if "\n# %%" in path.read_text())
SCRIPTS = sorted(path.name for path in EXAMPLES.glob("*.py") if path.name not in NOTEBOOKS)


@pytest.mark.parametrize("name", SCRIPTS)
def test_an_example_runs_top_to_bottom(
    name: str, system: System, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PLUMBLINE_URL", system.url)
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    assert capsys.readouterr().out, "an example shows something"


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_top_to_bottom_in_jupyter(
    name: str, system: System, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PLUMBLINE_URL", system.url)
    notebook = jupytext.read(EXAMPLES / name)
    assert len(notebook.cells) > 1, "it has cells"
    place = {"metadata": {"path": str(tmp_path)}}
    # A cell that raises ends it with the cell's traceback.
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3", resources=place).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any(output["output_type"] in ("stream", "display_data", "execute_result") for output in shown), shown


def test_a_flight_under_attack_is_streamed_and_read_back_as_both_frames(ground: plumbline.Ground, tmp_path: Path) -> None:
    with ground.vehicle().control() as fly:
        fly.wait_ready()
        fly.arm()
        fly.mode("altitude_hold")
        fly.setpoint(altitude_m=0.6)
        fly.wait_altitude(0.6)
        fly.attack([{"sensor": "height", "instance": 2, "kind": "bias", "start_s": 0.5, "duration_s": 2.0, "magnitude": 0.3}])
        fly.wait(v1.AttackState, lambda state: any(a.phase == v1.ATTACK_PHASE_ACTIVE for a in state.attacks))
        heights = list(fly.live.stream(v1.HeightSample, instance=2, seconds=1.0))
        assert len(heights) > 5 and {height.topic for height in heights} == {"/sensor/height/2"}
        assert [h.sequence for h in heights] == sorted(h.sequence for h in heights)
        alive = fly.live.alive_sent
        fly.land()
        assert fly.live.alive_sent > alive > 0, "each status is answered"
        flight_id = fly.flight_id
    assert ground.vehicle().lease().get("holder") is None, "the lease is given back"
    assert flight_id is not None
    flight = ground.flight(flight_id).wait_complete()
    assert flight.info["attacks"][0]["kind"] == "bias"
    names = ["control.armed", "control.mode", "height_2", "attacks", "events"]
    frame, same = flight.to_pandas(names, rate_hz=0), flight.to_polars(names, rate_hz=0)
    assert list(frame.columns) == same.columns and len(frame) == same.height > 500
    assert frame.attrs["units"]["height_2.sensed_m"] == "m"
    assert frame["control.armed"].any() and same["control.mode"].n_unique() >= 2
    attacked = frame[frame["attacks.active"] > 0]
    error = (attacked["height_2.received_m"] - attacked["height_2.sensed_m"]).iloc[20]
    assert abs(error - 0.3) < 1e-6
    evidence = flight.to_pandas(["residuals_9.height_2", "secure", "status.mode", "attacks.active"], rate_hz=0)
    ratio = evidence["residuals_9.height_2.height.ratio"]
    assert ratio[evidence["attacks.active"] > 0].max() > 2 * ratio[evidence["attacks.active"] == 0].median()
    assert evidence.attrs["units"]["residuals_9.height_2.height.innovation_m"] == "m"
    assert {"secure.height_2.flagged", "secure.height.margin", "secure.height_bound_m", "status.mode"} <= set(evidence.columns)
    assert evidence["secure.height_2.flagged"].any(), "excluded while it is attacked"
    part = flight.to_polars(names, from_s=2.0, to_s=3.0, rate_hz=10)
    assert 9 <= part.height <= 11

    flight.label(name="read back", notes="by a test")
    listed = ground.flights("read back")
    assert [found.id for found in listed] == [flight.id] and isinstance(listed[:1], plumbline.Flights)
    table: pandas.DataFrame = listed.to_pandas()
    assert table.loc[0, "name"] == "read back"
    rows: polars.DataFrame = listed.to_polars()
    assert rows["completeness"].to_list() == ["complete"]
    for kind in ("mcap", "csv", "mat", "ros2", "foxglove"):
        assert flight.download(tmp_path, kind).stat().st_size > 1000
    assert not list(tmp_path.glob("*.unfinished"))
    tar = ground.archive([flight], tmp_path / "flights.tar")
    assert tar.stat().st_size > flight.info["size_bytes"]
    with tarfile.open(ground.archive([flight], tmp_path / "tables.tar", format="parquet")) as tables:
        assert tables.getnames()[0] == f"{flight.id}.parquet"


def test_a_recording_is_taken_in_once(ground: plumbline.Ground, tmp_path: Path) -> None:
    header = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2,mx_uT,my_uT,mz_uT"
    header += ",ref_qw,ref_qx,ref_qy,ref_qz,ref_px_m,ref_py_m,ref_pz_m,movement\n"
    rows = (f"{k / 100},0,0,0,0,0,9.81,0,20,-40,1,0,0,0,0,0,0.5,1\n" for k in range(500))
    table = tmp_path / "at rest.csv"
    table.write_text(header + "".join(rows))
    flight = ground.import_recording(table)
    assert flight.info["name"] == "at rest.csv" and flight.info["notes"].startswith("imported from at rest.csv (broad)")
    assert any(name.startswith("estimate_1.") for name in flight.to_polars(rate_hz=10).columns)
    assert ground.import_recording(table).id == flight.id
    copy = flight.download(tmp_path)
    flight.delete()
    assert ground.import_recording(copy).id == flight.id, "a flight that was deleted comes back from its file"
    with pytest.raises(plumbline.Invalid, match="notes.txt: a file that begins with"):
        (tmp_path / "notes.txt").write_text("hello")
        ground.import_recording(tmp_path / "notes.txt")


def test_what_goes_wrong_in_a_block_lands_the_vehicle(ground: plumbline.Ground) -> None:
    with pytest.raises(RuntimeError, match="mine"):
        with ground.vehicle().control() as fly:
            fly.wait_ready()
            fly.arm()
            fly.mode("altitude_hold")
            fly.setpoint(altitude_m=0.5)
            fly.wait_altitude(0.5)
            raise RuntimeError("mine")
    assert ground.vehicles()[0]["armed"] is False


def test_a_script_that_does_nothing_is_not_taken_for_an_operator(ground: plumbline.Ground) -> None:
    with ground.vehicle().control(patience_s=0.5) as fly:
        fly.wait_ready()
        fly.arm()
        fly.mode("altitude_hold")
        fly.setpoint(altitude_m=0.5)
        fly.wait_altitude(0.5)
        time.sleep(1.0)
        sent = fly.live.alive_sent
        time.sleep(1.0)
        assert fly.live.alive_sent == sent, "its patience is over"
        deadline = time.monotonic() + 5
        while (status := fly.live.latest(v1.Status)) is None or status.failsafe != v1.FAILSAFE_OPERATOR_FREEZE:
            assert time.monotonic() < deadline, status
            time.sleep(0.05)
        fly.setpoint(altitude_m=0.5)
        fly.wait(v1.Status, lambda status: status.failsafe == v1.FAILSAFE_NONE)


def test_gains_are_pushed_examined_and_reverted(ground: plumbline.Ground) -> None:
    vehicle = ground.vehicle()
    before = vehicle.gains()
    with vehicle.control() as fly:
        weight = list(before["state_weight"] or [])
        weight[2] *= 1.2
        effort = list(before["input_weight"] or [])
        answer = fly.gains({"controller": "lqr_integral", "state_weight": weight, "input_weight": effort})
        revision = answer["revision"]
        in_use = fly.wait(v1.GainsInUse, lambda gains: gains.revision == revision)
        assert abs(in_use.weights.state_weight[2] - weight[2]) < 1e-9
        with pytest.raises(plumbline.Rejected) as refused:
            fly.gains({"controller": "lqr_integral", "state_weight": [1e9 * w for w in weight], "input_weight": effort})
        assert refused.value.revision is not None and refused.value.detail
        fly.gains({"controller": "lqr_integral", "state_weight": before["state_weight"], "input_weight": effort})
        again = fly.revert_gains()["revision"]
        in_use = fly.wait(v1.GainsInUse, lambda gains: gains.revision == again)
        assert abs(in_use.weights.state_weight[2] - weight[2]) < 1e-9


def test_one_operator_at_a_time(system: System, ground: plumbline.Ground) -> None:
    vehicle = ground.vehicle(system.vehicle)
    with vehicle.control():
        with plumbline.connect(system.url, operator="other") as other:
            with pytest.raises(plumbline.Held) as held, other.vehicle().control():
                pass
            assert held.value.holder == "tests"
            with other.vehicle().control(take_over=True) as theirs, pytest.raises(plumbline.Held) as lost:
                with plumbline.connect(system.url, operator="tests") as again:
                    again._connection.json("POST", vehicle.path("disarm"))
                theirs.status()
            assert lost.value.holder == "other"


def test_a_link_that_breaks_is_opened_again(ground: plumbline.Ground) -> None:
    with ground.vehicle().live() as live:
        live.wait(v1.Status, lambda _: True)
        live._socket.socket.shutdown(2)
        since = time.monotonic()
        while live.reconnected == 0:
            assert time.monotonic() - since < 5
            time.sleep(0.02)
        newest = live.newest_us or 0
        live.wait(v1.Control, lambda control: control.time_us > newest)
    assert live.closed


def test_waiting_ends_with_its_time_and_says_what_it_saw(ground: plumbline.Ground) -> None:
    with ground.vehicle().live() as live:
        with pytest.raises(plumbline.TimedOut, match="no Status as wanted within 0.3 s"):
            live.wait(v1.Status, lambda status: status.armed, 0.3)
        with pytest.raises(TypeError, match="Vector3"):
            live.latest(v1.Vector3)
