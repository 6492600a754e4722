//! What calibrations are fitted from: the samples of one IMU, checked before use.

use nalgebra::Vector3;

use super::CalibrationError;

/// One sample of an IMU; what it did not measure is `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sample {
    /// Time, s.
    pub time_s: f64,
    /// Angular rate, rad/s.
    pub gyro_radps: Option<Vector3<f64>>,
    /// Specific force, m/s².
    pub accel_mps2: Option<Vector3<f64>>,
    /// Magnetic field, µT.
    pub mag_ut: Option<Vector3<f64>>,
    /// Die temperature, °C.
    pub temperature_c: Option<f64>,
}

/// Which of the three sensors of an IMU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channel {
    /// Angular rate.
    Gyroscope,
    /// Specific force.
    Accelerometer,
    /// Magnetic field.
    Magnetometer,
}

impl Channel {
    fn names(self) -> [&'static str; 3] {
        match self {
            Self::Gyroscope => ["gyroscope x", "gyroscope y", "gyroscope z"],
            Self::Accelerometer => ["accelerometer x", "accelerometer y", "accelerometer z"],
            Self::Magnetometer => ["magnetometer x", "magnetometer y", "magnetometer z"],
        }
    }

    /// What a sensor at rest never reaches: an extreme that repeats beyond this is the end of its range.
    fn beyond(self) -> f64 {
        match self {
            Self::Gyroscope => 3.0,
            Self::Accelerometer => 15.0,
            Self::Magnetometer => 100.0,
        }
    }

    fn of(self, sample: &Sample) -> Option<Vector3<f64>> {
        match self {
            Self::Gyroscope => sample.gyro_radps,
            Self::Accelerometer => sample.accel_mps2,
            Self::Magnetometer => sample.mag_ut,
        }
    }
}

/// So many samples in a row at an extreme are no coincidence.
const STUCK: usize = 4;

/// `(time, value)` of one channel in time order, where it was measured.
///
/// # Errors
/// [`CalibrationError`] for NaN, fewer than `needed` samples, time that runs backwards, or saturation.
pub fn channel(
    samples: &[Sample],
    channel: Channel,
    what: &'static str,
    needed: usize,
) -> Result<Vec<(f64, Vector3<f64>)>, CalibrationError> {
    let names = channel.names();
    let mut values = Vec::with_capacity(samples.len());
    let mut before = f64::NEG_INFINITY;
    for (index, sample) in samples.iter().enumerate() {
        let Some(value) = channel.of(sample) else { continue };
        if !sample.time_s.is_finite() {
            return Err(CalibrationError::NotFinite { channel: "time", index, value: sample.time_s });
        }
        if sample.time_s < before {
            let what = format!("time of sample {index} (s)");
            return Err(CalibrationError::Value { what, value: sample.time_s, expected: "later than the one before" });
        }
        before = sample.time_s;
        for (axis, name) in names.iter().enumerate() {
            if !value[axis].is_finite() {
                return Err(CalibrationError::NotFinite { channel: name, index, value: value[axis] });
            }
        }
        values.push((sample.time_s, value));
    }
    if values.len() < needed {
        return Err(CalibrationError::TooFew { what, found: values.len(), needed });
    }
    for (axis, name) in names.iter().enumerate() {
        refuse_saturated(&values, axis, name, channel.beyond())?;
    }
    Ok(values)
}

/// An extreme that is held for several samples in a row is where the sensor ends.
fn refuse_saturated(
    values: &[(f64, Vector3<f64>)],
    axis: usize,
    name: &'static str,
    beyond: f64,
) -> Result<(), CalibrationError> {
    let extremes = values.iter().map(|(_, v)| v[axis]);
    let (least, most) = extremes.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    for end in [least, most] {
        if end.abs() < beyond {
            continue;
        }
        let (mut run, mut longest) = (0, 0);
        for (_, value) in values {
            run = if value[axis] == end { run + 1 } else { 0 };
            longest = longest.max(run);
        }
        if longest >= STUCK {
            return Err(CalibrationError::Saturated { channel: name, value: end, count: longest });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spinning(limit: f64) -> Vec<Sample> {
        let rate = |k: usize| (6.0 * (k as f64 * 0.05).sin()).clamp(-limit, limit);
        (0..400)
            .map(|k| Sample {
                time_s: k as f64 * 0.01,
                gyro_radps: Some(Vector3::new(rate(k), 0.1, 0.0)),
                ..Sample::default()
            })
            .collect()
    }

    #[test]
    fn saturation_nan_and_absence_are_named() {
        let ask = |samples: &[Sample]| channel(samples, Channel::Gyroscope, "gyroscope samples", 100);
        assert_eq!(ask(&spinning(10.0)).unwrap().len(), 400);
        let text = ask(&spinning(4.0)).unwrap_err().to_string();
        assert!(text.contains("saturated: gyroscope x stays at"), "{text}");
        let mut broken = spinning(10.0);
        broken[7].gyro_radps = Some(Vector3::new(0.0, f64::NAN, 0.0));
        assert_eq!(ask(&broken).unwrap_err().to_string(), "sample 7: gyroscope y is NaN, not a finite number");
        let none = channel(&broken, Channel::Magnetometer, "magnetometer samples", 100).unwrap_err();
        assert_eq!(none.to_string(), "0 magnetometer samples, at least 100 are needed");
        broken.swap(3, 4);
        broken[7].gyro_radps = Some(Vector3::zeros());
        assert!(ask(&broken).unwrap_err().to_string().contains("time of sample 4"));
    }
}
