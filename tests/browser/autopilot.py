"""A PX4 autopilot's double, by pymavlink: flies a rigid body and keeps PX4's documented rules of offboard mode.

- Offboard mode is refused until setpoints came at more than 2 Hz for one second.
- In offboard mode half a second without a setpoint ends it: the double lands by itself.
- Arming is refused outside offboard mode here, disarming in the air unless it is forced.
- Only SET_ATTITUDE_TARGET with body rates and thrust, for this system, counts as a setpoint.

Usage: autopilot.py PORT [AUTOPILOT [PILOT]]. A pilot takes over PILOT seconds after it was armed, if at all. Speaks to 127.0.0.1:PORT until its standard input ends, then prints what it saw as JSON.
"""

import json
import math
import os
import random
import select
import sys
import time

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil

mav = mavutil.mavlink
link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{sys.argv[1]}", source_system=1, source_component=1)
AUTOPILOT = int(sys.argv[2]) if len(sys.argv) > 2 else mav.MAV_AUTOPILOT_PX4
PILOT_S = float(sys.argv[3]) if len(sys.argv) > 3 else math.inf
HOVER, RATE_LOOP_S, G, STEP_S = 0.4, 0.05, 9.81, 0.0025
OFFBOARD, LAND = 6 << 16, (4 << 16) | (6 << 24)
FORCE = 21196
BOOTED_US = 7_000_000
random.seed(1)

position, velocity, rates = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]  # ENU, ENU, FRD
q = [1.0, 0.0, 0.0, 0.0]  # NED from FRD
thrust, target = 0.0, ((0.0, 0.0, 0.0), 0.0)
armed, armed_s, mode = False, math.inf, 0
setpoints, intervals = [], {}
seen = {"refused": 0, "wrong_setpoints": 0, "heartbeats": 0, "timesync_ms": None, "left_offboard": 0, "gap_max_s": 0.0,
        "disarmed_by_force": 0, "setpoints_in_offboard": 0, "altitudes": [], "modes": [], "first_offboard_s": None}


def turned(v):
    """A vector of the body in NED."""
    w, x, y, z = q
    return [
        (1 - 2 * (y * y + z * z)) * v[0] + 2 * (x * y - w * z) * v[1] + 2 * (x * z + w * y) * v[2],
        2 * (x * y + w * z) * v[0] + (1 - 2 * (x * x + z * z)) * v[1] + 2 * (y * z - w * x) * v[2],
        2 * (x * z - w * y) * v[0] + 2 * (y * z + w * x) * v[1] + (1 - 2 * (x * x + y * y)) * v[2],
    ]


def fly(dt):
    """One step of the body; returns the specific force in FRD."""
    global q, thrust
    wanted, level = target if armed else ((0.0, 0.0, 0.0), 0.0)
    thrust += (level - thrust) * min(1.0, dt / 0.03)
    for axis in range(3):
        rates[axis] += (wanted[axis] - rates[axis]) * dt / RATE_LOOP_S
    lift = thrust / HOVER * G
    down = turned([0.0, 0.0, -lift])
    force = [down[1], down[0], -down[2]]  # ENU
    force = [f - 0.2 * v for f, v in zip(force, velocity)]
    stands = position[2] <= 0.0 and force[2] < G
    if stands:
        rates[:], velocity[:], position[2] = [0.0] * 3, [0.0] * 3, 0.0
        q = [math.cos(yaw() / 2), 0.0, 0.0, math.sin(yaw() / 2)]
        return [0.0, 0.0, -G]
    for axis in range(3):
        velocity[axis] += (force[axis] - (G if axis == 2 else 0.0)) * dt
        position[axis] += velocity[axis] * dt
    w, x, y, z = q
    p, r, s = (rate * dt / 2 for rate in rates)
    q = [w - x * p - y * r - z * s, x + w * p + y * s - z * r, y + w * r + z * p - x * s, z + w * s + x * r - y * p]
    norm = math.sqrt(sum(c * c for c in q))
    q = [c / norm for c in q]
    # Of what is not weight, in FRD: the conjugate turns NED into FRD.
    north, east, below = force[1], force[0], -force[2]
    w, x, y, z = q[0], -q[1], -q[2], -q[3]
    own, q = q, [w, x, y, z]
    felt = turned([north, east, below])
    q = own
    return felt


def yaw():
    w, x, y, z = q
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def enter(new, now):
    global mode
    mode = new
    seen["modes"].append([round(now, 3), new])
    beat()


def beat():
    flags = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mav.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    link.mav.heartbeat_send(mav.MAV_TYPE_QUADROTOR, AUTOPILOT, flags, mode, mav.MAV_STATE_ACTIVE)


