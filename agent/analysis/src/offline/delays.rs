//! How late the stamps of heights and of motion capture are: what remains to be added to `delay_s` of their devices.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | d | delay: a sample stamped t was measured at t − d | s |
//! | w(t) | specific force of one IMU turned upright, less gravity, integrated twice | m |
//! | τ | time from the middle of a stretch | s |
//! | z₀, v₀, b | altitude and climb there, and what the accelerometer is off by | m, m/s, m/s² |
//!
//! Over a stretch of two seconds y(t) = w(t − d) + z₀ + v₀ τ + ½ b τ², with one d for all stretches. What z₀, v₀ and b explain is taken out
//! of each stretch first (variable projection, Golub and Pereyra 1973); d is found from a grid by Gauss–Newton, samples far off left
//! out. Its variance is that between stretches (clustered), as a laser is off by the same for longer than a sample.

use nalgebra::Vector3;

use plumbline_core::calibration::file::{Plot, Series};
use plumbline_core::calibration::samples::{Channel, Sample, channel};
use plumbline_core::calibration::{CalibrationError, CalibrationFile, Kind};
use plumbline_core::estimate::vqf::{Vqf, VqfOptions};
use plumbline_core::sensor::SensorFrame;
use plumbline_core::types::GRAVITY_MPS2;
use plumbline_proto::ids::SensorId;
use plumbline_proto::v1::SensorKind;

/// IMU samples for a fit.
const SAMPLES_MIN: usize = 500;
/// Length of a stretch, s.
const STRETCH_S: f64 = 2.0;
/// Measurements in a stretch that counts.
const STRETCH_MIN: usize = 8;
/// Stretches with them.
const STRETCHES_MIN: usize = 3;
/// An IMU silent for longer is not integrated over, s.
const SILENT_S: f64 = 0.1;
/// Delays looked for, s, and how far apart on the grid.
const FROM_S: f64 = -0.1;
const TO_S: f64 = 0.5;
const GRID_S: f64 = 0.01;
/// A larger uncertainty is of no use, s.
const SIGMA_MAX_S: f64 = 0.01;
/// Residuals beyond this many sigmas, by their median, are left out.
const FAR_SIGMAS: f64 = 4.0;
/// Largest residual, rms, m: where an IMU is shaken so that it does not follow the vehicle within this, what comes out is wrong by more
/// than its sigma.
const RESIDUAL_MAX_M: f64 = 0.015;

/// What a sensor says of the altitude: stamp, s, and altitude, m.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Altitudes {
    /// The sensor, as in `height 2`.
    pub name: String,
    /// In the order they came.
    pub measured: Vec<[f64; 2]>,
}

impl Altitudes {
    /// Adds what `frame` holds of each height and of motion capture.
    pub fn take(all: &mut Vec<Self>, frame: &SensorFrame) {
        let heights = (1..).zip(&frame.heights).filter_map(|(instance, sample)| {
            sample.map(|height| (SensorId::new(SensorKind::Height, instance), height.time, height.height_m))
        });
        let pose =
            frame.mocap_pose.map(|pose| (SensorId::new(SensorKind::MocapPose, 1), pose.time, pose.position_enu_m.z));
        for (sensor, time, altitude_m) in heights.chain(pose) {
            let name = sensor.to_string();
            let known = all.iter().position(|of| of.name == name);
            let place = known.unwrap_or_else(|| {
                all.push(Self { name, measured: Vec::new() });
                all.len() - 1
            });
            if let Some(of) = all.get_mut(place) {
                of.measured.push([time.as_seconds(), altitude_m]);
            }
        }
    }
}

/// How one IMU moved along the vertical, but for a quadratic in time.
struct Rise {
    /// Time, s, acceleration, m/s², climb, m/s, and altitude, m, at each sample.
    at: Vec<[f64; 4]>,
}

impl Rise {
    fn of(samples: &[Sample]) -> Result<Self, CalibrationError> {
        let gyro = channel(samples, Channel::Gyroscope, "gyroscope samples", SAMPLES_MIN)?;
        let force = channel(samples, Channel::Accelerometer, "accelerometer samples", SAMPLES_MIN)?;
        let mut filter = Vqf::new(VqfOptions { use_mag: false, ..VqfOptions::default() });
        let mut at: Vec<[f64; 4]> = Vec::with_capacity(force.len());
        for ((time_s, gyro), (_, force)) in gyro.into_iter().zip(force) {
            let before = at.last().copied();
            let dt_s = before.map_or(0.0, |[before_s, ..]| time_s - before_s);
            filter.push(dt_s, &gyro, &force, None);
            let lift = (filter.world_from_body() * force).dot(&Vector3::z()) - GRAVITY_MPS2;
            let [_, old, climb, rise] = before.unwrap_or([time_s, lift, 0.0, 0.0]);
            let then = climb + 0.5 * (old + lift) * dt_s;
            at.push([time_s, lift, then, rise + climb * dt_s + (2.0 * old + lift) * dt_s * dt_s / 6.0]);
        }
        Ok(Self { at })
    }

