//! Height above the floor from a scanner that looks down, its front along −z and its plane the y-z plane of its own axes.
//!
//! A line is fitted to the points of the downward sector: the best of many pairs by how many points lie on it, then total
//! least squares over those. The distance to that line is the height in the plane of the scan, so roll needs no correction;
//! tilt out of the plane is corrected by the vehicle. Whatever stands on the floor, or hangs in the sector, is left out
//! as long as the floor is seen by more points.

use crate::fault::Fault;
use crate::protocol::scip::{FRONT_STEP, RANGES, SMALLEST_MM, STEPS, STEPS_PER_TURN};
use arrayvec::ArrayVec;

/// Angle from one range to the next, rad.
pub const STEP_RAD: f64 = std::f64::consts::TAU / STEPS_PER_TURN as f64;
/// Half of the sector that may see the floor, rad.
const HALF_SECTOR_RAD: f64 = 0.7;
/// Accuracy that the maker promises up to 1 m; beyond it, this share of the distance (URG-04LX: ±30 mm, ±3 %).
const ON_LINE_M: f64 = 0.03;
const ON_LINE_SHARE: f64 = 0.03;
/// Fewer points than this are no floor.
const POINTS_MIN: usize = 20;
/// A smaller share of the sector is no floor.
const SHARE_MIN: f64 = 0.3;
/// A steeper line is a wall, rad.
const SLOPE_MAX_RAD: f64 = 0.8;

/// A fitted height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanHeight {
    /// Distance to the floor's line, m.
    pub distance_m: f64,
    /// How far the line is from level in the scanner's axes, rad.
    pub slope_rad: f64,
    /// One-sigma of the distance: scatter about the line over the root of the points, and 1 mm of resolution.
    pub sigma_m: f64,
    /// Share of the valid points of the sector that lie on the line.
    pub share: f64,
}

/// Angle of the range at `index`, rad; zero straight ahead, counter-clockwise.
pub fn angle_rad(index: usize) -> f64 {
    let step = (STEPS.start() + index) as f64 - FRONT_STEP as f64;
    step * STEP_RAD
}

/// Fits the floor to `ranges_mm`, from step 44 on.
///
/// # Errors
/// Too few echoes in the sector, or no line that enough of them lie on; with the device's own code where one prevails.
pub fn fit(ranges_mm: &[u16]) -> Result<ScanHeight, Fault> {
    let mut points = ArrayVec::<[f64; 2], RANGES>::new();
    let (mut beams, mut code) = (0_usize, None);
    for (index, &mm) in ranges_mm.iter().enumerate().take(RANGES) {
        let angle = angle_rad(index);
        if angle.abs() > HALF_SECTOR_RAD {
            continue;
        }
        beams += 1;
        if mm < SMALLEST_MM {
            code = code.or(Some(mm));
            continue;
        }
        let distance = f64::from(mm) * 1e-3;
        points.push([distance * angle.sin(), distance * angle.cos()]);
    }
    if points.len() < POINTS_MIN.max((SHARE_MIN * beams as f64) as usize) {
        return Err(match code {
            Some(code) => Fault::Reported { what: "range code", code: code.into() },
            None => Fault::Value { what: "echoes of the floor", value: points.len() as f64, expected: "20 or more" },
        });
    }
    let line = best_pair(&points).ok_or(Fault::Malformed("scan: no two points apart"))?;
    let line = least_squares(&points, &line);
    let (count, squares) = on_line(&points, &line);
    let share = count as f64 / points.len() as f64;
    if count < POINTS_MIN || share < SHARE_MIN {
        return Err(Fault::Value { what: "share of points on the floor", value: share, expected: "0.3 or more" });
    }
    let slope_rad = line.normal[0].atan2(line.normal[1]);
    if slope_rad.abs() > SLOPE_MAX_RAD {
        return Err(Fault::Value { what: "slope of the floor", value: slope_rad, expected: "within ±0.8 rad" });
    }
    let scatter_m = (squares / count as f64).sqrt();
    let sigma_m = (scatter_m / (count as f64).sqrt()).hypot(1e-3 / 12.0_f64.sqrt());
    Ok(ScanHeight { distance_m: line.distance_m, slope_rad, sigma_m, share })
}

