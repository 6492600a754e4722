macro_rules! kinds {
    ($($(#[$doc:meta])* $name:ident = $number:literal, $topic:literal, $message:literal;)*) => {
        /// What a frame carries. Numbers are part of the wire contract and never reused.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u16)]
        pub enum Kind { $($(#[$doc])* $name = $number,)* }

        impl Kind {
            /// Every kind of this schema, in wire order.
            pub const ALL: &[Kind] = &[$(Kind::$name),*];

            /// The kind with this number; `None` for kinds newer than this build.
            pub const fn from_wire(number: u16) -> Option<Self> {
                match number { $($number => Some(Kind::$name),)* _ => None }
            }

            /// First part of the topic; see [`Kind::topic`].
            pub const fn base_topic(self) -> &'static str {
                match self { $(Kind::$name => $topic,)* }
            }

            /// Full protobuf name of the message.
            pub const fn message_name(self) -> &'static str {
                match self { $(Kind::$name => concat!("plumbline.v1.", $message),)* }
            }
        }
    };
}

kinds! {
    /// One sample of an IMU.
    Imu = 1, "/sensor/imu", "ImuSample";
    /// One laser height.
    Height = 2, "/sensor/height", "HeightSample";
    /// One barometer sample.
    Barometer = 3, "/sensor/barometer", "BarometerSample";
    /// One GNSS fix.
    Gnss = 4, "/sensor/gnss", "GnssSample";
    /// One motion-capture pose.
    MocapPose = 5, "/sensor/mocap_pose", "MocapPoseSample";
    /// One set of camera ranges.
    CameraRanges = 6, "/sensor/camera_ranges", "CameraRangesSample";
    /// Output of one estimator; the instance is the estimator kind's number.
    Estimate = 10, "/estimate", "Estimate";
    /// Residuals of one estimator.
    Residuals = 11, "/residuals", "Residuals";
    /// Truth, from the simulator or a recording that carries it.
    Truth = 12, "/truth", "Truth";
    /// The secure estimator's own account: attacked set, margins, certificate.
    Secure = 13, "/secure", "SecureStatus";
    /// Setpoint, wrench and motors of one tick.
    Control = 20, "/control", "Control";
    /// Response to a setpoint step.
    StepResponse = 21, "/step", "StepResponse";
    /// Gains in use.
    Gains = 22, "/gains", "GainsInUse";
    /// State of the attack schedule.
    Attacks = 23, "/attacks", "AttackState";
    /// State of the agent.
    Status = 30, "/status", "Status";
    /// Event.
    Event = 31, "/event", "Event";
    /// Answer to a command.
    Ack = 32, "/ack", "Ack";
    /// Description of the vehicle, its suite and its limits.
    Description = 33, "/description", "Description";
    /// Begin or end of a flight.
    Flight = 34, "/flight", "FlightMark";
    /// How one device of a real vehicle is doing; the instance is its place in the configuration, from 1.
    Device = 35, "/device", "DeviceState";
    /// One whole scan of a scanner, where its configuration asks for it; the instance is that of its height.
    Scan = 36, "/scan", "Scan";
    /// State of the link, made by the ground.
    Link = 40, "/link", "LinkStatus";
    /// State of the recording, made by the ground.
    Recording = 41, "/recording", "RecordingStatus";
    /// Holder of the control lease, made by the ground.
    Lease = 42, "/lease", "ControlLease";
}

impl Kind {
    /// Number on the wire.
    pub const fn to_wire(self) -> u16 {
        self as u16
    }

    /// Is there one topic per instance (sensor instance, estimator, device or scanner)?
    pub const fn has_instances(self) -> bool {
        self.is_sensor() || matches!(self, Kind::Estimate | Kind::Residuals | Kind::Device | Kind::Scan)
    }

    /// Is it a sample of a sensor? Their numbers are those below the first estimate.
    pub const fn is_sensor(self) -> bool {
        self.to_wire() < Kind::Estimate.to_wire()
    }

    /// Topic of a flight file's channel: `/sensor/height/2`, `/status`.
    pub fn topic(self, instance: u16) -> String {
        if self.has_instances() { format!("{}/{instance}", self.base_topic()) } else { self.base_topic().to_owned() }
    }

    /// Inverse of [`Kind::topic`].
    pub fn from_topic(topic: &str) -> Option<(Self, u16)> {
        Self::ALL.iter().find_map(|kind| {
            let rest = topic.strip_prefix(kind.base_topic())?;
            if kind.has_instances() {
                Some((*kind, rest.strip_prefix('/')?.parse().ok()?))
            } else {
                rest.is_empty().then_some((*kind, 0))
            }
        })
    }

    /// Have a flight's tables columns of it?
    pub const fn has_columns(self) -> bool {
        self.is_sensor()
            || matches!(
                self,
                Kind::Control | Kind::Estimate | Kind::Truth | Kind::Residuals | Kind::Secure | Kind::Status
            )
    }

    /// How the names of a topic's columns and signals begin: `height_2` of `/sensor/height/2`.
    pub fn column_prefix(topic: &str) -> String {
        topic.trim_start_matches('/').trim_start_matches("sensor/").replace('/', "_")
    }

    /// Made by the ground for the page; never recorded as part of a flight.
    pub const fn is_ground_made(self) -> bool {
        matches!(self, Kind::Link | Kind::Recording | Kind::Lease)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_round_trip_and_are_distinct() {
        let mut seen = std::collections::HashSet::new();
        for kind in Kind::ALL {
            let instance = if kind.has_instances() { 3 } else { 0 };
            let topic = kind.topic(instance);
            assert_eq!(Kind::from_topic(&topic), Some((*kind, instance)), "{topic}");
            assert_eq!(Kind::from_wire(kind.to_wire()), Some(*kind));
            assert!(seen.insert(topic));
        }
        assert_eq!(Kind::column_prefix("/sensor/height/2"), "height_2");
        assert_eq!(Kind::column_prefix("/control"), "control");
        assert_eq!(Kind::from_topic("/sensor/imu"), None);
        assert_eq!(Kind::from_topic("/sensor/imu/x"), None);
        assert_eq!(Kind::from_wire(9999), None);
    }
}
