"""A PX4 autopilot's double, by pymavlink: flies a rigid body and keeps PX4's documented rules of offboard mode.

- Offboard mode is refused until setpoints came at more than 2 Hz for one second.
- In offboard mode half a second without a setpoint ends it: the double lands by itself.
- Arming is refused outside offboard mode here, disarming in the air unless it is forced.
- Only setpoints for this system count: SET_ATTITUDE_TARGET with body rates and thrust; by pose, with --pose,
  SET_POSITION_TARGET_LOCAL_NED in MAV_FRAME_LOCAL_NED.
- By pose it knows of itself only what ODOMETRY says, and flies by that with a position controller of its own. Offboard mode is
  refused, and ended, without external vision newer than half a second. ODOMETRY counts in MAV_FRAME_LOCAL_NED or _FRD with
  velocities in MAV_FRAME_BODY_FRD, finite, with a unit quaternion, an estimator type that PX4 takes, and a stamp that TIMESYNC maps
  to a time just gone by and after the one before.

Speaks to 127.0.0.1:PORT, or on a pseudo terminal that --pty links to, in pieces and with garbage between frames. Until its
standard input ends; then prints what it saw as JSON.
"""

import argparse
import json
import math
import os
import pty
import random
import select
import socket
import struct
import sys
import time
import tty

from quad_x import G, INERTIA, MASS, THRUST, TORQUE, angles, turned

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil

parser = argparse.ArgumentParser()
parser.add_argument("port", type=int, help="unused with --pty")
parser.add_argument("autopilot", type=int, nargs="?", default=12)
parser.add_argument("pilot_s", type=float, nargs="?", default=math.inf, help="after arming, somebody takes over")
parser.add_argument("--pty", help="a link to the terminal is made here")
parser.add_argument("--pose", action="store_true")
parser.add_argument("--vicon", type=int, help="where its true pose is sent as a Vicon server sends it")
parser.add_argument("--hide_s", type=float, default=math.inf, help="from then on the true pose is sent no longer")
parser.add_argument("--deny", type=int, nargs="*", default=[], help="messages whose interval is refused")
parser.add_argument("--system", type=int, default=1)
parser.add_argument("--key", help="signs with these hexadecimal digits, and refuses what is not signed with them")
parser.add_argument("--jump_s", type=float, default=math.inf, help="then its clock goes back by half of that")
options = parser.parse_args()

mav = mavutil.mavlink


class Terminal(mavutil.mavfile):
    """pymavlink's link on the far end of a pseudo terminal."""

    def __init__(self, path):
        own, far = pty.openpty()
        tty.setraw(far)
        os.set_blocking(own, False)
        super().__init__(own, path, source_system=options.system, source_component=1)
        self.far, self.frames = far, 0
        os.symlink(os.ttyname(far), path)

    def recv(self, n=None):
        try:
            return os.read(self.fd, n or 4096)
        except BlockingIOError:
            return b""

    def write(self, frame):
        self.frames += 1
        noise = bytes(random.choices([0xFD, 0xFE, 0, 7, 255], k=random.randrange(1, 40))) if self.frames % 50 == 0 else b""
        cut = random.randrange(len(frame))
        for piece in (noise + frame[:cut], frame[cut:]):
            try:
                os.write(self.fd, piece)
            except BlockingIOError:
                pass


if options.pty:
    link = Terminal(options.pty)
else:
    link = mavutil.mavlink_connection(
        f"udpout:127.0.0.1:{options.port}", source_system=options.system, source_component=1
    )
if options.key:
    link.setup_signing(bytes.fromhex(options.key), sign_outgoing=True, link_id=0)
vicon = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
HOVER, RATE_LOOP_S, STEP_S = 0.4, 0.05, 0.0025
OFFBOARD, LAND = 6 << 16, (4 << 16) | (6 << 24)
FORCE = 21196
BOOTED_US = 7_000_000
random.seed(1)

