//! Decoders of bytes: valid input made by the product's own encoders, damaged.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;

use plumbline_agent::calibration::{CalibrationFile, Kind as Calibrated};
use plumbline_agent::design::file::{proposal, read};
use plumbline_agent::link::backfill::Archive as _;
use plumbline_agent::link::inbound;
use plumbline_agent::log::{self, LogArchive};
use plumbline_agent::model::airframe::Airframe;
use plumbline_agent::offline::calibrate::{Request, from_table, load};
use plumbline_agent::recordings;
use plumbline_agent::recordings::replay::{ReplayVehicle, Samples};
use plumbline_agent::sim::Scenario;
use plumbline_agent::vehicle::Vehicle;
use plumbline_ground::attack_plan::to_schedule;
use plumbline_proto::codec::{self, Delimited};
use plumbline_proto::{Kind, Message as _, v1};

use super::engine::{Scratch, fuzz};

fn batch() -> Vec<u8> {
    let mut out = Vec::new();
    codec::begin_batch(&mut out);
    let status =
        v1::Status { time_us: 5, flight_id: "f-1".into(), failsafe_reason: "none".into(), ..Default::default() };
    codec::encode_message(&mut out, Kind::Status, 0, 1, 5, &status);
    let control = v1::Control { time_us: 6, ..Default::default() };
    codec::encode_message(&mut out, Kind::Control, 0, 2, 6, &control);
    let mark = v1::FlightMark { time_us: 7, flight_id: "f-1".into(), first_sequence: 1, ..Default::default() };
    codec::encode_message(&mut out, Kind::Flight, 0, 3, 7, &mark);
    out
}

#[test]
fn fuzz_wire_codec() {
    fuzz("wire_codec", &[batch()], |input| {
        for frames in codec::decode_batch(input).into_iter().chain([codec::decode_frames(input)]) {
            for frame in frames.map_while(Result::ok) {
                let _ = frame.message::<v1::Status>();
                let _ = frame.message::<v1::Control>();
                let mut again = Vec::new();
                frame.encode(&mut again);
                assert_eq!(again.len(), frame.encoded_len());
            }
        }
        // What the ground parses at once is what comes frame by frame.
        let frames = codec::decode_batch(input).and_then(Iterator::collect::<Result<Vec<_>, _>>);
        match (codec::Batch::parse(input.to_vec().into()), frames) {
            (Ok(batch), Ok(frames)) => assert!(batch.frames().eq(frames)),
            (batch, frames) => assert_eq!(batch.err(), frames.err()),
        }
    });
}

#[test]
fn fuzz_command_stream() {
    let bodies = [
        v1::command_frame::Body::Heartbeat(v1::Heartbeat { ground_time_us: 7, agent_time_us: Some(8) }),
        v1::command_frame::Body::Frames(batch()),
        v1::command_frame::Body::Command(v1::Command {
            command_id: 3,
            operator: "ann".into(),
            seen_us: Some(5_000_000),
            body: Some(v1::command::Body::Setpoint(v1::Setpoint { altitude_m: Some(0.5), ..Default::default() })),
        }),
    ];
    let mut seed = Vec::new();
    for body in bodies {
        codec::encode_delimited(&mut seed, &v1::CommandFrame { body: Some(body) });
    }
    fuzz("command_stream", &[seed], |input| {
        let mut stream = Delimited::default();
        for piece in input.chunks(37) {
            stream.push(piece);
            while let Ok(Some(frame)) = stream.next_frame() {
                if let Some(v1::command_frame::Body::Command(command)) = frame.body {
                    inbound::parse(command);
                }
            }
        }
    });
}

#[test]
fn fuzz_commands() {
    let attack =
        v1::Attack { id: 1, sensor: 2, instance: 2, kind: 2, start_s: 1.0, duration_s: 2.0, ..Default::default() };
    let weights = v1::LqrWeights { state_weight: vec![1.0; 16], input_weight: vec![1.0; 4] };
    let bodies = [
        v1::command::Body::AttackSchedule(v1::AttackSchedule {
            schedule_id: 1,
            attacks: vec![attack; 3],
            ..Default::default()
        }),
        v1::command::Body::PushGains(v1::PushGains { revision: 2, weights: Some(weights), ..Default::default() }),
        v1::command::Body::SetMode(v1::SetMode { mode: 3 }),
        v1::command::Body::SetReplay(v1::SetReplay { speed: 1.0, step: 0 }),
    ];
    let seeds: Vec<_> = bodies
        .into_iter()
        .map(|body| {
            v1::Command { command_id: 1, operator: "t".into(), seen_us: Some(7), body: Some(body) }.encode_to_vec()
        })
        .collect();
    fuzz("commands", &seeds, |input| {
        if let Ok(command) = v1::Command::decode(input) {
            inbound::parse(command);
        }
    });
}

