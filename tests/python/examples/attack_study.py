# %% [markdown]
# # A height under attack, as the estimator sees it
# One flight: the vehicle hovers, height 2 is given a bias of half a metre, and the flight is read back.

# %%
import os

import matplotlib.pyplot as plt

import plumbline

ground = plumbline.connect(os.environ.get("PLUMBLINE_URL", "http://127.0.0.1:4747"))

# %% [markdown]
# Whatever happens in the block, the vehicle lands at its end.

# %%
with ground.vehicle().control() as fly:
    fly.wait_ready()
    fly.arm()
    fly.mode("altitude_hold")
    fly.setpoint(altitude_m=0.6)
    fly.wait_altitude(0.6)
    fly.attack(
        [{"sensor": "height", "instance": 2, "kind": "bias", "start_s": 1.0, "duration_s": 3.0, "magnitude": 0.5}]
    )
    fly.wait_attacked()
    fly.land()
    flight_id = fly.flight_id

# %% [markdown]
# The table of the flight, with units in `attrs`; the heights as sensed and as received.

# %%
assert flight_id is not None
flight = ground.flight(flight_id).wait_complete()
frame = flight.to_pandas(columns=["height_2", "estimate_1.position_enu_m.z", "truth.position_enu_m.z", "attacks"], rate_hz=0)
attacked = frame["attacks.active"] > 0
error = frame["estimate_1.position_enu_m.z"] - frame["truth.position_enu_m.z"]
print(f"rms of the altitude's error: {(error[attacked] ** 2).mean() ** 0.5:.3f} m under attack, "
      f"{(error[~attacked] ** 2).mean() ** 0.5:.3f} m without")

# %%
figure, axes = plt.subplots()
for name in ("height_2.received_m", "height_2.sensed_m", "estimate_1.position_enu_m.z"):
    axes.plot(frame["time_s"], frame[name], label=name)
axes.set(xlabel="time, s", ylabel="m")
axes.legend()
figure.savefig("attack.png")

# %%
ground.close()
