//! Parameters of the protocol: the gains in use and the limits that the agent enforces, to be read. Gains are pushed on the page, where
//! they are examined; limits are the agent's own configuration.

use plumbline_proto::v1;
use serde_json::{Value, json};

/// All of them, by name.
pub(super) fn all(gains: Option<&v1::GainsInUse>, limits: Option<&v1::Limits>) -> Vec<(String, Value)> {
    let mut all = Vec::new();
    if let Some(gains) = gains {
        all.push(("gains.revision".into(), json!(gains.revision)));
        all.push(("gains.controller".into(), json!(gains.controller)));
        all.push(("gains.margin_policy".into(), json!(gains.margin_policy)));
        all.push(("gains.slowest_pole_per_s".into(), json!(gains.slowest_pole_per_s)));
        if let Some(weights) = &gains.weights {
            all.push(("gains.state_weight".into(), json!(weights.state_weight)));
            all.push(("gains.input_weight".into(), json!(weights.input_weight)));
        }
        all.extend(gains.parameters.iter().map(|p| (format!("gains.parameters.{}", p.name), json!(p.value))));
    }
    if let Some(limits) = limits {
        let named = [
            ("altitude_min_m", limits.altitude_min_m),
            ("altitude_max_m", limits.altitude_max_m),
            ("lateral_max_m", limits.lateral_max_m),
            ("climb_max_mps", limits.climb_max_mps),
            ("descent_max_mps", limits.descent_max_mps),
            ("tilt_max_rad", limits.tilt_max_rad),
            ("thrust_max_n", limits.thrust_max_n),
            ("attack_max_duration_s", limits.attack_max_duration_s),
        ];
        all.extend(named.map(|(name, value)| (format!("limits.{name}"), json!(value))));
    }
    all
}

/// Those of `wanted`, or all where none are named, as the protocol writes them. Names that are not known are left out, as it asks.
pub(super) fn values(all: &[(String, Value)], wanted: &[String]) -> Vec<Value> {
    let chosen = all.iter().filter(|(name, _)| wanted.is_empty() || wanted.contains(name));
    let write = |(name, value): &(String, Value)| {
        let mut parameter = json!({ "name": name, "value": value });
        // Whole numbers would pass for integers.
        match value {
            Value::Number(_) => parameter["type"] = "float64".into(),
            Value::Array(_) => parameter["type"] = "float64_array".into(),
            _ => {}
        }
        parameter
    };
    chosen.map(write).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_and_limits_are_named_and_only_those_asked_for_are_answered() {
        let weights = v1::LqrWeights { state_weight: vec![1.0; 16], input_weight: vec![2.0; 4] };
        let parameters = vec![v1::Parameter { name: "delay_s".into(), value: 0.01 }];
        let gains = v1::GainsInUse { revision: 7, weights: Some(weights), parameters, ..Default::default() };
        let limits = v1::Limits { altitude_max_m: 2.0, ..Default::default() };
        let all = all(Some(&gains), Some(&limits));
        assert_eq!(values(&all, &[]).len(), 4 + 2 + 1 + 8);
        let asked = ["limits.altitude_max_m", "gains.parameters.delay_s", "nothing"].map(str::to_owned);
        assert_eq!(
            values(&all, &asked),
            [
                json!({ "name": "gains.parameters.delay_s", "value": 0.01, "type": "float64" }),
                json!({ "name": "limits.altitude_max_m", "value": 2.0, "type": "float64" }),
            ]
        );
        assert!(super::all(None, None).is_empty(), "nothing is made up before the vehicle has said it");
    }
}
