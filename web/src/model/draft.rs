//! A schedule of attacks being written: what the form says, checked before it leaves the page.

use plumbline_proto::v1::{AttackChannel, AttackKind, Description, SensorChannel, SensorDescription, SensorKind};

use plumbline_rest::command::PlannedAttack;

use super::{format, names};

/// One attack of the draft.
#[derive(Debug, Clone, PartialEq)]
pub struct Draft {
    /// Sensor attacked.
    pub sensor: SensorKind,
    /// Its instance.
    pub instance: u32,
    /// Channels covered.
    pub channel: AttackChannel,
    /// What is done.
    pub kind: AttackKind,
    /// Size; see [`magnitude_unit`].
    pub magnitude: f64,
    /// Begin after acceptance, s.
    pub start_s: f64,
    /// Length, s.
    pub duration_s: f64,
    /// What a bias follows: each value for so long, s, times the magnitude.
    pub sequence: (f64, Vec<f64>),
}

/// A draft as the browser keeps it: sensor, instance, channel, kind, magnitude, start, duration, what a bias follows.
pub type Row = (i32, u32, i32, i32, f64, f64, f64, (f64, Vec<f64>));

impl Draft {
    /// As the browser keeps it.
    pub fn row(&self) -> Row {
        let (sensor, channel, kind) = (self.sensor.into(), self.channel.into(), self.kind.into());
        (sensor, self.instance, channel, kind, self.magnitude, self.start_s, self.duration_s, self.sequence.clone())
    }

    /// From what the browser kept; `None` when it is of another version.
    pub fn from_row(row: Row) -> Option<Self> {
        let (sensor, instance, channel, kind, magnitude, start_s, duration_s, sequence) = row;
        let (sensor, channel) = (SensorKind::try_from(sensor).ok()?, AttackChannel::try_from(channel).ok()?);
        let kind = AttackKind::try_from(kind).ok()?;
        Some(Self { sensor, instance, channel, kind, magnitude, start_s, duration_s, sequence })
    }

    /// "height 2: bias +0.5 m"
    pub fn subject(&self, vehicle: Option<&Description>) -> String {
        let text = subject(self.sensor, self.instance, self.channel, self.kind, self.magnitude, vehicle);
        if self.sequence.1.is_empty() { text } else { format!("{text}, a sequence") }
    }

    /// One that the ground prepared; `None` where this page knows no such names.
    pub fn prepared(planned: &PlannedAttack) -> Option<Self> {
        let find = |name: &str, all: i32, of: &dyn Fn(i32) -> Option<String>| {
            (0..all).find(|number| of(*number).as_deref() == Some(name))
        };
        let sensor = find(&planned.sensor, 16, &|n| SensorKind::try_from(n).ok().map(names::sensor_json))?;
        let channel = find(&planned.channel, 32, &|n| AttackChannel::try_from(n).ok().map(names::attack_channel_json))?;
        let kind = find(&planned.kind, 32, &|n| AttackKind::try_from(n).ok().map(names::attack_kind_json))?;
        Self::from_row((
            sensor,
            planned.instance,
            channel,
            kind,
            planned.magnitude,
            planned.start_s,
            planned.duration_s,
            (planned.sequence_period_s.unwrap_or_default(), planned.sequence.clone()),
        ))
    }

    /// As the ground wants it; attacks of one schedule get different seeds.
    pub fn body(&self, seed: u64) -> PlannedAttack {
        PlannedAttack {
            sensor: names::sensor_json(self.sensor),
            instance: self.instance,
            channel: names::attack_channel_json(self.channel),
            kind: names::attack_kind_json(self.kind),
            start_s: self.start_s,
            duration_s: self.duration_s,
            magnitude: self.magnitude,
            seed,
            sequence: self.sequence.1.clone(),
            sequence_period_s: (!self.sequence.1.is_empty()).then_some(self.sequence.0),
        }
    }
}

/// What an attack can name: sensors, then rotors.
pub fn targets(vehicle: &Description) -> impl Iterator<Item = &SensorDescription> {
    vehicle.sensors.iter().chain(&vehicle.actuators)
}

