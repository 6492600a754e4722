//! Plans to begin with, and what the page shows of results.

pub mod selection;

use plumbline_proto::v1::Description;
use plumbline_rest::command::PlannedAttack;
use plumbline_rest::experiment::{Condition, Flight};

use super::{axis::ValueAxis, draft::Draft};
use selection::value;

/// Room of a row of dots for them, px.
pub const DOTS_PX: f64 = 300.0;
/// Height of a row, px.
pub const ROW_PX: f64 = 22.0;

const SCRIPT: &str = r#"[scenario]
world = "datasheet"
duration_s = 30
rig = { hanging_strings = { mode = "flight", height_m = 0.3 } }
script = [
  { at_s = 3, do = "arm" }, { at_s = 4, do = "mode", mode = "altitude_hold" },
  { at_s = 5, do = "setpoint", altitude_m = 0.9 }, { at_s = 20, do = "setpoint", altitude_m = 1.2 },
]
"#;

/// The part of it that climbs while it is attacked.
const CLIMBS: &str = r#" { at_s = 20, do = "setpoint", altitude_m = 1.2 },"#;

/// Which of them, the sign and the onset are drawn from the flight's seed.
const HEIGHT: &str = "[attack]\nsensor = \"height\"\n";

const DETECTABILITY: &str = r#"[attack]
sensor = "height"                # which of them, the sign and the onset are drawn from the seed
kind = "bias"
[[factor]]
key = "agent.estimators.in_loop"
values = ["ekf_bias", "lanes"]
[[factor]]
key = "attack.magnitude"         # m
values = [0.02, 0.05, 0.1, 0.2, 0.5]
"#;

const ESTIMATORS: &str = r#"[attack]
sensor = "any"
kind = "drawn"                   # sensor, channel, kind, size, sign, onset and length
[[factor]]
key = "agent.estimators.in_loop"
values = ["ekf_bias", "secure", "lanes"]
"#;

const WORLDS: &str = r#"[[factor]]
key = "scenario.world"
values = ["bench", "datasheet", "harsh"]
[[factor]]
key = "agent.estimators.in_loop"
values = ["ekf_bias", "lanes"]
"#;

const STEPS: &str = r#"[[factor]]
key = "agent.controller.kind"
values = ["lqr_integral", "lqr", "pid"]
[[factor]]
key = "scenario.rig"
values = [{ hanging_strings = { mode = "flight", height_m = 0.3 } }, { free = { height_m = 0.0 } }]
"#;

const RECORDED: &str = r#"[[factor]]
key = "agent.estimators.in_loop"
values = ["ekf_bias", "lanes"]
# With an [attack] the clean samples are attacked; without, what was received then is received again.
"#;

/// Of a vehicle that is there.
fn by_hand(vehicle: &str) -> String {
    format!(
        "[by_hand]                        # an operator flies it, in an order that is drawn\nvehicle = {vehicle:?}\naltitude_m = [0.5, 0.8, 1.0, \
         0.5]\nhold_s = 8.0\nrest_s = 20.0                    # between two flights, least\n[[factor]]\nkey = \
         \"agent.estimators.in_loop\"\nvalues = [\"ekf_bias\", \"lanes\"]\n"
    )
}

/// [Clinic] Table 1: one of three heights attacked in each of his ways; `altitude_m` over that of "none" is his e / e*.
fn table_1() -> String {
    let attacks = [("none", 0.0), ("zero", 0.0), ("bias", 0.5), ("ramp", 0.1), ("noise", 0.2), ("replay", 3.0)];
    let estimators = ["ekf_bias", "secure", "lanes"];
    let all = attacks.iter().flat_map(|attack| estimators.map(|estimator| (attack, estimator)));
    all.map(|((kind, magnitude), estimator)| {
        format!(
            "[[condition]]\n\"agent.estimators.in_loop\" = \"{estimator}\"\n\"attack.kind\" = \"{kind}\"\n\"attack.magnitude\" = \
             {magnitude:?}\n"
        )
    })
    .collect()
}

