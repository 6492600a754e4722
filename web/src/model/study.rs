//! A plan written from what a vehicle has: the form's answers, and the text they come to.

use plumbline_proto::v1::{AttackChannel, AttackKind, Description, SensorKind};

use super::{draft, format, names};

/// Sensors of a suite of the simulator by kind: IMU, height, barometer.
const SUITES: [(&str, [usize; 3]); 2] = [("string_rig", [4, 3, 1]), ("clinic", [4, 2, 0])];
const IN_SUITES: [SensorKind; 3] = [SensorKind::Imu, SensorKind::Height, SensorKind::Barometer];
/// Kinds of which a suite may have more, or any at all.
const ADDED: [SensorKind; 5] =
    [SensorKind::Height, SensorKind::Barometer, SensorKind::Gnss, SensorKind::MocapPose, SensorKind::CameraRanges];
/// The first altitude is commanded then, s.
const FIRST_S: f64 = 5.0;
/// Where no onset is given, the ground draws one up to then, s …
const LATEST_ONSET_S: f64 = 22.0;
/// … and so much of an attack is to be seen, s.
const ATTACKED_S: f64 = 4.0;
/// On strings, and free.
const RIGS: [&str; 2] =
    ["{ hanging_strings = { mode = \"flight\", height_m = 0.3 } }", "{ free = { height_m = 0.0 } }"];

/// What is attacked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Target {
    /// Kind of sensor.
    pub sensor: SensorKind,
    /// Which of them; `None`: drawn for each flight.
    pub instance: Option<u32>,
}

/// The answers, as typed and ticked.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs)]
pub struct Study {
    /// `None`: nothing is attacked.
    pub target: Option<Target>,
    pub channel: AttackChannel,
    pub kind: AttackKind,
    pub sizes: String,
    /// In the words of a configuration.
    pub estimators: Vec<String>,
    pub worlds: Vec<String>,
    /// On strings, free.
    pub rigs: [bool; 2],
    pub altitudes: String,
    pub hold_s: String,
    pub repeats: String,
    pub seed: String,
}

impl Default for Study {
    fn default() -> Self {
        Self {
            target: Some(Target { sensor: SensorKind::Height, instance: None }),
            channel: AttackChannel::All,
            kind: AttackKind::Bias,
            sizes: "0.05 0.1 0.2".into(),
            estimators: vec!["ekf_bias".into(), "lanes".into()],
            worlds: vec!["datasheet".into()],
            rigs: [true, false],
            altitudes: "0.9 1.2".into(),
            hold_s: "15".into(),
            repeats: "10".into(),
            seed: "1000".into(),
        }
    }
}

/// At least one number.
fn numbers(name: &str, text: &str) -> Result<Vec<f64>, String> {
    let all: Result<Vec<f64>, String> = format::list(text).map(format::parse_number).collect();
    match all {
        Ok(all) if all.is_empty() => Err(format!("{name}: none is given")),
        Ok(all) => Ok(all),
        Err(error) => Err(format!("{name}: {error}")),
    }
}

fn whole(name: &str, text: &str) -> Result<u64, String> {
    text.trim().parse().map_err(|_| format!("{name}: {text:?} is not a whole number"))
}

fn listed<T: std::fmt::Debug>(key: &str, values: &[T]) -> String {
    format!("[[factor]]\nkey = \"{key}\"\nvalues = {values:?}\n")
}

/// The suite that comes nearest to what the vehicle has.
fn suite(vehicle: Option<&Description>) -> String {
    let Some(vehicle) = vehicle else { return "{ preset = \"string_rig\" }".into() };
    let has = |kind: SensorKind| vehicle.sensors.iter().filter(|sensor| sensor.kind() == kind).count();
    let own = IN_SUITES.map(has);
    let off = |of: &[usize; 3]| of.iter().zip(own).map(|(a, b)| a.abs_diff(b)).sum::<usize>();
    let [mut best, other] = SUITES;
    if off(&other.1) < off(&best.1) {
        best = other;
    }
    let counted = |kind| IN_SUITES.iter().position(|known| *known == kind).map_or(0, |place| best.1[place]);
    let more = ADDED
        .iter()
        .flat_map(|kind| std::iter::repeat_n(names::sensor_json(*kind), has(*kind).saturating_sub(counted(*kind))));
    let more: Vec<String> = more.collect();
    if more.is_empty() {
        format!("{{ preset = {:?} }}", best.0)
    } else {
        format!("{{ preset = {:?}, add = {more:?} }}", best.0)
    }
}

impl Study {
    /// Unit of the sizes; `None` where the attack has none, or there is none.
    pub fn unit(&self, vehicle: Option<&Description>) -> Option<String> {
        let Target { sensor, instance } = self.target?;
        draft::magnitude_unit(self.kind, draft::channels(vehicle, sensor, instance.unwrap_or(1)), self.channel)
    }

