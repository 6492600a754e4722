//! A calibration in front of the simulator, by configuration and by command.

use std::sync::Arc;
use std::time::{Duration, Instant};

use plumbline_agent::calibration::applied::Correction;
use plumbline_agent::calibration::{Calibration, CalibrationFile, Kind};
use plumbline_agent::command::Command;
use plumbline_agent::event::EventKind;
use plumbline_agent::flight::Flight;
use plumbline_agent::link::inbound::{Calibrating, Inbound, Request, parse};
use plumbline_agent::runner::pace::Pace;
use plumbline_agent::runner::stop::Stop;
use plumbline_agent::runner::{Runner, RunnerPorts};
use plumbline_agent::sensor::imu::Distortion;
use plumbline_agent::sim::{Scenario, SimVehicle};
use plumbline_agent::telemetry::{Outlet, Telemetry};
use plumbline_agent::vehicle::Vehicle as _;
use plumbline_agent::vehicle::calibrated::CalibratedVehicle;
use plumbline_proto::codec::decode_frames;
use plumbline_proto::ids::CommandId;
use plumbline_proto::v1::command::Body;
use plumbline_proto::{Kind as Topic, v1};
use plumbline_support::calibrations::{accelerometer, file};
use plumbline_support::flown::{identification, runner_options};

#[test]
fn a_distorted_simulator_reads_as_a_true_one_once_calibrated() {
    let mut scenario = Scenario::bare();
    let plain = scenario.clone();
    let imu = scenario.suite.imus.first_mut().unwrap();
    imu.distortion = Distortion {
        accel: [[1.1, 0.0, 0.0], [0.0, 0.95, 0.0], [0.0, 0.0, 1.04]],
        hard_iron_ut: [5.0, -9.0, 20.0],
        ..Distortion::default()
    };
    let field_ut = scenario.site.magnetic_field_enu_ut.norm();
    let mut calibration = Calibration::default();
    calibration.add(&accelerometer(1, [1.1, 0.95, 1.04])).unwrap();
    let hard = [("hard_x", 5.0), ("hard_y", -9.0), ("hard_z", 20.0), ("field", field_ut)];
    let soft = ["soft_xx", "soft_yy", "soft_xy", "soft_xz", "soft_yz"].map(|name| (name, 0.0));
    calibration.add(&file(Kind::Magnetometer, 1, &[&hard[..], &soft[..]].concat())).unwrap();

    let sim = |scenario: &Scenario| Box::new(SimVehicle::new(scenario).unwrap());
    let mut calibrated = CalibratedVehicle::new(sim(&scenario), calibration.clone());
    let (mut raw, mut truth) = (sim(&scenario), sim(&plain));
    // The same noise in all; a bias of 0.05 m/s² is scaled by a few per cent, and rounding is to 0.04 m/s².
    const NEAR_MPS2: f64 = 0.1;
    let mut seen = 0;
    for _ in 0..400 {
        let [calibrated, raw, truth] =
            [calibrated.sense(), raw.sense(), truth.sense()].map(|frame| frame.unwrap().imus[0]);
        let (Some(calibrated), Some(raw), Some(truth)) = (calibrated, raw, truth) else { continue };
        assert!((calibrated.accel_mps2 - truth.accel_mps2).amax() < NEAR_MPS2);
        assert!((raw.accel_mps2 - truth.accel_mps2).amax() > 0.2);
        assert_eq!(calibrated.gyro_radps, truth.gyro_radps);
        if let (Some(a), Some(b)) = (calibrated.mag_ut, truth.mag_ut) {
            // One step of the reading, and what the monitor has learnt of the unit's own half a microtesla.
            assert!((a - b).amax() < 1.5, "{a} {b}");
            seen += 1;
        }
    }
    assert!(seen > 100, "{seen}");
    assert!(calibrated.fields().all(|field| field.imu == 1 && field.fits));

    // A magnet comes near: the calibration no longer fits, and says so.
    let near = scenario.suite.imus.first_mut().unwrap();
    near.distortion.hard_iron_ut[2] += 2.0 * field_ut;
    let mut other = CalibratedVehicle::new(sim(&scenario), calibration);
    assert!(other.fields().all(|field| field.fits), "fits until seen");
    (0..400).for_each(|_| {
        other.sense().unwrap();
    });
    let fields: Vec<_> = other.fields().collect();
    assert!(fields.len() == 1 && !fields[0].fits && fields[0].withheld > 50, "{fields:?}");
}

