//! Altitude on the string rig and in free flight: the figures that must be reached.
#![allow(clippy::unwrap_used)]

mod common;

use common::{check, expect, scenario};

#[test]
fn take_off_to_one_metre_overshoots_less_than_ten_centimetres() {
    let flown = check(&scenario("takeoff"), |f| {
        let highest = f.rows.iter().map(|r| r.truth.position_enu_m.z).fold(0.0, f64::max);
        println!("highest {highest:.3} m");
        expect(highest <= 1.1, || format!("rises to {highest:.3} m"))?;
        let last = f.last().truth.position_enu_m;
        expect((last.z - 1.0).abs() < 0.05, || format!("ends at {last}"))
    });
    println!("{}", flown.log());
}