/// A small flight file: finished, and as a crash leaves it.
fn flight_files() -> Vec<Vec<u8>> {
    let mut out = std::io::Cursor::new(Vec::new());
    {
        let mut writer = mcap::WriteOptions::new().chunk_size(Some(512)).create(&mut out).unwrap();
        let metadata = BTreeMap::from([
            ("flight_id".to_owned(), "f-1".to_owned()),
            ("agent_id".to_owned(), "iris-1".to_owned()),
            ("first_sequence".to_owned(), "1".to_owned()),
            ("boot_wall_time_us".to_owned(), "1000".to_owned()),
        ]);
        writer.write_metadata(&mcap::records::Metadata { name: "plumbline".into(), metadata }).unwrap();
        let schema = writer.add_schema("plumbline.v1.HeightSample", "protobuf", b"descriptor").unwrap();
        let channel = writer.add_channel(schema, "/sensor/height/1", "protobuf", &BTreeMap::new()).unwrap();
        for sequence in 1..60_u32 {
            let sample = v1::HeightSample { time_us: u64::from(sequence), sensed_m: 0.5, ..Default::default() };
            let header = mcap::records::MessageHeader {
                channel_id: channel,
                sequence,
                log_time: u64::from(sequence) * 1_000_000,
                publish_time: 0,
            };
            writer.write_to_known_channel(&header, &sample.encode_to_vec()).unwrap();
        }
        writer.flush().unwrap();
        writer.finish().unwrap();
    }
    let finished = out.into_inner();
    let unfinished = finished[..finished.len() / 2].to_vec();
    vec![finished, unfinished]
}

#[test]
fn fuzz_flight_file_repair() {
    let scratch = Scratch::new();
    fuzz("flight_file_repair", &flight_files(), |input| {
        let path = scratch.with("f-1.001.part", input);
        let _ = plumbline_ground::recorder::inspect(&path);
    });
}

#[test]
fn fuzz_onboard_log() {
    let scratch = Scratch::new();
    let whole = v1::BackfillRequest { flight_id: "f-1".into(), first_sequence: 0, last_sequence: u64::MAX };
    fuzz("onboard_log", &flight_files(), |input| {
        let path = scratch.with("f-1.mcap", input);
        let archive = LogArchive::at(path.parent().unwrap());
        let mut told = 0;
        let mut count = |_: &codec::Frame<'_>| {
            told += 1;
            ControlFlow::Continue(())
        };
        let _ = archive.read(&whole, &mut count);
        log::finish_all(&log::unfinished(path.parent().unwrap()));
        for left in std::fs::read_dir(path.parent().unwrap()).unwrap() {
            std::fs::remove_file(left.unwrap().path()).unwrap();
        }
        assert!(told < 1 << 20, "{told} messages in {} bytes", input.len());
    });
}

/// Opens and replays at most so many ticks.
fn replay(path: &Path) {
    if let Ok(recording) = recordings::open(path) {
        let mut vehicle = ReplayVehicle::new(recording, Samples::Received);
        for _ in 0..500 {
            if vehicle.sense().is_err() {
                break;
            }
        }
    }
}

#[test]
fn fuzz_flight_file_replay() {
    let scratch = Scratch::new();
    fuzz("flight_file_replay", &flight_files(), |input| replay(&scratch.with("f.mcap", input)));
}

fn table(header: &str, row: impl Fn(usize, usize) -> f64) -> Vec<u8> {
    let columns = header.split(',').count();
    let mut text = format!("{header}\n");
    for line in 0..40 {
        let cells: Vec<_> = (0..columns).map(|column| row(line, column).to_string()).collect();
        text += &(cells.join(",") + "\n");
    }
    text.into_bytes()
}

#[test]
fn fuzz_recordings_of_others() {
    let broad = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2,mx_uT,my_uT,mz_uT,ref_qw,ref_qx,ref_qy,ref_qz,\
                 ref_px_m,ref_py_m,ref_pz_m,movement";
    let rotorpy = "t_s,ax,ay,az,gx,gy,gz,mocap_x,mocap_y,mocap_z,mocap_qx,mocap_qy,mocap_qz,mocap_qw,true_x,true_y,\
                   true_z,true_vx,true_vy,true_vz,true_qx,true_qy,true_qz,true_qw,true_wx,true_wy,true_wz,\
                   rotor1_rad_s,rotor2_rad_s,rotor3_rad_s,rotor4_rad_s";
    let cell = |line: usize, column: usize| if column == 0 { line as f64 * 0.005 } else { 0.5 + column as f64 * 0.1 };
    let seeds = [table(broad, cell), table(rotorpy, cell), ulog()];
    let scratch = Scratch::new();
    fuzz("recordings", &seeds, |input| replay(&scratch.with("recording", input)));
}

#[test]
fn fuzz_mocap_log() {
    let header = "t,T,tx,ty,tz,x,y,z,vx,vy,vz,phi,theta,psi,p,q,r,r1,r2,r3,r4,m_phi,m_theta,m_psi";
    let cell = |line: usize, column: usize| if column == 0 { line as f64 * 0.01 } else { 0.1 * column as f64 };
    let scratch = Scratch::new();
    fuzz("mocap_log", &[table(header, cell)], |input| {
        let _ = recordings::mocap_log::read(&scratch.with("log.csv", input));
    });
}

