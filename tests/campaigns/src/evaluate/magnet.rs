//! A magnet that stands in the room: BROAD's undisturbed trials with the field of a dipole added where the optical
//! reference says the magnetometer was.

use nalgebra::{UnitQuaternion, Vector3};
use plumbline_agent::estimate::attitude::AttitudeFilter;
use plumbline_agent::estimate::attitude_ekf::AttitudeEkf;
use plumbline_agent::estimate::vqf::Vqf;
use plumbline_agent::frames::wrap_pi;
use plumbline_agent::recordings;

use super::scored::{Scored, Target};
use super::{entries, stem};

/// μ₀ / 4π, µT m³ / (A m²).
const DIPOLE_UT: f64 = 0.1;
/// The magnetometer is never nearer than this, m: a magnet has a size.
const NEAREST_M: f64 = 0.15;
/// When the magnet appears, s; at zero the whole recording has it.
const APPEARS_S: [(&str, f64); 2] = [("appears", 60.0), ("from_the_start", 0.0)];
/// Distance of the magnet from the middle of the path, m, and its moment, A m².
const MAGNETS: [(f64, f64); 4] = [(0.35, 2.0), (0.6, 8.0), (0.6, 15.0), (1.0, 40.0)];

/// One sample and where it was taken.
struct Row {
    time_s: f64,
    gyro: Vector3<f64>,
    force: Vector3<f64>,
    field: Option<Vector3<f64>>,
    position: Vector3<f64>,
    attitude: UnitQuaternion<f64>,
    scored: bool,
}

pub fn standing_magnets(scored: &mut Scored) {
    scored.report.heading("BROAD with a magnet that stands in the room");
    scored.report.paragraph(
        "Heading error of undisturbed trials to which the field of a dipole is added: 2 A m² at 0.35 m from the middle of \
         the path to 40 A m² at 1 m, in many directions. One that is there from the start makes a wrong north, and nothing \
         in these sensors knows a better one: it is not solved, by either filter.",
    );
    let trials = entries("data/broad_imu_mocap", |path| stem(path).contains("_undisturbed_"));
    let Some(trials) = trials.filter(|trials| !trials.is_empty()) else {
        return scored.skipped("broad/magnet", "data/broad_imu_mocap is absent");
    };
    let rows: Vec<(String, Vec<Row>)> = trials.iter().map(|path| (stem(path), read(path))).collect();
    for (when, appears_s) in APPEARS_S {
        let mut sums = [0.0; 2];
        for (trial, (name, rows)) in rows.iter().enumerate() {
            for (magnet, (distance_m, moment)) in MAGNETS.into_iter().enumerate() {
                let moving: Vec<_> = rows.iter().filter(|row| row.scored).map(|row| row.position).collect();
                let middle = moving.iter().sum::<Vector3<f64>>() / moving.len() as f64;
                let (at, moment) =
                    (middle + distance_m * direction(8 * trial + magnet), moment * direction(8 * trial + magnet + 4));
                let added = |row: &Row| dipole_ut(&(row.position - at), &moment) * f64::from(row.time_s >= appears_s);
                let ours = heading_rms_deg(&mut AttitudeEkf::with_declination(0.0), rows, added);
                let vqf = heading_rms_deg(&mut Vqf::with_declination(0.0), rows, added);
                let name = format!("broad/magnet/{when}/{}/{magnet}", &name[..2]);
                scored.value(&name, ours, "deg", Target::Peer(Some((vqf * 100.0).round() / 100.0)));
                sums[0] += ours;
                sums[1] += vqf;
            }
        }
        let [ours, vqf] = sums.map(|sum| sum / (rows.len() * MAGNETS.len()) as f64);
        let name = format!("broad/magnet/{when}/mean_heading");
        scored.value(&name, ours, "deg", Target::Peer(Some((vqf * 100.0).round() / 100.0)));
    }
}

/// Some direction, another one for each number.
fn direction(number: usize) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| (1.7 * number as f64 + 2.3 * axis as f64 + 0.4).sin()).normalize()
}

fn dipole_ut(from_magnet_m: &Vector3<f64>, moment: &Vector3<f64>) -> Vector3<f64> {
    let distance_m = from_magnet_m.norm().max(NEAREST_M);
    let towards = from_magnet_m / distance_m;
    DIPOLE_UT * (3.0 * towards * towards.dot(moment) - moment) / distance_m.powi(3)
}

/// Root mean square of the heading error where the data set scores.
fn heading_rms_deg(filter: &mut impl AttitudeFilter, rows: &[Row], added: impl Fn(&Row) -> Vector3<f64>) -> f64 {
    let (mut sum, mut count, mut last_s) = (0.0, 0.0, rows.first().map_or(0.0, |row| row.time_s));
    for row in rows {
        let field = row.field.map(|field| field + row.attitude.inverse() * added(row));
        filter.push(row.time_s - last_s, &row.gyro, &row.force, field.as_ref());
        last_s = row.time_s;
        if row.scored {
            let error = row.attitude * filter.world_from_body().inverse();
            sum += wrap_pi(2.0 * error.k.atan2(error.w)).to_degrees().powi(2);
            count += 1.0;
        }
    }
    f64::sqrt(sum / count)
}

/// The trial; position and attitude are the last that were seen, or the first.
fn read(path: &std::path::Path) -> Vec<Row> {
    let mut recording = recordings::open(path).unwrap();
    let mut rows: Vec<Row> = Vec::new();
    let (mut position, mut attitude) = (None, None);
    while let Some(tick) = recording.next_tick() {
        let Some(imu) = tick.sensed.imus.iter().flatten().next() else { continue };
        if let Some(truth) = tick.truth {
            position = Some(truth.position_enu_m).filter(|p| p.iter().all(|x| x.is_finite())).or(position);
            attitude = Some(truth.world_from_body);
        }
        rows.push(Row {
            time_s: imu.time.as_seconds(),
            gyro: imu.gyro_radps,
            force: imu.accel_mps2,
            field: imu.mag_ut,
            position: position.unwrap_or_else(|| Vector3::repeat(f64::NAN)),
            attitude: attitude.unwrap_or_else(UnitQuaternion::identity),
            scored: tick.truth.is_some(),
        });
    }
    let first = rows.iter().find(|row| row.position.x.is_finite()).map(|row| (row.position, row.attitude));
    for row in rows.iter_mut().take_while(|row| !row.position.x.is_finite()) {
        (row.position, row.attitude) = first.unwrap_or_default();
    }
    rows
}
