//! Errors over time. No result keeps them: the first repeats of each condition are flown again, which is the same flight.
//!
//! | file | what |
//! |---|---|
//! | `traces.parquet` | a row for each [`STEP_S`] of each flight flown again |
//! | `bands.json` | [`Bands`], for the report |

use plumbline_agent::flight::Flight;
use plumbline_file::parquet::{Cell, Kind, Writer};
use serde::{Deserialize, Serialize};

use crate::draw::{median, parallel, percentile};
use crate::flight::{Seen, Setup, fly_seen};
use crate::store::{Experiment, StoreError, write_whole};

/// Between two points, s.
pub const STEP_S: f64 = 0.1;
/// Most flights flown again for them.
pub const MOST: u64 = 2000;

const BANDS: &str = "bands.json";

/// One point of a flight.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Point {
    /// Since the first onset, or since boot where there is none, s.
    t_s: f64,
    /// True altitude less setpoint, m; NaN where a recording knows no setpoint.
    altitude_m: f64,
    /// Estimated less true altitude, m; NaN where no altitude is known.
    estimate_m: f64,
}

/// The altitude's error over time, condition by condition.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Bands {
    /// Repeats flown again.
    pub repeats: u64,
    /// A band for each condition.
    pub bands: Vec<Band>,
}

/// |true altitude less setpoint| of one condition, m.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Band {
    /// Which of the plan.
    pub condition: u64,
    /// When, since the onset or boot, s; at each time the quartiles of the flights that are still in the air then.
    pub t_s: Vec<f64>,
    /// The smaller quartile, the median and the larger one, m.
    pub quartiles: Vec<[f64; 3]>,
}

/// Flies the first `repeats` of each condition again and keeps what came of it.
///
/// # Errors
/// [`StoreError`]: another program's, too many, a flight that cannot be flown, or a file.
pub fn write(experiment: &Experiment, repeats: u64) -> Result<std::path::PathBuf, StoreError> {
    experiment.own()?;
    let plan = &experiment.plan;
    let repeats = repeats.min(plan.repeats);
    let flights = repeats.saturating_mul(plan.conditions());
    if flights > MOST {
        return Err(StoreError::Traces(format!("{flights} flights would be flown again, more than {MOST}")));
    }
    // Flights are numbered repeat by repeat: these are the first ones.
    let flown = parallel(flights as usize, |index| {
        let (condition, repeat) = plan.place(index as u64);
        let setup = plan.condition(condition)?.setup(plan.seed_of(repeat));
        traced(&setup)
    });
    let flown: Result<Vec<Vec<Point>>, String> = flown.into_iter().collect();
    let flown = flown.map_err(StoreError::Traces)?;
    let bands = (0..plan.conditions()).map(|condition| {
        let of = flown.iter().skip(condition as usize).step_by(plan.conditions().max(1) as usize);
        band(condition, &of.map(Vec::as_slice).collect::<Vec<_>>())
    });
    let bands = Bands { repeats, bands: bands.collect() };
    experiment.keep_beside(BANDS, &bands)?;
    table(experiment, &flown)
}

/// What [`write`] kept, if it did.
pub fn bands(experiment: &Experiment) -> Option<Bands> {
    experiment.read_beside(BANDS)
}

fn traced(setup: &Setup) -> Result<Vec<Point>, String> {
    let mut points: Vec<Point> = Vec::new();
    let mut begin_s = None;
    let watch = |flight: &mut Flight, seen: &Seen| {
        let now_s = flight.report().sensed.time.as_seconds();
        let begin_s = *begin_s.get_or_insert(if setup.recording.is_some() { now_s } else { 0.0 });
        let t_s = now_s - begin_s - setup.judged_from_s;
        let Some(place) = seen.place_enu_m(flight) else { return };
        if points.last().is_some_and(|last| t_s < last.t_s + STEP_S - 1e-9) {
            return;
        }
        let motion = flight.estimate_in_loop().and_then(|estimate| estimate.motion);
        let known = motion.filter(|motion| motion.altitude_known && seen.reference.is_some());
        let altitude_m = place.z - seen.deed(flight).setpoint_enu_m.z;
        if altitude_m.is_finite() || known.is_some() {
            let estimate_m = known.map_or(f64::NAN, |known| known.position_enu_m.z - place.z);
            points.push(Point { t_s, altitude_m, estimate_m });
        }
    };
    fly_seen(setup, watch).map_err(|error| error.to_string())?;
    Ok(points)
}

/// Flights begin at other times before their onsets: they are put beside each other by whole steps.
fn band(condition: u64, flights: &[&[Point]]) -> Band {
    let step = |point: &Point| (point.t_s / STEP_S).round() as i64;
    let mut at: std::collections::BTreeMap<i64, Vec<f64>> = std::collections::BTreeMap::new();
    for point in flights.iter().copied().flatten().filter(|point| point.altitude_m.is_finite()) {
        at.entry(step(point)).or_default().push(point.altitude_m.abs());
    }
    let quartiles = at.values().map(|values| [percentile(values, 0.25), median(values), percentile(values, 0.75)]);
    let t_s = at.keys().map(|step| *step as f64 * STEP_S).collect();
    Band { condition, t_s, quartiles: quartiles.collect() }
}

fn table(experiment: &Experiment, flown: &[Vec<Point>]) -> Result<std::path::PathBuf, StoreError> {
    let path = experiment.folder.join("traces.parquet");
    let broken = |source| StoreError::Io { path: path.clone(), source };
    let whole = ["index", "condition", "seed"].map(|name| (name.to_owned(), Kind::Integer)).into_iter();
    let numbers = ["t_s", "altitude_m", "estimate_m"].map(|name| (name.to_owned(), Kind::Number));
    let mut table = Writer::new("traces", whole.chain(numbers));
    let mut bytes = Vec::new();
    for (index, points) in flown.iter().enumerate() {
        let (condition, repeat) = experiment.plan.place(index as u64);
        let whole = [index as u64, condition, experiment.plan.seed_of(repeat)];
        for point in points {
            let numbers = [point.t_s, point.altitude_m, point.estimate_m];
            let whole = whole.iter().map(|number| Cell::Integer(number.cast_signed()));
            let cell = |number: f64| if number.is_finite() { Cell::Number(number) } else { Cell::Absent };
            table.row(whole.chain(numbers.map(cell))).map_err(broken)?;
        }
        bytes.append(&mut table.take());
    }
    let about = [("plan", experiment.plan.text.as_str()), ("hash", &experiment.identity.hash)];
    bytes.extend(table.finish(&about).map_err(broken)?);
    write_whole(&path, &bytes)?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flights_lie_beside_each_other_by_their_onset() {
        let flight = |from_s: f64, errors_m: &[f64]| -> Vec<Point> {
            let each = errors_m.iter().zip(0..);
            each.map(|(m, n)| Point { t_s: from_s + f64::from(n) * STEP_S, altitude_m: *m, estimate_m: f64::NAN })
                .collect()
        };
        let (one, other) = (flight(-0.2, &[9.0, -1.0, 2.0]), flight(-0.096, &[3.0, 4.0]));
        let band = band(5, &[&one, &other]);
        assert_eq!(band.condition, 5);
        assert!(band.t_s.iter().zip([-0.2, -0.1, 0.0]).all(|(a, b)| (a - b).abs() < 1e-9), "{:?}", band.t_s);
        assert_eq!(band.quartiles.iter().map(|[_, median, _]| *median).collect::<Vec<_>>(), [9.0, 2.0, 3.0]);
    }
}
