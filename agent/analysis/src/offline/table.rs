//! Plain CSV tables for calibrations: columns found by name whatever their order, units in the names.
//!
//! | table | columns (one of each line) |
//! |---|---|
//! | IMU | `t_s` `time_s`; `gx_radps` `gx_rad_s` `gx_dps` (and y, z); `ax_mps2` `ax_m_s2` `ax_g` (and y, z); `mx_ut` (and y, z); `temperature_c` |
//! | motor | `command` (0 to 1); `speed_radps` `rpm` |
//! | thrust | `speed_radps` `rpm`; `thrust_n`; optionally `torque_nm` |
//! | thrust, tunnel | `PropName`, `diameter_in`, `pitch_in`, `rpm`, `CT`, `CP` (UIUC Propeller Database) |
//! | mass | `axis`, `mass_kg`, then `inertia_kgm2` or `period_s`, `length_m`, `separation_m` |
//!
//! An example of each is in `tables/`; the page offers them.
//!
//! Commas, semicolons or tabs between the fields, as the first line has them; where it is not the comma, `0,5` is a half.
//! Sensors an IMU table lacks are absent. An empty field is NaN, and refused where a fit needs it.

use std::io::BufRead as _;

use nalgebra::Vector3;
use plumbline_core::calibration::mass::Axis;
use plumbline_core::calibration::samples::Sample;
use plumbline_core::calibration::thrust::Point;
use plumbline_core::types::GRAVITY_MPS2;

/// Inches to metres.
const INCH_M: f64 = 0.0254;
/// rev/min to rad/s.
const RPM_RADPS: f64 = std::f64::consts::TAU / 60.0;

/// Most rows of a table: over an hour of one IMU at 200 Hz.
const MAX_ROWS: usize = 1_000_000;

/// A table in memory, as compact as its text: whoever uploads many short rows gets no more of it.
pub(super) struct Table {
    header: Vec<String>,
    /// All fields, one after the other.
    text: String,
    /// Where each of them ends; as many in every row as the header has.
    ends: Vec<u32>,
    /// A comma may be a decimal one: another sign is between the fields.
    decimal_comma: bool,
}

impl Table {
    /// Reads `text`; the reason otherwise.
    pub fn read(text: impl std::io::Read) -> Result<Self, String> {
        let mut text = std::io::BufReader::new(text);
        let start = text.fill_buf().map_err(|e| e.to_string())?;
        let line = start.split(|byte| *byte == b'\n').next().unwrap_or_default();
        let delimiter = [b';', b'\t'].into_iter().find(|between| line.contains(between)).unwrap_or(b',');
        let mut reader = csv::ReaderBuilder::new().delimiter(delimiter).trim(csv::Trim::All).from_reader(text);
        let header = reader.headers().map_err(|e| e.to_string())?.iter().map(str::to_lowercase).collect();
        let mut table = Self { header, text: String::new(), ends: Vec::new(), decimal_comma: delimiter != b',' };
        let mut record = csv::StringRecord::new();
        while reader.read_record(&mut record).map_err(|e| e.to_string())? {
            if table.rows() >= MAX_ROWS {
                return Err(format!("more than {MAX_ROWS} rows"));
            }
            for field in &record {
                table.text.push_str(field);
                let end = u32::try_from(table.text.len()).map_err(|_| "more than 4 GiB of text".to_owned())?;
                table.ends.push(end);
            }
        }
        Ok(table)
    }

    fn rows(&self) -> usize {
        self.ends.len() / self.header.len().max(1)
    }

    fn text(&self, row: usize, column: usize) -> &str {
        let index = row * self.header.len() + column;
        let start = index.checked_sub(1).map_or(Some(&0), |before| self.ends.get(before));
        let range = start.zip(self.ends.get(index)).filter(|_| column < self.header.len());
        range.and_then(|(start, end)| self.text.get(*start as usize..*end as usize)).unwrap_or_default()
    }

    fn find(&self, names: &[&str]) -> Option<(usize, usize)> {
        names.iter().enumerate().find_map(|(which, name)| Some((self.header.iter().position(|h| h == name)?, which)))
    }

    fn need(&self, names: &[&str]) -> Result<(usize, usize), String> {
        self.find(names).ok_or_else(|| {
            let shown: Vec<&str> = self.header.iter().take(8).map(String::as_str).collect();
            format!("no column {}; the first are {}", names.join(" or "), shown.join(", "))
        })
    }

