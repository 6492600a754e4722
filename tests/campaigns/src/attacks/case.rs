//! The rows of the table: who is attacked in which world, and how much it may cost.

use plumbline_agent::attack::{Attack, Channel};
use plumbline_agent::sensor::height::Height;
use plumbline_agent::sensor::imu::Imu;
use plumbline_agent::sensor::suite::Sheet as _;
use plumbline_agent::sim::Scenario;
use plumbline_agent::types::EstimatorKind;
use plumbline_experiment::attacked::{Attacked, Given};
use plumbline_experiment::flight::Setup;
use plumbline_experiment::monitor::Test;
use plumbline_experiment::reception::Reception;
use plumbline_proto::v1::SensorKind;

/// Length of a flight, and of a long one, s.
const END_S: f64 = 40.0;
const LONG_S: f64 = 600.0;
/// Altitudes: from when, s, and how high, m.
const STEPS: [(f64, f64); 3] = [(5.0, 0.9), (18.0, 1.2), (29.0, 0.8)];
/// Free, and on strings: by turns of the seed.
const RIGS: [&str; 2] = ["[rig.free]\nheight_m = 0.0\n", "[rig.hanging_strings]\nmode = \"flight\"\nheight_m = 0.3\n"];

/// A row of the table.
#[derive(Debug, Clone, Copy)]
pub struct Case {
    pub name: &'static str,
    pub world: &'static str,
    pub end_s: f64,
    pub pilots: &'static [Pilot],
    /// Whose flight without attack e* is of.
    pub against: Pilot,
    pub heights: usize,
    pub imus: usize,
    pub attacked: Attacked,
    /// Most that e/e* may be: median, 95th percentile, worst.
    pub altitude: [f64; 3],
    /// The same of the tilt's error.
    pub tilt: [f64; 3],
    /// Most flights lost of a hundred.
    pub lost: f64,
}

/// No limit.
const ANY: [f64; 3] = [f64::INFINITY; 3];

impl Case {
    const PLAIN: Self = Self {
        name: "none",
        world: "datasheet",
        end_s: END_S,
        pilots: &Pilot::ALL,
        against: Pilot::EKF,
        heights: 3,
        imus: 4,
        attacked: Attacked::None,
        altitude: [1.05, 1.15, 1.25],
        tilt: ANY,
        lost: 0.0,
    };

    /// The rows of the table.
    pub const ALL: [Self; 9] = [
        Self::PLAIN,
        Self { name: "none_ten_minutes", end_s: LONG_S, pilots: &[Pilot::LANES], ..Self::PLAIN },
        Self {
            name: "one_sensor",
            attacked: Attacked::One,
            altitude: [1.15, 1.3, 1.5],
            tilt: [1.1, 1.7, 2.0],
            ..Self::PLAIN
        },
        Self { name: "imu_and_height", attacked: Attacked::ImuAndHeight, altitude: [1.15, 1.35, 1.6], ..Self::PLAIN },
        Self {
            name: "two_of_five_heights",
            heights: 5,
            imus: 5,
            attacked: Attacked::Several(SensorKind::Height, 2),
            altitude: [1.3, 1.6, 1.8],
            ..Self::PLAIN
        },
        Self {
            name: "two_of_five_imus",
            heights: 5,
            imus: 5,
            attacked: Attacked::Several(SensorKind::Imu, 2),
            altitude: [1.1, 1.3, 1.5],
            tilt: [1.2, 2.2, 2.5],
            ..Self::PLAIN
        },
        Self { name: "two_of_three_heights_colluding", attacked: Attacked::Colluding(2), altitude: ANY, ..Self::PLAIN },
        Self { name: "harsh_none", world: "harsh", against: Pilot::LANES, altitude: ANY, lost: 1.0, ..Self::PLAIN },
        Self {
            name: "harsh_one_sensor",
            world: "harsh",
            against: Pilot::LANES,
            attacked: Attacked::One,
            altitude: [1.3, 1.8, f64::INFINITY],
            lost: 1.0,
            ..Self::PLAIN
        },
    ];