/// normal · point = distance.
#[derive(Debug, Clone, Copy)]
struct Line {
    normal: [f64; 2],
    distance_m: f64,
}

impl Line {
    /// Through `point` with a normal along `normal`, downwards.
    fn through(point: &[f64; 2], normal: [f64; 2]) -> Option<Self> {
        let length = normal[0].hypot(normal[1]);
        let sign = if normal[1] < 0.0 { -1.0 } else { 1.0 };
        let normal = normal.map(|n| sign * n / length);
        let distance_m = normal[0] * point[0] + normal[1] * point[1];
        (length > 1e-9).then_some(Self { normal, distance_m })
    }

    fn off(&self, point: &[f64; 2]) -> f64 {
        self.normal[0] * point[0] + self.normal[1] * point[1] - self.distance_m
    }

    fn holds(&self, point: &[f64; 2]) -> bool {
        self.off(point).abs() <= ON_LINE_M.max(ON_LINE_SHARE * point[0].hypot(point[1]))
    }
}

/// Points on the line, and the sum of their squared distances from it.
fn on_line(points: &[[f64; 2]], line: &Line) -> (usize, f64) {
    let held = points.iter().filter(|point| line.holds(point));
    held.fold((0, 0.0), |(count, squares), point| (count + 1, squares + line.off(point).powi(2)))
}

/// The line through two of the points that holds most of them, and most closely among equals.
fn best_pair(points: &[[f64; 2]]) -> Option<Line> {
    let mut best: Option<(usize, f64, Line)> = None;
    // Pairs a third, a half and two thirds of the sector apart, from every second point.
    for apart in [points.len() / 3, points.len() / 2, 2 * points.len() / 3] {
        for (a, b) in points.iter().zip(points.iter().skip(apart)).step_by(2) {
            let Some(line) = Line::through(a, [a[1] - b[1], b[0] - a[0]]) else { continue };
            let (count, squares) = on_line(points, &line);
            if best.is_none_or(|(most, least, _)| (count, -squares) > (most, -least)) {
                best = Some((count, squares, line));
            }
        }
    }
    best.map(|(_, _, line)| line)
}

/// Total least squares over the points that `line` holds, twice: the first improves which they are.
fn least_squares(points: &[[f64; 2]], line: &Line) -> Line {
    let mut line = *line;
    for _ in 0..2 {
        let held = || points.iter().filter(|point| line.holds(point));
        let n = held().count().max(1) as f64;
        let (sx, sy) = held().fold((0.0, 0.0), |(x, y), p| (x + p[0], y + p[1]));
        let mean = [sx / n, sy / n];
        let (xx, xy, yy) = held().fold((0.0, 0.0, 0.0), |(xx, xy, yy), p| {
            let (x, y) = (p[0] - mean[0], p[1] - mean[1]);
            (xx + x * x, xy + x * y, yy + y * y)
        });
        // Direction of the largest spread.
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        line = Line::through(&mean, [-angle.sin(), angle.cos()]).unwrap_or(line);
    }
    line
}

/// The scan of a scanner `distance_m` above a level floor, turned by `slope_rad` in its plane; error code 0 beyond `reach_m`.
pub fn encode(distance_m: f64, slope_rad: f64, reach_m: f64, mut noise_m: impl FnMut() -> f64) -> [u16; RANGES] {
    std::array::from_fn(|index| {
        let range_m = distance_m / (angle_rad(index) - slope_rad).cos();
        let seen = range_m > 0.0 && range_m < reach_m;
        let mm = ((range_m + noise_m()) * 1e3).round();
        if seen && mm >= f64::from(SMALLEST_MM) { mm as u16 } else { 0 }
    })
}
