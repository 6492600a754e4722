"""A MAVLink ground control station: attaches, reads a flight, asks for things. Prints what it got, as JSON."""

import json
import os
import sys
import time

os.environ["MAVLINK20"] = "1"
import pymavlink
from pymavlink import mavutil

PATIENCE = 20
mav = mavutil.mavlink
link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{sys.argv[1]}", source_system=255)


def next_of(*kinds):
    message = link.recv_match(type=list(kinds), blocking=True, timeout=PATIENCE)
    assert message is not None, f"no {kinds} within {PATIENCE} s"
    return message


beat = link.wait_heartbeat(timeout=PATIENCE)
assert beat is not None, "no heartbeat"
system = beat.get_srcSystem()
found = {"version": pymavlink.__version__, "system": system, "autopilot": beat.autopilot, "type": beat.type}
link.mav.heartbeat_send(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 0)

attitudes = [next_of("ATTITUDE") for _ in range(20)]
found["attitude"] = [attitudes[-1].roll, attitudes[-1].pitch, attitudes[-1].yaw]
found["attitude_rising"] = all(a.time_boot_ms <= b.time_boot_ms for a, b in zip(attitudes, attitudes[1:]))
place = next_of("LOCAL_POSITION_NED")
found["down_m"] = place.z
found["north_known"] = place.x == place.x
battery = next_of("BATTERY_STATUS")
found["battery"] = [battery.voltages[0], battery.battery_remaining]

link.mav.param_request_list_send(system, 1)
parameters = {}
while True:
    value = next_of("PARAM_VALUE")
    parameters[value.param_id] = value.param_value
    if len(parameters) == value.param_count:
        break
found["parameters"] = parameters
link.mav.param_set_send(system, 1, b"GAINS_REVISION", 99.0, mav.MAV_PARAM_TYPE_REAL32)
found["after_set"] = next_of("PARAM_VALUE").param_value
link.mav.mission_request_list_send(system, 1)
found["mission"] = next_of("MISSION_COUNT").count


def order(command, *values):
    values = list(values) + [0.0] * (7 - len(values))
    link.mav.command_long_send(system, 1, command, 0, *values)
    while True:
        ack = next_of("COMMAND_ACK")
        if ack.command == command:
            return ack.result


found["version_asked"] = order(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
found["capabilities"] = next_of("AUTOPILOT_VERSION").capabilities
found["unknown"] = order(mav.MAV_CMD_DO_REPOSITION)
found["arm"] = order(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
found["mode"] = order(mav.MAV_CMD_DO_SET_MODE, mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 3)
# Only the altitude.
mask = 0xFFF & ~mav.POSITION_TARGET_TYPEMASK_Z_IGNORE
for _ in range(5):
    link.mav.set_position_target_local_ned_send(0, system, 1, mav.MAV_FRAME_LOCAL_NED, mask, 0, 0, -1.25, *[0] * 8)
    time.sleep(0.05)
found["land"] = order(mav.MAV_CMD_NAV_LAND)
found["disarm"] = order(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0)
found["cut"] = order(mav.MAV_CMD_DO_FLIGHTTERMINATION, 1)
link.mav.heartbeat_send(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 0)

texts, pieces = [], {}
until = time.time() + 1.5
while time.time() < until:
    text = link.recv_match(type=["STATUSTEXT", "HEARTBEAT"], blocking=True, timeout=0.1)
    if text is not None and text.get_type() == "HEARTBEAT":
        found["armed_shown"] = bool(text.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
        found["mode_shown"] = text.custom_mode
    elif text is not None:
        pieces.setdefault(text.id, "")
        pieces[text.id] += text.text
        texts.append(text.text)
found["texts"] = texts
print(json.dumps(found))
