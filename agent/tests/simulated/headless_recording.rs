//! GIVEN a scripted scenario WHEN it is flown without a ground THEN the onboard log holds the whole flight.

use std::collections::BTreeMap;

use plumbline_agent::flight::Flight;
use plumbline_agent::log::{self, LogConfig, RING_BYTES};
use plumbline_agent::runner::pace::Pace;
use plumbline_agent::runner::{Runner, RunnerPorts};
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::telemetry::{Outlet, Telemetry};
use plumbline_proto::time::FlightTime;
use plumbline_proto::{Kind, Message, v1};
use plumbline_support::flown::{BOOT, identification, runner_options};

#[test]
fn a_scripted_flight_is_recorded_whole() {
    let mut scenario = Scenario::default_string_rig();
    // Magnetic north is 8° west of the frame's.
    scenario.site.magnetic_field_enu_ut.x = -2.5;
    let folder = tempfile::tempdir().unwrap();
    let flight = Flight::new(scenario.flight_config()).unwrap();
    let (ring, frames) = rtrb::RingBuffer::new(8 * RING_BYTES);
    let log = log::spawn(
        LogConfig {
            folder: folder.path().to_owned(),
            max_bytes: log::DEFAULT_MAX_BYTES,
            agent_id: "iris-1".into(),
            boot_wall_time: BOOT,
        },
        frames,
    )
    .unwrap();
    let telemetry = Telemetry::new(identification(&scenario), &flight, None, Some(Outlet::new(ring)));
    let options = runner_options(Pace::Free, Some(15.0), Some(scenario.script.clone()));
    let ports = RunnerPorts { log: Some(log.state().clone()), ..RunnerPorts::default() };
    let vehicle = Box::new(SimVehicle::new(&scenario).unwrap());
    let summary = Runner::new(vehicle, flight, telemetry, options, ports)
        .run(&plumbline_agent::runner::stop::Stop::default())
        .unwrap();
    let error = log.state().error();
    log.stop();
    assert_eq!(error, None);
    assert!((3000..3300).contains(&summary.ticks), "{summary:?}");

    let files: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(files.len(), 1, "{files:?}");
    let told = plumbline_agent::recordings::open(&files[0]).unwrap().info().declination_rad.unwrap();
    assert_eq!((told, told.to_degrees().round()), (scenario.site.declination_rad(), -8.0));
    let bytes = std::fs::read(&files[0]).unwrap();
    let mut counts = BTreeMap::new();
    let mut sequences = Vec::new();
    let mut marks = Vec::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        *counts.entry(message.channel.topic.clone()).or_insert(0_u64) += 1;
        sequences.push(message.sequence);
        let schema = message.channel.schema.as_ref().unwrap();
        let (kind, _) = Kind::from_topic(&message.channel.topic).unwrap();
        assert_eq!((schema.name.as_str(), schema.encoding.as_str()), (kind.message_name(), "protobuf"));
        match kind {
            Kind::Flight => marks.push(v1::FlightMark::decode(&*message.data).unwrap()),
            Kind::Control => {
                let control = v1::Control::decode(&*message.data).unwrap();
                assert_eq!(message.log_time, BOOT.at(FlightTime(control.time_us)).as_nanos());
            }
            _ => {}
        }
    }
    assert!(sequences.windows(2).all(|pair| pair[1] == pair[0] + 1), "the flight has a gap");
    assert_eq!((marks.len(), marks[0].last_sequence), (2, None));
    assert_eq!(marks[1].last_sequence, sequences.last().map(|last| u64::from(*last)));
    assert_eq!(marks[0].first_sequence, u64::from(sequences[0]));
    let ticks = counts["/control"];
    assert_eq!(counts["/estimate/9"], ticks, "{counts:?}");
    assert!(ticks > 1500, "{counts:?}");
    for topic in ["/sensor/imu/1", "/sensor/imu/4", "/sensor/height/3", "/sensor/barometer/1", "/residuals/9", "/truth"]
    {
        assert!(counts.get(topic).is_some_and(|count| *count > 50), "{topic}: {counts:?}");
    }
    for topic in ["/description", "/gains", "/attacks", "/status", "/event"] {
        assert!(counts.contains_key(topic), "{topic}: {counts:?}");
    }
    // The summary of a finished file agrees with what can be read.
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, sequences.len() as u64);
}