position, velocity, rates = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]  # ENU, ENU, FRD
q = [1.0, 0.0, 0.0, 0.0]  # NED from FRD
thrust, target = 0.0, ((0.0, 0.0, 0.0), 0.0)
armed, armed_s, mode = False, math.inf, 0
setpoints, intervals = [], {}
# What ODOMETRY said last, turned to NED: when it came, its stamp, place, velocity, attitude; and the setpoint.
vision, place_target = None, None
integral = [0.0, 0.0, 0.0]
offset_ns = None
# Of the Iris: rotor arms x, y and spin, FLU; motor curve.
ROTORS = [(0.13, -0.22, 1), (-0.13, 0.20, 1), (0.13, 0.22, -1), (-0.13, -0.20, -1)]
BATTERY_V, NOMINAL_V, CURVE = 11.9, 11.1, (100.0, 1000.0)
VISION_S = 0.5
# MAX_RTT_SAMPLE of PX4's Timesync.
ROUND_TRIP_NS = 10_000_000
seen = {"late_s": 0.0, "refused": 0, "wrong_setpoints": 0, "heartbeats": 0, "timesync_ms": None, "left_offboard": 0, "gap_max_s": 0.0,
        "disarmed_by_force": 0, "setpoints_in_offboard": 0, "altitudes": [], "modes": [], "first_offboard_s": None, "round_trips": 0, "odometry": {
            "count": 0, "refused": {}, "rate_hz": 0.0, "place_error_max_m": 0.0, "velocity_error_max_mps": 0.0,
            "attitude_error_max_rad": 0.0, "age_max_s": 0.0, "resets": 0, "above": None}, "vision_lost": 0}


def fly(dt):
    """One step of the body; returns the specific force in FRD."""
    global q, thrust
    wanted, level = target if armed else ((0.0, 0.0, 0.0), 0.0)
    thrust += (level - thrust) * min(1.0, dt / 0.03)
    for axis in range(3):
        rates[axis] += (wanted[axis] - rates[axis]) * dt / RATE_LOOP_S
    lift = thrust / HOVER * G
    down = turned(q, [0.0, 0.0, -lift])
    force = [down[1], down[0], -down[2]]  # ENU
    force = [f - 0.2 * v for f, v in zip(force, velocity)]
    stands = position[2] <= 0.0 and force[2] < G
    if stands:
        rates[:], velocity[:], position[2] = [0.0] * 3, [0.0] * 3, 0.0
        yaw = angles(q)[2]
        q = [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]
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
    return turned(conjugate(q), [force[1], force[0], -force[2]])


def conjugate(a):
    return [a[0], -a[1], -a[2], -a[3]]


def product(a, b):
    return [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]


def unit(v):
    length = math.sqrt(sum(c * c for c in v))
    return [c / length for c in v]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def attitude_of(forward, right, down):
    """The quaternion whose body axes these are."""
    m = list(zip(forward, right, down))
    w = math.sqrt(max(1e-12, 1 + m[0][0] + m[1][1] + m[2][2])) / 2
    return unit([w, (m[2][1] - m[1][2]) / (4 * w), (m[0][2] - m[2][0]) / (4 * w), (m[1][0] - m[0][1]) / (4 * w)])


def clipped(value, least, most):
    return min(max(value, least), most)


def see(message, now, stamp_s):
    """ODOMETRY as EKF2 takes external vision; why it does not, else nothing."""
    global vision
    numbers = [message.x, message.y, message.z, message.vx, message.vy, message.vz, *message.q]
    if message.frame_id not in (mav.MAV_FRAME_LOCAL_NED, mav.MAV_FRAME_LOCAL_FRD):
        return f"frame {message.frame_id}"
    if message.child_frame_id != mav.MAV_FRAME_BODY_FRD:
        return f"child frame {message.child_frame_id}"
    if not all(map(math.isfinite, numbers)):
        return "not finite"
    if abs(sum(c * c for c in message.q) - 1) > 1e-3:
        return "no unit quaternion"
    if message.estimator_type not in (0, mav.MAV_ESTIMATOR_TYPE_VISION, mav.MAV_ESTIMATOR_TYPE_VIO, 6):
        return f"estimator type {message.estimator_type}"
    if not (message.quality >= 0 and message.pose_covariance[0] > 0):
        return "quality or covariance"
    if stamp_s is None:
        return "no TIMESYNC yet"
    if not now - 0.2 < stamp_s < now + 0.02:
        return "stamp out of time"
    if vision and stamp_s <= vision["stamp_s"]:
        return "stamp runs backwards"
    attitude = list(message.q)
    vision = {
        "came_s": now, "stamp_s": stamp_s, "place": [message.x, message.y, message.z], "attitude": attitude,
        "velocity": turned(attitude, [message.vx, message.vy, message.vz]),
    }
    return None