fn use_of(file: &CalibrationFile) -> Request {
    let body = Body::UseCalibration(v1::UseCalibration { file: file.to_value().to_string() });
    parse(v1::Command { command_id: 1, operator: "t".into(), seen_us: None, body: Some(body) }).request
}

/// What a runner answers to `requests`, each given before its first tick, and what it says then.
fn answered(requests: &[Request], kept: Option<&std::path::Path>) -> (Vec<v1::Ack>, v1::Description, Vec<v1::Event>) {
    let mut scenario = Scenario::bare();
    scenario.suite.imus.first_mut().unwrap().distortion.accel[2][2] = 1.04;
    let flight = Flight::new(scenario.flight_config()).unwrap();
    let (ring, mut link) = rtrb::RingBuffer::new(16 << 20);
    let telemetry = Telemetry::new(identification(&scenario), &flight, Some(Outlet::new(ring)), None);
    let mut options = runner_options(Pace::Free, Some(1.0), None);
    options.calibrations = kept.map(Into::into);
    let (mut commands, inbound) = rtrb::RingBuffer::new(16);
    for (id, request) in (1..).zip(requests) {
        commands.push(Inbound { id: CommandId(id), request: request.clone() }).unwrap();
    }
    let ports = RunnerPorts { inbound: Some(inbound), ..RunnerPorts::default() };
    let vehicle = Box::new(SimVehicle::new(&scenario).unwrap());
    Runner::new(vehicle, flight, telemetry, options, ports).run(&Stop::default()).unwrap();
    let chunk = link.read_chunk(link.slots()).unwrap();
    let bytes = [chunk.as_slices().0, chunk.as_slices().1].concat();
    let frames: Vec<_> = decode_frames(&bytes).map(Result::unwrap).collect();
    let of = |kind: Topic| frames.iter().filter(move |frame| frame.known_kind() == Some(kind));
    let acks = of(Topic::Ack).map(|frame| frame.message().unwrap()).collect();
    let events = of(Topic::Event).map(|frame| frame.message().unwrap()).collect();
    (acks, of(Topic::Description).next_back().unwrap().message().unwrap(), events)
}

#[test]
fn a_command_puts_a_calibration_to_use_and_stops_that() {
    let folder = tempfile::tempdir().unwrap();
    let drop = |kind, imu| Request::Calibration(Calibrating::Drop { kind, imu });
    let requests = [
        (use_of(&accelerometer(1, [1.0, 1.0, 1.04])), Ok("IMU 1: accelerometer calibration is in use")),
        (use_of(&accelerometer(1, [1.0, 1.0, 1.05])), Err("of 2026-11-26T11:00:00Z is in use: stop using that first")),
        (use_of(&accelerometer(2, [1.0, 1.0, 1.01])), Ok("IMU 2: accelerometer calibration is in use")),
        (drop(Kind::Accelerometer, 2), Ok("IMU 2: accelerometer calibration is no longer used")),
        (drop(Kind::Gyroscope, 1), Err("IMU 1: no gyroscope calibration is in use")),
        // What no sensor needs, what corrects nothing, and what is no file.
        (use_of(&accelerometer(3, [1.0, 1.0, 3.0])), Err("scale or axis off by is 0.6")),
        (use_of(&file(Kind::Mass, 1, &[])), Err("mass: corrects no samples")),
        (use_of(&accelerometer(9, [1.0, 1.0, 1.0])), Err("sensor 9 is not 1 to")),
    ];
    let asked: Vec<Request> = requests.iter().map(|(request, _)| request.clone()).collect();
    let (acks, description, events) = answered(&asked, Some(folder.path()));
    assert_eq!(acks.len(), requests.len());
    for (ack, (_, expected)) in acks.iter().zip(&requests) {
        let (Ok(said) | Err(said)) = expected;
        assert_eq!(ack.stage() == v1::AckStage::Accepted, expected.is_ok(), "{ack:?}");
        assert!(ack.reason.contains(said), "{ack:?}: {said}");
    }
    let used: Vec<_> =
        description.calibrations.iter().map(|used| (used.kind.as_str(), used.imu, used.configured)).collect();
    assert_eq!(used, [("accelerometer", 1, false)]);
    let told = events.iter().filter(|event| event.kind == EventKind::Estimator.as_str()).count();
    assert!(told >= 3, "{events:?}");
    // What is kept is what is in use, and the next start takes it.
    let names: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names, ["accelerometer-1.json"]);
    let mut next = Calibration::default();
    plumbline_agent::runner::keeper::load(folder.path(), &mut next).unwrap();
    assert_eq!(next.used().len(), 1);

    // Without a folder it lasts as long as the agent.
    let (acks, ..) = answered(&asked[..1], None);
    assert!(acks[0].reason.ends_with("until the agent stops"), "{}", acks[0].reason);
}