    /// Climb, m/s, and altitude, m, at `time_s`; `None` where no IMU sample is near.
    fn at(&self, time_s: f64) -> Option<[f64; 2]> {
        let after = self.at.partition_point(|[at_s, ..]| *at_s <= time_s);
        let [[from_s, lift, climb, rise], [to_s, next, ..]] =
            [*self.at.get(after.checked_sub(1)?)?, *self.at.get(after)?];
        let (whole_s, dt_s) = (to_s - from_s, time_s - from_s);
        if whole_s > SILENT_S {
            return None;
        }
        let slope = (next - lift) / whole_s;
        let climb_then = climb + (lift + 0.5 * slope * dt_s) * dt_s;
        Some([climb_then, rise + (climb + (0.5 * lift + slope * dt_s / 6.0) * dt_s) * dt_s])
    }
}

/// Samples of one stretch, less what altitude, climb and bias there explain: what is left of each, m, and what a second of delay makes of
/// it, m/s.
type Stretch = Vec<[f64; 2]>;

/// Of `measured` with a delay of `delay_s`; `None` of too few.
fn stretch(measured: &[[f64; 2]], rise: &Rise, delay_s: f64) -> Option<Stretch> {
    if measured.len() < STRETCH_MIN {
        return None;
    }
    let middle_s = 0.5 * (measured.first()?[0] + measured.last()?[0]);
    let row = |[stamp_s, altitude_m]: &[f64; 2]| {
        let [climb, risen] = rise.at(stamp_s - delay_s)?;
        Some([altitude_m - risen, climb])
    };
    let mut left: Stretch = measured.iter().map(row).collect::<Option<_>>()?;
    // Orthonormal polynomials (Gram–Schmidt).
    let mut basis: Vec<Vec<f64>> = Vec::with_capacity(3);
    for power in 0..3 {
        let mut next: Vec<f64> = measured.iter().map(|[t, _]| ((t - middle_s) / STRETCH_S).powi(power)).collect();
        for known in &basis {
            let share = along(&next, known);
            next.iter_mut().zip(known).for_each(|(next, known)| *next -= share * known);
        }
        let norm = along(&next, &next).sqrt();
        if norm < 1e-6 {
            return None;
        }
        next.iter_mut().for_each(|next| *next /= norm);
        basis.push(next);
    }
    for known in &basis {
        let shares =
            left.iter().zip(known).fold([0.0, 0.0], |[r, j], (row, known)| [r + row[0] * known, j + row[1] * known]);
        for (row, known) in left.iter_mut().zip(known) {
            row.iter_mut().zip(shares).for_each(|(value, share)| *value -= share * known);
        }
    }
    Some(left)
}

fn along(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(a, b)| a * b).sum()
}

/// One sensor's stretches.
struct Fitting<'a> {
    rise: &'a Rise,
    /// Measurements that count.
    parts: Vec<Vec<[f64; 2]>>,
}

impl Fitting<'_> {
    fn stretches(&self, delay_s: f64) -> Vec<Stretch> {
        self.parts.iter().filter_map(|part| stretch(part, self.rise, delay_s)).collect()
    }

    /// What is left, mean square, m².
    fn cost(&self, delay_s: f64) -> f64 {
        let stretches = self.stretches(delay_s);
        let (sum, n) = stretches.iter().flatten().fold((0.0, 0.0), |(s, n), [r, _]| (s + r * r, n + 1.0));
        sum / n
    }

    /// The minimum near `delay_s`.
    fn nearest(&self, mut delay_s: f64) -> f64 {
        for _ in 0..8 {
            let stretches = self.stretches(delay_s);
            let rows = stretches.iter().flatten();
            let (gradient, curvature) = rows.fold((0.0, 0.0), |(g, h), [r, j]| (g + r * j, h + j * j));
            // A delay of d takes climb · d off an altitude.
            let step_s = -gradient / f64::max(curvature, 1e-12);
            delay_s = (delay_s + step_s.clamp(-GRID_S, GRID_S)).clamp(FROM_S, TO_S);
        }
        delay_s
    }

    /// Leaves out what is far off at `delay_s`.
    fn keep_near(&mut self, delay_s: f64) {
        let stretches = self.stretches(delay_s);
        let mut off: Vec<f64> = stretches.iter().flatten().map(|[r, _]| r.abs()).collect();
        if off.is_empty() {
            return;
        }
        let half = off.len() / 2;
        // Of white noise half lies within 0.6745 sigmas.
        let sigma_m = *off.select_nth_unstable_by(half, f64::total_cmp).1 / 0.6745;
        let far = FAR_SIGMAS * sigma_m.max(1e-4);
        for part in &mut self.parts {
            if let Some(left) = stretch(part, self.rise, delay_s) {
                let mut near = left.iter().map(|[r, _]| r.abs() <= far);
                part.retain(|_| near.next().unwrap_or(true));
            }
        }
    }
}

