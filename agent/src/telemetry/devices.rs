//! How the devices of a real vehicle are doing, and the scans of those that are asked for them.

use plumbline_proto::Kind;
use plumbline_proto::time::FlightTime;

use super::{Telemetry, convert, due};
use crate::sensor::wire;
use crate::vehicle::Vehicle;

const DEVICES_S: f64 = 1.0;

impl Telemetry {
    /// Each device of `vehicle`, once a second.
    pub fn devices(&mut self, now: FlightTime, vehicle: &mut dyn Vehicle) {
        if !due(&mut self.due.devices, now, DEVICES_S) {
            return;
        }
        let Self { outlets, kept, .. } = self;
        for (index, instance) in (1..=u16::MAX).enumerate() {
            let Some(state) = vehicle.device(index) else { return };
            let message = &mut kept.device;
            message.time_us = now.0;
            convert::set(&mut message.name, state.name);
            convert::set(&mut message.port, state.port);
            convert::set(&mut message.reason, &state.reason);
            (message.up, message.rate_hz) = (state.up, state.rate_hz);
            (message.age_s, message.jitter_us) = (state.age_s, state.jitter_us);
            (message.round_trip_us, message.clock_offset_us) = (state.round_trip_us, state.clock_offset_us);
            (message.faults, message.given_up, message.opened) = (state.faults, state.given_up, state.opened);
            outlets.send(Kind::Device, instance, now, message);
        }
    }

    /// The scans that came since the last tick.
    pub fn scans(&mut self, vehicle: &mut dyn Vehicle) {
        let Self { outlets, kept, .. } = self;
        vehicle.scans(&mut |scan| {
            let message = &mut kept.scan;
            (message.time_us, message.device_time_ms) = (scan.time.0, scan.device_time_ms);
            (message.first_angle_rad, message.step_angle_rad) = (scan.first_angle_rad, scan.step_angle_rad);
            message.range_mm.clear();
            message.range_mm.extend(scan.ranges_mm.iter().map(|mm| u32::from(*mm)));
            message.position_flu_m = wire::vector(&scan.position_flu_m);
            message.body_from_scan = wire::quaternion(&scan.body_from_scan);
            outlets.send(Kind::Scan, scan.instance, scan.time, message);
        });
    }
}
