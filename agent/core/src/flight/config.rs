//! What a flight needs to know before it starts: plain data, built once by the configuration.

use plumbline_proto::ids::SensorId;

use super::watermark;
use crate::attack::Bounds;
use crate::control::policy::MarginPolicy;
use crate::control::setpoint::Limits;
use crate::control::tuning::Design;
use crate::estimate::bank::{Assumptions, build};
use crate::estimate::lanes::linear::Shaken;
use crate::estimate::secure::Decoder;
use crate::estimate::secure::SLOTS;
use crate::model::airframe::Airframe;
use crate::sensor::SensorModel;
use crate::sensor::suite::Suite;
use crate::supervisor::Settings;
use crate::types::{Actuation, ControllerKind, EstimatorKind};

/// Fraction of the weight that the motors may lift in the orientation test. At 0.9 the string holds so little that two
/// degrees of tilt swing the vehicle by 35°; with 0.8 it is a quarter of that.
const ORIENTATION_CEILING: f64 = 0.8;

/// What holds the vehicle; decides what it may be asked to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RigKind {
    /// Nothing.
    Free,
    /// Turns about one axis only; cannot lift.
    SingleAxis,
    /// Hanging from strings with the thrust kept below lift-off (\[Paternain\] VIII-B).
    StringsOrientation,
    /// Hanging from strings, lifting itself within their reach (\[Paternain\] VIII-C).
    StringsFlight {
        /// Highest altitude at which the strings still catch gently, m.
        reach_m: f64,
    },
    /// Tethered to the ground.
    Tethered {
        /// Length of the tether, m.
        reach_m: f64,
    },
    /// On its stand: may take off and land there.
    OnStand,
}

impl RigKind {
    /// May the vehicle lift itself?
    pub fn can_lift(self) -> bool {
        !matches!(self, Self::SingleAxis | Self::StringsOrientation)
    }

    /// Does the rig catch a vehicle whose motors stop?
    pub fn catches(self) -> bool {
        matches!(self, Self::SingleAxis | Self::StringsOrientation | Self::StringsFlight { .. })
    }

    /// Most thrust allowed in total, N.
    pub fn thrust_ceiling_n(self, weight_n: f64) -> f64 {
        if self == Self::StringsOrientation { ORIENTATION_CEILING * weight_n } else { f64::INFINITY }
    }

    /// Highest altitude the rig allows, m.
    pub fn altitude_max_m(self) -> f64 {
        match self {
            Self::StringsFlight { reach_m } | Self::Tethered { reach_m } => reach_m,
            _ => f64::INFINITY,
        }
    }

    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Free => "free flight",
            Self::SingleAxis => "single axis",
            Self::StringsOrientation => "strings, orientation",
            Self::StringsFlight { .. } => "strings, flight",
            Self::Tethered { .. } => "tethered",
            Self::OnStand => "on its stand",
        }
    }
}

/// May sensors be attacked, and how far?
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AttackPolicy {
    /// At all?
    pub enabled: bool,
    /// How far.
    pub bounds: Bounds,
}

/// What must be proved of the attack envelope before it arms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EnvelopeDemand {
    /// Nobody who is not seen may move the altitude further, m …
    pub altitude_max_m: f64,
    /// … who owns so many sensors …
    pub sensors: usize,
    /// … while the lanes measure this of their accelerometers.
    pub shaken: Shaken,
}

/// Everything a [`super::Flight`] is built from: a field for each thing that can be configured, hence so many.
#[derive(Debug, Clone)]
pub struct FlightConfig {
    /// The vehicle.
    pub airframe: Airframe,
    /// What holds it.
    pub rig: RigKind,
    /// What it is commanded by.
    pub actuation: Actuation,
    /// Control ticks a second, 50 to 1000.
    pub tick_rate_hz: f64,
    /// Limits of setpoints.
    pub limits: Limits,
    /// The controller to start with.
    pub design: Design,
    /// What gains must forgive before they fly.
    pub margins: MarginPolicy,
    /// Estimators that run side by side.
    pub estimators: Vec<EstimatorKind>,
    /// The one in the loop.
    pub in_loop: EstimatorKind,
    /// The program that the secure estimator solves first; `None` leaves it the default.
    pub decoder: Option<Decoder>,
    /// Slots of 40 ms in its window: T of \[Clinic\].
    pub window_slots: usize,
    /// What the estimators assume of the sensors.
    pub sensor_model: SensorModel,
    /// Sensors of the vehicle.
    pub sensors: Vec<SensorId>,
    /// Those on a wire of their own: the watchdog reads only them, of their kind, and nothing can be injected there.
    pub independent: Vec<SensorId>,
    /// What may be done to sensors on purpose.
    pub attacks: AttackPolicy,
    /// Thresholds of the failsafes.
    pub failsafe: Settings,
    /// What must be proved of the attack envelope to arm; nothing where it is left out.
    pub envelope: Option<EnvelopeDemand>,
    /// What is added to the thrust against replays; nothing where it is left out.
    pub watermark: Option<watermark::Settings>,
}

impl FlightConfig {
    /// Defaults for `airframe` on `rig` with the sensors of `suite`: 200 Hz, no attacks, the secure estimator by lanes
    /// in the loop where there are [IMUs to compare](Self::in_loop_of), the bias EKF where there is one; both run, with
    /// the complementary filter beside them.
    pub fn new(airframe: Airframe, rig: RigKind, suite: &Suite) -> Self {
        Self {
            design: Design::new(ControllerKind::LqrIntegral, &airframe),
            margins: MarginPolicy::default(),
            airframe,
            rig,
            actuation: Actuation::Motors,
            tick_rate_hz: 200.0,
            limits: Limits::default(),
            estimators: vec![EstimatorKind::EkfBias, EstimatorKind::Complementary, EstimatorKind::Lanes],
            in_loop: Self::in_loop_of(suite.imus.len()),
            decoder: None,
            window_slots: SLOTS,
            sensor_model: SensorModel::from(suite),
            sensors: suite.descriptions().iter().map(|d| d.id).collect(),
            independent: Vec::new(),
            attacks: AttackPolicy::default(),
            failsafe: Settings::default(),
            envelope: None,
            watermark: None,
        }
    }

    /// The estimator that a vehicle with so many IMUs is flown by where nobody says: each samples on a clock of its own,
    /// what shakes the frame differs between them, and the bias EKF, which compares them at one instant, takes that for
    /// faults.
    pub fn in_loop_of(imus: usize) -> EstimatorKind {
        if imus > 1 { EstimatorKind::Lanes } else { EstimatorKind::EkfBias }
    }

    /// What its estimators assume.
    pub fn assumptions(&self) -> Assumptions<'_> {
        Assumptions { airframe: &self.airframe, sensors: &self.sensor_model, window_slots: self.window_slots }
    }

    /// With every estimator there is running side by side, for a vehicle that can spare the time: the simulator and
    /// replays of its flights. The one in the loop stays.
    pub fn with_every_estimator(mut self) -> Self {
        let assumed = self.assumptions();
        let mut kinds = vec![self.in_loop];
        let built = |kind: &EstimatorKind| build(*kind, &assumed).is_ok();
        kinds.extend(EstimatorKind::all().filter(|kind| *kind != self.in_loop).filter(built));
        self.estimators = kinds;
        self
    }

    /// Highest altitude setpoint: the limit, or the rig's where that is lower, m.
    pub fn altitude_max_m(&self) -> f64 {
        self.limits.altitude_max_m.min(self.rig.altitude_max_m())
    }
}
