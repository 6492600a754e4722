//! Magnetometer: hard and soft iron, from the field of the Earth seen in many directions.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | m | reading | µT |
//! | b | hard iron: what turns with the vehicle | µT |
//! | W = I + S | inverse of soft iron, S symmetric with trace 0: the scale is in F | |
//! | F | strength of the field | µT |
//!
//! |W (m − b)| = F whatever the attitude: an ellipsoid becomes a sphere. Samples are thinned so that a direction
//! held for long counts once, and weighted (Tukey) so that a stretch in another field does not bend the fit. S is
//! drawn to zero by a weak prior (`SOFT_SIGMA`): where the directions do not tell an ellipsoid from a sphere the
//! answer is the sphere. A rotation common to all axes cannot be seen and is taken as none.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use super::fit::{self, Fit, median};
use super::guide::{Aim, Progress};
use super::inertial::Triad;
use super::samples::{Channel, Sample, channel};
use super::{CalibrationError, CalibrationFile, Kind};
use crate::calibration::file::{Plot, Series};

/// A sample counts when its direction is this far from the last that did, rad.
const APART_RAD: f64 = 0.07;
/// Fewer directions say nothing.
const DIRECTIONS_MIN: usize = 60;
/// The sphere of directions is cut into this many sectors of one size: bands × sectors of a band.
const BANDS: usize = 3;
const SECTORS: usize = 6;
/// So many of the 18 must have been seen.
const SECTORS_MIN: usize = 9;
/// What is counted.
const DIRECTIONS: &str = "directions of the field 4° apart (turn the vehicle about all axes)";
const THICK: &str = "% of its width is the thickness of the cloud of readings (turn the vehicle about all axes)";
const SEEN: &str = "of 18 sectors of the sphere seen (turn the vehicle about all axes)";
/// Least spread of the readings over their greatest: a disc has many spheres through its edge.
const THICKNESS_MIN: f64 = 0.08;
/// Prior of each entry of S, one-sigma: 5 % of soft iron is common, 15 % is rare.
const SOFT_SIGMA: f64 = 0.05;
/// Largest residual, as a fraction of F.
const RESIDUAL_MAX: f64 = 0.15;
/// Hard iron must be known to this fraction of F.
const HARD_SIGMA_MAX: f64 = 0.03;
/// The field of the Earth, with room for a building, µT.
const FIELD_UT: std::ops::RangeInclusive<f64> = 10.0..=150.0;
/// Neighbouring samples share the errors of their place: so many count as one.
const CORRELATED: f64 = 10.0;
/// Tukey's constant.
const TUKEY: f64 = 4.685;
/// Least sigma of one sample's misfit, µT.
const SIGMA_FLOOR_UT: f64 = 0.2;
/// Rounds of reweighting.
const ROUNDS: usize = 12;

const NAMES: [(&str, &str); 9] = [
    ("hard_x", "µT"),
    ("hard_y", "µT"),
    ("hard_z", "µT"),
    ("field", "µT"),
    ("soft_xx", ""),
    ("soft_yy", ""),
    ("soft_xy", ""),
    ("soft_xz", ""),
    ("soft_yz", ""),
];

/// What a magnetometer file says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldModel {
    /// W and b.
    pub triad: Triad,
    /// F, µT.
    pub field_ut: f64,
    /// Misfit of one sample, one-sigma, µT.
    pub sigma_ut: f64,
}

fn triad(x: &[f64]) -> Triad {
    let at = |i: usize| x.get(i).copied().unwrap_or(0.0);
    let (xx, yy, xy, xz, yz) = (at(4), at(5), at(6), at(7), at(8));
    Triad {
        matrix: Matrix3::new(1.0 + xx, xy, xz, xy, 1.0 + yy, yz, xz, yz, 1.0 - xx - yy),
        offset: Vector3::new(at(0), at(1), at(2)),
    }
}

/// The model of a file.
///
/// # Errors
/// [`CalibrationError::File`] where a parameter is missing.
pub fn magnetometer_of(file: &CalibrationFile) -> Result<FieldModel, CalibrationError> {
    let x: Vec<f64> = NAMES.iter().map(|(name, _)| file.value(name)).collect::<Result<_, _>>()?;
    Ok(FieldModel { triad: triad(&x), field_ut: x[3], sigma_ut: file.residual.value.max(SIGMA_FLOOR_UT) })
}

