//! The simulator allocates nothing once it runs. A test binary of its own, for its counting allocator.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use plumbline_agent::vehicle::sim::{Scenario, SimVehicle};
use plumbline_agent::vehicle::{MotorCommand, Vehicle};

struct Counting;

thread_local! {
    // Of this thread only: the test harness has others.
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: hands every request to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller's contract is passed on.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's contract is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn sense_and_actuate_allocate_nothing() {
    let scenario = Scenario::from_toml(
        "name = \"everything\"\n[suite]\nadd = [\"gnss\", \"mocap_pose\", \"camera_ranges\"]\n\
         [[push]]\nat_s = 1\nduration_s = 1\naxis = \"yaw\"\nangle_rad = 0.3\n\
         [[outage]]\nsensor = \"imu\"\nstart_s = 1\nduration_s = 1\n",
    )
    .unwrap();
    let mut vehicle = SimVehicle::new(&scenario).unwrap();
    let before = ALLOCATIONS.get();
    assert!(before > 0, "the allocator does not count");
    for _ in 0..2000 {
        std::hint::black_box(vehicle.sense().unwrap());
        vehicle.actuate(&MotorCommand { throttle: [0.7; 4] }).unwrap();
        std::hint::black_box(vehicle.truth());
    }
    assert_eq!(ALLOCATIONS.get() - before, 0);
}
