use std::ops::ControlFlow;
use std::path::Path;

use plumbline_proto::codec::encode_message;
use plumbline_proto::v1::BackfillRequest;
use rtrb::{Producer, RingBuffer};

use super::*;
use crate::link::backfill::Archive;

fn config(folder: &Path) -> LogConfig {
    LogConfig {
        folder: folder.to_owned(),
        max_bytes: DEFAULT_MAX_BYTES,
        agent_id: "iris-1".into(),
        boot_wall_time: WallTime(1_700_000_000_000_000),
    }
}

fn mark(ring: &mut Producer<u8>, id: &str, sequence: u64, last: Option<u64>) {
    let mark = v1::FlightMark {
        time_us: sequence * 1000,
        flight_id: id.into(),
        first_sequence: sequence,
        last_sequence: last,
        reason: "test".into(),
    };
    let mut bytes = Vec::new();
    encode_message(&mut bytes, Kind::Flight, 0, sequence, mark.time_us, &mark);
    ring.push_entire_slice(&bytes).unwrap();
}

fn heights(ring: &mut Producer<u8>, sequences: std::ops::Range<u64>) {
    for sequence in sequences {
        let sample = v1::HeightSample { time_us: sequence * 1000, sensed_m: sequence as f64, ..Default::default() };
        let mut bytes = Vec::new();
        encode_message(&mut bytes, Kind::Height, 2, sequence, sample.time_us, &sample);
        ring.push_entire_slice(&bytes).unwrap();
    }
}

fn backfill(archive: &LogArchive, id: &str, first: u64, last: u64) -> Vec<(u64, u64, u16, u16)> {
    let mut got = Vec::new();
    let request = BackfillRequest { flight_id: id.into(), first_sequence: first, last_sequence: last };
    archive
        .read(&request, &mut |frame| {
            got.push((frame.sequence, frame.time_us, frame.kind, frame.instance));
            ControlFlow::Continue(())
        })
        .unwrap();
    got
}

#[test]
fn a_flight_is_kept_whole_and_can_be_asked_for_again() {
    let folder = tempfile::tempdir().unwrap();
    let (mut ring, consumer) = RingBuffer::new(RING_BYTES);
    let log = spawn(config(folder.path()), consumer).unwrap();
    let archive = log.archive();
    // Sequences beyond 32 bits come back whole.
    let first = (7 << 32) - 100;
    heights(&mut ring, first - 10..first);
    mark(&mut ring, "f-1", first, None);
    heights(&mut ring, first + 1..first + 500);
    // Still open: what is not flushed yet is waited for.
    let got = backfill(&archive, "f-1", first + 300, first + 310);
    let expected: Vec<_> = (first + 300..=first + 310).map(|s| (s, s * 1000, Kind::Height.to_wire(), 2)).collect();
    assert_eq!(got, expected);
    mark(&mut ring, "f-1", first + 500, Some(first + 500));
    heights(&mut ring, first + 501..first + 600);
    log.stop();
    assert_eq!(backfill(&archive, "f-1", first, u64::MAX).len(), 501, "nothing from outside the flight");
    assert!(backfill(&archive, "never-flown", 1, 10).is_empty());
    // Asked for in any order: what is known of the file from before changes nothing.
    for (from, to) in [(490, 495), (0, 5), (300, 310), (200, 499), (499, 800)] {
        let expected = LogArchive::new(folder.path().to_owned(), Arc::default());
        let fresh = backfill(&expected, "f-1", first + from, first + to);
        assert_eq!(backfill(&archive, "f-1", first + from, first + to), fresh, "{from}..={to}");
    }

    let bytes = std::fs::read(folder.path().join("f-1.mcap")).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.stats.as_ref().unwrap().message_count, 501);
    assert!(summary.schemas.values().any(|schema| schema.name == "plumbline.v1.HeightSample"));
    // By the index, as viewers read.
    let mut indexed = mcap::sans_io::IndexedReader::new(&summary).unwrap();
    let mut times = Vec::new();
    while let Some(event) = indexed.next_event() {
        match event.unwrap() {
            mcap::sans_io::IndexedReadEvent::ReadChunkRequest { offset, length } => {
                let chunk = &bytes[offset as usize..][..length];
                indexed.insert_chunk_record_data(offset, chunk).unwrap();
            }
            mcap::sans_io::IndexedReadEvent::Message { header, .. } => times.push(header.log_time),
        }
    }
    assert!(times.len() == 501 && times.is_sorted());
    for index in &summary.chunk_indexes {
        let places = summary.read_message_indexes(&bytes, index).unwrap();
        assert_eq!(places.values().map(Vec::len).sum::<usize>(), summary.stream_chunk(&bytes, index).unwrap().count());
    }
    assert_eq!(summary.metadata_indexes.len(), 1);
    assert!(mcap::read::metadata(&bytes, &summary.metadata_indexes[0]).unwrap().metadata.contains_key("flight_id"));
}

