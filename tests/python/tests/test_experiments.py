"""Experiments: flown, stopped, read as frames, and a flight of them flown again."""

from __future__ import annotations

from pathlib import Path

import pytest

import plumbline
from plumbline import models

PLAN = """
name = "python"
repeats = 3
seed = 7
[scenario]
duration_s = 40
suite = { preset = "string_rig" }
[scenario.rig.hanging_strings]
mode = "flight"
height_m = 0.3
[[scenario.script]]
at_s = 2
do = "arm"
[[scenario.script]]
at_s = 3
do = "mode"
mode = "altitude_hold"
[[scenario.script]]
at_s = 4
do = "setpoint"
altitude_m = 0.8
[attack]
sensor = "height"
kind = "bias"
[[factor]]
key = "attack.magnitude"
values = [0.1, 0.5]
"""


def test_a_plan_is_flown_read_reported_and_opened(ground: plumbline.Ground, tmp_path: Path) -> None:
    size = ground.size(PLAN)
    assert (size["conditions"], size["flights"]) == (2, 6)
    seen: list[models.State] = []
    experiment = ground.run(PLAN).wait(timeout_s=120, progress=seen.append)
    assert experiment.state["done"] == 6 and seen[-1]["done"] == 6
    assert ground.run(PLAN).wait(timeout_s=30).id == experiment.id, "the same plan is the same experiment"
    frame, same = experiment.to_pandas(), experiment.to_polars()
    assert len(frame) == same.height == 6 and set(frame["attack.magnitude"]) == {0.1, 0.5}
    flights = list(experiment.flights())
    assert [flight["index"] for flight in flights] == list(range(6))
    assert [f["index"] for f in experiment.flights(condition=flights[0]["condition"])] != []
    assert "python" in experiment.report(tmp_path / "report.html").read_text()
    assert experiment.plan().strip() == PLAN.strip()
    flight = experiment.fly_again(flights[0]["index"])
    assert flight.info["duration_s"] > 5 and len(flight.to_polars(columns=["control"])) > 100
    assert experiment.id in [known.id for known in ground.experiments()]
    assert ground.experiment(experiment.id).state["flights"] == 6


AGAIN = """
name = "again"
[[factor]]
key = "recording"
values = ["{flight}"]
[[factor]]
key = "agent.estimators.in_loop"
values = ["ekf_bias", "lanes"]
"""


def test_a_recorded_flight_is_flown_again_under_other_estimators(ground: plumbline.Ground) -> None:
    flight = ground.run(PLAN).wait(timeout_s=120).fly_again(1)
    experiment = ground.run(AGAIN.format(flight=flight.id)).wait(timeout_s=120)
    frame = experiment.to_polars().sort("index")
    assert frame["recording"].to_list() == [flight.id] * 2
    assert frame["altitude_m"].n_unique() == 1, "the way flown is that of then"
    assert frame["estimate_m"].n_unique() == 2 and frame["estimate_m"].null_count() == 0
    assert "Recordings flown again" in experiment.results()["notes"][0]
    assert experiment.fly_again(1).info["vehicle"] == "replay"


BY_HAND = """
name = "by_hand"
[by_hand]
vehicle = "{vehicle}"
altitude_m = [0.5, 0.8]
"""


def test_a_flight_by_hand_counts_when_it_is_accepted(ground: plumbline.Ground) -> None:
    flight = ground.run(PLAN).wait(timeout_s=120).fly_again(2)
    experiment = ground.run(BY_HAND.format(vehicle=flight.info["vehicle_id"]))
    assert experiment.state["by_hand"] and not experiment.state["running"]
    following = experiment.by_hand()["next"]
    assert following is not None
    index = following["index"]
    with pytest.raises(plumbline.Invalid, match="say why the flight is void"):
        experiment.say(index, flight, accepted=False)
    assert experiment.say(index, flight, accepted=False, reason="a gust")["said"][-1]["reason"] == "a gust"
    assert experiment.say(index, flight, accepted=True)["next"] is None
    (condition,) = experiment.results()["conditions"]
    altitude = condition["measures"][0]
    assert altitude is not None and altitude["count"] == 1
    assert experiment.fly_again(index).id == flight.id, "its dot is the recording"