def note(message, now):
    """Counts an ODOMETRY, and compares it with the truth."""
    stamp_s = None if offset_ns is None else (message.time_usec * 1e3 + offset_ns) * 1e-9
    odometry = seen["odometry"]
    odometry["count"] += 1
    why = see(message, now, stamp_s)
    if why:
        odometry["refused"][why] = odometry["refused"].get(why, 0) + 1
        return
    odometry["resets"] = message.reset_counter
    odometry["first_s"] = odometry.get("first_s", now)
    odometry["taken"] = odometry.get("taken", 0) + 1
    odometry["rate_hz"] = round(odometry["taken"] / max(now - odometry["first_s"], 1e-3), 1)
    if position[2] > 0.5:
        covariances = [message.pose_covariance, message.velocity_covariance]
        odometry["above"] = [[c if math.isfinite(c) else None for c in all] for all in covariances]
    # In the air: its floor stops it from one step to the next.
    if not armed or position[2] < 0.02:
        return
    true = [position[1], position[0], -position[2]]
    moves = [velocity[1], velocity[0], -velocity[2]]
    off = product(conjugate(q), vision["attitude"])
    for name, value in [
        ("place_error_max_m", math.dist(true, vision["place"])),
        ("velocity_error_max_mps", math.dist(moves, vision["velocity"])),
        ("attitude_error_max_rad", 2 * math.asin(min(1.0, math.sqrt(sum(c * c for c in off[1:]))))),
        ("age_max_s", now - stamp_s),
    ]:
        odometry[name] = round(max(odometry[name], value), 4)


def control(dt, now):
    """Body rates and thrust that bring what vision says to the place asked for: position, velocity, attitude."""
    place = [p + v * (now - vision["stamp_s"]) for p, v in zip(vision["place"], vision["velocity"])]
    velocity_now, attitude = vision["velocity"], vision["attitude"]
    asked, ahead, yaw_asked = place_target
    # PX4 idles on the ground until a setpoint above it comes.
    if position[2] <= 0.0 and asked[2] > place[2] - 0.05:
        integral[:] = [0.0, 0.0, 0.0]
        return ((0.0, 0.0, 0.0), 0.05)
    force = []
    for axis, (gain, most, rate_gain, slow) in enumerate([(0.95, 2.0, 1.8, 0.4), (0.95, 2.0, 1.8, 0.4), (1.0, 1.5, 4.0, 2.0)]):
        wanted = clipped(gain * (asked[axis] - place[axis]) + ahead[axis], -most, most)
        missing = wanted - velocity_now[axis]
        integral[axis] = clipped(integral[axis] + slow * missing * dt, -3.0, 3.0)
        force.append(clipped(rate_gain * missing, -5.0, 5.0) + integral[axis])
    force[2] -= G
    lift = math.sqrt(sum(f * f for f in force))
    down = [-f / lift for f in force]
    right = unit(cross(down, [math.cos(yaw_asked), math.sin(yaw_asked), 0.0]))
    desired = attitude_of(cross(right, down), right, down)
    off = product(conjugate(attitude), desired)
    sign = 1.0 if off[0] >= 0 else -1.0
    turn = [clipped(2 * sign * gain * c, -4.0, 4.0) for gain, c in zip((6.5, 6.5, 2.0), off[1:])]
    return (tuple(turn), clipped(lift / G * HOVER, 0.05, 1.0))


