//! How far an attacker who is not seen can push the vehicle (`GET /api/v1/vehicles/{id}/envelope`, `POST /api/v1/envelope`), with
//! what, and how surely that is seen (`POST /api/v1/envelope/attack`).

use serde::{Deserialize, Serialize};

use crate::command::PlannedAttack;
use crate::design::Design;

/// What is asked; what is left out is as usual.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct EnvelopeQuestion {
    /// The gains, as a design; its airframe and tick rate count.
    #[serde(default)]
    pub design: Design,
    /// Name of a suite of sensors; where it is left out that of the vehicle asked about, or `string_rig`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub suite: Option<String>,
    /// All sets of at most so many sensors, 1 to 3, and all heights; 2 where it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub most: Option<usize>,
    /// Only this set: sensors by name, `height 2`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensors: Option<Vec<String>>,
    /// Sensors that are excluded: neither used nor attacked.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub without: Vec<String>,
    /// `z`, the altitude, where it is left out; `x` or `y`: tilt, velocity and position along a horizontal axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axis: Option<String>,
    /// One sensor more of this kind, `height`, `imu`, `gnss` or `pose`: what would it buy?
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub more: Option<String>,
    /// How long the attack lasts, s; 10 where it is left out, 5 along a horizontal axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub horizon_s: Option<f64>,
    /// Noise that the lanes measure of their accelerometers, m/s²: the more there is, the later one that is attacked is seen. Where it is
    /// left out there is none beyond the data sheets': what is called unseen is so in flight as well, and an IMU's bound is the least, beyond which
    /// one goes that is shaken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_mps2: Option<f64>,
    /// What the lanes take all accelerometers to be off by alike as they are shaken, m/s²: heights weigh more, and one that is attacked moves
    /// the altitude further. Along z only; none where it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rectified_mps2: Option<f64>,
    /// Along a swing along the axis in the place of a hover, from where one begins. Not asked over HTTP.
    #[serde(skip)]
    pub swing: Option<Swing>,
    /// The climb as well, along z.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub climb: bool,
    /// The maximising sequence and the certificate as well; only of one set along z, `sensors`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub proof: bool,
}

/// To and fro along the axis asked about, about 1 m over the ground.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Swing {
    /// m.
    pub amplitude_m: f64,
    /// Of one swing, s.
    pub period_s: f64,
}

/// The bounds of all sets asked for.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Envelope {
    /// Name of the suite, or of the vehicle whose it is.
    pub suite: String,
    /// Name of the airframe.
    pub airframe: String,
    /// s.
    pub horizon_s: f64,
    /// One for each set, the smaller sets first.
    pub sets: Vec<EnvelopeSet>,
}

/// The bound of one set of attacked sensors, from a flight without the attack.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct EnvelopeSet {
    /// By name.
    pub sensors: Vec<String>,
    /// No silent attack moves the altitude further, m; absent where there is no bound.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub altitude_m: Option<f64>,
    /// The worst one found moves it as far, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reached_m: Option<f64>,
    /// No silent attack makes it climb faster, m/s; where that was asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub climb_mps: Option<f64>,
    /// Without a bound: as fast the altitude can drift for ever, m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drift_mps: Option<f64>,
    /// Along a horizontal axis: no silent attack tilts it further, rad; absent where nobody judges the set, or it is beyond small angles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tilt_rad: Option<f64>,
    /// None makes it faster there, m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity_mps: Option<f64>,
    /// None moves it further there, m; with motion capture or GNSS.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_m: Option<f64>,
    /// The worst attacks found there reach at least this part of their bounds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reached: Option<f64>,
    /// The detector that holds most of the bound, along a horizontal axis of the tilt's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub binding: Option<String>,
    /// Solved in, ms; 0 where another set has the same program.
    pub took_ms: f64,
    /// The sequence that moves the altitude by `reached_m`, silently; where that was asked.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub attack: Vec<EnvelopeSequence>,
    /// What proves `altitude_m`; where that was asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub certificate: Option<EnvelopeCertificate>,
}

/// What is added to the samples of one sensor, one after another.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct EnvelopeSequence {
    /// By name.
    pub sensor: String,
    /// Between two of them, s; of an IMU a slot, whose samples all have the same added.
    pub period_s: f64,
    /// m, along z m/s² of an IMU.
    pub values: Vec<f64>,
}

/// Why no silent attack goes further: cᵀa ≤ Σ |λᵢ| lᵢ + Σⱼ |c − Σ λᵢ mᵢ|ⱼ uⱼ for any λ, and these are some.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct EnvelopeCertificate {
    /// `full`: every sensor weighs fully; `outvoted`: healthy heights weigh as little as just before their exclusion. The larger
    /// bound is told, and this is its certificate.
    pub regime: String,
    /// When the altitude is furthest, s since the onset.
    pub end_s: f64,
    /// λᵢ and lᵢ.
    pub multipliers: Vec<EnvelopeMultiplier>,
    /// The second sum, m: what the multipliers leave to the most that may be added.
    pub added_m: f64,
    /// c, one number for each value that is added: sensor after sensor as in `attack`, each until `end_s`.
    pub objective: Vec<f64>,
    /// u.
    pub most: Vec<f64>,
}