/// The delay of one sensor.
struct Delay {
    delay_s: f64,
    sigma_s: f64,
    samples: usize,
    rms_m: f64,
    picture: Plot,
}

fn delay(of: &Altitudes, rise: &Rise) -> Result<Delay, CalibrationError> {
    for (index, [stamp_s, altitude_m]) in of.measured.iter().enumerate() {
        for (channel, value) in [("time", *stamp_s), ("altitude", *altitude_m)] {
            if !value.is_finite() {
                return Err(CalibrationError::NotFinite { channel, index, value });
            }
        }
    }
    let (first_s, last_s) =
        rise.at.first().zip(rise.at.last()).map_or((0.0, 0.0), |(a, b)| (a[0] + TO_S, b[0] + FROM_S));
    let mut parts: Vec<Vec<[f64; 2]>> = Vec::new();
    let mut place = usize::MAX;
    for one in of.measured.iter().filter(|[stamp_s, _]| (first_s..=last_s).contains(stamp_s)) {
        let number = ((one[0] - first_s) / STRETCH_S) as usize;
        if std::mem::replace(&mut place, number) != number {
            parts.push(Vec::new());
        }
        if let Some(part) = parts.last_mut() {
            part.push(*one);
        }
    }
    let mut fitting = Fitting { rise, parts };
    let found = fitting.stretches(0.0).len();
    if found < STRETCHES_MIN {
        return Err(CalibrationError::TooFew {
            what: "stretches of 2 s with measurements",
            found,
            needed: STRETCHES_MIN,
        });
    }
    let grid = (0..=((TO_S - FROM_S) / GRID_S).round() as usize).map(|k| FROM_S + k as f64 * GRID_S);
    let costs = grid.map(|delay_s| (fitting.cost(delay_s), delay_s));
    let best_s = costs.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, delay_s)| delay_s);
    let mut delay_s = fitting.nearest(best_s);
    fitting.keep_near(delay_s);
    delay_s = fitting.nearest(delay_s);
    let stretches = fitting.stretches(delay_s);
    let clustered = stretches.iter().map(|s| s.iter().fold([0.0, 0.0], |[g, h], [r, j]| [g + r * j, h + j * j]));
    let (scatter, curvature) = clustered.fold((0.0, 0.0), |(s, h), [g, own]| (s + g * g, h + own));
    let many = stretches.len() as f64;
    let sigma_s = (many / (many - 1.0) * scatter).sqrt() / curvature;
    let parameter = format!("delay of {}", of.name);
    if sigma_s.is_nan() || sigma_s > SIGMA_MAX_S {
        return Err(CalibrationError::Undetermined {
            parameter: format!("{parameter} (s)"),
            sigma: sigma_s,
            limit: SIGMA_MAX_S,
        });
    }
    if !(FROM_S + GRID_S..=TO_S - GRID_S).contains(&delay_s) {
        let expected = "between -0.09 and 0.49: stamps of another clock?";
        return Err(CalibrationError::Value { what: format!("{parameter} (s)"), value: delay_s, expected });
    }
    let samples = stretches.iter().flatten().count();
    let rms_m = fitting.cost(delay_s).sqrt();
    if rms_m > RESIDUAL_MAX_M {
        return Err(CalibrationError::BadFit { found: rms_m, limit: RESIDUAL_MAX_M, unit: "m" });
    }
    let as_stamped = fitting.stretches(0.0);
    let points: Vec<[f64; 2]> = as_stamped.iter().flatten().map(|[r, j]| [*j, *r]).collect();
    let ends = points.iter().fold([0.0_f64; 2], |[low, high], [climb, _]| [low.min(*climb), high.max(*climb)]);
    let picture = Plot {
        title: format!("{}: delay {:.0} ± {:.1} ms", of.name, 1e3 * delay_s, 1e3 * sigma_s),
        x: "climb by the IMU, m/s".into(),
        y: "altitude off as stamped, m".into(),
        log: false,
        series: vec![
            Series::new("measured", false, points),
            Series::new("fit", true, ends.map(|climb| [climb, -delay_s * climb])),
        ],
    };
    Ok(Delay { delay_s, sigma_s, samples, rms_m, picture })
}

