"""A stock PX4's double at the simulator: connects by TCP as PX4's simulator_mavlink does, and flies in lockstep.

Its clock is HIL_SENSOR 0, each of which it answers with one HIL_ACTUATOR_CONTROLS (flag LOCKSTEP): nothing while it
starts, then disarmed, then armed, up to 1 m and there. It flies by HIL_STATE_QUATERNION. Everything is decoded by
pymavlink. Prints what it saw as JSON.

Usage: stock_px4.py PORT SECONDS [FAULT]. A fault happens at 6 s: `leave` closes the connection, `silent` answers no more,
`garbage` sends noise instead of answers, `noise` sends noise before one answer, `old` sends an old answer before each one,
`free` never sets the flag LOCKSTEP.
"""

import json
import math
import os
import select
import socket
import sys
import time

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink

import quad_x

port, seconds = int(sys.argv[1]), float(sys.argv[2])
fault = sys.argv[3] if len(sys.argv) > 3 else ""
FAULT_US = 6_000_000
# It starts for a second, stands for another, and is armed from then on.
STARTED_US, ARMED_US = 1_000_000, 2_000_000
METRES_PER_DEGREE = 111_000.0

begun = time.time()
while True:
    try:
        line = socket.create_connection(("127.0.0.1", port))
        break
    except OSError:
        assert time.time() - begun < 30, "no simulator"
        time.sleep(0.02)
line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
reader = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
reader.robust_parsing = True


def send(message):
    line.sendall(message.pack(reader))


send(mavlink.MAVLink_heartbeat_message(0, 12, 0, 0, 0, 3))
send(mavlink.MAVLink_command_long_message(0, 0, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 115, 5e3, 0, 0, 0, 0, 0))

seen = {"counts": {}, "fields": {}, "steps_us": {}, "went_back": 0, "bad": 0, "unasked": None, "distances": {}, "barometer": [],
        "gyro_z": {}, "gps": [], "odometry": [], "course": [], "heartbeats": 0, "senders": [], "stopped": ""}
rest = {}
last_us, state, origin, pending, waited = None, None, None, [], False


def mean(key, values):
    """Averages of what is measured while it stands."""
    if last_us is not None and last_us < ARMED_US:
        n, sums = rest.get(key, (0, [0.0] * len(values)))
        rest[key] = (n + 1, [a + b for a, b in zip(sums, values)])


def messages():
    """The next messages, in order; none at the end of the stream."""
    while True:
        while pending:
            yield pending.pop(0)
        data = line.recv(65536)
        if not data:
            seen["stopped"] = "closed"
            return
        pending.extend(reader.parse_buffer(data) or [])


def local(message):
    """NED of a place on the Earth about the first one."""
    north = (message.lat - origin.lat) * 1e-7 * METRES_PER_DEGREE
    east = (message.lon - origin.lon) * 1e-7 * METRES_PER_DEGREE * math.cos(math.radians(origin.lat * 1e-7))
    return [north, east, (origin.alt - message.alt) * 1e-3]


def answer(now_us):
    armed = now_us >= ARMED_US
    controls = [0.0] * 16
    if armed:
        # The pose of the tick before: in a stream nothing of this one has come yet but its HIL_SENSOR.
        q, rates = state.attitude_quaternion, (state.rollspeed, state.pitchspeed, state.yawspeed)
        velocity = [v * 0.01 for v in (state.vx, state.vy, state.vz)]
        up = min(1.0, (now_us - ARMED_US) * 0.5e-6)
        controls[:4] = quad_x.motors(q, rates, local(state), velocity, [0.0, 0.0, -up], yaw)
    mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    flags = 0 if fault == "free" else mavlink.HIL_ACTUATOR_CONTROLS_FLAGS_LOCKSTEP
    return mavlink.MAVLink_hil_actuator_controls_message(now_us, controls, mode, flags)


def stands_still():
    """Does the simulator wait while no answer comes?"""
    until, sensors = time.time() + 0.3, 0
    while time.time() < until:
        if select.select([line], [], [], 0.05)[0]:
            found = reader.parse_buffer(line.recv(65536)) or []
            sensors += sum(m.get_type() == "HIL_SENSOR" and m.id == 0 for m in found)
            pending.extend(found)
    return sensors