    fn number(&self, row: usize, column: usize) -> Result<f64, String> {
        let text = self.text(row, column);
        if text.is_empty() {
            return Ok(f64::NAN);
        }
        let name = self.header.get(column).map_or("", String::as_str);
        let parsed = match text.split_once(',').filter(|_| self.decimal_comma) {
            Some((whole, part)) if !part.contains([',', '.', '-', '+']) => format!("{whole}.{part}").parse(),
            _ => text.parse(),
        };
        // The header is line 1.
        parsed.map_err(|_| format!("line {}: {name} is {text:?}, not a number", row + 2))
    }

    /// Three columns x, y, z of the first unit that is there, times its factor.
    fn triple(&self, row: usize, found: &Option<([usize; 3], f64)>) -> Result<Option<Vector3<f64>>, String> {
        let Some((columns, factor)) = found else { return Ok(None) };
        let value =
            Vector3::new(self.number(row, columns[0])?, self.number(row, columns[1])?, self.number(row, columns[2])?)
                * *factor;
        // A sensor slower than the rows leaves its fields empty.
        Ok((!value.iter().all(|v| v.is_nan())).then_some(value))
    }

    fn triple_columns(&self, letter: &str, units: &[(&str, f64)]) -> Option<([usize; 3], f64)> {
        units.iter().find_map(|(unit, factor)| {
            let column = |axis: &str| self.header.iter().position(|h| *h == format!("{letter}{axis}{unit}"));
            Some(([column("x")?, column("y")?, column("z")?], *factor))
        })
    }

    /// An IMU table.
    pub fn imu(&self) -> Result<Vec<Sample>, String> {
        let (time, _) = self.need(&["t_s", "time_s"])?;
        let gyro = self.triple_columns("g", &[("_radps", 1.0), ("_rad_s", 1.0), ("_dps", 1f64.to_radians())]);
        let accel = self.triple_columns("a", &[("_mps2", 1.0), ("_m_s2", 1.0), ("_g", GRAVITY_MPS2)]);
        let mag = self.triple_columns("m", &[("_ut", 1.0), ("_gauss", 100.0)]);
        let temperature = self.find(&["temperature_c"]);
        if gyro.is_none() && accel.is_none() && mag.is_none() {
            return Err("no columns of a sensor: gx_radps…, ax_mps2… or mx_ut…".into());
        }
        (0..self.rows())
            .map(|row| {
                Ok(Sample {
                    time_s: self.number(row, time)?,
                    gyro_radps: self.triple(row, &gyro)?,
                    accel_mps2: self.triple(row, &accel)?,
                    mag_ut: self.triple(row, &mag)?,
                    temperature_c: temperature.map(|(column, _)| self.number(row, column)).transpose()?,
                })
            })
            .collect()
    }

    /// Points of a motor: command and speed, rad/s.
    pub fn motor(&self) -> Result<Vec<(f64, f64)>, String> {
        let (command, _) = self.need(&["command"])?;
        let (speed, unit) = self.need(&["speed_radps", "rpm"])?;
        let factor = [1.0, RPM_RADPS][unit];
        (0..self.rows()).map(|row| Ok((self.number(row, command)?, self.number(row, speed)? * factor))).collect()
    }

    /// Points of a propeller; `propeller` chooses one of a tunnel's table.
    pub fn thrust(&self, propeller: Option<&str>, density_kgpm3: f64) -> Result<Vec<Point>, String> {
        if let Some((name, _)) = self.find(&["propname"]) {
            return self.tunnel(name, propeller, density_kgpm3);
        }
        let (speed, unit) = self.need(&["speed_radps", "rpm"])?;
        let factor = [1.0, RPM_RADPS][unit];
        let (thrust, _) = self.need(&["thrust_n"])?;
        let torque = self.find(&["torque_nm"]);
        (0..self.rows())
            .map(|row| {
                Ok(Point {
                    speed_radps: self.number(row, speed)? * factor,
                    thrust_n: self.number(row, thrust)?,
                    torque_nm: torque.map(|(column, _)| self.number(row, column)).transpose()?,
                })
            })
            .collect()
    }

