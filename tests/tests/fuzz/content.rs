//! Files that are well formed, with right checksums, and whose content is odd.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use arbitrary::{Result, Unstructured};
use plumbline_agent::offline::{EstimateArgs, run_flight};
use plumbline_agent::recordings;
use plumbline_agent::recordings::replay::{ReplayVehicle, Samples};
use plumbline_agent::vehicle::Vehicle as _;
use plumbline_ground::GroundConfig;
use plumbline_ground::people::{Accounts, People, Role, Token};
use plumbline_ground::recorder::{self, Export, Format, Selection};
use plumbline_link::identity;
use plumbline_proto::Kind;
use plumbline_proto::descriptor::FILE_DESCRIPTOR_SET;
use serde_json::json;

use super::engine::{Scratch, drawn};
use super::odd;

/// A flight file by the library's own writer: every checksum is right.
fn flight_file(u: &mut Unstructured<'_>) -> Result<Vec<u8>> {
    let mut out = Cursor::new(Vec::new());
    let mut writer = mcap::WriteOptions::new().chunk_size(Some(2048)).create(&mut out).unwrap();
    let mut metadata = BTreeMap::new();
    for key in ["flight_id", "agent_id", "first_sequence", "boot_id", "boot_wall_time_us"] {
        if !u.ratio(1, 10)? {
            let plain = if key.ends_with("id") { odd::text(u)? } else { odd::count(u)?.to_string() };
            metadata.insert(key.to_owned(), plain);
        }
    }
    writer.write_metadata(&mcap::records::Metadata { name: "plumbline".into(), metadata }).unwrap();
    let mut channels = BTreeMap::new();
    let mut sequence = 0_u32;
    // The tick first: what reads a flight goes by it.
    let kinds = [Kind::Control, Kind::Imu, Kind::Height, Kind::Estimate, Kind::Flight, Kind::Description];
    for _ in 0..u.int_in_range(1..=60)? {
        let kind = if u.ratio(3, 4)? { *u.choose(&kinds)? } else { *u.choose(Kind::ALL)? };
        let topic = match u.int_in_range(0..=20)? {
            0 => odd::text(u)?,
            1 => format!("{}/{}", kind.base_topic(), odd::text(u)?),
            _ => kind.topic(u.int_in_range(0..=3)?),
        };
        let of = if u.ratio(1, 20)? { u.choose(Kind::ALL)?.message_name() } else { kind.message_name() };
        let described = if u.ratio(1, 20)? { b"no description".as_slice() } else { FILE_DESCRIPTOR_SET };
        let channel = *channels.entry((topic.clone(), of)).or_insert_with(|| {
            let schema = writer.add_schema(of, "protobuf", described).unwrap();
            writer.add_channel(schema, &topic, "protobuf", &BTreeMap::new()).unwrap()
        });
        sequence = if u.ratio(1, 12)? { odd::count(u)? as u32 } else { sequence.wrapping_add(1) };
        let log_time = if u.ratio(1, 12)? { odd::count(u)? } else { u64::from(sequence).wrapping_mul(5_000_000) };
        let header = mcap::records::MessageHeader { channel_id: channel, sequence, log_time, publish_time: 0 };
        writer.write_to_known_channel(&header, &odd::message(u, kind.message_name())?).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    Ok(out.into_inner())
}

/// Everything that reads a flight's bytes on its own.
fn read(bytes: &[u8], path: &Path) {
    for estimator in ["ekf-bias", "secure", "vqf", "complementary"] {
        let mut left = 2000_u32;
        let each = |_: &_| {
            left = left.saturating_sub(1);
            if left == 0 { Err(plumbline_agent::offline::OfflineError::GivenUp) } else { Ok(()) }
        };
        let args = EstimateArgs::new(Path::new("f-1"), estimator, Path::new(""));
        let _ = run_flight(bytes, &args, each);
    }
    if let Ok(recording) = recordings::open(path) {
        let mut vehicle = ReplayVehicle::new(recording, Samples::Received);
        (0..500).take_while(|_| vehicle.sense().is_ok()).for_each(drop);
    }
}

#[test]
fn fuzz_flight_content() {
    let scratch = Scratch::new();
    drawn("flight_content", |u| {
        let Ok(bytes) = flight_file(u) else { return };
        let folder = tempfile::tempdir_in(scratch.folder.path()).unwrap();
        let flights = folder.path().join("flights");
        std::fs::create_dir(&flights).unwrap();
        std::fs::write(flights.join("f-1.mcap"), &bytes).unwrap();
        read(&bytes, &flights.join("f-1.mcap"));
        let _ = recorder::inspect(&flights.join("f-1.mcap"));
        // The ground finds it, learns it and exports it.
        let mut config = GroundConfig::new(folder.path());
        config.reserve_bytes = 0;
        let recorder = recorder::start(&config, None).unwrap();
        let handle = recorder.handle();
        while !handle.ready() {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        for flight in handle.flights().unwrap() {
            let wide = |format| Export::wide(handle.open(&flight.id).unwrap(), Selection::default(), format);
            let mut exports: Vec<_> = Format::ALL.into_iter().map(wide).collect();
            exports.extend([(None, None), (Some("control,imu"), None), (None, Some(100))].map(|(kinds, columns)| {
                Export::frames(handle.open(&flight.id).unwrap(), kinds, (0.0, f64::INFINITY), columns)
            }));
            for kind in Kind::ALL {
                exports.push(Export::topic(handle.open(&flight.id).unwrap(), &kind.topic(1)));
            }
            for export in exports.into_iter().flatten() {
                let mut length = 0;
                let mut sink = |piece: Vec<u8>| {
                    length += piece.len();
                    assert!(length < 64 << 20, "{length} bytes from {}", bytes.len());
                    true
                };
                let _ = export.write(&mut sink);
            }
        }
        recorder.finish();
    });
}

#[test]
fn fuzz_people_files() {
    let scratch = Scratch::new();
    // What the product writes, once.
    let made = tempfile::tempdir_in(scratch.folder.path()).unwrap();
    Accounts::of(made.path()).add("ann", Role::Admin, "a long enough password").unwrap();
    let accounts = std::fs::read(made.path().join("people/accounts.json")).unwrap();
    let accounts: serde_json::Value = serde_json::from_slice(&accounts).unwrap();
    let sessions = json!([{ "account": "ann", "stamp": "x", "begun_s": 1, "seen_s": 2, "from": "127.0.0.1" }]);
    let sessions = json!({ "ab": sessions[0], "sessions": sessions });
    drawn("people_files", |u| {
        let folder = tempfile::tempdir_in(scratch.folder.path()).unwrap();
        let people = folder.path().join("people");
        std::fs::create_dir(&people).unwrap();
        let Ok(odd_accounts) = odd::json(u, &accounts) else { return };
        let Ok(odd_sessions) = odd::json(u, &sessions) else { return };
        std::fs::write(people.join("accounts.json"), odd_accounts.to_string()).unwrap();
        std::fs::write(people.join("sessions.json"), odd_sessions.to_string()).unwrap();
        let everyone = People::open(folder.path(), ([127, 0, 0, 1], 1).into());
        let _ = (everyone.sign_in_needed(), everyone.sessions(None), everyone.may_command("ann"));
        let stranger = everyone.person(Token::from_cookie("plumbline=ab").as_ref());
        assert!(stranger.is_none() || !everyone.sign_in_needed(), "a session from nowhere");
        let names = || everyone.accounts().all().map(|all| all.iter().map(|one| one.name.clone()).collect::<Vec<_>>());
        let known = names();
        let removed = everyone.accounts().remove("ann");
        match known {
            // What cannot be read is not written over.
            Err(_) => assert!(removed.is_err(), "an account was removed from what cannot be read"),
            Ok(mut known) => {
                known.retain(|name| removed.is_err() || name != "ann");
                assert_eq!(names().unwrap(), known, "{removed:?}");
            }
        }
    });
}

#[test]
fn fuzz_peer_files() {
    let scratch = Scratch::new();
    let (ours, theirs) = (scratch.folder.path().join("a"), scratch.folder.path().join("b"));
    let (mine, other) = (identity::load_or_create(&ours).unwrap(), identity::load_or_create(&theirs).unwrap());
    identity::pair(&mine, "iris-1", &other).unwrap();
    let peers = std::fs::read_dir(&theirs).unwrap().map(|entry| entry.unwrap().path());
    let peers = peers.filter(|path| std::fs::read_to_string(path).is_ok_and(|text| text.contains("iris-1")));
    let peers = peers.collect::<Vec<_>>().pop().unwrap();
    let valid = std::fs::read(&peers).unwrap();
    super::engine::fuzz("peer_files", &[valid], |input| {
        std::fs::write(&peers, input).unwrap();
        // Peers that are no text are refused at the start, by name.
        let Ok(other) = identity::load_or_create(&theirs) else { return };
        let known = other.peer(mine.fingerprint());
        assert!(other.peer(other.fingerprint()).is_none(), "whoever is not in the file is trusted");
        let before = other.trouble();
        match other.enrol(mine.fingerprint(), "iris-1") {
            Ok(()) => assert_eq!(other.peer(mine.fingerprint()).as_deref(), Some("iris-1"), "{before:?}"),
            // What cannot be read is not written over; a name that is another's is not given twice.
            Err(_) => assert_eq!(std::fs::read(&peers).unwrap(), input, "{known:?}"),
        }
        let _ = other.revoke("iris-1");
    });
}