def solved(a, b):
    """a x = b by Gauss and Jordan."""
    rows = [list(row) + [value] for row, value in zip(a, b)]
    for i in range(len(rows)):
        pivot = max(range(i, len(rows)), key=lambda r: abs(rows[r][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [c / rows[i][i] for c in rows[i]]
        for r in range(len(rows)):
            if r != i:
                rows[r] = [c - rows[r][i] * d for c, d in zip(rows[r], rows[i])]
    return [row[-1] for row in rows]


def outputs():
    """Pulses of the four motors, µs, that give this thrust and turn the body as its rate loop does."""
    if not armed:
        return [900] * 4
    wanted, _ = target
    turning = [(w - r) / RATE_LOOP_S for w, r in zip(wanted, rates)]
    torque = [INERTIA[0] * turning[0], -INERTIA[1] * turning[1], -INERTIA[2] * turning[2]]  # FLU
    mixing = [
        [1.0] * 4,
        [y for _, y, _ in ROTORS],
        [-x for x, _, _ in ROTORS],
        [-spin * TORQUE for *_, spin in ROTORS],
    ]
    thrusts = solved(mixing, [thrust / HOVER * MASS * G, *torque])
    speeds = [math.sqrt(max(t, 0.0) / THRUST) / (BATTERY_V / NOMINAL_V) for t in thrusts]
    return [round(1000 + 1000 * clipped((speed - CURVE[0]) / CURVE[1], 0.01, 1.0)) for speed in speeds]


def show(frame):
    """The true pose as a Vicon server says it, world ENU and body FLU, with a millimetre of noise."""
    axes = [turned(q, axis) for axis in ([1, 0, 0], [0, -1, 0], [0, 0, -1])]  # of FLU, in NED
    r = [[axis[i] for axis in axes] for i in (1, 0)] + [[-axis[2] for axis in axes]]
    turn = [math.atan2(-r[1][2], r[2][2]), math.asin(clipped(r[0][2], -1, 1)), math.atan2(-r[0][1], r[0][0])]
    place = [1e3 * (c + random.gauss(0.0, 0.001)) for c in position]
    item = struct.pack("<24s6d", b"quad", *place, *turn)
    vicon.sendto(struct.pack("<IBBH", frame, 1, 0, len(item)) + item, ("127.0.0.1", options.vicon))


def enter(new, now):
    global mode
    mode = new
    seen["modes"].append([round(now, 3), new])
    beat()


def beat():
    flags = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mav.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    link.mav.heartbeat_send(mav.MAV_TYPE_QUADROTOR, options.autopilot, flags, mode, mav.MAV_STATE_ACTIVE)


def order(message, now):
    """PX4's answers to the commands that a companion gives."""
    global armed, armed_s
    accepted = mav.MAV_RESULT_ACCEPTED
    result = mav.MAV_RESULT_DENIED
    if message.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
        if int(message.param1) not in options.deny:
            intervals[int(message.param1)] = message.param2 * 1e-6
            result = accepted
    elif message.command == mav.MAV_CMD_DO_SET_MODE and int(message.param2) == 6:
        streams = [t for t in setpoints if now - t < 1.1]
        sees = not options.pose or (vision and now - vision["came_s"] < VISION_S)
        if sees and streams and now - streams[0] >= 1.0 and max(b - a for a, b in zip(streams, streams[1:])) < 0.5:
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
    if result != accepted and message.command != mav.MAV_CMD_SET_MESSAGE_INTERVAL:
        seen["refused"] += 1
    link.mav.command_ack_send(message.command, result)
    beat()


def takes(now):
    """A setpoint that counts has come."""
    if mode == OFFBOARD:
        seen["setpoints_in_offboard"] += 1
        if setpoints:
            seen["gap_max_s"] = max(seen["gap_max_s"], round(now - setpoints[-1], 4))
    setpoints.append(now)
    del setpoints[:-2000]


def hear(message, now):
    global target, place_target, offset_ns
    kind = message.get_type()
    if kind == "HEARTBEAT":
        seen["heartbeats"] += 1
    elif kind == "TIMESYNC" and message.tc1 > 0:
        round_trip_ns = boot_ns() - message.ts1
        seen["timesync_ms"] = round(round_trip_ns * 1e-6, 3)
        # The offset of PX4's EKF2 inputs: our clock of this program less theirs, ns. As PX4 does, one of a slow round trip
        # is left out.
        if round_trip_ns < ROUND_TRIP_NS or offset_ns is None:
            offset_ns = int(now * 1e9) - round_trip_ns // 2 - message.tc1
    elif kind == "TIMESYNC":
        seen["round_trips"] += 1
        link.mav.timesync_send(boot_ns(), message.ts1)
    elif kind == "COMMAND_LONG" and message.target_system == options.system:
        order(message, now)
    elif kind == "ODOMETRY" and options.pose:
        note(message, now)
    elif kind == "SET_POSITION_TARGET_LOCAL_NED":
        mask, numbers = message.type_mask, [message.x, message.y, message.z, message.yaw]
        if (
            not options.pose or message.target_system != options.system or mask & 0b111
            or message.coordinate_frame != mav.MAV_FRAME_LOCAL_NED or not all(map(math.isfinite, numbers))
        ):
            seen["wrong_setpoints"] += 1
            return
        ahead = [0.0 if mask & (8 << axis) else v for axis, v in enumerate((message.vx, message.vy, message.vz))]
        place_target = (numbers[:3], ahead, message.yaw)
        takes(now)
    elif kind == "SET_ATTITUDE_TARGET":
        rates_wanted = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
        wrong = message.target_system != options.system or message.type_mask != 128
        if options.pose or wrong or not all(map(math.isfinite, rates_wanted)):
            seen["wrong_setpoints"] += 1
            return
        if mode == OFFBOARD:
            target = (rates_wanted, min(max(message.thrust, 0.0), 1.0))
        takes(now)


def boot_ns():
    """The autopilot's clock: 50 ppm fast, and once it may jump."""
    now = time.monotonic() - begun
    back_s = options.jump_s / 2 if now > options.jump_s else 0.0
    return int(BOOTED_US * 1e3 + (now * (1 + 50e-6) - back_s) * 1e9)


try:
    # An autopilot does not wait for its processor.
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))
except OSError:
    pass
begun = time.monotonic()
turned_at = None
due = {"step": 0.0, "beat": 0.0, "imu": 0.0, "range": 0.0, "status": 0.0, "sync": 0.0, "look": 0.0, "aim": 0.0,
       "outputs": 0.0, "vicon": 0.0}
while not select.select([sys.stdin], [], [], 0)[0]:
    while (message := link.recv_match(blocking=False)) is not None:
        # When it is heard: what comes while this program waits for its processor is later than its step.
        hear(message, time.monotonic() - begun)
    now = time.monotonic() - begun
    seen["late_s"] = max(seen["late_s"], now - (turned_at or now))
    turned_at = now
    if mode == OFFBOARD and setpoints and now - setpoints[-1] > 0.5:
        seen["left_offboard"] += 1
        enter(LAND, now)
    if mode == OFFBOARD and options.pose and now - vision["came_s"] > VISION_S:
        seen["vision_lost"] += 1
        enter(LAND, now)
    if mode == OFFBOARD and now - armed_s > options.pilot_s:
        enter(LAND, now)
    if mode == LAND and armed:
        target = ((0.0, 0.0, 0.0), HOVER * (1.0 + 0.5 * (-0.5 - velocity[2])))
        armed = position[2] > 0.0
    felt = None
    while due["step"] <= now:
        due["step"] += STEP_S
        if options.pose and mode == OFFBOARD and vision and place_target:
            target = control(STEP_S, now)
        felt = fly(STEP_S)
        if vision:
            # Between two of vision's attitudes the own gyroscopes go on.
            vision["attitude"] = unit(product(vision["attitude"], [1.0, *(r * STEP_S / 2 for r in rates)]))

    def is_due(name, period):
        if period is None or now < due[name]:
            return False
        due[name] = max(due[name] + period, now)
        return True

    boot_us = boot_ns() // 1000
    if felt is not None and is_due("imu", intervals.get(105)):
        pressure = 1013.25 - 0.12 * position[2] + random.gauss(0.0, 0.02)
        noisy = [f + random.gauss(0.0, 0.02) for f in felt] + [r + random.gauss(0.0, 0.002) for r in rates]
        link.mav.highres_imu_send(boot_us, *noisy, 0.0, 0.0, 0.0, pressure, 0.0, 0.0, 30.0, 0b1_0010_0011_1111)
    if is_due("range", intervals.get(132)):
        below = max(position[2] / max(1 - 2 * (q[1] ** 2 + q[2] ** 2), 0.3), 0.0) + random.gauss(0.0, 0.005)
        link.mav.distance_sensor_send(boot_us // 1000, 0, 1200, max(round(100 * below), 0), 0, 0, 25, 0)
    if is_due("aim", intervals.get(83)):
        (roll_rate, pitch_rate, yaw_rate), level = target
        link.mav.attitude_target_send(boot_us // 1000, 128, q, roll_rate, pitch_rate, yaw_rate, level)
    if is_due("outputs", intervals.get(36)):
        link.mav.servo_output_raw_send(boot_us & 0xFFFFFFFF, 0, *outputs(), *[0] * 4)
    if options.vicon and now < options.hide_s and is_due("vicon", 0.01):
        show(int(now * 100))
    if is_due("status", intervals.get(1)):
        link.mav.sys_status_send(0, 0, 0, 100, round(1e3 * BATTERY_V), -1, 90, 0, 0, 0, 0, 0, 0)
    if is_due("beat", 1.0):
        beat()
    if is_due("sync", 0.5):
        link.mav.timesync_send(0, boot_ns())
    if is_due("look", 0.1):
        seen["altitudes"].append([round(now, 2), round(position[2], 4), armed, mode == OFFBOARD])
    time.sleep(0.0008)

seen["rate_hz"] = round(len(setpoints) / (setpoints[-1] - setpoints[0]), 1) if len(setpoints) > 1 else 0.0
signing = link.mav.signing
seen["signing"] = {"good": signing.goodsig_count, "bad": signing.badsig_count}
seen["armed"], seen["place"] = armed, [round(c, 3) for c in position]
print(json.dumps(seen))
