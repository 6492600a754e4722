"""Flies an altitude step and reads it back: the same script on the simulator and on the vehicle.

    cargo xtask run                      # in another terminal
    python tests/python/examples/step.py
"""

import os

import plumbline

with plumbline.connect(os.environ.get("PLUMBLINE_URL", "http://127.0.0.1:4747")) as ground:
    with ground.vehicle().control() as fly:
        fly.wait_ready()
        fly.arm()
        fly.mode("altitude_hold")
        fly.setpoint(altitude_m=0.5)
        fly.wait_altitude(0.5)
        fly.setpoint(altitude_m=0.8)
        fly.wait_altitude(0.8)
        fly.land()
        flight_id = fly.flight_id

    assert flight_id is not None
    flight = ground.flight(flight_id).wait_complete()
    frame = flight.to_pandas(columns=["control.setpoint.altitude_m", "estimate_1.position_enu_m.z", "truth"])
    for step in flight.info["steps"]:
        print(f"{step['from_m']:.1f} m to {step['to_m']:.1f} m: overshoot {step['overshoot_percent']:.0f} %")
    print(f"{flight.id}: {len(frame)} rows, highest {frame['estimate_1.position_enu_m.z'].max():.2f} m")