    fn tunnel(&self, name: usize, propeller: Option<&str>, density_kgpm3: f64) -> Result<Vec<Point>, String> {
        let columns = ["diameter_in", "pitch_in", "rpm", "ct"].map(|c| self.need(&[c]).map(|found| found.0));
        let [diameter, pitch, rpm, ct] = columns;
        let (diameter, pitch, rpm, ct) = (diameter?, pitch?, rpm?, ct?);
        let cp = self.find(&["cp"]).map(|found| found.0);
        let wanted =
            propeller.ok_or("the table holds many propellers: name one, as in --propeller \"apcsf 10x4.7\"")?;
        let mut points = Vec::new();
        let mut chosen: Option<String> = None;
        for row in 0..self.rows() {
            let found = self.text(row, name);
            if !same_propeller(wanted, found, self.number(row, diameter)?, self.number(row, pitch)?) {
                continue;
            }
            if chosen.as_deref().is_some_and(|c| c != found) {
                let first = chosen.unwrap_or_default();
                return Err(format!("{wanted:?} is more than one propeller: {first:?} and {found:?}"));
            }
            chosen.get_or_insert_with(|| found.to_owned());
            let cp = cp.map(|column| self.number(row, column)).transpose()?;
            let diameter_m = self.number(row, diameter)? * INCH_M;
            let point =
                Point::from_coefficients(self.number(row, rpm)?, self.number(row, ct)?, cp, diameter_m, density_kgpm3);
            points.push(point);
        }
        if points.is_empty() {
            return Err(format!("no propeller {wanted:?} among {} rows", self.rows()));
        }
        Ok(points)
    }

    /// Mass and the three axes.
    pub fn mass(&self) -> Result<(f64, [Axis; 3]), String> {
        let (axis, _) = self.need(&["axis"])?;
        let (mass, _) = self.need(&["mass_kg"])?;
        let inertia = self.find(&["inertia_kgm2"]);
        let mut mass_kg = f64::NAN;
        let mut axes = [None; 3];
        for row in 0..self.rows() {
            let letter = self.text(row, axis);
            let index = ["x", "y", "z"].iter().position(|l| l.eq_ignore_ascii_case(letter));
            let index = index.ok_or_else(|| format!("line {}: axis is {letter:?}, not x, y or z", row + 2))?;
            let here = self.number(row, mass)?;
            if here.is_finite() {
                mass_kg = here;
            }
            let known = inertia.map(|(column, _)| self.number(row, column)).transpose()?.filter(|v| v.is_finite());
            axes[index] = Some(match known {
                Some(value) => Axis::Known(value),
                None => Axis::Pendulum {
                    period_s: self.number(row, self.need(&["period_s"])?.0)?,
                    length_m: self.number(row, self.need(&["length_m"])?.0)?,
                    separation_m: self.number(row, self.need(&["separation_m"])?.0)?,
                },
            });
        }
        let [Some(x), Some(y), Some(z)] = axes else { return Err("a row for each of the axes x, y and z".into()) };
        Ok((mass_kg, [x, y, z]))
    }
}