#[test]
fn a_file_that_cannot_be_gone_on_with_is_ended_where_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let mark = v1::FlightMark { flight_id: "f-1".into(), first_sequence: 1, ..Default::default() };
    let mut file = LogFile::create(&config(folder.path()), &mark, 1).unwrap();
    let payload = [7; 1000];
    let frame = |sequence: u64| Frame {
        kind: Kind::Event.to_wire(),
        instance: 0,
        sequence,
        time_us: sequence,
        payload: &payload,
    };
    let syncer = Syncer::start().unwrap();
    (1..=100).for_each(|sequence| file.write(&frame(sequence)).unwrap());
    file.flush(&syncer).unwrap();
    (101..=200).for_each(|sequence| file.write(&frame(sequence)).unwrap());
    // Half a chunk, as a full disk leaves it.
    use std::io::Write as _;
    std::fs::File::options().append(true).open(file.path()).unwrap().write_all(&[6, 1, 2, 3]).unwrap();
    file.give_up();
    let bytes = std::fs::read(file.path()).unwrap();
    assert_eq!(mcap::Summary::read(&bytes).unwrap().unwrap().stats.unwrap().message_count, 200);
    assert_eq!(mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).count(), 100);
}

#[test]
fn what_was_flushed_survives_a_kill() {
    let folder = tempfile::tempdir().unwrap();
    let (mut ring, consumer) = RingBuffer::new(RING_BYTES);
    let log = spawn(config(folder.path()), consumer).unwrap();
    mark(&mut ring, "f-1", 1, None);
    heights(&mut ring, 2..1001);
    let archive = log.archive();
    assert_eq!(backfill(&archive, "f-1", 1, 1000).len(), 1000);
    // A copy of the file as it is now is what a kill would leave.
    let copy = tempfile::tempdir().unwrap();
    std::fs::copy(folder.path().join("f-1.mcap"), copy.path().join("f-1.mcap")).unwrap();
    let left = LogArchive::new(copy.path().to_owned(), Arc::default());
    assert_eq!(backfill(&left, "f-1", 1, 2000).len(), 1000);
    // Cut anywhere, it still reads up to the cut.
    let bytes = std::fs::read(copy.path().join("f-1.mcap")).unwrap();
    for cut in (0..bytes.len()).step_by(97) {
        std::fs::write(copy.path().join("f-1.mcap"), &bytes[..cut]).unwrap();
        let got = backfill(&left, "f-1", 1, 2000);
        assert!(got.len() <= 1000);
    }
}

/// Ends as a finished file does.
fn finished(length: usize) -> Vec<u8> {
    [&vec![0; length][..], mcap::MAGIC].concat()
}

#[test]
fn the_oldest_flights_make_room_and_a_full_log_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    for n in 0..3 {
        let path = folder.path().join(format!("old-{n}.mcap"));
        std::fs::write(&path, finished(400_000)).unwrap();
        let age = std::time::SystemTime::now() - Duration::from_secs(100 - n);
        std::fs::File::options().write(true).open(&path).unwrap().set_modified(age).unwrap();
    }
    let bounded = LogConfig { max_bytes: 1_000_000, ..config(folder.path()) };
    let (_ring, consumer) = RingBuffer::new(1024);
    let log = spawn(bounded.clone(), consumer).unwrap();
    let left = |n: u32| folder.path().join(format!("old-{n}.mcap")).exists();
    assert_eq!([left(0), left(1), left(2)], [false, true, true]);
    assert_eq!(log.state().error(), None);
    log.stop();
    // What the ground holds goes before what only this vehicle has, however young.
    let archive = LogArchive::new(folder.path().to_owned(), Arc::default());
    std::fs::write(folder.path().join("new.mcap"), finished(400_000)).unwrap();
    archive.kept("new");
    archive.kept("never-flown");
    assert!(!folder.path().join("never-flown.kept").exists());
    room::make_room(&bounded, None).unwrap();
    assert!(!folder.path().join("new.mcap").exists() && !folder.path().join("new.kept").exists());
    assert_eq!([left(1), left(2)], [true, true]);
    let open = folder.path().join("open.mcap");
    std::fs::write(&open, vec![0; 2_000_000]).unwrap();
    let error = room::make_room(&bounded, Some(&open)).unwrap_err().to_string();
    assert!(error.contains("no room") && open.exists(), "{error}");
}

