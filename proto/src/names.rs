//! Names of estimators and decoders: in configuration, scenarios, the HTTP API and on the command line, and for people.

use crate::v1::{Decoder, EstimatorKind, Health};

/// Names that older files and scripts use.
const FORMER: [(&str, EstimatorKind); 3] = [
    ("primary", EstimatorKind::Complementary),
    ("point_mass", EstimatorKind::ConstantAcceleration),
    ("attitude", EstimatorKind::Vqf),
];

impl EstimatorKind {
    /// The names of all of them, for messages.
    pub const NAMES: &str =
        "ekf_bias, complementary, ekf_hybrid, ukf, constant_acceleration, vqf, secure, attitude_ekf, lanes";

    /// The estimator called `name`: the lower-snake-case name of the wire (`ekf_bias`), or what it was called once.
    pub fn named(name: &str) -> Option<Self> {
        let former = FORMER.iter().find(|(former, _)| *former == name).map(|(_, kind)| *kind);
        let lower = || name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_');
        let present = || Self::from_str_name(&format!("ESTIMATOR_KIND_{}", name.to_ascii_uppercase()));
        former.or_else(|| if lower() { present() } else { None }).filter(|kind| *kind != Self::Unspecified)
    }

    /// For people.
    pub fn title(self) -> &'static str {
        match self {
            Self::Unspecified => "—",
            Self::EkfBias => "EKF with biases",
            Self::Complementary => "Complementary filter",
            Self::EkfHybrid => "Hybrid EKF",
            Self::Ukf => "UKF",
            Self::ConstantAcceleration => "Constant acceleration",
            Self::Vqf => "VQF",
            Self::AttitudeEkf => "Attitude EKF",
            Self::Secure => "Window decoder",
            Self::Lanes => "Secure (lanes)",
        }
    }

    /// Every estimator, by its number.
    pub fn all() -> impl Iterator<Item = Self> {
        (1..).map_while(|number| Self::try_from(number).ok())
    }

    /// Does it estimate attitude alone, neither position nor altitude?
    pub fn attitude_only(self) -> bool {
        matches!(self, Self::Vqf | Self::AttitudeEkf)
    }
}

impl Decoder {
    /// The decoder called `name`: the lower-snake-case name of the wire (`l2_split`).
    pub fn named(name: &str) -> Option<Self> {
        let present = Self::from_str_name(&format!("DECODER_{}", name.to_ascii_uppercase()));
        present.filter(|decoder| *decoder != Self::Unspecified)
    }

    /// For people.
    pub fn title(self) -> &'static str {
        match self {
            Self::Unspecified => "—",
            Self::L2 => "ℓ1/ℓ2",
            Self::L1 => "ℓ1/ℓ1",
            Self::L2Split => "ℓ1/ℓ2, split",
            Self::L1Split => "ℓ1/ℓ1, split",
        }
    }
}

impl Health {
    /// For people, within a sentence.
    pub fn word(self) -> &'static str {
        match self {
            Self::Unspecified => "of unknown health",
            Self::Initialising => "initialising",
            Self::Healthy => "healthy",
            Self::Degraded => "degraded",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn estimators_keep_the_names_that_old_files_use() {
        for (name, kind) in [
            ("vqf", EstimatorKind::Vqf),
            ("attitude", EstimatorKind::Vqf),
            ("complementary", EstimatorKind::Complementary),
            ("primary", EstimatorKind::Complementary),
            ("constant_acceleration", EstimatorKind::ConstantAcceleration),
            ("point_mass", EstimatorKind::ConstantAcceleration),
            ("ekf_bias", EstimatorKind::EkfBias),
            ("secure", EstimatorKind::Secure),
            ("lanes", EstimatorKind::Lanes),
        ] {
            assert_eq!(EstimatorKind::named(name), Some(kind), "{name}");
        }
        for name in ["magic", "unspecified", "SECURE", "", "ekf-bias"] {
            assert_eq!(EstimatorKind::named(name), None, "{name}");
        }
    }

    #[test]
    fn messages_name_every_estimator() {
        let named: Vec<_> = EstimatorKind::NAMES.split(", ").map(EstimatorKind::named).collect();
        assert_eq!(named, EstimatorKind::all().map(Some).collect::<Vec<_>>());
    }

    #[test]
    fn decoders_have_the_names_of_the_wire() {
        assert_eq!(Decoder::named("l2_split"), Some(Decoder::L2Split));
        assert_eq!((Decoder::named("l3"), Decoder::named("unspecified"), Decoder::named("")), (None, None, None));
    }
}
