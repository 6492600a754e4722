"""Other people's MAVLink stations at the ground: MAVProxy, a program, and MAVSDK and pymavlink, libraries.

Usage: stations.py mavproxy|mavsdk|pymavlink[-flies] PORT. The last one signs: without a key, with a wrong one, with the right one (bytes
0 to 31), and sends what it signed once more. The others attach, read a flight, and ask to arm, to land and to cut. Prints what it got,
as JSON: answers are named as COMMAND_ACK names them. `mavsdk-flies` and `pymavlink-flies` fly a vehicle to 0.8 m and land it.
"""

import importlib.metadata
import json
import math
import re
import subprocess
import sys
import tempfile
import time

PATIENCE = 30


def mavproxy(port):
    """By its command line: what it says is read, and what is typed is written."""
    options = ["--state-basedir", ".", "--default-modules", "arm,cmdlong", "--mav20"]
    program = [sys.executable, "-u", "-m", "MAVProxy.mavproxy", "--master", f"udpin:127.0.0.1:{port}"]
    with tempfile.TemporaryDirectory() as folder, open(f"{folder}/said", "w+") as output:
        station = subprocess.Popen(program + options, cwd=folder, stdin=subprocess.PIPE, stdout=output, stderr=output, text=True)

        def said():
            with open(output.name) as file:
                return file.read()

        def ask(line, pattern):
            """Types `line` again and again until its answer is there."""
            begun, seen = time.time(), len(said())
            while time.time() - begun < PATIENCE:
                station.stdin.write(line + "\n")
                station.stdin.flush()
                until = time.time() + 2
                while time.time() < until:
                    if found := re.search(pattern, said()[seen:]):
                        return found
                    time.sleep(0.05)
            raise AssertionError(f"{line}: no {pattern} in {said()}")

        number = r"(-?[\d.]+(?:e-?\d+)?)"
        attitude = ask("status ATTITUDE", rf"roll : {number}, pitch : {number}, yaw : {number}")
        place = ask("status LOCAL_POSITION_NED", rf"z : {number}, vx")
        battery = ask("status BATTERY_STATUS", r"voltages : \[(\d+)")
        found = {
            "yaw": float(attitude.group(3)),
            "down_m": float(place.group(1)),
            "battery_v": 1e-3 * float(battery.group(1)),
        }
        for name, line, command in [
            ("arm", "arm throttle", "COMPONENT_ARM_DISARM"),
            ("land", "long MAV_CMD_NAV_LAND 0 0 0 0 0 0 0", "NAV_LAND"),
            ("cut", "long MAV_CMD_DO_FLIGHTTERMINATION 1 0 0 0 0 0 0", "DO_FLIGHTTERMINATION"),
        ]:
            found[name] = ask(line, rf"Got COMMAND_ACK: {command}: (\w+)").group(1)
        # It answers SIGTERM with a question.
        station.kill()
        station.wait()
        return found


def mavsdk(port):
    """By its native Python package."""
    from mavsdk import ComponentType, Configuration, Mavsdk
    from mavsdk.plugins.action import Action, ActionError
    from mavsdk.plugins.telemetry import Telemetry

    sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    sdk.add_any_connection(f"udpin://127.0.0.1:{port}")
    system = sdk.first_autopilot(PATIENCE)
    assert system is not None, "no autopilot"
    telemetry, action = Telemetry(system), Action(system)

    def known(read, value):
        """As soon as there is something."""
        begun = time.time()
        while not math.isfinite(value(read())) or value(read()) == 0.0:
            assert time.time() - begun < PATIENCE, f"no {read.__name__}"
            time.sleep(0.1)
        return value(read())

    def answer(asked):
        try:
            asked()
            return "ACCEPTED"
        except ActionError as error:
            return error.result.name.replace("COMMAND_", "")

    return {
        "yaw": math.radians(known(telemetry.attitude_euler, lambda angle: angle.yaw_deg)),
        "down_m": known(telemetry.position_velocity_ned, lambda place: place.position.down_m),
        "battery_v": known(telemetry.battery, lambda battery: battery.voltage_v),
        "arm": answer(action.arm),
        "land": answer(action.land),
        "cut": answer(action.terminate),
    }


def pymavlink(port):
    """By its own signing: what each way of it gets for an order to arm."""
    import os

    os.environ["MAVLINK20"] = "1"
    from pymavlink import mavutil

    mav = mavutil.mavlink
    link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=255)
    assert link.wait_heartbeat(timeout=PATIENCE) is not None, "no heartbeat"
    attitude = link.recv_match(type="ATTITUDE", blocking=True, timeout=PATIENCE)
    # Without a key all of it can be read.
    found = {"yaw": attitude.yaw, "signed": attitude.get_signed()}
    order = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, *[0] * 6)

    def answer(send):
        """The result and what is said of it within a second."""
        until, got, texts = time.time() + 1.2, None, []
        send()
        while time.time() < until:
            message = link.recv_match(type=["COMMAND_ACK", "STATUSTEXT"], blocking=True, timeout=0.1)
            if message is not None and message.get_type() == "COMMAND_ACK":
                got = message.result
            elif message is not None:
                texts.append(message.text)
        return [got, texts]

    key = bytes(range(32))
    found["unsigned"] = answer(lambda: link.mav.send(order))
    link.setup_signing(key[::-1], allow_unsigned_callback=lambda *_: True)
    found["wrong"] = answer(lambda: link.mav.send(order))
    link.setup_signing(key)
    found["right"] = answer(lambda: link.mav.send(order))
    frame = order.get_msgbuf()
    found["again"] = answer(lambda: link.write(frame))
    found["verified"], found["unverified"] = link.mav.signing.goodsig_count, link.mav.signing.badsig_count
    return found


