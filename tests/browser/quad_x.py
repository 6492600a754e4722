"""A pilot for the doubles of stock autopilots: attitude and position by PD, of a quad-X as PX4 and ArduPilot number it.

Everything is NED and FRD. The numbers are those of the simulated Iris; what a pilot would have tuned.
"""

import math

MASS, G = 1.545, 9.81
INERTIA = (0.029125, 0.029125, 0.055225)
THRUST, TORQUE = 5.84e-6, 0.06  # N s², m
# Forward, right (m), and the sign of the reaction about down: motors 1 and 2 turn counter-clockwise, seen from above.
MOTORS = ((0.13, 0.22, 1), (-0.13, -0.20, 1), (0.13, -0.22, -1), (-0.13, 0.20, -1))
TILT_MAX = 0.3
# A full battery lifts more than these numbers say, m/s².
TRIM = 1.8


def turned(q, v):
    """A vector of the body in the world, by w, x, y, z."""
    w, x, y, z = q
    return [
        (1 - 2 * (y * y + z * z)) * v[0] + 2 * (x * y - w * z) * v[1] + 2 * (x * z + w * y) * v[2],
        2 * (x * y + w * z) * v[0] + (1 - 2 * (x * x + z * z)) * v[1] + 2 * (y * z - w * x) * v[2],
        2 * (x * z - w * y) * v[0] + 2 * (y * z + w * x) * v[1] + (1 - 2 * (x * x + y * y)) * v[2],
    ]


def angles(q):
    """Roll, pitch, yaw."""
    w, x, y, z = q
    return (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x)))),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )


def wrapped(angle):
    return math.atan2(math.sin(angle), math.cos(angle))


def cut(v, most):
    return max(-most, min(most, v))


def motors(q, rates, position, velocity, goal, yaw_goal):
    """Commands 0 to 1 that bring the vehicle from `position` to `goal`."""
    roll, pitch, yaw = angles(q)
    ahead = [1.5 * (g - p) - 2.0 * v for g, p, v in zip(goal, position, velocity)]
    # Accelerations in the vertical plane of the heading, taken by tilt.
    forward = ahead[0] * math.cos(yaw) + ahead[1] * math.sin(yaw)
    right = -ahead[0] * math.sin(yaw) + ahead[1] * math.cos(yaw)
    wanted = (cut(right / G, TILT_MAX), cut(-forward / G, TILT_MAX), yaw_goal)
    down = cut(6.0 * (goal[2] - position[2]) - 4.0 * velocity[2] + TRIM, 6.0)
    lift = MASS * (G - down) / max(0.5, math.cos(roll) * math.cos(pitch))
    error = (wanted[0] - roll, wanted[1] - pitch, cut(wrapped(wanted[2] - yaw), 0.5))
    gains = ((60.0, 13.0), (60.0, 13.0), (6.0, 4.0))
    torque = [j * (p * e - d * w) for j, (p, d), e, w in zip(INERTIA, gains, error, rates)]
    commands = []
    for x, y, turn in MOTORS:
        newton = lift / 4 - torque[0] * math.copysign(1, y) / (4 * 0.21) + torque[1] * math.copysign(1, x) / (4 * 0.13)
        newton += turn * torque[2] / (4 * TORQUE)
        speed = math.sqrt(max(0.0, newton) / THRUST)
        commands.append(min(1.0, max(0.0, (speed - 100.0) / 1000.0)))
    return commands
