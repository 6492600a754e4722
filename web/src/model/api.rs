//! The ground's JSON, as the page reads and writes it.

use plumbline_rest::Problem;
use plumbline_rest::flight::Curves;
use plumbline_rest::people::Session;
use serde::Deserialize;
use serde_json::Value;

/// Who is signed in, as what; `None` where nobody needs to be.
pub fn who(session: &Session) -> Option<String> {
    let name = session.name.as_ref()?;
    Some(session.role.map_or_else(|| name.clone(), |role| format!("{name} ({})", role.name())))
}

/// `GET /api/v1/flights/{id}/estimate`: a recording estimated again.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub struct Again {
    /// Its errors.
    pub score: Score,
    /// What it estimated.
    #[serde(flatten)]
    pub curves: Curves,
}

/// Root mean square errors against truth; absent where there is none.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
#[allow(missing_docs)]
pub struct Score {
    pub position_rmse_xyz_m: [Option<f64>; 3],
    pub velocity_rmse_xyz_mps: [Option<f64>; 3],
    pub heading_rmse_deg: Option<f64>,
    pub inclination_rmse_deg: Option<f64>,
    pub nees: Option<f64>,
    pub nees_states: Option<u32>,
}

/// What to tell the operator about a failed request: the ground's own text where it gave one.
pub fn failure_text(status: u16, body: &str) -> String {
    let problem: Problem = serde_json::from_str(body).unwrap_or_default();
    if !problem.detail.is_empty() {
        return problem.detail;
    }
    match status {
        0 => "the ground station does not answer".to_owned(),
        423 => "another operator holds control".to_owned(),
        503 => "the vehicle is not connected".to_owned(),
        504 => "the vehicle did not answer within 2 s".to_owned(),
        other => format!("the ground answered {other}"),
    }
}

/// Does the vehicle carry out a command however late it comes? So it does with the cut, disarm, land and the abort of attacks.
pub fn counts_late(method: &str, action: &str, body: &Value) -> bool {
    match (method, action) {
        ("POST", "cut" | "disarm") | ("DELETE", "attacks") => true,
        ("POST", "mode") => body.get("mode").is_some_and(|mode| mode == "land"),
        _ => false,
    }
}

/// Does it matter to the vehicle whether this command or another comes first? Gains, calibrations and whatever else takes long to answer
/// are not waited for.
pub fn in_order(action: &str) -> bool {
    matches!(
        action,
        "arm" | "disarm" | "cut" | "release-cut" | "mode" | "setpoint" | "trajectory" | "estimator" | "attacks"
    )
}

#[cfg(test)]
mod tests {
    use plumbline_proto::v1::Mode;
    use serde_json::json;

    use super::*;
    use crate::model::names;

    #[test]
    fn what_ends_a_flight_or_an_attack_counts_however_late() {
        let mode = |mode| json!(plumbline_rest::command::Mode { mode: names::mode_json(mode) });
        for (method, action, body, late) in [
            ("POST", "cut", json!({}), true),
            ("POST", "disarm", json!({}), true),
            ("POST", "mode", mode(Mode::Land), true),
            ("DELETE", "attacks", json!({}), true),
            ("POST", "mode", mode(Mode::AltitudeHold), false),
            ("POST", "attacks", json!({}), false),
            ("POST", "arm", json!({}), false),
            ("POST", "setpoint", json!({}), false),
        ] {
            assert_eq!(counts_late(method, action, &body), late, "{method} {action} {body}");
        }
    }

    #[test]
    fn failures_say_what_the_ground_said() {
        assert_eq!(
            failure_text(422, r#"{"detail":"height 3.4 m above limit 2.0 m"}"#),
            "height 3.4 m above limit 2.0 m"
        );
        assert_eq!(
            failure_text(
                409,
                r#"{"status":409,"code":"rejected","command_id":3,"detail":"battery 13.1 V below 14.0 V"}"#
            ),
            "battery 13.1 V below 14.0 V"
        );
        assert_eq!(failure_text(504, "<html>"), "the vehicle did not answer within 2 s");
        assert_eq!(failure_text(418, ""), "the ground answered 418");
    }
}