/// Fits hard and soft iron.
///
/// # Errors
/// [`CalibrationError`]: NaN, saturation, too few directions, a part of the sphere never seen, a field that is
/// not the Earth's, a bad fit.
pub fn magnetometer(samples: &[Sample]) -> Result<CalibrationFile, CalibrationError> {
    // Some samples of a mixed recording carry none; one that is there and not finite is refused.
    let all = channel(samples, Channel::Magnetometer, "magnetometer samples", DIRECTIONS_MIN)?;
    let directions = thin(&all);
    if directions.len() < DIRECTIONS_MIN {
        return Err(CalibrationError::TooFew { what: DIRECTIONS, found: directions.len(), needed: DIRECTIONS_MIN });
    }
    refuse_flat(&directions)?;
    let (centre, radius) = sphere(&directions)?;
    refuse_unseen(&directions.iter().map(|m| m - centre).collect::<Vec<_>>())?;
    let (fit, sigma) = fit_robust(&directions, centre, radius)?;
    let model = triad(fit.x.as_slice());
    let field = fit.x[3];
    if !FIELD_UT.contains(&field) {
        let what = "strength of the field (µT)".to_owned();
        return Err(CalibrationError::Value { what, value: field, expected: "10 to 150" });
    }
    let calibrated: Vec<Vector3<f64>> = directions.iter().map(|m| model.apply(m)).collect();
    let seen = refuse_unseen(&calibrated)?;
    for (i, (name, _)) in NAMES.iter().enumerate().take(3) {
        let limit = HARD_SIGMA_MAX * field;
        if fit.sigma(i) > limit {
            return Err(CalibrationError::Undetermined { parameter: (*name).into(), sigma: fit.sigma(i), limit });
        }
    }
    fit.converged()?;
    if sigma > RESIDUAL_MAX * field {
        return Err(CalibrationError::BadFit { found: sigma, limit: RESIDUAL_MAX * field, unit: "µT" });
    }
    let mut file = CalibrationFile::new(Kind::Magnetometer, directions.len(), sigma, "µT").with_fit(&fit, &NAMES);
    let misfit: Vec<f64> = calibrated.iter().map(|c| (c.norm() - field).abs()).collect();
    let outside = misfit.iter().filter(|r| **r > TUKEY * sigma).count();
    if outside * 20 > directions.len() {
        let percent = 100 * outside / directions.len();
        file.notes.push(format!("{percent} % of the directions do not fit: the field changed while they were taken"));
    }
    file.notes.push(format!("{seen} of 18 sectors of the sphere seen"));
    for (i, j, title) in [(0, 1, "x and y"), (0, 2, "x and z"), (1, 2, "y and z")] {
        let points = |list: &[Vector3<f64>]| list.iter().map(|v| [v[i], v[j]]).collect::<Vec<_>>();
        let circle = (0..=72).map(|k| {
            let (s, c) = (f64::from(k) * std::f64::consts::TAU / 72.0).sin_cos();
            [field * c, field * s]
        });
        file.picture.push(Plot {
            title: format!("Field in {title}"),
            x: "µT".into(),
            y: "µT".into(),
            log: false,
            series: vec![
                Series::new("before", false, points(&directions)),
                Series::new("after", false, points(&calibrated)),
                Series::new("field", true, circle),
            ],
        });
    }
    Ok(file)
}

/// One sample for each direction the field moves on to. A direction is the mean of what was read in it.
fn thin(all: &[(f64, Vector3<f64>)]) -> Vec<Vector3<f64>> {
    let mut kept = Vec::new();
    let mut sum = Vector3::zeros();
    let (mut count, mut at) = (0.0, None::<Vector3<f64>>);
    for (_, m) in all {
        let moved = at.is_none_or(|from| from.angle(m) > APART_RAD);
        if moved && count > 0.0 {
            kept.push(sum / count);
            (sum, count) = (Vector3::zeros(), 0.0);
        }
        if moved {
            at = Some(*m);
        }
        sum += m;
        count += 1.0;
    }
    if count > 0.0 {
        kept.push(sum / count);
    }
    kept
}