/// Weights of the altitude a fourth, as they are by default for an Iris, and four times.
fn gains() -> String {
    let weights = [0.25, 1.0, 4.0].map(|factor| {
        let z = 25.0 * factor;
        format!(
            "  {{ state = [1, 1, {z:?}, 0.69, 0.69, 4, 32.7, 32.7, 8.2, 0.11, 0.11, 0.25, 0.11, 0.11, {z:?}, 0.44], input = \
             [0.0086, 5.9, 5.9, 58] }},\n"
        )
    });
    format!(
        "# x y z, vx vy vz, roll pitch yaw, p q r, integrals of x y z yaw; thrust, torque x y z\n[[factor]]\nkey = \
         \"agent.weights\"\nvalues = [\n{}]\n",
        weights.concat()
    )
}

/// A plan to begin with: what it asks, and its text. `flights` are recorded ones, by their ids; `vehicle` is the one shown.
pub fn templates(flights: &[String], vehicle: &str) -> [(&'static str, String); 8] {
    let head = |name: &str, repeats: u32| format!("name = \"{name}\"\nrepeats = {repeats}\nseed = 1000\n");
    // Tables of the plan come after its own keys.
    let plan = |name: &str, repeats: u32, rest: &str| format!("{}{SCRIPT}{rest}", head(name, repeats));
    // What the model expects is known of a vehicle that hovers.
    let hovering = plan("detectability", 4, DETECTABILITY).replace(CLIMBS, "");
    let again = format!("[[factor]]\nkey = \"recording\"\nvalues = {flights:?}\n");
    [
        ("From which size on is an attack found?", hovering),
        ("Which estimator holds altitude under attack?", plan("estimators", 10, ESTIMATORS)),
        ("Table 1 of [Clinic]: one height attacked", plan("clinic_table_1", 5, &format!("{HEIGHT}{}", table_1()))),
        ("Which gains hold altitude best?", plan("gains", 10, &gains())),
        ("How do controllers step, on strings and free?", plan("steps", 10, STEPS)),
        ("What does a harder world cost?", plan("worlds", 5, WORLDS)),
        ("Which estimator fits what was flown?", format!("{}{again}{RECORDED}", head("recorded", 1))),
        (
            "On the rig, flown by hand: which estimator holds steps?",
            format!("{}{}", head("by_hand", 3), by_hand(vehicle)),
        ),
    ]
}

/// What is done to the sensors of a recording that is flown again.
#[derive(Debug, Clone, PartialEq)]
pub enum Again {
    /// As received then, attacks of then included.
    Received,
    /// As sensed, without any attack.
    Sensed,
    /// As sensed, and attacked in this way; it begins so long after the recording.
    Attacked(Draft),
}

impl Again {
    /// A plan that flies recording `id` once under each of these estimators.
    pub fn plan(&self, id: &str, estimators: &[String]) -> String {
        let attack = match self {
            Self::Received => String::new(),
            Self::Sensed => "[attack]\nsensor = \"none\"\n".to_owned(),
            Self::Attacked(draft) => {
                let PlannedAttack { sensor, instance, channel, kind, magnitude, start_s, duration_s, .. } =
                    draft.body(1);
                format!(
                    "[attack]\nsensor = {sensor:?}\ninstance = {instance}\nchannel = {channel:?}\nkind = {kind:?}\nmagnitude = \
                     {magnitude:?}\nsign = \"given\"\nstart_s = {start_s:?}\nduration_s = {duration_s:?}\n"
                )
            }
        };
        format!(
            "name = \"again\"\n{attack}[[factor]]\nkey = \"recording\"\nvalues = [{id:?}]\n[[factor]]\nkey = \"agent.estimators.in_loop\"\n\
             values = {estimators:?}\n"
        )
    }

    /// Of the flight that comes of it, which its `vehicle` describes.
    pub fn name(&self, vehicle: Option<&Description>) -> String {
        match self {
            Self::Received => "as received".into(),
            Self::Sensed => "not attacked".into(),
            Self::Attacked(draft) => draft.subject(vehicle),
        }
    }
}

/// A flight's dot in the row of its condition.
#[derive(Debug, Clone, PartialEq)]
pub struct Dot {
    /// Which flight of the plan.
    pub index: u64,
    /// From the left of the row and from its top, px.
    pub at: [f64; 2],
    /// The value, or why it was lost.
    pub title: String,
    /// Lost flights lie at the right edge.
    pub lost: bool,
}

/// The axis that all rows of one measure share, from zero where nothing is below.
pub fn axis(flights: &[Flight], measure: usize) -> ValueAxis {
    let values = flights.iter().filter_map(|flight| value(flight, measure));
    let (low, high) = values
        .filter(|value| value.is_finite())
        .fold((0.0_f64, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    ValueAxis::fit(low, high.max(low), 1e-6, None)
}

/// The dots of one condition.
pub fn dots(flights: &[Flight], condition: &Condition, measure: usize, axis: &ValueAxis) -> Vec<Dot> {
    let of = flights.iter().filter(|flight| flight.condition == condition.number);
    of.filter_map(|flight| {
        let lost = !flight.lost.is_empty();
        let value = value(flight, measure);
        let x = if lost { DOTS_PX } else { axis.fraction(value?) * (DOTS_PX - 16.0) };
        // Flights of the same seed lie at the same height of their rows.
        let y = ROW_PX * (0.25 + 0.5 * ((flight.seed as f64 * 0.618_034).fract()));
        let what = if lost { format!("lost: {}", flight.lost) } else { format!("{:.4}", value.unwrap_or(f64::NAN)) };
        Some(Dot { index: flight.index, at: [x, y], title: format!("seed {}, {what}", flight.seed), lost })
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::draft::Form;

    fn flight(index: u64, condition: u64, value: Option<f64>, lost: &str) -> Flight {
        Flight { index, condition, seed: 1000 + index, lost: lost.into(), values: vec![value] }
    }

    #[test]
    fn each_flight_is_a_dot_of_its_condition_and_lost_ones_lie_at_the_edge() {
        let flights = [
            flight(0, 0, Some(0.01), ""),
            flight(1, 0, Some(0.03), ""),
            flight(2, 0, None, "fell"),
            flight(3, 1, Some(0.02), ""),
            flight(4, 0, None, ""),
        ];
        let axis = axis(&flights, 0);
        let seen = dots(&flights, &Condition::default(), 0, &axis);
        assert_eq!(seen.iter().map(|dot| dot.index).collect::<Vec<_>>(), [0, 1, 2], "what has no value has no dot");
        assert!(seen[0].at[0] < seen[1].at[0] && seen[2].at[0] == DOTS_PX && seen[2].lost);
        assert!(seen.iter().all(|dot| (0.0..=ROW_PX).contains(&dot.at[1])));
        assert!(seen[2].title.contains("fell"));
    }

    #[test]
    fn a_recording_is_flown_again_under_each_estimator_and_attacked_as_drafted() {
        let plan = |again: &Again| again.plan("f1", &["ukf".into(), "lanes".into()]);
        assert!(plan(&Again::Received).ends_with(
            "values = [\"f1\"]\n[[factor]]\nkey = \"agent.estimators.in_loop\"\nvalues = [\"ukf\", \"lanes\"]\n"
        ));
        assert!(!plan(&Again::Received).contains("[attack]") && plan(&Again::Sensed).contains("sensor = \"none\""));
        let again = Again::Attacked(Form::default().check(None).unwrap());
        assert!(
            plan(&again).contains(
                "[attack]\nsensor = \"height\"\ninstance = 2\nchannel = \"all\"\nkind = \"bias\"\nmagnitude = 0.5\nsign = \
                 \"given\"\nstart_s = 5.0\nduration_s = 10.0\n[[factor]]"
            ),
            "{}",
            plan(&again)
        );
        assert_eq!(again.name(None), "height 2: bias +0.5");
    }

    #[test]
    fn every_template_has_a_name_and_varies_something() {
        for (_, plan) in templates(&["20260131-iris-1".into()], "iris-1") {
            assert!(
                plan.starts_with("name = ") && (plan.contains("[[factor]]") || plan.contains("[[condition]]")),
                "{plan}"
            );
        }
        let climb = templates(&[], "").map(|(_, plan)| plan.contains("at_s = 20"));
        assert_eq!(climb, [false, true, true, true, true, true, false, false], "what the model expects is of a hover");
        let [.., (_, again), (_, by_hand)] = templates(&["a".into(), "b".into()], "iris-2");
        assert!(again.contains("values = [\"a\", \"b\"]") && !again.contains("[scenario]"), "{again}");
        assert!(by_hand.contains("vehicle = \"iris-2\"") && !by_hand.contains("[scenario]"), "{by_hand}");
    }
}