#[test]
fn armed_nothing_changes_under_the_estimators() {
    let scenario = Scenario::default_string_rig();
    let flight = Flight::new(scenario.flight_config()).unwrap();
    let (ring, mut link) = rtrb::RingBuffer::new(64 << 20);
    let telemetry = Telemetry::new(identification(&scenario), &flight, Some(Outlet::new(ring)), None);
    let (mut commands, inbound) = rtrb::RingBuffer::new(16);
    let ports = RunnerPorts { inbound: Some(inbound), ..RunnerPorts::default() };
    let stop = Arc::new(Stop::default());
    let stopped = stop.clone();
    let flying = std::thread::spawn(move || {
        let vehicle = Box::new(SimVehicle::new(&scenario).unwrap());
        let options = runner_options(Pace::Times(1.0), None, None);
        Runner::new(vehicle, flight, telemetry, options, ports).run(&stopped).unwrap();
    });
    const USE: u64 = 1_000_000;
    let (begun, mut next, mut armed) = (Instant::now(), 1, false);
    let answer = 'answered: loop {
        assert!(begun.elapsed() < Duration::from_secs(60), "no answer, armed {armed}");
        std::thread::sleep(Duration::from_millis(20));
        // Until its checks pass.
        if !armed {
            let _ = commands.push(Inbound { id: CommandId(next), request: Request::Flight(Command::Arm) });
            next += 1;
        }
        let chunk = link.read_chunk(link.slots()).unwrap();
        let bytes = [chunk.as_slices().0, chunk.as_slices().1].concat();
        chunk.commit_all();
        let acks = decode_frames(&bytes).map(Result::unwrap).filter(|frame| frame.known_kind() == Some(Topic::Ack));
        for ack in acks.map(|frame| frame.message::<v1::Ack>().unwrap()) {
            if ack.command_id == USE {
                break 'answered ack;
            }
            if ack.stage() == v1::AckStage::Accepted && !armed {
                armed = true;
                let request = use_of(&accelerometer(1, [1.0, 1.0, 1.04]));
                commands.push(Inbound { id: CommandId(USE), request }).unwrap();
            }
        }
    };
    stop.ask();
    stop.ask();
    flying.join().unwrap();
    assert!(answer.stage() == v1::AckStage::Rejected && answer.reason.starts_with("armed"), "{answer:?}");
}

#[test]
fn samples_are_corrected_from_the_next_frame_on() {
    let mut scenario = Scenario::bare();
    let plain = scenario.clone();
    scenario.suite.imus.first_mut().unwrap().distortion.accel[2][2] = 1.04;
    let sim = |scenario: &Scenario| Box::new(SimVehicle::new(scenario).unwrap());
    let mut vehicle = CalibratedVehicle::from(sim(&scenario));
    let mut truth = sim(&plain);
    let mut apart = |vehicle: &mut CalibratedVehicle| {
        let pair = || {
            let (a, b) = (vehicle.sense().unwrap(), truth.sense().unwrap());
            a.imus[0].zip(b.imus[0])
        };
        let off: Vec<f64> = std::iter::repeat_with(pair)
            .take(50)
            .flatten()
            .map(|(a, b)| (a.accel_mps2 - b.accel_mps2).amax())
            .collect();
        off.iter().copied().fold(0.0, f64::max)
    };
    assert!(apart(&mut vehicle) > 0.3);
    vehicle.put(&Correction::of(&accelerometer(1, [1.0, 1.0, 1.04])).unwrap()).unwrap();
    assert!(apart(&mut vehicle) < 0.1);
    vehicle.take(Kind::Accelerometer, 1).unwrap();
    assert!(apart(&mut vehicle) > 0.3);
    // What the configuration says is taken out there.
    let mut configured = Calibration::default();
    configured.add(&accelerometer(1, [1.0, 1.0, 1.04])).unwrap();
    let refused = configured.take(Kind::Accelerometer, 1).unwrap_err().to_string();
    assert!(refused.contains("configuration"), "{refused}");
}
