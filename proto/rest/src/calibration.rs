//! Calibrations: `POST /api/v1/calibrations` fits and keeps one, `GET` lists those kept, `GET …/{id}` is a whole one.
//!
//! Samples for one are taken of a vehicle in somebody's hands by `POST /api/v1/vehicles/{id}/calibration`; `GET` says how far that has
//! come, `DELETE` gives it up. `POST /api/v1/vehicles/{id}/calibrations` puts a kept one to use, `DELETE …/{kind}/{imu}` stops that.

use serde::{Deserialize, Serialize};

use crate::number;

/// `POST /api/v1/calibrations`: what to fit, from exactly one of `flight`, `csv` and `vehicle`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Fit {
    /// `accelerometer`, `gyroscope`, `magnetometer`, `thermal`, `motor-curve`, `thrust`, `mass`, `allan` or `delays`.
    pub kind: String,
    /// Id of a recorded flight.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flight: Option<String>,
    /// Text of a table.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub csv: Option<String>,
    /// Id of a vehicle whose samples were taken by hand, of this kind.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vehicle: Option<String>,
    /// Name of the table, to be noted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Which IMU, from 1; 1 when left out; of a vehicle that whose samples were taken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub imu: Option<usize>,
    /// Flight time to begin at, s.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub from_s: Option<f64>,
    /// Flight time to end at, s.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub to_s: Option<f64>,
    /// The first half of the recording only.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub first_half: bool,
    /// Gravity of the place, m/s².
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub gravity_mps2: Option<f64>,
    /// Which propeller of a table of many.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub propeller: Option<String>,
    /// Air density for a tunnel's coefficients, kg/m³.
    #[serde(default, deserialize_with = "number", skip_serializing_if = "Option::is_none")]
    pub air_density_kgpm3: Option<f64>,
    /// Id of a kept calibration, for a gyroscope.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub accelerometer: Option<String>,
}

/// `POST /api/v1/vehicles/{id}/calibration`: take samples for this; what was taken before is dropped.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Taking {
    /// `accelerometer`, `gyroscope` or `magnetometer`.
    pub kind: String,
    /// Which IMU, from 1; 1 when left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub imu: Option<usize>,
}

/// `POST /api/v1/vehicles/{id}/calibrations`: correct the vehicle's samples by this from now on.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Using {
    /// Id of a kept calibration.
    pub calibration: String,
}

/// `GET /api/v1/vehicles/{id}/calibration`: samples taken so far, and what the fit asks for, counted by the fit's own code. Directions
/// are unit vectors in the body frame FLU.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Taken {
    /// As [`Taking::kind`]; empty while nothing is taken.
    pub kind: String,
    /// Which IMU, from 1.
    pub imu: usize,
    /// Samples taken.
    pub samples: u64,
    /// From the first of them to the last, s.
    pub span_s: f64,
    /// Why none are taken now; empty while they are.
    pub problem: String,
    /// What the fit counts.
    pub aims: Vec<Aim>,
    /// What the fit cannot tell yet, although all that it counts is there: more of the same mends that. Empty otherwise.
    pub undetermined: String,
    /// Is everything there without which the fit refuses?
    pub ready: bool,
    /// How long the vehicle has been held still by now, as a share of what makes a pose, 0 to 1.
    pub still: f64,
    /// Where up is now; absent where no pose is asked for.
    pub up: Option<[f64; 3]>,
    /// Where up was in each pose that counts, in the order they were taken.
    pub poses: Vec<[f64; 3]>,
    /// Where the field points now; absent where no field is asked for, or sent.
    pub field: Option<[f64; 3]>,
    /// The sphere of directions is cut into so many bands of one height, from −z to z.
    pub bands: u64,
    /// Which sectors of it were seen: band by band, in each from −π to π about z.
    pub sectors: Vec<bool>,
}