def order(message, now):
    """PX4's answers to the commands that a companion gives."""
    global armed, armed_s
    accepted = mav.MAV_RESULT_ACCEPTED
    result = mav.MAV_RESULT_DENIED
    if message.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
        intervals[int(message.param1)] = message.param2 * 1e-6
        result = accepted
    elif message.command == mav.MAV_CMD_DO_SET_MODE and int(message.param2) == 6:
        streams = [t for t in setpoints if now - t < 1.1]
        if streams and now - streams[0] >= 1.0 and max(b - a for a, b in zip(streams, streams[1:])) < 0.5:
            result = accepted
            seen["first_offboard_s"] = seen["first_offboard_s"] or round(now, 3)
            enter(OFFBOARD, now)
        else:
            result = mav.MAV_RESULT_TEMPORARILY_REJECTED
    elif message.command == mav.MAV_CMD_COMPONENT_ARM_DISARM:
        if message.param1 == 1.0 and mode == OFFBOARD:
            armed, armed_s, result = True, now, accepted
        elif message.param1 == 0.0 and (position[2] < 0.05 or message.param2 == FORCE):
            seen["disarmed_by_force"] += int(armed and position[2] >= 0.05)
            armed, result = False, accepted
    if result != accepted:
        seen["refused"] += 1
    link.mav.command_ack_send(message.command, result)
    beat()


def hear(message, now):
    global target
    kind = message.get_type()
    if kind == "HEARTBEAT":
        seen["heartbeats"] += 1
    elif kind == "TIMESYNC" and message.tc1 > 0:
        seen["timesync_ms"] = round((time.monotonic() - begun) * 1e3 - message.ts1 * 1e-6, 3)
    elif kind == "COMMAND_LONG" and message.target_system == 1:
        order(message, now)
    elif kind == "SET_ATTITUDE_TARGET":
        rates_wanted = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
        if message.target_system != 1 or message.type_mask != 128 or not all(map(math.isfinite, rates_wanted)):
            seen["wrong_setpoints"] += 1
            return
        if mode == OFFBOARD:
            seen["setpoints_in_offboard"] += 1
            if setpoints:
                seen["gap_max_s"] = max(seen["gap_max_s"], round(now - setpoints[-1], 4))
            target = (rates_wanted, min(max(message.thrust, 0.0), 1.0))
        setpoints.append(now)
        del setpoints[:-2000]


begun = time.monotonic()
due = {"step": 0.0, "beat": 0.0, "imu": 0.0, "range": 0.0, "status": 0.0, "sync": 0.0, "look": 0.0}
while not select.select([sys.stdin], [], [], 0)[0]:
    now = time.monotonic() - begun
    while (message := link.recv_match(blocking=False)) is not None:
        hear(message, now)
    if mode == OFFBOARD and setpoints and now - setpoints[-1] > 0.5:
        seen["left_offboard"] += 1
        enter(LAND, now)
    if mode == OFFBOARD and now - armed_s > PILOT_S:
        enter(LAND, now)
    if mode == LAND and armed:
        target = ((0.0, 0.0, 0.0), HOVER * (1.0 + 0.5 * (-0.5 - velocity[2])))
        armed = position[2] > 0.0
    felt = None
    while due["step"] <= now:
        due["step"] += STEP_S
        felt = fly(STEP_S)

    def is_due(name, period):
        if period is None or now < due[name]:
            return False
        due[name] = max(due[name] + period, now)
        return True

    # The autopilot's clock is 50 ppm fast.
    boot_us = int(BOOTED_US + now * 1e6 * (1 + 50e-6))
    if felt is not None and is_due("imu", intervals.get(105)):
        pressure = 1013.25 - 0.12 * position[2] + random.gauss(0.0, 0.02)
        noisy = [f + random.gauss(0.0, 0.02) for f in felt] + [r + random.gauss(0.0, 0.002) for r in rates]
        link.mav.highres_imu_send(boot_us, *noisy, 0.0, 0.0, 0.0, pressure, 0.0, 0.0, 30.0, 0b1_0010_0011_1111)
    if is_due("range", intervals.get(132)):
        below = max(position[2] / max(1 - 2 * (q[1] ** 2 + q[2] ** 2), 0.3), 0.0) + random.gauss(0.0, 0.005)
        link.mav.distance_sensor_send(boot_us // 1000, 0, 1200, max(round(100 * below), 0), 0, 0, 25, 0)
    if is_due("status", intervals.get(1)):
        link.mav.sys_status_send(0, 0, 0, 100, 11900, -1, 90, 0, 0, 0, 0, 0, 0)
    if is_due("beat", 1.0):
        beat()
    if is_due("sync", 0.5):
        link.mav.timesync_send(0, int(now * 1e9))
    if is_due("look", 0.1):
        seen["altitudes"].append([round(now, 2), round(position[2], 4), armed, mode == OFFBOARD])
    time.sleep(0.0008)

seen["rate_hz"] = round(len(setpoints) / (setpoints[-1] - setpoints[0]), 1) if len(setpoints) > 1 else 0.0
seen["armed"], seen["place"] = armed, [round(c, 3) for c in position]
print(json.dumps(seen))