    /// The plan, for a `vehicle` that describes itself so.
    ///
    /// # Errors
    /// What is wrong, with the value.
    pub fn plan(&self, vehicle: Option<&Description>) -> Result<String, String> {
        let (repeats, seed) = (whole("repeats", &self.repeats)?, whole("seed", &self.seed)?);
        let altitudes = numbers("altitudes", &self.altitudes)?;
        let hold_s = format::parse_number(&self.hold_s).map_err(|error| format!("each for: {error}"))?;
        let Some(world) = self.worlds.first() else { return Err("worlds: none is ticked".into()) };
        if self.estimators.is_empty() {
            return Err("estimators: none is ticked".into());
        }
        let rigs: Vec<&str> = RIGS.iter().zip(self.rigs).filter(|(_, ticked)| *ticked).map(|(rig, _)| *rig).collect();
        let Some(first_rig) = rigs.first() else { return Err("rigs: none is ticked".into()) };
        let duration_s = FIRST_S + hold_s * altitudes.len() as f64;
        let mut text = format!(
            "name = \"study\"\nrepeats = {repeats}\nseed = {seed}\n[scenario]\nworld = {world:?}\nduration_s = {duration_s:?}\nsuite = {}\n\
             rig = {first_rig}\nscript = [\n  {{ at_s = 3, do = \"arm\" }}, {{ at_s = 4, do = \"mode\", mode = \"altitude_hold\" }},\n",
            suite(vehicle)
        );
        for (n, altitude_m) in altitudes.iter().enumerate() {
            let at_s = FIRST_S + hold_s * n as f64;
            text += &format!("  {{ at_s = {at_s:?}, do = \"setpoint\", altitude_m = {altitude_m:?} }},\n");
        }
        text += "]\n";
        let mut factors = String::new();
        if let Some(Target { sensor, instance }) = self.target {
            text += &format!(
                "[attack]\nsensor = {:?}\nkind = {:?}\n",
                names::sensor_json(sensor),
                names::attack_kind_json(self.kind)
            );
            if self.channel != AttackChannel::All {
                text += &format!("channel = {:?}\n", names::attack_channel_json(self.channel));
            }
            if let Some(instance) = instance {
                text += &format!("instance = {instance}\n");
            }
            if duration_s < LATEST_ONSET_S + ATTACKED_S {
                // In the middle of what is flown.
                text += &format!("start_s = {:?}\n", 0.5 * (FIRST_S + duration_s));
            }
            if self.unit(vehicle).is_some() {
                factors += &listed("attack.magnitude", &numbers("sizes", &self.sizes)?);
            }
        }
        factors += &listed("agent.estimators.in_loop", &self.estimators);
        if self.worlds.len() > 1 {
            factors += &listed("scenario.world", &self.worlds);
        }
        if rigs.len() > 1 {
            factors += &format!("[[factor]]\nkey = \"scenario.rig\"\nvalues = [{}]\n", rigs.join(", "));
        }
        Ok(text + &factors)
    }
}

#[cfg(test)]
mod tests {
    use plumbline_proto::v1::{SensorChannel, SensorDescription};

    use super::*;

    fn vehicle(kinds: &[(SensorKind, u32)]) -> Description {
        let sensor = |kind: SensorKind, instance| SensorDescription {
            kind: kind.into(),
            instance,
            channels: vec![SensorChannel { channel: AttackChannel::All.into(), unit: "m".into(), offset_max: 2.0 }],
            ..SensorDescription::default()
        };
        let all = kinds.iter().flat_map(|(kind, count)| (1..=*count).map(|instance| sensor(*kind, instance)));
        Description { sensors: all.collect(), ..Description::default() }
    }

    #[test]
    fn the_suite_is_the_vehicles() {
        use SensorKind::{Barometer, Gnss, Height, Imu, MocapPose};
        assert_eq!(suite(Some(&vehicle(&[(Imu, 4), (Height, 3), (Barometer, 1)]))), "{ preset = \"string_rig\" }");
        assert_eq!(suite(Some(&vehicle(&[(Imu, 4), (Height, 2)]))), "{ preset = \"clinic\" }");
        let more = vehicle(&[(Imu, 4), (Height, 5), (Barometer, 1), (Gnss, 1), (MocapPose, 1)]);
        let added = "{ preset = \"string_rig\", add = [\"height\", \"height\", \"gnss\", \"mocap_pose\"] }";
        assert_eq!(suite(Some(&more)), added);
    }

    #[test]
    fn answers_become_a_plan_and_what_is_wrong_is_said() {
        let vehicle = vehicle(&[(SensorKind::Imu, 4), (SensorKind::Height, 3), (SensorKind::Barometer, 1)]);
        let study = Study { rigs: [true, true], worlds: vec!["bench".into(), "harsh".into()], ..Study::default() };
        let text = study.plan(Some(&vehicle)).unwrap();
        for part in [
            "repeats = 10",
            "world = \"bench\"",
            "duration_s = 35.0",
            "{ at_s = 20.0, do = \"setpoint\", altitude_m = 1.2 }",
            "key = \"attack.magnitude\"\nvalues = [0.05, 0.1, 0.2]",
            "key = \"scenario.world\"\nvalues = [\"bench\", \"harsh\"]",
            "key = \"scenario.rig\"",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(!text.contains("start_s"), "{text}");
        let short = Study { altitudes: "0.9".into(), ..study.clone() }.plan(Some(&vehicle)).unwrap();
        assert!(short.contains("duration_s = 20.0") && short.contains("\nstart_s = 12.5\n"), "{short}");
        let refused = |change: fn(&mut Study)| {
            let mut study = study.clone();
            change(&mut study);
            study.plan(Some(&vehicle)).unwrap_err()
        };
        assert!(refused(|study| study.sizes = "0.1 much".into()).contains("much"));
        assert!(refused(|study| study.repeats = "-3".into()).contains("-3"));
        assert!(refused(|study| study.altitudes = " ".into()).contains("altitudes"));
        assert!(refused(|study| study.estimators.clear()).contains("estimators"));
        assert!(refused(|study| study.rigs = [false; 2]).contains("rigs"));
        let quiet = Study { target: None, ..study };
        assert!(!quiet.plan(Some(&vehicle)).unwrap().contains("attack"));
    }
}