/// Something that a fit counts.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Aim {
    /// Of what.
    pub what: String,
    /// How many there are.
    pub found: u64,
    /// With fewer the fit refuses.
    pub needed: u64,
    /// From here on more of them determine no more parameters.
    pub best: u64,
}

/// `GET /api/v1/calibrations`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Calibrations {
    /// One page, newest first, without covariance and picture.
    pub calibrations: Vec<Calibration>,
    /// Calibrations on all pages.
    pub total: u64,
}

/// A calibration: the agent's file, with the name it is kept under. An agent reads it as it is.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Calibration {
    /// Kind and date, safe as a file name.
    pub id: String,
    /// Version of the file.
    pub schema: u32,
    /// What was fitted, as [`Fit::kind`].
    pub kind: String,
    /// When, ISO 8601.
    pub date: String,
    /// Recording or table it was fitted to.
    pub input: String,
    /// Which IMU, from 1; absent for what is no IMU.
    pub sensor: Option<u8>,
    /// Stretch of the recording used, s.
    pub span_s: Option<[f64; 2]>,
    /// How many samples, poses or points the fit rests on.
    pub samples: u64,
    /// What the model leaves.
    pub residual: Residual,
    /// The numbers.
    pub parameters: Vec<Parameter>,
    /// Over `parameters`, row by row; empty where nothing is known, absent in a list.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub covariance: Option<Vec<Vec<f64>>>,
    /// What a user should know.
    pub notes: Vec<String>,
    /// What to draw; absent in a list.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub picture: Vec<Picture>,
}

/// One fitted number.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema), schema(as = CalibratedParameter))]
#[serde(default)]
pub struct Parameter {
    /// Name within its kind.
    pub name: String,
    /// In `unit`.
    pub value: f64,
    /// One-sigma; absent where nothing is known of it.
    pub sigma: Option<f64>,
    /// Unit; empty for a pure number.
    pub unit: String,
}

/// What the model leaves.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Residual {
    /// Root mean square.
    pub value: Option<f64>,
    /// Unit.
    pub unit: String,
}

/// One plot of a fit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Picture {
    /// Headline.
    pub title: String,
    /// Label of the x axis, with unit.
    pub x: String,
    /// Label of the y axis, with unit.
    pub y: String,
    /// Both axes logarithmic?
    pub log: bool,
    /// What is in it.
    pub series: Vec<Series>,
}

/// Points of one kind in a plot.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct Series {
    /// For the legend.
    pub name: String,
    /// Joined by a line?
    pub line: bool,
    /// x and y.
    pub points: Vec<[Option<f64>; 2]>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_is_strict_and_what_is_answered_is_not() {
        let asked = Fit { kind: "thrust".into(), csv: Some("rpm,thrust_n\n".into()), ..Fit::default() };
        let text = serde_json::to_string(&asked).unwrap();
        assert_eq!(text, r#"{"kind":"thrust","csv":"rpm,thrust_n\n"}"#);
        assert_eq!(serde_json::from_str::<Fit>(&text).unwrap(), asked);
        for wrong in [r#"{"kind":"mass","from":1}"#, r#"{"kind":"mass","from_s":null}"#, "{}"] {
            assert!(serde_json::from_str::<Fit>(wrong).is_err(), "{wrong}");
        }
        let text = r#"{"id":"m-1","kind":"magnetometer","sensor":1,"span_s":[5.0,60.0],"samples":1109,"new_field":1,
            "residual":{"value":0.6,"unit":"µT"},"parameters":[{"name":"hard_x","value":-1.4,"sigma":0.3,"unit":"µT"}],
            "picture":[{"title":"Field","log":true,"series":[{"name":"before","line":false,"points":[[10.0,null]]}]}]}"#;
        let read: Calibration = serde_json::from_str(text).unwrap();
        assert_eq!((read.parameters[0].sigma, read.residual.value), (Some(0.3), Some(0.6)));
        assert_eq!(read.picture[0].series[0].points, [[Some(10.0), None]]);
    }
}
