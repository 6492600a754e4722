//! Figures 5 to 7: the vehicle with its motors left alone: straight up, left, right.

use nalgebra::Vector3;
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::model::integrate::rk4;
use plumbline_agent::model::rigid_body::{Input, State, derivative};
use plumbline_agent::types::ROTORS;
use plumbline_tests::report::{Plot, Report, Series};

const PERIOD_S: f64 = 0.002;
const FLOWN_S: f64 = 1.0;
/// Speeds of the rotors over that of hovering: more on all, and more on one side than on the other.
const MORE: f64 = 1.1;
const SIDES: f64 = 0.01;

/// Flies with the left rotors (y > 0) so much faster than the right ones for half a second, and then so much slower.
fn flown(airframe: &Airframe, all: f64, left: f64) -> Vec<(f64, Vector3<f64>)> {
    let mut state = State::at_rest(Vector3::zeros());
    let hover = airframe.hover_speed_radps();
    (0..=(FLOWN_S / PERIOD_S) as u32)
        .map(|tick| {
            let t_s = f64::from(tick) * PERIOD_S;
            let lean = if t_s < 0.5 * FLOWN_S { left } else { -left };
            let speeds: [f64; ROTORS] =
                std::array::from_fn(|i| hover * (all + lean * airframe.rotors[i].position_flu_m.y.signum()));
            let input = Input::from_rotors(airframe, &speeds, &[0.0; ROTORS]);
            let at = (t_s, state.position_enu_m);
            state = rk4(&state, PERIOD_S, |x| derivative(airframe, x, &input)).normalised();
            at
        })
        .collect()
}

pub fn run(report: &mut Report) {
    report.heading("Figures 5 to 7: straight up, left, right");
    let airframe = Airframe::clinic();
    // Body y points left: faster rotors on the right push the vehicle there.
    let cases = [("5", "up", MORE, 0.0, 2), ("6", "left", 1.0, -SIDES, 1), ("7", "right", 1.0, SIDES, 1)];
    for (figure, name, all, left, axis) in cases {
        let track = flown(&airframe, all, left);
        let moved_m = track.last().map_or(f64::NAN, |(_, place)| place[axis]);
        let met = if name == "right" { moved_m < 0.0 } else { moved_m > 0.0 };
        let more = serde_json::json!({ "after_s": FLOWN_S, "axis": axis, "met": met });
        report.value(&format!("figure_{figure}/{name}"), moved_m, "m", more);
        let mut plot = Plot::new(&format!("Motors left alone: {name}"), "t, s", "place, m");
        for (axis, label) in ["x (ahead)", "y (left)", "z (up)"].into_iter().enumerate() {
            plot = plot.with(Series::line(label, track.iter().map(|(t, place)| (*t, place[axis])).collect()));
        }
        report.figure(&format!("figure_{figure}"), &format!("Figure {figure}: {name}."), &plot).unwrap();
    }
}