#: `SET_POSITION_TARGET_LOCAL_NED`: nothing but z counts.
Z_ALONE = 0x0DFB
ALTITUDE_M = 0.8


def until(what, check):
    """Asks again until it is so, and says how long that took."""
    begun = time.time()
    while not check():
        assert time.time() - begun < PATIENCE, f"{what}: not within {PATIENCE} s"
        time.sleep(0.05)
    return time.time() - begun


def flight(arm, hold, climb, land, armed, altitude_m):
    """Armed, in altitude hold, at its altitude for a second, landed, disarmed by itself."""
    until("armed", lambda: arm() and armed())
    until("altitude hold", hold)
    climb()
    climbed_s = until("at its altitude", lambda: abs(altitude_m() - ALTITUDE_M) < 0.03)
    time.sleep(1)
    held_m = altitude_m()
    until("landing", land)
    landed_s = until("disarmed", lambda: not armed())
    return {"climbed_s": climbed_s, "held_m": held_m, "landed_s": landed_s, "landed_m": altitude_m()}


def mavsdk_flies(port):
    """Mode and setpoint as messages of its own making: it has no words for modes but PX4's."""
    from mavsdk import ComponentType, Configuration, Mavsdk
    from mavsdk.plugins.action import Action, ActionError
    from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
    from mavsdk.plugins.telemetry import Telemetry

    sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    sdk.add_any_connection(f"udpin://127.0.0.1:{port}")
    system = sdk.first_autopilot(PATIENCE)
    assert system is not None, "no autopilot"
    telemetry, action, direct = Telemetry(system), Action(system), MavlinkDirect(system)

    def done(asked):
        try:
            asked()
            return True
        except ActionError:
            return False

    def send(name, **fields):
        target = {"target_system": 1, "target_component": 1}
        direct.send_message(MavlinkMessage(name, 245, 190, 1, 1, json.dumps({**target, **fields})))
        return True

    modes = []
    direct.subscribe_message("HEARTBEAT", lambda message, _: modes.append(json.loads(message.fields_json)["custom_mode"]))

    def hold():
        params = {"param1": 1.0, "param2": 3.0, **{f"param{n}": 0.0 for n in range(3, 8)}}
        send("COMMAND_LONG", command=176, confirmation=0, **params)
        time.sleep(1)
        return modes[-1:] == [3]

    def climb():
        others = dict.fromkeys(["x", "y", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"], 0.0)
        send("SET_POSITION_TARGET_LOCAL_NED", time_boot_ms=0, coordinate_frame=1, type_mask=Z_ALONE, z=-ALTITUDE_M, **others)

    return flight(
        arm=lambda: done(action.arm),
        hold=hold,
        climb=climb,
        land=lambda: done(action.land),
        armed=telemetry.armed,
        altitude_m=lambda: -telemetry.position_velocity_ned().position.down_m,
    )


def pymavlink_flies(port):
    """Every message by hand, with a heartbeat a second of its own."""
    import os
    import threading

    os.environ["MAVLINK20"] = "1"
    from pymavlink import mavutil

    mav = mavutil.mavlink
    link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=255)
    assert link.wait_heartbeat(timeout=PATIENCE) is not None, "no heartbeat"
    over = threading.Event()

    def alive():
        while not over.wait(1.0):
            link.mav.heartbeat_send(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 0)

    threading.Thread(target=alive, daemon=True).start()

    def asked(command, *values):
        link.mav.command_long_send(1, 1, command, 0, *values, *[0] * (7 - len(values)))
        until = time.time() + 2
        while time.time() < until:
            answer = link.recv_match(type="COMMAND_ACK", blocking=True, timeout=0.5)
            if answer is not None and answer.command == command:
                return answer.result == mav.MAV_RESULT_ACCEPTED
        return False

    def newest(kind):
        while link.recv_match(blocking=False) is not None:
            pass
        message = link.recv_match(type=kind, blocking=True, timeout=PATIENCE)
        assert message is not None, f"no {kind}"
        return message

    found = flight(
        arm=lambda: asked(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1),
        hold=lambda: asked(mav.MAV_CMD_DO_SET_MODE, 1, 3),
        climb=lambda: link.mav.set_position_target_local_ned_send(
            0, 1, 1, mav.MAV_FRAME_LOCAL_NED, Z_ALONE, 0, 0, -ALTITUDE_M, *[0] * 8
        ),
        land=lambda: asked(mav.MAV_CMD_NAV_LAND),
        armed=lambda: bool(newest("HEARTBEAT").base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED),
        altitude_m=lambda: -newest("LOCAL_POSITION_NED").z,
    )
    over.set()
    return found


station, port = sys.argv[1:]
stations = {
    "mavproxy": mavproxy,
    "mavsdk": mavsdk,
    "pymavlink": pymavlink,
    "mavsdk-flies": mavsdk_flies,
    "pymavlink-flies": pymavlink_flies,
}
found = stations[station](port)
found["version"] = importlib.metadata.version(station.removesuffix("-flies"))
print(json.dumps(found))