/// Is `wanted` ("apcsf 10x4.7", or the table's own name) this row's propeller?
fn same_propeller(wanted: &str, found: &str, diameter_in: f64, pitch_in: f64) -> bool {
    if wanted.eq_ignore_ascii_case(found) {
        return true;
    }
    let mut words = wanted.split_whitespace();
    let (Some(family), Some(size), None) = (words.next(), words.next(), words.next()) else { return false };
    let Some((d, p)) = size.split_once('x') else { return false };
    let near = |text: &str, value: f64| text.parse::<f64>().is_ok_and(|v| (v - value).abs() < 1e-6);
    found.split_whitespace().next().is_some_and(|f| f.eq_ignore_ascii_case(family))
        && near(d, diameter_in)
        && near(p, pitch_in)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_found_by_name_with_their_units() {
        let table = Table::read("az_g,ax_g,ay_g,Time_s,gx_dps,gy_dps,gz_dps\n1,0,0,0.5,180,,0\n".as_bytes()).unwrap();
        let samples = table.imu().unwrap();
        assert_eq!(samples[0].time_s, 0.5);
        assert_eq!(samples[0].accel_mps2.unwrap().z, GRAVITY_MPS2);
        let gyro = samples[0].gyro_radps.unwrap();
        assert!((gyro.x - std::f64::consts::PI).abs() < 1e-12 && gyro.y.is_nan());
        assert!(samples[0].mag_ut.is_none());
        let many = "t_s\n".to_owned() + &"1\n".repeat(MAX_ROWS + 1);
        assert!(Table::read(many.as_bytes()).err().unwrap().contains("more than 1000000 rows"));
        let error = |text: &str| Table::read(text.as_bytes()).and_then(|t| t.imu().map(|_| ())).unwrap_err();
        assert!(error("t_s,b\n0,1\n").contains("no columns of a sensor"));
        assert!(error("t,mx_ut\n").contains("no column t_s or time_s; the first are t, mx_ut"));
        assert!(error("t_s,mx_ut,my_ut,mz_ut\n0,1,x,1\n").contains("line 2: my_ut is \"x\""));
    }

    #[test]
    fn semicolons_tabs_and_decimal_commas_are_read_as_a_spreadsheet_writes_them() {
        let of = |text: &str| Table::read(text.as_bytes()).and_then(|table| table.motor());
        let expected = vec![(0.25, 120.5), (1.0, -1e3)];
        for text in [
            "command,speed_radps\n0.25,120.5\n1,-1e3\n",
            "command;speed_radps\r\n0,25;120,5\r\n1;-1e3\r\n",
            "command\tspeed_radps\n0,25\t120.5\n1\t-1000,0\n",
        ] {
            assert_eq!(of(text).unwrap(), expected, "{text}");
        }
        for text in
            ["command;speed_radps\n0;1.234,5\n", "command;speed_radps\n0;1,2,3\n", "command;speed_radps\n0;1,-2\n"]
        {
            assert!(of(text).unwrap_err().starts_with("line 2: speed_radps is \"1"), "{text}");
        }
    }

    #[test]
    fn a_propeller_is_chosen_by_family_and_size() {
        let text = "PropName,B,diameter_in,pitch_in,rpm,CT,CP\napcsf 10.0x4.7 - 2,2,10.0,4.7,3000,0.11,0.044\n\
                    apcsf 10.0x7.0 - 2,2,10.0,7.0,3000,0.12,0.06\n";
        let table = Table::read(text.as_bytes()).unwrap();
        for name in ["apcsf 10x4.7", "APCSF 10.0x4.7 - 2"] {
            assert_eq!(table.thrust(Some(name), 1.225).unwrap().len(), 1);
        }
        assert!(table.thrust(None, 1.225).unwrap_err().contains("name one"));
        assert!(
            table.thrust(Some("apcsf 9x9"), 1.225).unwrap_err().contains("no propeller \"apcsf 9x9\" among 2 rows")
        );
    }

    #[test]
    fn the_examples_are_read_and_those_of_a_bench_are_fitted() {
        use crate::offline::calibrate::{Request, from_table};
        use plumbline_core::calibration::Kind;
        for (kind, text, name, near) in [
            (Kind::MotorCurve, include_str!("../../tables/motor-curve.csv"), "slope", 890.0),
            (Kind::Thrust, include_str!("../../tables/thrust.csv"), "thrust_coefficient", 1.62e-5),
            (Kind::Mass, include_str!("../../tables/mass.csv"), "inertia_z", 0.055),
        ] {
            let made = from_table(text.as_bytes(), "example", &Request::new(kind, String::new())).unwrap();
            let value = made.value(name).unwrap();
            assert!((value / near - 1.0).abs() < 0.01, "{name} is {value}");
        }
        let samples = Table::read(include_bytes!("../../tables/imu.csv").as_slice()).unwrap().imu().unwrap();
        let whole = |s: &Sample| s.gyro_radps.is_some() && s.accel_mps2.is_some() && s.mag_ut.is_some();
        assert!(samples.len() == 5 && samples.iter().all(whole));
    }

    #[test]
    fn mass_by_pendulum_or_known() {
        let text =
            "axis,mass_kg,inertia_kgm2,period_s,length_m,separation_m\nx,1.5,0.03,,,\ny,,,1.2,2.0,0.4\nz,,0.05,,,\n";
        let (mass_kg, axes) = Table::read(text.as_bytes()).unwrap().mass().unwrap();
        assert_eq!(mass_kg, 1.5);
        assert_eq!(axes[0], Axis::Known(0.03));
        assert!(matches!(axes[1], Axis::Pendulum { period_s: 1.2, .. }));
        assert!(Table::read("axis,mass_kg,inertia_kgm2\nw,1,1\n".as_bytes()).unwrap().mass().is_err());
    }
}