/// Readings that lie nearly in a plane, as of a vehicle that only yaws, are refused.
fn refuse_flat(directions: &[Vector3<f64>]) -> Result<(), CalibrationError> {
    let found = thickness(directions).ok_or(CalibrationError::Singular("the spread of the readings has no axes"))?;
    if found < THICKNESS_MIN {
        let what = "thickness of the cloud of readings over its width (turn the vehicle about all axes)";
        return Err(CalibrationError::TooSmall { what, found, needed: THICKNESS_MIN, unit: "" });
    }
    Ok(())
}

/// Least spread of the readings over their greatest; `None` where they have none.
fn thickness(directions: &[Vector3<f64>]) -> Option<f64> {
    let mean = directions.iter().sum::<Vector3<f64>>() / directions.len() as f64;
    let scatter: Matrix3<f64> = directions.iter().map(|m| (m - mean) * (m - mean).transpose()).sum();
    let eigen = SymmetricEigen::try_new(scatter, 1e-12, 100)?;
    Some((eigen.eigenvalues.min().max(0.0) / eigen.eigenvalues.max().max(1e-300)).sqrt())
}

/// How far samples are from what [`magnetometer`] asks for.
pub(super) fn directions_taken(samples: &[Sample]) -> Result<Progress, CalibrationError> {
    let all = channel(samples, Channel::Magnetometer, "magnetometer samples", 0)?;
    let directions = thin(&all);
    let thick = if directions.len() < 3 { 0.0 } else { thickness(&directions).unwrap_or(0.0) };
    // Without a shape yet there is no centre either: hard iron is most often less than the field.
    let shaped = directions.len() * 2 >= DIRECTIONS_MIN && thick >= THICKNESS_MIN;
    let centre =
        if shaped { sphere(&directions).map_or(Vector3::zeros(), |(centre, _)| centre) } else { Vector3::zeros() };
    let sectors = seen(directions.iter().map(|m| m - centre));
    let percent = |share: f64| (share * 100.0) as usize;
    let aims = vec![
        Aim { what: DIRECTIONS, found: directions.len(), needed: DIRECTIONS_MIN, best: DIRECTIONS_MIN },
        Aim { what: SEEN, found: sectors.iter().filter(|s| **s).count(), needed: SECTORS_MIN, best: sectors.len() },
        Aim { what: THICK, found: percent(thick), needed: percent(THICKNESS_MIN), best: percent(THICKNESS_MIN) },
    ];
    Ok(Progress {
        bands: BANDS,
        sectors: sectors.to_vec(),
        field: all.last().and_then(|(_, m)| (m - centre).try_normalize(1e-9)),
        aims,
        ..Progress::default()
    })
}

/// Which of the sectors of one size hold a direction: bands from −z to z, in each of them from −π about z.
fn seen(directions: impl Iterator<Item = Vector3<f64>>) -> [bool; BANDS * SECTORS] {
    let mut seen = [false; BANDS * SECTORS];
    for v in directions {
        let Some(u) = v.try_normalize(1e-9) else { continue };
        // Bands of one height are of one area (Archimedes).
        let band = (((u.z + 1.0) * 0.5 * BANDS as f64) as usize).min(BANDS - 1);
        let turn = (u.y.atan2(u.x) / std::f64::consts::TAU + 0.5) * SECTORS as f64;
        seen[band * SECTORS + (turn as usize).min(SECTORS - 1)] = true;
    }
    seen
}

/// How many of them hold a direction; too few are refused.
fn refuse_unseen(directions: &[Vector3<f64>]) -> Result<usize, CalibrationError> {
    let found = seen(directions.iter().copied()).iter().filter(|s| **s).count();
    if found < SECTORS_MIN {
        return Err(CalibrationError::TooFew { what: SEEN, found, needed: SECTORS_MIN });
    }
    Ok(found)
}