/// What an attack can name of a sensor, as its `vehicle` describes it; nothing before it has.
pub fn channels(vehicle: Option<&Description>, sensor: SensorKind, instance: u32) -> &[SensorChannel] {
    let found = vehicle.and_then(|v| targets(v).find(|s| s.kind() == sensor && s.instance == instance));
    found.map_or(&[], |s| s.channels.as_slice())
}

/// Does this kind add to what is sensed?
fn is_additive(kind: AttackKind) -> bool {
    matches!(kind, AttackKind::Bias | AttackKind::Ramp | AttackKind::Parabola | AttackKind::Noise)
}

/// Those of `channels` that an attack of this kind can cover: what it adds needs a unit, and one offset for all of an IMU
/// has none.
pub fn offered(channels: &[SensorChannel], kind: AttackKind) -> Vec<AttackChannel> {
    let found: Vec<_> =
        channels.iter().filter(|c| !is_additive(kind) || !c.unit.is_empty()).map(SensorChannel::channel).collect();
    if channels.is_empty() { vec![AttackChannel::All] } else { found }
}

/// "height 2: bias +0.5 m"
pub fn subject(
    sensor: SensorKind,
    instance: u32,
    channel: AttackChannel,
    kind: AttackKind,
    magnitude: f64,
    vehicle: Option<&Description>,
) -> String {
    let what = match channel {
        AttackChannel::All => String::new(),
        other => format!(" {}", names::attack_channel(other)),
    };
    let mut text = format!("{}{what}: {}", names::instance(sensor, instance), names::attack_kind(kind));
    if let Some(unit) = magnitude_unit(kind, channels(vehicle, sensor, instance), channel) {
        let signed = matches!(kind, AttackKind::Bias | AttackKind::Ramp | AttackKind::Parabola | AttackKind::TimeShift);
        let sign = if signed && magnitude > 0.0 { "+" } else { "" };
        let number = trimmed(magnitude).replace('-', "\u{2212}");
        text.push_str(&format!(" {sign}{number}"));
        if !unit.is_empty() {
            text.push_str(&format!(" {unit}"));
        }
    }
    text
}

