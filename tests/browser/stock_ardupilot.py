"""A stock ArduPilot's double at the simulator: servo packets to it by UDP, lines of JSON back, as its JSON model speaks.

It stands for a second, then flies up to 1 m by the attitude and position that it is told. A line that does not come is asked for again with
the same packet after 0.2 s (ArduPilot: a second). Prints what it saw as JSON.

Usage: stock_ardupilot.py PORT SECONDS [FAULT]. Faults, from 5 s on: `lost` loses every fiftieth line, `twice` sends every
fiftieth packet twice, `skips` loses a packet of its own now and then, `wrong` sends wrong magic and half a packet, `anew` starts again,
`silent` says nothing any more, `wide` speaks with 32 channels from the beginning.
"""

import json
import re
import socket
import struct
import sys
import time

import quad_x

port, seconds = int(sys.argv[1]), float(sys.argv[2])
fault = sys.argv[3] if len(sys.argv) > 3 else ""
FAULT_S, ARMED_S, RATE_HZ = 5.0, 1.0, 400
MAGIC, CHANNELS = (29569, 32) if fault == "wide" else (18458, 16)


def opened():
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    line.connect(("127.0.0.1", port))
    line.settimeout(0.2)
    return line


def packet(count, pulses, magic=MAGIC):
    return struct.pack(f"<HHI{CHANNELS}H", magic, RATE_HZ, count, *(pulses + [1500] * CHANNELS)[:CHANNELS])


def field(line, section, key, pattern):
    """As ArduPilot's reader finds it: the letters of the key, a quotation mark and a colon, then the value."""
    at = line.find(key, line.find(section) + len(section) + 1)
    assert at >= 0, f"no {section}/{key} in {line}"
    found = re.match(pattern, line[at + len(key) + 2 :])
    assert found, f"{key} in {line}"
    return [float(number) for number in found.groups()]


NUMBER = r"(-?[0-9.]+(?:[eE]-?[0-9]+)?)"
THREE = r"\[" + ",".join([NUMBER] * 3) + r"\]"
FOUR = r"\[" + ",".join([NUMBER] * 4) + r"\]"
seen = {"lines": 0, "again": 0, "repeated": 0, "went_back": 0, "steps_ms": {}, "rest": [], "ranges": [], "course": [], "keys": [],
        "gyro_z": [], "anew_at_s": None, "after_anew": None, "volts": None, "stopped": "done"}
line, count, pulses, last_s, lost, heard, anew = opened(), 0, [1000] * 4, None, "", "", False
begun, silent_since = time.time(), None
while True:
    if fault == "skips" and last_s and last_s > FAULT_S and count % 50 == 0:
        count += 1
    if fault == "wrong" and last_s and last_s > FAULT_S and count % 50 == 0:
        line.send(packet(count, pulses, 18459))
        line.send(packet(count, pulses)[:21])
    try:
        line.send(packet(count, pulses))
        if fault == "twice" and last_s and last_s > FAULT_S and count % 50 == 0:
            line.send(packet(count, pulses))
        text = line.recv(65536).decode()
        while text == heard:
            # The line before, once more.
            seen["repeated"] += 1
            text = line.recv(65536).decode()
        if fault == "lost" and last_s and last_s > FAULT_S and count % 50 == 0 and text != lost:
            lost = text
            raise TimeoutError
        silent_since, heard = None, text
    except (TimeoutError, ConnectionRefusedError) as error:
        silent_since = silent_since or time.time()
        if time.time() - silent_since > 5 and seen["lines"] > 0 or seen["lines"] == 0 and time.time() - begun > 30:
            seen["stopped"] = f"no answer: {error}"
            break
        seen["again"] += 1
        if isinstance(error, ConnectionRefusedError):
            time.sleep(0.05)
        continue
    assert text.startswith("\n") and text.endswith("}\n") and " " not in text, text
    said = json.loads(text)
    now_s = field(text, "", "timestamp", NUMBER)[0]
    rates = field(text, "imu", "gyro", THREE)
    force = field(text, "imu", "accel_body", THREE)
    position, velocity = field(text, "", "position", THREE), field(text, "", "velocity", THREE)
    q = field(text, "", "quaternion", FOUR)
    assert said["timestamp"] == now_s and said["velocity"] == velocity and said["imu"]["gyro"] == rates, text
    seen["lines"] += 1
    if seen["lines"] == 1:
        stands, yaw = position[2], quad_x.angles(q)[2]
    if last_s is not None and not anew:
        step = f"{(now_s - last_s) * 1e3:.1f}"
        seen["steps_ms"][step] = seen["steps_ms"].get(step, 0) + 1
        seen["went_back"] += now_s < last_s
    if anew:
        seen["after_anew"] = [now_s, *position]
    anew, last_s = False, now_s
    if sorted(said) != seen["keys"]:
        seen["keys"] = sorted(said)
    if now_s < ARMED_S and seen["anew_at_s"] is None:
        seen["rest"].append([*force, *rates, *position, *q])
    if seen["lines"] % 40 == 0:
        seen["course"].append([now_s, position[0], position[1], stands - position[2]])
        seen["gyro_z"].append([now_s, rates[2]])
        seen["ranges"].append([now_s, *(said.get(f"rng_{k}") for k in (1, 2, 3))])
        seen["volts"] = said.get("battery", {}).get("voltage")
    if now_s >= seconds:
        break
    pulses = [1000] * 4
    if now_s >= ARMED_S:
        goal = [0.0, 0.0, stands - min(1.0, 0.5 * (now_s - ARMED_S))]
        pulses = [round(1000 + 1000 * u) for u in quad_x.motors(q, rates, position, velocity, goal, yaw)]
    count += 1
    if now_s > FAULT_S and fault == "silent":
        time.sleep(6)
        seen["stopped"] = "silent"
        break
    if now_s > FAULT_S and fault == "anew" and seen["anew_at_s"] is None:
        seen["anew_at_s"] = now_s
        line.close()
        line, count, pulses, anew = opened(), 0, [1000] * 4, True
if seen["rest"]:
    seen["rest"] = [sum(column) / len(seen["rest"]) for column in zip(*seen["rest"])]
seen["wall_s"] = time.time() - begun
print(json.dumps(seen))
