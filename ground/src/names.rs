//! Enum names of the JSON API: lower snake case of the proto names, without their prefix.

use plumbline_proto::v1;

/// An enum of the schema that has a JSON name.
pub trait JsonName: Sized + Copy {
    /// Prefix of the proto names, `MODE_`.
    const PREFIX: &'static str;
    /// What it is called in an error message.
    const WHAT: &'static str;

    /// The proto name.
    fn proto_name(self) -> &'static str;
    /// Inverse of [`JsonName::proto_name`].
    fn from_proto_name(name: &str) -> Option<Self>;

    /// `altitude_hold`.
    fn json_name(self) -> String {
        let name = self.proto_name();
        name.strip_prefix(Self::PREFIX).unwrap_or(name).to_ascii_lowercase()
    }

    /// Inverse of [`JsonName::json_name`].
    ///
    /// # Errors
    /// A sentence with the name that is not known.
    fn from_json_name(name: &str) -> Result<Self, String> {
        // The JSON name is lower case only: "ALTITUDE_HOLD" is a typing error, not a synonym.
        let known = name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_');
        known
            .then(|| Self::from_proto_name(&format!("{}{}", Self::PREFIX, name.to_ascii_uppercase())))
            .flatten()
            .ok_or_else(|| format!("{} {:?} is not known", Self::WHAT, clip(name)))
    }

    /// JSON name of a number from the wire; `unknown_7` when this build does not know it.
    fn json_name_of(number: i32) -> String
    where
        Self: TryFrom<i32>,
    {
        Self::try_from(number).map_or_else(|_| format!("unknown_{number}"), Self::json_name)
    }
}

/// First characters of something a client sent, for an error message.
pub fn clip(text: &str) -> String {
    text.chars().take(80).collect()
}

macro_rules! json_names {
    ($($name:ident, $prefix:literal, $what:literal;)*) => {$(
        impl JsonName for v1::$name {
            const PREFIX: &'static str = $prefix;
            const WHAT: &'static str = $what;
            fn proto_name(self) -> &'static str {
                self.as_str_name()
            }
            fn from_proto_name(name: &str) -> Option<Self> {
                Self::from_str_name(name)
            }
        }
    )*};
}

json_names! {
    Mode, "MODE_", "mode";
    SensorKind, "SENSOR_KIND_", "sensor";
    AttackKind, "ATTACK_KIND_", "attack kind";
    AttackChannel, "ATTACK_CHANNEL_", "channel";
    AttackPhase, "ATTACK_PHASE_", "attack phase";
    Decoder, "DECODER_", "decoder";
    AckStage, "ACK_STAGE_", "stage";
    Failsafe, "FAILSAFE_", "failsafe";
    TrajectoryShape, "TRAJECTORY_SHAPE_", "shape";
}

impl JsonName for v1::EstimatorKind {
    const PREFIX: &'static str = "ESTIMATOR_KIND_";
    const WHAT: &'static str = "estimator";
    fn proto_name(self) -> &'static str {
        self.as_str_name()
    }
    /// Former names are known as well.
    fn from_proto_name(name: &str) -> Option<Self> {
        Self::named(&name.strip_prefix(Self::PREFIX)?.to_ascii_lowercase())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip_and_unknown_ones_are_quoted() {
        assert_eq!(v1::Mode::AltitudeHold.json_name(), "altitude_hold");
        assert_eq!(v1::Mode::from_json_name("altitude_hold"), Ok(v1::Mode::AltitudeHold));
        assert_eq!(v1::EstimatorKind::from_json_name("ekf_bias"), Ok(v1::EstimatorKind::EkfBias));
        assert_eq!(v1::EstimatorKind::from_json_name("attitude"), Ok(v1::EstimatorKind::Vqf));
        assert_eq!(v1::Mode::from_json_name("hover").unwrap_err(), "mode \"hover\" is not known");
        assert!(v1::Mode::from_json_name("HOLD").is_err());
        assert_eq!(v1::AttackPhase::json_name_of(77), "unknown_77");
    }
}