/// A number without needless zeros.
fn trimmed(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Unit of the magnitude, as the agent takes it (SI); `None` for kinds that have none.
pub fn magnitude_unit(kind: AttackKind, channels: &[SensorChannel], channel: AttackChannel) -> Option<String> {
    let unit = channels.iter().find(|c| c.channel() == channel).map_or("", |c| c.unit.as_str());
    match kind {
        AttackKind::Bias | AttackKind::Noise => Some(unit.to_owned()),
        AttackKind::Ramp => Some(format!("{unit}/s")),
        AttackKind::Parabola => Some(format!("{unit}/s²")),
        AttackKind::Scale => Some("×".to_owned()),
        AttackKind::Replay | AttackKind::Delay | AttackKind::TimeShift => Some("s".to_owned()),
        AttackKind::Dropout => Some("of samples".to_owned()),
        AttackKind::Zero | AttackKind::Freeze | AttackKind::SignFlip | AttackKind::Unspecified => None,
    }
}

/// The fields of the form, as typed.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs)]
pub struct Form {
    pub sensor: SensorKind,
    pub instance: u32,
    pub channel: AttackChannel,
    pub kind: AttackKind,
    pub magnitude: String,
    pub start: String,
    pub duration: String,
}

impl Default for Form {
    fn default() -> Self {
        Self {
            sensor: SensorKind::Height,
            instance: 2,
            channel: AttackChannel::All,
            kind: AttackKind::Bias,
            magnitude: "0.5".to_owned(),
            start: "5".to_owned(),
            duration: "10".to_owned(),
        }
    }
}

impl Form {
    /// The attack it describes.
    ///
    /// # Errors
    /// What is wrong, with the value. The agent checks again, against its own bounds.
    pub fn check(&self, vehicle: Option<&Description>) -> Result<Draft, String> {
        let number = |name: &str, text: &str| format::parse_number(text).map_err(|e| format!("{name}: {e}"));
        let start_s = number("start", &self.start)?;
        let duration_s = number("duration", &self.duration)?;
        let channels = channels(vehicle, self.sensor, self.instance);
        let needs_magnitude = magnitude_unit(self.kind, channels, self.channel).is_some();
        let magnitude = if needs_magnitude { number("magnitude", &self.magnitude)? } else { 0.0 };
        if start_s < 0.0 {
            return Err(format!("start: {start_s} s lies in the past"));
        }
        if duration_s <= 0.0 {
            return Err(format!("duration: {duration_s} s is not positive"));
        }
        let longest = vehicle.and_then(|v| v.limits).map_or(0.0, |l| l.attack_max_duration_s);
        if longest > 0.0 && duration_s > longest {
            return Err(format!("duration: {duration_s} s above the vehicle's limit {longest} s"));
        }
        if !offered(channels, self.kind).contains(&self.channel) {
            let (kind, channel) = (names::attack_kind(self.kind), names::attack_channel(self.channel));
            return Err(format!("{kind} cannot cover {channel} of {}: their units differ", names::sensor(self.sensor)));
        }
        if self.kind == AttackKind::Dropout && !(0.0..=1.0).contains(&magnitude) {
            return Err(format!("magnitude: {magnitude} is not a probability 0..1"));
        }
        let most = channels.iter().find(|c| c.channel() == self.channel).map_or(0.0, |c| c.offset_max);
        if is_additive(self.kind) && most > 0.0 && magnitude.abs() > most {
            let unit = magnitude_unit(self.kind, channels, self.channel).unwrap_or_default();
            return Err(format!("magnitude: {magnitude} {unit} beyond the vehicle's limit {most} {unit}"));
        }
        if matches!(self.kind, AttackKind::Replay | AttackKind::Delay | AttackKind::Noise) && magnitude <= 0.0 {
            return Err(format!("magnitude: {magnitude} is not positive"));
        }
        Ok(Draft {
            sensor: self.sensor,
            instance: self.instance,
            channel: self.channel,
            kind: self.kind,
            magnitude,
            start_s,
            duration_s,
            sequence: (0.0, Vec::new()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_proto::v1::Limits;

    /// A vehicle with two heights, an IMU and GNSS.
    fn vehicle() -> Description {
        use AttackChannel::{Accel, All, Gyro, GyroX, X};
        let sensor = |kind, instance, channels: &[(AttackChannel, &str)]| SensorDescription {
            kind: SensorKind::into(kind),
            instance,
            channels: channels
                .iter()
                .map(|(channel, unit)| SensorChannel {
                    channel: (*channel).into(),
                    unit: (*unit).into(),
                    offset_max: 5.0,
                })
                .collect(),
            ..SensorDescription::default()
        };
        Description {
            sensors: vec![
                sensor(SensorKind::Height, 1, &[(All, "m")]),
                sensor(SensorKind::Height, 2, &[(All, "m")]),
                sensor(SensorKind::Imu, 1, &[(All, ""), (Gyro, "rad/s"), (Accel, "m/s²"), (GyroX, "rad/s")]),
                sensor(SensorKind::Gnss, 1, &[(All, "m"), (X, "m")]),
            ],
            actuators: vec![SensorDescription {
                channels: vec![SensorChannel { unit: "of full thrust".into(), offset_max: 1.0, ..Default::default() }],
                ..sensor(SensorKind::Rotor, 2, &[])
            }],
            limits: Some(Limits { attack_max_duration_s: 60.0, ..Default::default() }),
            ..Description::default()
        }
    }

    #[test]
    fn the_example_of_the_issue() {
        let draft = Form::default().check(Some(&vehicle())).unwrap();
        assert_eq!(draft.subject(Some(&vehicle())), "height 2: bias +0.5 m");
        // Before the vehicle has described itself there is no unit to show.
        assert_eq!(draft.subject(None), "height 2: bias +0.5");
        let body = serde_json::to_value(draft.body(1)).unwrap();
        assert_eq!(
            body,
            serde_json::json!({"sensor":"height","instance":2,"channel":"all","kind":"bias","start_s":5.0,
                "duration_s":10.0,"magnitude":0.5,"seed":1})
        );
    }

    #[test]
    fn a_draft_outlives_a_reload() {
        let draft = Form::default().check(Some(&vehicle())).unwrap();
        let text = serde_json::to_string(&draft.row()).unwrap();
        assert_eq!(Draft::from_row(serde_json::from_str(&text).unwrap()), Some(draft.clone()));
        assert_eq!(Draft::from_row((99, 1, 0, 0, 0.0, 0.0, 0.0, (0.0, Vec::new()))), None);
        let followed = Draft { sequence: (0.1, vec![1.0, -0.5]), ..draft };
        assert_eq!(Draft::prepared(&followed.body(1)), Some(followed.clone()));
        assert_eq!(followed.subject(None), "height 2: bias +0.5, a sequence");
    }

    #[test]
    fn one_offset_for_all_channels_of_an_imu_is_neither_offered_nor_taken() {
        let form = |kind, channel| Form { sensor: SensorKind::Imu, instance: 1, kind, channel, ..Form::default() };
        for kind in [AttackKind::Bias, AttackKind::Ramp, AttackKind::Noise] {
            let refused = form(kind, AttackChannel::All).check(Some(&vehicle())).unwrap_err();
            assert!(refused.contains("units differ"), "{refused}");
            assert!(form(kind, AttackChannel::GyroX).check(Some(&vehicle())).is_ok());
        }
        assert!(form(AttackKind::Freeze, AttackChannel::All).check(Some(&vehicle())).is_ok());
        let gnss = Form { sensor: SensorKind::Gnss, instance: 1, ..Form::default() };
        assert!(gnss.check(Some(&vehicle())).is_ok(), "all three are lengths");
    }

    #[test]
    fn a_rotor_is_a_target_like_a_sensor() {
        let form = |kind, magnitude: &str| Form {
            sensor: SensorKind::Rotor,
            instance: 2,
            kind,
            magnitude: magnitude.into(),
            ..Form::default()
        };
        let told = |kind, magnitude| form(kind, magnitude).check(Some(&vehicle())).map(|d| d.subject(Some(&vehicle())));
        assert_eq!(told(AttackKind::Scale, "0.8").unwrap(), "rotor 2: scale 0.8 \u{d7}");
        assert_eq!(told(AttackKind::Bias, "-0.1").unwrap(), "rotor 2: bias \u{2212}0.1 of full thrust");
        assert!(told(AttackKind::Bias, "1.5").unwrap_err().contains("limit 1 of full thrust"));
        let body = serde_json::to_value(form(AttackKind::Freeze, "").check(Some(&vehicle())).unwrap().body(1)).unwrap();
        assert_eq!((&body["sensor"], &body["instance"]), (&"rotor".into(), &2.into()));
    }

    #[test]
    fn every_mistake_is_named_with_its_value() {
        let check = |change: fn(&mut Form)| {
            let mut form = Form::default();
            change(&mut form);
            form.check(Some(&vehicle())).unwrap_err()
        };
        assert_eq!(check(|f| f.start = "-1".into()), "start: -1 s lies in the past");
        assert_eq!(check(|f| f.duration = "0".into()), "duration: 0 s is not positive");
        assert_eq!(check(|f| f.duration = "90".into()), "duration: 90 s above the vehicle's limit 60 s");
        assert_eq!(check(|f| f.magnitude = "x".into()), "magnitude: \u{201c}x\u{201d} is not a number");
        assert_eq!(check(|f| f.magnitude = "-5.5".into()), "magnitude: -5.5 m beyond the vehicle's limit 5 m");
        let steep = |f: &mut Form| {
            f.kind = AttackKind::Ramp;
            f.magnitude = "6".into();
        };
        assert_eq!(check(steep), "magnitude: 6 m/s beyond the vehicle's limit 5 m/s");
        assert_eq!(
            check(|f| {
                f.kind = AttackKind::Dropout;
                f.magnitude = "2".into()
            }),
            "magnitude: 2 is not a probability 0..1"
        );
    }

    #[test]
    fn kinds_without_magnitude_need_none() {
        let form = Form { kind: AttackKind::Freeze, magnitude: "".into(), ..Form::default() };
        assert_eq!(form.check(Some(&vehicle())).unwrap().subject(None), "height 2: freeze");
        let gyro = Form {
            sensor: SensorKind::Imu,
            instance: 1,
            channel: AttackChannel::GyroX,
            kind: AttackKind::Ramp,
            magnitude: "-0.01".into(),
            ..Form::default()
        };
        let vehicle = vehicle();
        assert_eq!(
            gyro.check(Some(&vehicle)).unwrap().subject(Some(&vehicle)),
            "IMU 1 gyro x: ramp \u{2212}0.01 rad/s/s"
        );
    }
}
