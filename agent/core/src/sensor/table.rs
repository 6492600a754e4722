//! One line a kind of sensor makes everything that has a place for each kind: the frame, the suite, the messages.
//!
//! A frame has a fixed place for each instance instead of a list to search: it stays `Copy`, takes no sorting, and an
//! estimator names what it uses (`frame.heights`). Whatever handles any kind goes through [`super::Registered`].

macro_rules! sensors {
    ($($(#[$doc:meta])* $field:ident: $places:ty => $name:ident($sample:ty);)*) => {
        /// Everything that arrived since the frame before. A place is `None` when that sensor had nothing new.
        #[derive(Debug, Clone, Copy, PartialEq, Default)]
        pub struct SensorFrame {
            /// Time of this tick.
            pub time: FlightTime,
            $($(#[$doc])* pub $field: $places,)*
            /// Battery voltage at this tick, V; `None` when not measured.
            pub battery_v: Option<f64>,
        }

        /// Most sensors of a vehicle.
        pub const MAX_SENSORS: usize = 0 $(+ <$places as Places<$sample>>::LEN)*;

        /// One sample, of whatever kind.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub enum AnySample {
            $(
                #[doc = concat!("A [`", stringify!($sample), "`].")]
                $name($sample),
            )*
        }

        /// A message of each kind, kept from tick to tick so that filling one allocates nothing.
        #[derive(Debug)]
        pub struct Wires { $($field: <$sample as Sample>::Wire,)* }

        impl Wires {
            /// With room for the longest message.
            pub fn with_room() -> Self {
                Self { $($field: <$sample as Sample>::wire_with_room(),)* }
            }
        }

        $(impl Registered for $sample {
            fn places(frame: &SensorFrame) -> &[Option<Self>] {
                frame.$field.places()
            }
            fn places_mut(frame: &mut SensorFrame) -> &mut [Option<Self>] {
                frame.$field.places_mut()
            }
            fn wire(wires: &mut Wires) -> &mut Self::Wire {
                &mut wires.$field
            }
            fn any(self) -> AnySample {
                AnySample::$name(self)
            }
        })*

        impl SensorFrame {
            /// Shows `visitor` the place of every sensor, kind by kind.
            pub fn visit(&mut self, visitor: &mut impl Visitor) {
                $(for (i, place) in <$sample>::places_mut(self).iter_mut().enumerate() {
                    visitor.place(SensorId::new(<$sample>::KIND, i as u8 + 1), place);
                })*
            }

            /// Shows `visitor` every sample of this frame, beside what `received` has in its place.
            pub fn visit_beside(&self, received: &SensorFrame, visitor: &mut impl PairVisitor) {
                $(for (i, pair) in <$sample>::places(self).iter().zip(<$sample>::places(received)).enumerate() {
                    if let (Some(sensed), received) = pair {
                        visitor.pair(SensorId::new(<$sample>::KIND, i as u8 + 1), sensed, received.as_ref());
                    }
                })*
            }

            /// Puts a sample into the place of instance `index` + 1; one that has none is given up.
            pub fn put(&mut self, index: usize, sample: AnySample) {
                match sample {
                    $(AnySample::$name(sample) => {
                        if let Some(place) = <$sample>::places_mut(self).get_mut(index) {
                            *place = Some(sample);
                        }
                    })*
                }
            }
        }

        impl AnySample {
            /// Its kind.
            pub fn kind(&self) -> SensorKind {
                match self {
                    $(Self::$name(_) => <$sample>::KIND,)*
                }
            }

            /// A message of `topic`: the sample sensed and what was received. `None` where the topic is no sensor's;
            /// `Some(None)` where the message cannot be read.
            pub fn decode(topic: Kind, message: &[u8]) -> Option<Option<(Self, Received<Self>)>> {
                $(if topic == <$sample>::TOPIC {
                    return Some(decode::<$sample>(message));
                })*
                None
            }
        }

        /// What a kind of sensor measures; nothing where the kind is not known.
        pub fn quantities(kind: SensorKind) -> &'static [Quantity] {
            $(if kind == <$sample>::KIND {
                return <$sample>::QUANTITIES;
            })*
            &[]
        }

        /// Every sensor of a vehicle. Instances count from 1 in each list.
        #[derive(Debug, Clone, PartialEq, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct Suite {
            $($(#[$doc])* #[serde(default)] pub $field: <$places as Places<$sample>>::Sheets,)*
            /// Battery voltage noise, V; `None` when it is not measured.
            #[serde(default)]
            pub battery_sigma_v: Option<f64>,
        }

        /// What estimators assume of the sensors, shared by all of them: noise, walks, gates and places as configured.
        /// Neither what the sensors really do nor, in a simulation, what is simulated.
        #[derive(Debug, Clone, PartialEq)]
        pub struct SensorModel {
            $($(#[$doc])* pub $field: <$sample as Sample>::Model,)*
        }

        impl From<&Suite> for SensorModel {
            /// As the data sheets of `suite` say; what they do not say keeps its default.
            fn from(suite: &Suite) -> Self {
                Self { $($field: <$sample>::model(suite.$field.as_slice()),)* }
            }
        }

        impl Default for SensorModel {
            /// Consumer MEMS in a lab: figures of \[Paternain\] Table I and \[Clinic\] 5.4, cameras of \[Umasankar\].
            fn default() -> Self {
                Self::from(&Suite::empty())
            }
        }

        impl Suite {
            /// Every kind there is.
            pub fn kinds() -> impl Iterator<Item = SensorKind> {
                [$(<$sample>::KIND),*].into_iter()
            }

            /// No sensor at all.
            pub fn empty() -> Self {
                Self { $($field: Default::default(),)* battery_sigma_v: Some(0.02) }
            }

            /// Shows every data sheet, kind by kind, with its sensor and its key in a suite's file.
            pub fn sheets(&self, mut each: impl FnMut(SensorId, String, &dyn Sheet)) {
                $(for (i, sheet) in self.$field.iter().enumerate() {
                    let key = key(stringify!($field), <$places as Places<$sample>>::MANY, i);
                    each(SensorId::new(<$sample>::KIND, i as u8 + 1), key, sheet);
                })*
            }

            /// The same, to alter.
            pub fn sheets_mut(&mut self, mut each: impl FnMut(SensorId, &mut dyn Sheet)) {
                $(for (i, sheet) in self.$field.iter_mut().enumerate() {
                    each(SensorId::new(<$sample>::KIND, i as u8 + 1), sheet);
                })*
            }

            /// Adds one of `kind` as its data sheet is by default; false where there is no room, or no such kind.
            pub fn add(&mut self, kind: SensorKind) -> bool {
                $(if kind == <$sample>::KIND {
                    let instance = self.$field.iter().count() + 1;
                    return instance <= <$places as Places<$sample>>::LEN && {
                        self.$field.fill(Sheet::typical(instance));
                        true
                    };
                })*
                false
            }
        }
    };
}
pub(super) use sensors;
