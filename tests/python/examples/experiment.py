# %% [markdown]
# # From which size on is a bias found?
# A small plan over two estimators, flown by the ground on all cores but one, and its results as a Polars frame. The report of
# the ground has the same with intervals and comparisons; every dot in it opens its flight.

# %%
import os

import polars as pl

import plumbline

ground = plumbline.connect(os.environ.get("PLUMBLINE_URL", "http://127.0.0.1:4747"))

PLAN = """
name = "bias-by-estimator"
repeats = 2
seed = 100
[scenario]
duration_s = 40
suite = { preset = "string_rig" }
rig = { hanging_strings = { mode = "flight", height_m = 0.3 } }
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
key = "agent.estimators.in_loop"
values = ["ekf_bias", "secure"]
[[factor]]
key = "attack.magnitude"
values = [0.05, 0.5]
"""

# %%
size = ground.size(PLAN)
print(f"{size['conditions']} conditions, {size['flights']} flights, about {size['expected_s']:.0f} s")

# %%
experiment = ground.run(PLAN).wait(progress=lambda state: print(f"{state['done']} of {state['flights']}"))

# %%
frame = experiment.to_polars()
table = (
    frame.group_by("agent.estimators.in_loop", "attack.magnitude")
    .agg(pl.col("altitude_m").median(), (pl.col("missed") == 0).mean().alias("detected"))
    .sort("agent.estimators.in_loop", "attack.magnitude")
)
print(table)

# %% [markdown]
# The worst flight, flown again from its seed and recorded as any other.

# %%
worst = frame.sort("altitude_m", descending=True, nulls_last=True).row(0, named=True)
flight = experiment.fly_again(worst["index"])
print(flight)
experiment.report("report.html")
ground.close()