/// Finds how late the stamps of each of `sensors` are, in a flight with steps of altitude, by the `samples` of one IMU. A sensor of which
/// the flight does not tell is left out, with a note; where it tells of none the first one's reason is the answer.
///
/// # Errors
/// [`CalibrationError`]: NaN, too few samples, a delay that is not determined.
pub fn delays(samples: &[Sample], sensors: &[Altitudes]) -> Result<CalibrationFile, CalibrationError> {
    let rise = Rise::of(samples)?;
    let mut file = CalibrationFile::new(Kind::Delays, 0, 0.0, "m");
    let (mut squares, mut refused) = (0.0, None);
    for of in sensors {
        match delay(of, &rise) {
            Ok(found) => {
                file.push(&of.name.replace(' ', "_"), found.delay_s, Some(found.sigma_s), "s");
                file.picture.push(found.picture);
                file.samples += found.samples;
                squares += found.rms_m * found.rms_m * found.samples as f64;
            }
            Err(error) => {
                file.notes.push(format!("{} left out: {error}", of.name));
                refused = refused.or(Some(error));
            }
        }
    }
    if file.parameters.is_empty() {
        let none = CalibrationError::TooFew { what: "sensors that measure an altitude", found: 0, needed: 1 };
        return Err(refused.unwrap_or(none));
    }
    file.residual.value = (squares / file.samples as f64).sqrt();
    file.notes
        .push("add each to delay_s of its device in the agent's configuration: that is taken off its stamps".into());
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    const D_S: f64 = 0.07;

    /// Altitude, climb and acceleration of a vehicle that swings up and down from `moves_s` on.
    fn moved(time_s: f64, moves_s: f64) -> [f64; 3] {
        let w = 3.0;
        let t = (time_s - moves_s).max(0.0);
        [
            0.15 * (1.0 - (w * t).cos()),
            0.15 * w * (w * t).sin(),
            0.15 * w * w * (w * t).cos() * f64::from(u8::from(t > 0.0)),
        ]
    }

    fn noise(k: usize, salt: f64) -> f64 {
        ((k as f64 * 12.9898 + salt).sin() * 43758.5453).fract()
    }

    fn flown(moves_s: f64) -> (Vec<Sample>, Altitudes) {
        let imu = (0..4000).map(|k| {
            let time_s = k as f64 * 0.01;
            let lift = GRAVITY_MPS2 + moved(time_s, moves_s)[2] + 0.4 + 0.05 * noise(k, 1.0);
            // Leans by a tenth: what it feels has to be turned upright.
            let force = Vector3::new(0.0, lift * 0.1_f64.sin(), lift * 0.1_f64.cos());
            Sample { time_s, gyro_radps: Some(Vector3::zeros()), accel_mps2: Some(force), ..Sample::default() }
        });
        let heights = (0..400).map(|k| {
            let stamp_s = k as f64 * 0.1 + 0.003;
            let spurious = if k % 37 == 5 { 0.5 } else { 0.0 };
            [stamp_s, 0.1 + moved(stamp_s - D_S, moves_s)[0] + 0.007 * noise(k, 2.0) - spurious]
        });
        (imu.collect(), Altitudes { name: "height 1".into(), measured: heights.collect() })
    }

    /// GIVEN heights stamped 70 ms late, some of them of a string, and an accelerometer that is off by 0.4 m/s² THEN the delay is found
    /// within its sigma, and by how much a laser that is right is off: nothing.
    #[test]
    fn finds_how_late_stamps_are() {
        let (imu, late) = flown(5.0);
        let right: Vec<_> = late.measured.iter().map(|[stamp_s, m]| [stamp_s - D_S, *m]).collect();
        let still =
            Altitudes { name: "height 3".into(), measured: (0..400).map(|k| [k as f64 * 0.1, f64::NAN]).collect() };
        let sensors = [late, Altitudes { name: "mocap pose".into(), measured: right }, still];
        let file = delays(&imu, &sensors).unwrap();
        let [of, pose] =
            ["height_1", "mocap_pose"].map(|name| file.parameters.iter().find(|p| p.name == name).unwrap());
        let sigma = of.sigma.unwrap();
        assert!((of.value - D_S).abs() < 3.0 * sigma && sigma < 0.005, "{of:?}");
        assert!(pose.value.abs() < 3.0 * pose.sigma.unwrap(), "{pose:?}");
        assert!(file.notes[0].starts_with("height 3 left out: sample 0: altitude is NaN"), "{:?}", file.notes);
        assert!(file.residual.value < 0.015, "{}", file.residual.value);
    }

    #[test]
    fn a_vehicle_that_stays_where_it_is_tells_no_delay() {
        let (imu, heights) = flown(1e6);
        let text = delays(&imu, &[heights]).unwrap_err().to_string();
        assert!(text.starts_with("delay of height 1 (s) is not determined: one sigma is "), "{text}");
        assert!(delays(&imu, &[]).unwrap_err().to_string().contains("0 sensors that measure an altitude"));
        assert!(delays(&imu[..100], &[]).unwrap_err().to_string().contains("100 gyroscope samples"));
    }
}
