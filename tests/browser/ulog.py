"""The sensors of ULog files by the third-party `pyulog`, as our reader takes them: counts, and sums in body FLU and world ENU. JSON."""

import json
import sys
from importlib.metadata import version

import numpy
from pyulog import ULog


def changes(*columns):
    """Where one of them is not what it was."""
    new = numpy.zeros(len(columns[0]), dtype=bool)
    new[:1] = True
    for column in columns:
        new[1:] |= column[1:] != column[:-1]
    return new


def sums(data, field, signs, scale=1.0, rows=slice(None)):
    columns = [data[f"{field}[{axis}]"][rows].astype(float) for axis in range(3)]
    return len(columns[0]), [sign * scale * column.sum() for sign, column in zip(signs, columns)]


def found(path):
    topics = {topic.name: topic.data for topic in ULog(path).data_list if topic.multi_id == 0}
    imu = topics["sensor_combined"]
    flu = (1, -1, -1)
    count, gyro = sums(imu, "gyro_rad", flu)
    told = {"imu": count, "gyro_radps": gyro, "accel_mps2": sums(imu, "accelerometer_m_s2", flu)[1]}
    # Before 2019 magnetometer and barometer stood in sensor_combined, again and again.
    if "vehicle_magnetometer" in topics:
        told["mag"], told["mag_ut"] = sums(topics["vehicle_magnetometer"], "magnetometer_ga", flu, 100)
    elif "magnetometer_ga[0]" in imu:
        rows = changes(*(imu[f"magnetometer_ga[{axis}]"] for axis in range(3)))
        told["mag"], told["mag_ut"] = sums(imu, "magnetometer_ga", flu, 100, rows)
    if "vehicle_air_data" in topics:
        told["baro"] = len(topics["vehicle_air_data"]["timestamp"])
        told["baro_pa"] = topics["vehicle_air_data"]["baro_pressure_pa"].astype(float).sum()
    elif "baro_alt_meter" in imu:
        told["baro"] = int(changes(imu["baro_alt_meter"]).sum())
    if "vehicle_gps_position" in topics:
        fix = topics["vehicle_gps_position"]
        rows = fix["fix_type"] >= 3
        told["gnss"] = int(rows.sum())
        told["gnss_enu_mps"] = [sign * fix[axis][rows].astype(float).sum() for sign, axis in
                                ((1, "vel_e_m_s"), (1, "vel_n_m_s"), (-1, "vel_d_m_s"))]
    return told


json.dump({"version": version("pyulog"), "files": [found(path) for path in sys.argv[1:]]}, sys.stdout)
