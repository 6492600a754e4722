//! The simulator allocates nothing once it runs. A test binary of its own, for its counting allocator.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::types::MotorCommand;
use plumbline_agent::vehicle::Vehicle;
use plumbline_support::counting::{self, Counting};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn sense_and_actuate_allocate_nothing() {
    for world in ["bench", "datasheet", "harsh"] {
        let scenario = Scenario::from_toml(&format!(
            "name = \"everything\"\nworld = \"{world}\"\n[suite]\nadd = [\"gnss\", \"mocap_pose\", \"camera_ranges\"]\n\
             [[push]]\nat_s = 1\nduration_s = 1\naxis = \"yaw\"\nangle_rad = 0.3\n\
             [[outage]]\nsensor = \"imu\"\nstart_s = 1\nduration_s = 1\n",
        ))
        .unwrap();
        let mut vehicle = SimVehicle::new(&scenario).unwrap();
        let before = counting::requests();
        assert!(before > 0, "the allocator does not count");
        for _ in 0..2000 {
            std::hint::black_box(vehicle.sense().unwrap());
            vehicle.actuate(&MotorCommand { throttle: [0.7; 4] }).unwrap();
            std::hint::black_box(vehicle.truth());
        }
        assert_eq!(counting::requests() - before, 0, "{world}");
    }
}