    /// One sensor attacked by a bias of this size.
    pub fn sized(sensor: SensorKind, channel: Channel, size: f64) -> Self {
        Self {
            name: "curve",
            attacked: Attacked::Given(Given::bias(sensor, channel, size)),
            altitude: ANY,
            ..Self::PLAIN
        }
    }

    /// The flight of this `seed`, without its attacks.
    pub fn scenario(&self, seed: u64) -> Scenario {
        let mut text =
            format!("name = \"attacks\"\nseed = {seed}\nduration_s = {}\nworld = \"{}\"\n", self.end_s, self.world);
        text += "[[script]]\nat_s = 3\ndo = \"arm\"\n[[script]]\nat_s = 4\ndo = \"mode\"\nmode = \"altitude_hold\"\n";
        for (at_s, altitude_m) in STEPS {
            text += &format!("[[script]]\nat_s = {at_s}\ndo = \"setpoint\"\naltitude_m = {altitude_m}\n");
        }
        text += RIGS[(seed % 2) as usize];
        text += "[suite]\npreset = \"string_rig\"\n";
        let mut scenario = Scenario::from_toml(&text).unwrap_or_else(|e| panic!("{e}\n{text}"));
        scenario.suite.heights = (1..=self.heights).map(|i| Height::laser(i, self.heights)).collect();
        scenario.suite.imus = (1..=self.imus).map(Imu::typical).collect();
        scenario
    }
}

/// Who estimates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pilot {
    /// The estimator of this name, as it is shipped: gates, votes, cross-checks.
    Shipped(EstimatorKind),
    /// The shipped EKF, and what stands between it and the sensors.
    Behind(Reception),
}

impl Pilot {
    pub const EKF: Self = Self::Shipped(EstimatorKind::EkfBias);
    pub const LANES: Self = Self::Shipped(EstimatorKind::Lanes);
    pub const ALL: [Self; 8] = [
        Self::EKF,
        Self::Behind(Reception::Median),
        Self::Behind(Reception::Detected(Test::ChiSquare)),
        Self::Behind(Reception::Detected(Test::Cusum)),
        Self::Behind(Reception::EkfPerImu),
        Self::Shipped(EstimatorKind::Secure),
        Self::LANES,
        Self::Behind(Reception::Oracle),
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Shipped(EstimatorKind::EkfBias) => "shipped EKF",
            Self::Shipped(EstimatorKind::Secure) => "window decoder",
            Self::Shipped(EstimatorKind::Lanes) => "lanes",
            Self::Shipped(_) => "another",
            Self::Behind(Reception::All) => "shipped EKF",
            Self::Behind(Reception::Median) => "median fusion",
            Self::Behind(Reception::Detected(Test::ChiSquare)) => "chi-square detector",
            Self::Behind(Reception::Detected(Test::Cusum)) => "CUSUM detector",
            Self::Behind(Reception::EkfPerImu) => "EKF per IMU",
            Self::Behind(Reception::Oracle) => "oracle",
        }
    }

    /// Does it say which sensors it excludes?
    pub fn judges(self) -> bool {
        matches!(self, Self::Shipped(EstimatorKind::Secure | EstimatorKind::Lanes))
    }

    fn estimator(self) -> EstimatorKind {
        if let Self::Shipped(kind) = self { kind } else { EstimatorKind::EkfBias }
    }

    /// The flight of `scenario` that this one flies.
    pub fn setup(self, scenario: &Scenario, attacks: &[Attack], judged_from_s: f64) -> Setup {
        let mut config = scenario.flight_config();
        config.estimators = vec![self.estimator()];
        config.in_loop = self.estimator();
        let reception = match self {
            Self::Shipped(_) => Reception::All,
            Self::Behind(reception) => reception,
        };
        let simulated = Setup::simulated(scenario.clone(), config, judged_from_s);
        Setup { reception, attacks: attacks.to_vec(), ..simulated }
    }
}