#[test]
fn the_newest_flight_stays_whatever_the_wall_clock_was_set_to() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(format!("{name}.mcap"));
    // GIVEN a flight from before flights had numbers, and three flights of two starts, named and dated by a wall clock
    // that was set back by years before the last one
    std::fs::write(path("20260101-old"), finished(1000)).unwrap();
    let fly = |names: &[&str]| {
        let (mut ring, consumer) = RingBuffer::new(RING_BYTES);
        let log = spawn(config(folder.path()), consumer).unwrap();
        for (n, name) in (0..).zip(names) {
            mark(&mut ring, name, 1000 * n + 1, None);
            mark(&mut ring, name, 1000 * n + 2, Some(1000 * n + 2));
        }
        log.stop();
    };
    fly(&["20261121-a", "20261121-b"]);
    fly(&["19700101-c"]);
    for (name, seconds) in [("20260101-old", 1_900_000_000), ("20261121-a", 1_795_262_400), ("19700101-c", 100)] {
        let date = std::time::SystemTime::UNIX_EPOCH + Duration::from_secs(seconds);
        std::fs::File::options().write(true).open(path(name)).unwrap().set_modified(date).unwrap();
    }
    // WHEN room is needed for all but one after the other THEN the newest is the last to go
    let mut left = ["20260101-old", "20261121-a", "20261121-b", "19700101-c"].to_vec();
    while left.len() > 1 {
        let used: u64 = left.iter().map(|name| std::fs::metadata(path(name)).unwrap().len()).sum();
        let bounded = LogConfig { max_bytes: used - 1, ..config(folder.path()) };
        room::make_room(&bounded, Some(Path::new("another"))).unwrap();
        assert!(!path(left.remove(0)).exists() && left.iter().all(|name| path(name).exists()), "{left:?}");
    }
}

#[test]
fn an_unusable_folder_is_reported_and_stops_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "in the way").unwrap();
    let (mut ring, consumer) = RingBuffer::new(RING_BYTES);
    let log = spawn(config(&file.join("log")), consumer).unwrap();
    assert!(log.state().error().unwrap().contains("file"));
    mark(&mut ring, "f-1", 1, None);
    heights(&mut ring, 2..100);
    let state = log.state().clone();
    let begun = Instant::now();
    while state.messages.load(Ordering::Relaxed) == 0 && state.error().is_some() && begun.elapsed() < 2 * LOOK_PERIOD {
        std::thread::sleep(POLL_PERIOD);
    }
    assert!(state.messages.load(Ordering::Relaxed) == 0 && state.error().is_some());
    // The folder becomes usable: this flight is not logged any more, the next one may begin.
    std::fs::remove_file(&file).unwrap();
    std::thread::sleep(LOOK_PERIOD);
    assert!(state.error().is_some());
    mark(&mut ring, "f-1", 100, Some(100));
    let begun = Instant::now();
    while state.error().is_some() {
        assert!(begun.elapsed() < Duration::from_secs(10), "{:?}", state.error());
        std::thread::sleep(POLL_PERIOD);
    }
    log.stop();
}

#[test]
fn what_a_killed_agent_left_is_finished_at_the_next_start() {
    let folder = tempfile::tempdir().unwrap();
    let (mut ring, consumer) = RingBuffer::new(RING_BYTES);
    let log = spawn(config(folder.path()), consumer).unwrap();
    mark(&mut ring, "f-1", 7_000_000_000, None);
    heights(&mut ring, 7_000_000_001..7_000_001_000);
    assert_eq!(backfill(&log.archive(), "f-1", 7_000_000_000, 7_000_000_999).len(), 1000);
    // A copy is what a kill would leave; beside it a file that was not even begun, and a half-made repair.
    let killed = tempfile::tempdir().unwrap();
    std::fs::copy(folder.path().join("f-1.mcap"), killed.path().join("f-1.mcap")).unwrap();
    std::fs::write(killed.path().join("f-0.mcap"), b"\x89MC").unwrap();
    std::fs::write(killed.path().join("f-9.mcap.tmp"), b"half").unwrap();
    let left = repair::unfinished(killed.path());
    assert_eq!(left.len(), 2, "{left:?}");
    repair::finish_all(&left);
    let bytes = std::fs::read(killed.path().join("f-1.mcap")).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, 1000);
    assert!(repair::unfinished(killed.path()).is_empty());
    let archive = LogArchive::new(killed.path().to_owned(), Arc::default());
    assert_eq!(
        backfill(&archive, "f-1", 7_000_000_500, 7_000_000_600),
        backfill(&log.archive(), "f-1", 7_000_000_500, 7_000_000_600)
    );
    assert!(killed.path().join("f-0.mcap.corrupt").exists() && !killed.path().join("f-9.mcap.tmp").exists());
}