/// A ULog with one topic that is a sensor.
fn ulog() -> Vec<u8> {
    fn message(out: &mut Vec<u8>, kind: u8, body: &[u8]) {
        out.extend_from_slice(&(body.len() as u16).to_le_bytes());
        out.push(kind);
        out.extend_from_slice(body);
    }
    let mut out = b"ULog\x01\x12\x35\x01".to_vec();
    out.extend_from_slice(&1_000_u64.to_le_bytes());
    message(&mut out, b'B', &[0; 40]);
    message(&mut out, b'F', b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;");
    message(&mut out, b'A', b"\0\x01\0sensor_combined");
    for tick in 0..60_u64 {
        let mut body = vec![1, 0];
        body.extend_from_slice(&(1_000 + 4_000 * tick).to_le_bytes());
        for value in [0.01_f32, 0.02, 0.03, 0.1, 0.2, -9.8] {
            body.extend_from_slice(&value.to_le_bytes());
        }
        message(&mut out, b'D', &body);
    }
    out
}

#[test]
fn fuzz_plans() {
    let attack = |kind: &str| {
        serde_json::json!({ "sensor": "height", "instance": 2, "channel": "all", "kind": kind, "start_s": 1.0,
            "duration_s": 5.0, "magnitude": 0.3, "seed": 1 })
    };
    let plan = serde_json::json!({ "attacks": [attack("bias"), attack("replay")] }).to_string().into_bytes();
    assert!(to_schedule(&serde_json::from_slice(&plan).unwrap(), 1, None).is_ok());
    fuzz("plans", &[plan], |input| {
        if let Ok(plan) = serde_json::from_slice(input)
            && let Ok(schedule) = to_schedule(&plan, 1, None)
        {
            let finite = schedule.attacks.iter().all(|a| a.start_s.is_finite() && a.magnitude.is_finite());
            assert!(finite, "a plan that is no number passed: {schedule:?}");
        }
    });
}

#[test]
fn fuzz_gains() {
    let gains =
        serde_json::json!({ "state_weight": vec![1.0; 16], "input_weight": vec![0.5; 4] }).to_string().into_bytes();
    assert!(read(&gains).is_ok());
    fuzz("gains", &[gains], |input| drop(read(input).and_then(|design| proposal(&design))));
}

#[test]
fn fuzz_calibration_tables() {
    let spin = |line: usize, column: usize| match column {
        0 => line as f64 * 0.01,
        1..=3 => 0.1 * (line * column) as f64,
        column => ((line + column) as f64).sin() * 9.8,
    };
    let rising = |line: usize, column: usize| (line + 1) as f64 * [0.02, 11.0, 0.3][column.min(2)];
    let seeds = [
        table("t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2,mx_ut,my_ut,mz_ut,temperature_c", spin),
        table("command,speed_radps", rising),
        table("speed_radps,thrust_n,torque_nm", rising),
        b"axis,mass_kg,period_s,length_m,separation_m\nx,1.5,1.2,1.0,0.3\ny,1.5,1.3,1.0,0.3\nz,1.5,1.6,1.0,0.3\n"
            .to_vec(),
    ];
    fuzz("calibration_tables", &seeds, |input| {
        for (_, kind) in Calibrated::ALL {
            if let Ok(file) = from_table(input, "table", &Request::new(kind, "2026-01-01")) {
                let _ = CalibrationFile::from_json(&file.to_value().to_string());
            }
        }
    });
}

#[test]
fn fuzz_calibration_files() {
    let curve = table("command,speed_radps", |line, column| (line + 1) as f64 * [0.02, 11.0][column]);
    let file = from_table(curve.as_slice(), "curve", &Request::new(Calibrated::MotorCurve, "2026-01-01")).unwrap();
    let scratch = Scratch::new();
    fuzz("calibration_files", &[file.to_value().to_string().into_bytes()], |input| {
        if let Ok(calibration) = load(&[scratch.with("calibration.json", input)]) {
            calibration.apply_to_airframe(&mut Airframe::by_name("iris").unwrap());
        }
    });
}

#[test]
fn fuzz_scenarios_and_configurations() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios");
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_file());
    let mut seeds: Vec<Vec<u8>> = files.map(|path| std::fs::read(path).unwrap()).collect();
    seeds.push(b"id = \"iris-1\"\nground = \"127.0.0.1:4748\"\n[log]\nmax_mib = 100\n".to_vec());
    let scratch = Scratch::new();
    fuzz("scenarios", &seeds, |input| {
        let text = String::from_utf8_lossy(input);
        let _ = Scenario::from_toml(&text);
        let _ = plumbline_agent::config::AgentConfig::read(&scratch.with("agent.toml", input));
    });
}