yaw = 0.0
for m in messages():
    kind = m.get_type()
    if kind == "BAD_DATA":
        seen["bad"] += 1
        continue
    seen["counts"][kind] = seen["counts"].get(kind, 0) + 1
    if [m.get_srcSystem(), m.get_srcComponent()] not in seen["senders"]:
        seen["senders"].append([m.get_srcSystem(), m.get_srcComponent()])
    if kind == "HIL_SENSOR":
        by = seen["fields"].setdefault(str(m.id), {})
        by[str(m.fields_updated)] = by.get(str(m.fields_updated), 0) + 1
        if m.fields_updated & 0x3F == 0x3F:
            mean(f"accel {m.id}", (m.xacc, m.yacc, m.zacc))
            mean(f"gyro {m.id}", (m.xgyro, m.ygyro, m.zgyro))
            if m.time_usec % 20_000 == 0:
                seen["gyro_z"].setdefault(str(m.id), []).append([m.time_usec * 1e-6, m.zgyro])
        if m.fields_updated & 0x1C0 == 0x1C0:
            mean(f"mag {m.id}", (m.xmag, m.ymag, m.zmag))
        if m.fields_updated & 0x1A00 == 0x1A00:
            mean("barometer", (m.abs_pressure, m.pressure_alt, m.temperature))
            seen["barometer"].append([m.time_usec * 1e-6, m.abs_pressure])
    elif kind == "HIL_GPS":
        mean("gps", (m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3, m.fix_type, m.satellites_visible))
        if origin:
            seen["gps"].append([m.time_usec * 1e-6, *local(m)])
    elif kind == "DISTANCE_SENSOR":
        mean(f"distance {m.id}", (m.current_distance * 0.01, m.orientation, m.type))
        seen["distances"].setdefault(str(m.id), []).append([m.time_boot_ms * 1e-3, m.current_distance * 0.01])
    elif kind == "ODOMETRY":
        seen["odometry"].append([m.time_usec * 1e-6, m.x, m.y, m.z, m.frame_id, m.estimator_type])
    elif kind == "HEARTBEAT":
        seen["heartbeats"] += 1
    elif kind == "HIL_STATE_QUATERNION":
        if origin is None:
            origin, yaw = m, quad_x.angles(m.attitude_quaternion)[2]
        state = m
        mean("state", (*m.attitude_quaternion, m.zacc, m.alt * 1e-3))
        if m.time_usec % 100_000 == 0:
            place = local(m)
            seen["course"].append([m.time_usec * 1e-6, place[0], place[1], -place[2]])
    # PX4's clock, and what it answers to. The pose that it flies by comes behind: an answer is due with the next message.
    if kind != "HIL_SENSOR" or m.id != 0:
        continue
    now_us = m.time_usec
    if last_us is not None:
        step = str(now_us - last_us)
        seen["steps_us"][step] = seen["steps_us"].get(step, 0) + 1
        seen["went_back"] += now_us <= last_us
    last_us = now_us
    if now_us >= seconds * 1e6:
        seen["stopped"] = "done"
        break
    if now_us < STARTED_US:
        continue
    if not waited and now_us > STARTED_US + 500_000:
        waited = True
        seen["unasked"] = stands_still()
    if fault and now_us >= FAULT_US:
        if fault == "leave":
            seen["stopped"] = "left"
            break
        if fault == "silent":
            continue
        if fault == "garbage":
            try:
                line.sendall(bytes((now_us * 7 + k * k) % 251 for k in range(300)))
            except OSError:
                seen["stopped"] = "closed"
                break
            continue
        if fault == "noise" and now_us < FAULT_US + 4_000:
            line.sendall(b"\xfd\xff\x00noise\xfe\x01" * 40)
    new = answer(now_us)
    if fault == "old":
        send(mavlink.MAVLink_hil_actuator_controls_message(now_us - 8_000, [1.0] * 16, new.mode, new.flags))
    try:
        send(new)
    except OSError:
        seen["stopped"] = "closed"
        break
line.close()
seen["rest"] = {key: [total / n for total in sums] for key, (n, sums) in rest.items()}
seen["wall_s"] = time.time() - begun
print(json.dumps(seen))
