"""Other people's MAVLink stations at the ground: MAVProxy, a program, and MAVSDK and pymavlink, libraries.

Usage: stations.py mavproxy|mavsdk|pymavlink PORT. The last one signs: without a key, with a wrong one, with the right one (bytes 0
to 31), and sends what it signed once more. The others attach, reads a flight, and asks to arm, to land and to cut. Prints what it got, as JSON:
answers are named as COMMAND_ACK names them.
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


station, port = sys.argv[1:]
found = {"mavproxy": mavproxy, "mavsdk": mavsdk, "pymavlink": pymavlink}[station](port)
found["version"] = importlib.metadata.version(station)
print(json.dumps(found))