/// A detector at one time, and its multiplier.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct EnvelopeMultiplier {
    /// Its name.
    pub detector: String,
    /// Whose, where it is a sensor's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor: Option<String>,
    /// When, s.
    pub time_s: f64,
    /// l, in the unit of its statistic.
    pub limit: f64,
    /// λ, m for each of that unit.
    pub multiplier: f64,
    /// Statistics that it is made of: more than one where it is a cut of a sum of squares.
    pub statistics: usize,
    /// m.
    pub row: Vec<f64>,
}

/// An attack to be prepared, or one to be judged before it flies (`POST /api/v1/envelope/attack`).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct AttackQuestion {
    /// The loop; `sensors` are those attacked, for `horizon_s`. For `zero_dynamics` and `covert` they may name `rotors`, all of them.
    #[serde(default)]
    pub of: EnvelopeQuestion,
    /// `optimal` (what the bound is nearly reached with), `stealthy_bias` (the largest constant one seen in one of twenty flights),
    /// `zero_dynamics` (what no healthy sensor sees; no `attacks` where the loop has none, and `note` tells its zeros)
    /// or `covert` (a motion that is not in what is received); left out, `attacks` are judged as they are, along the `axis` that
    /// all of them are along where none is named. Along x and y `zero_dynamics` and `rotors` are not prepared, a stealthy bias
    /// is one of IMUs under motion capture, and a covert motion needs all that measure it attacked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub generator: Option<String>,
    /// Of an optimal one and of a stealthy bias along `axis` x or y: what it pushes, `tilt` (as left out), `velocity` or `position`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deviation: Option<String>,
    /// Of a covert one, along x and y the largest of the motion itself; and the largest that rotors add along zero dynamics, m/s².
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub accel_mps2: Option<f64>,
    /// rms of the vehicle's watermark, m/s², where it flies one: what tells a replayed accelerometer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub watermark_mps2: Option<f64>,
    /// After the schedule is accepted, s.
    #[serde(default)]
    pub start_s: f64,
    /// What is judged.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub attacks: Vec<PlannedAttack>,
}

/// An attack, and what is expected of it with lanes in the loop.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct PreparedAttack {
    /// As a schedule has them.
    pub attacks: Vec<PlannedAttack>,
    /// Part of flights in which a sensor is excluded, or heights are found to contradict each other: drawn white noise, of accelerometers as measured, about hover. Of a rotor in which
    /// it is isolated, of a replay in which the watermark tells it: by closed forms, which `note` says. Along x and y only where
    /// motion capture measures the motion, or every IMU has the same added.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// Furthest that they move the altitude of the linear loop until they are seen, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub altitude_m: Option<f64>,
    /// Along a horizontal axis, where that is pushed or `attacks` were judged: furthest that they tilt the linear loop, rad;
    /// absent beyond small angles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tilt_rad: Option<f64>,
    /// The same of its velocity, m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity_mps: Option<f64>,
    /// The same of its position, m; of judged ones where motion capture measures it, and of a covert motion its length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_m: Option<f64>,
    /// Why nothing is expected of some; by what else than draws, and of what, something is; what a sequence is not.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub note: String,
}

/// Noises of the accelerometers that the bounds of a flight are asked at, m/s².
pub const NOISES_MPS2: [f64; 24] = [
    0.013, 0.02, 0.025, 0.031, 0.038, 0.044, 0.05, 0.07, 0.1, 0.13, 0.17, 0.23, 0.3, 0.4, 0.5, 0.67, 0.85, 1.2, 1.4,
    1.6, 2.2, 3.1, 3.7, 4.5,
];
/// What they rectify that the bounds of a flight are asked at, m/s².
const RECTIFIED_MPS2: [f64; 10] = [0.0, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.1, 1.6, 2.5];

/// The two that `rectified_mps2` lies between, m/s²; `None` above the last. Nearest zero it is two as well.
pub fn around(rectified_mps2: f64) -> Option<[f64; 2]> {
    let after = RECTIFIED_MPS2.iter().position(|one| *one >= rectified_mps2)?.max(1);
    let [low, high] = [after - 1, after].map(|i| RECTIFIED_MPS2.get(i).copied());
    Some([low?, high?])
}

/// Bounds bend between two of them, and waver: a line between two is raised by this factor. Held by a test against bounds found there.
const RAISED: f64 = 1.05;

/// The bound at `noise_mps2` and `rectified_mps2` between `rows` of noise, m/s², and bound, m, with rising noise, those at either of what is
/// [`around`] it: never less than it is; `None` above the last.
pub fn between(rows: &[Vec<(f64, f64)>; 2], noise_mps2: f64, rectified_mps2: f64) -> Option<f64> {
    let [low, high] = around(rectified_mps2)?;
    let [low_m, high_m] = rows.each_ref().map(|rows| along(rows, noise_mps2));
    let (low_m, high_m) = low_m.zip(high_m)?;
    Some(RAISED * (low_m + (high_m - low_m) * (rectified_mps2 - low) / (high - low)))
}

fn along(rows: &[(f64, f64)], noise_mps2: f64) -> Option<f64> {
    let after = rows.iter().position(|(noise, _)| *noise >= noise_mps2)?;
    let (high, high_m) = *rows.get(after)?;
    let Some((low, low_m)) = after.checked_sub(1).and_then(|before| rows.get(before)) else {
        return Some(high_m);
    };
    Some(low_m + (high_m - low_m) * (noise_mps2 - low) / (high - low))
}