/// Iteratively reweighted: the fit and the sigma of one sample (1.4826 median of |misfit|).
fn fit_robust(directions: &[Vector3<f64>], centre: Vector3<f64>, radius: f64) -> Result<(Fit, f64), CalibrationError> {
    let mut x = vec![centre.x, centre.y, centre.z, radius, 0.0, 0.0, 0.0, 0.0, 0.0];
    let sizes = [10.0, 10.0, 10.0, 10.0, 0.1, 0.1, 0.1, 0.1, 0.1];
    let mut last = None;
    for _ in 0..ROUNDS {
        let (model, field) = (triad(&x), x[3]);
        let misfit: Vec<f64> = directions.iter().map(|m| model.apply(m).norm() - field).collect();
        let mut sizes_of: Vec<f64> = misfit.iter().map(|r| r.abs()).collect();
        let sigma = (1.4826 * median(&mut sizes_of).unwrap_or(0.0)).max(SIGMA_FLOOR_UT);
        let weights: Vec<f64> = misfit
            .iter()
            .map(|r| {
                let u = r / (TUKEY * sigma);
                // Square root of Tukey's weight, over sigma.
                if u.abs() < 1.0 { (1.0 - u * u) / sigma } else { 0.0 }
            })
            .collect();
        let fit = fit::least_squares(&x, &sizes, |x, r| {
            let (model, field) = (triad(x), x[3]);
            r.clear();
            let scale = CORRELATED.sqrt().recip();
            r.extend(directions.iter().zip(&weights).map(|(m, w)| scale * w * (model.apply(m).norm() - field)));
            r.extend(x[4..].iter().map(|s| s / SOFT_SIGMA));
        })?;
        let moved = fit.x.iter().zip(&x).zip(&sizes).map(|((a, b), s)| ((a - b) / s).abs()).fold(0.0, f64::max);
        x = fit.x.as_slice().to_vec();
        last = Some((fit, sigma));
        if moved < 1e-4 {
            break;
        }
    }
    let (mut fit, sigma) = last.ok_or(CalibrationError::Singular("no round of the fit"))?;
    // The residuals are whitened already: undo the scaling by their own size.
    let count = (directions.len() + x.len() - 4) as f64;
    let variance = fit.rms * fit.rms * count / (count - x.len() as f64).max(1.0);
    if variance > 0.0 {
        fit.covariance /= variance;
    }
    let eigen = SymmetricEigen::try_new(triad(&x).matrix, 1e-12, 100);
    if eigen.is_none_or(|e| e.eigenvalues.min() <= 0.1) {
        return Err(CalibrationError::Singular("the ellipsoid is open: the directions do not close it"));
    }
    Ok((fit, sigma))
}

/// Sphere through the points, with outliers taken off in rounds: linear in centre and r² − |c|².
fn sphere(points: &[Vector3<f64>]) -> Result<(Vector3<f64>, f64), CalibrationError> {
    let mean = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let scale = points.iter().map(|p| (p - mean).norm()).sum::<f64>() / points.len() as f64;
    let mut weights = vec![1.0; points.len()];
    let mut answer = (mean, scale);
    for _ in 0..ROUNDS {
        let mut normal = nalgebra::Matrix4::<f64>::zeros();
        let mut right = nalgebra::Vector4::<f64>::zeros();
        for (p, w) in points.iter().zip(&weights) {
            let u = (p - mean) / scale;
            let row = nalgebra::Vector4::new(2.0 * u.x, 2.0 * u.y, 2.0 * u.z, 1.0);
            normal += row * row.transpose() * *w;
            right += row * (u.norm_squared() * w);
        }
        let cholesky = normal
            .cholesky()
            .ok_or(CalibrationError::Singular("the readings lie in a plane: turn the vehicle about all axes"))?;
        let x = cholesky.solve(&right);
        let centre = x.xyz();
        let radius_squared = x.w + centre.norm_squared();
        if !(radius_squared.is_finite() && radius_squared > 0.0) {
            return Err(CalibrationError::Singular("no sphere passes through the readings"));
        }
        answer = (mean + centre * scale, radius_squared.sqrt() * scale);
        let misfit: Vec<f64> = points.iter().map(|p| (p - answer.0).norm() - answer.1).collect();
        let mut sizes: Vec<f64> = misfit.iter().map(|r| r.abs()).collect();
        let sigma = (1.4826 * median(&mut sizes).unwrap_or(0.0)).max(SIGMA_FLOOR_UT);
        weights = misfit
            .iter()
            .map(|r| {
                let u = r / (TUKEY * sigma);
                if u.abs() < 1.0 { (1.0 - u * u).powi(2) } else { 0.0 }
            })
            .collect();
    }
    Ok(answer)
}

#[cfg(test)]
mod tests;
