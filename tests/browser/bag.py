"""A ROS 2 bag, read by the third-party `rosbags`, by the definitions in the file. Prints what it found, as JSON."""

import json
import sys
from collections import defaultdict
from importlib.metadata import version
from pathlib import Path

from rosbags.highlevel import AnyReader

found = defaultdict(lambda: {"type": "", "messages": 0})
with AnyReader([Path(sys.argv[1])]) as reader:
    for connection, time_ns, raw in reader.messages():
        message = reader.deserialize(raw, connection.msgtype)
        topic = found[connection.topic]
        topic["type"] = connection.msgtype
        topic["messages"] += 1
        if connection.msgtype == "nav_msgs/msg/Odometry":
            topic["frame"] = message.header.frame_id
            topic["z"] = message.pose.pose.position.z
            topic["stamped"] = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time_ns
        if connection.msgtype == "sensor_msgs/msg/Range":
            topic["range"] = float(message.range)
        # One field of each that is simply a number or a list of them.
        for name, read in {
            "FluidPressure": lambda: message.fluid_pressure,
            "MagneticField": lambda: message.magnetic_field.z,
            "NavSatFix": lambda: [message.latitude, message.longitude, *message.position_covariance[::4]],
            "LaserScan": lambda: [message.angle_max, *message.ranges],
            "BatteryState": lambda: [message.voltage, message.percentage],
            "Actuators": lambda: message.normalized,
            "PoseStamped": lambda: [message.pose.position.z, message.pose.orientation.z],
        }.items():
            if connection.msgtype.endswith(f"/{name}"):
                value = read()
                topic["value"] = float(value) if isinstance(value, float) else [float(v) for v in value]
        if connection.msgtype == "tf2_msgs/msg/TFMessage":
            for one in message.transforms:
                frames = f"{one.header.frame_id} {one.child_frame_id}"
                topic.setdefault("frames", {})[frames] = one.transform.translation.z
        if connection.msgtype == "rcl_interfaces/msg/Log":
            topic["text"] = message.msg
json.dump({"version": version("rosbags"), "topics": found}, sys.stdout)
