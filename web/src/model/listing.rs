//! The list of flights: heads of its columns, times, and a small picture of each.

use plumbline_proto::time::WallTime;
use plumbline_rest::flight::{Column, Flight};

/// Forms of a flight to download: the route below it, and its name.
pub const FORMS: [(&str, &str); 6] = [
    (OWN, "MCAP"),
    ("csv", "CSV"),
    ("parquet", "Parquet"),
    ("mat", "MATLAB"),
    ("ros2", "ROS 2 bag"),
    ("foxglove", "Foxglove"),
];
/// The form that a flight is recorded in: it is downloaded whole.
const OWN: &str = "mcap";

/// What are tables: they have columns, and rows at a rate.
const TABLES: [&str; 3] = ["csv", "parquet", "mat"];

/// What of a flight is downloaded: all of it where nothing is said.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Part {
    /// Since the flight's start, s.
    pub stretch_s: Option<[f64; 2]>,
    /// Of a table: by name, or by the beginning of it.
    pub columns: Vec<String>,
    /// Of a table: most rows a second, 0 for all.
    pub rate_hz: Option<u32>,
}

impl Part {
    /// In words; empty where it is all.
    pub fn name(&self) -> String {
        let stretch = self.stretch_s.map(|[from_s, to_s]| format!("{from_s:.1} to {to_s:.1} s"));
        let columns = match self.columns.as_slice() {
            [] => None,
            [one] => Some(one.clone()),
            several => Some(format!("{} columns", several.len())),
        };
        let rate = self.rate_hz.map(|hz| if hz == 0 { "every tick".to_owned() } else { format!("{hz} Hz") });
        [stretch, columns, rate].into_iter().flatten().collect::<Vec<_>>().join(", ")
    }
}

/// Where a flight is downloaded, or what is meant of it, as far as the form has it.
pub fn download(id: &str, form: &str, part: &Part) -> String {
    let mut asked = Vec::new();
    if let Some([from_s, to_s]) = part.stretch_s.filter(|_| form != OWN) {
        asked.push(format!("from_s={from_s:.3}&to_s={to_s:.3}"));
    }
    if TABLES.contains(&form) {
        asked.extend((!part.columns.is_empty()).then(|| format!("columns={}", part.columns.join(","))));
        asked.extend(part.rate_hz.map(|hz| format!("rate_hz={hz}")));
    }
    let question = if asked.is_empty() { "" } else { "?" };
    format!("/api/v1/flights/{id}/{form}{question}{}", asked.join("&"))
}

/// Where flights are downloaded: one as it is, several as one tar.
pub fn download_all(ids: &[String], form: &str) -> Option<String> {
    match ids {
        [] => None,
        [id] => Some(download(id, form, &Part::default())),
        several => Some(format!("/api/v1/archive?ids={}&format={form}", several.join(","))),
    }
}

/// Head of a column.
pub const fn head(column: Column) -> &'static str {
    match column {
        Column::Started => "when",
        Column::Tracking => "error RMS",
        Column::Completeness => "state",
        other => other.query(),
    }
}

/// Is a column aligned to the right?
pub const fn is_number(column: Column) -> bool {
    matches!(column, Column::Duration | Column::Steps | Column::Attacks | Column::Tracking | Column::Size)
}

/// `2026-11-21 13:45` of a Unix time in µs, `offset_min` minutes behind UTC.
pub fn when(unix_us: u64, offset_min: i64) -> String {
    if unix_us == 0 {
        return super::format::NONE.to_owned();
    }
    let local = WallTime(unix_us.saturating_add_signed(-offset_min * 60_000_000));
    let ((year, month, day), (hour, minute, _)) = local.utc();
    format!("{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}")
}

/// Most tags that a list shows of a flight.
const TAGS: usize = 4;

/// Words of notes that begin with `#`: what flights are found by together.
pub fn tags(notes: &str) -> Vec<String> {
    let mut tags: Vec<String> = Vec::new();
    for word in notes.split_whitespace().filter(|word| word.starts_with('#')) {
        let named: String = word.chars().skip(1).take_while(|c| c.is_alphanumeric() || "-_".contains(*c)).collect();
        let tag = format!("#{}", named.to_lowercase());
        if !named.is_empty() && !tags.contains(&tag) && tags.len() < TAGS {
            tags.push(tag);
        }
    }
    tags
}

/// Least height of a thumbnail, m: noise on the ground is no flight.
const THUMBNAIL_SPAN_M: f64 = 0.5;

/// A small picture of the altitude of a flight.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Thumbnail {
    /// From the least to the greatest altitude of each stretch of time, as a path.
    pub path: String,
    /// What lies below that.
    pub below: String,
    /// From where to where it was attacked.
    pub attacks: Vec<[f64; 2]>,
    /// Least and greatest altitude, m.
    pub range_m: [f64; 2],
}

/// The picture of a flight in a box as wide and high; `None` where its altitude is not known.
pub fn thumbnail(flight: &Flight, [width, height]: [f64; 2]) -> Option<Thumbnail> {
    use std::fmt::Write;
    let outline = flight.outline.as_ref()?;
    let m = |cm: i32| f64::from(cm) / 100.0;
    let known = outline.altitude_cm.iter().flatten();
    let none = (f64::INFINITY, f64::NEG_INFINITY);
    let (low, high) = known.fold(none, |(low, high), range| (low.min(m(range[0])), high.max(m(range[1]))));
    if low > high {
        return None;
    }
    let duration_s = flight.duration_s.max(1e-3);
    let x = |time_s: f64| (time_s / duration_s).clamp(0.0, 1.0) * width;
    let bottom = low.min(0.0);
    let span = (high - bottom).max(THUMBNAIL_SPAN_M);
    // A pixel at both ends for the line itself.
    let y = |m: f64| 1.0 + (1.0 - (m - bottom) / span) * (height - 2.0);
    let at = |k: usize| x(outline.from_s + (k as f64 + 0.5) * outline.step_s);
    let (mut path, mut below) = (String::new(), String::new());
    let numbered: Vec<_> = outline.altitude_cm.iter().enumerate().collect();
    for run in numbered.split(|(_, range)| range.is_none()).filter(|run| !run.is_empty()) {
        let edge = |end: usize| run.iter().filter_map(move |(k, range)| range.map(|range| (at(*k), y(m(range[end])))));
        let lower: Vec<_> = edge(0).collect();
        let draw = |out: &mut String, points: &mut dyn Iterator<Item = (f64, f64)>| {
            for (i, (x, y)) in points.enumerate() {
                // A string takes whatever is written to it.
                let _ = write!(out, "{}{x:.1} {y:.1}", if i == 0 { 'M' } else { 'L' });
            }
            out.push('Z');
        };
        draw(&mut path, &mut edge(1).chain(lower.iter().rev().copied()));
        let ground = [lower.last(), lower.first()].into_iter().flatten().map(|(x, _)| (*x, height));
        draw(&mut below, &mut lower.iter().copied().chain(ground));
    }
    let flown = flight.attacks.iter().filter(|a| !matches!(a.phase.as_str(), "accepted" | "rejected"));
    let attacks = flown.map(|a| [a.planned.start_s, a.planned.start_s + a.planned.duration_s].map(x)).collect();
    Some(Thumbnail { path, below, attacks, range_m: [low, high] })
}

#[cfg(test)]
mod tests {
    use plumbline_rest::command::PlannedAttack;
    use plumbline_rest::flight::{FlownAttack, Outline};

    use super::*;

    #[test]
    fn words_with_a_hash_are_tags() {
        assert_eq!(tags("#Windy, new #prop-8 and #windy\nSHA-256 3#4 # ##x"), ["#windy", "#prop-8"]);
        assert_eq!(tags("#a #b #c #d #e").len(), TAGS);
        assert!(tags("nothing").is_empty());
    }

    #[test]
    fn a_thumbnail_holds_every_stretch_that_is_known_and_its_attacks() {
        let attack = |phase: &str| FlownAttack {
            planned: PlannedAttack { start_s: 5.0, duration_s: 99.0, ..PlannedAttack::default() },
            phase: phase.into(),
        };
        let outline = Outline {
            from_s: 0.0,
            step_s: 2.0,
            altitude_cm: vec![Some([0, 100]), Some([90, 100]), None, Some([50, 60]), Some([0, 0])],
        };
        let attacks = vec![attack("done"), attack("accepted")];
        let flight = Flight { duration_s: 10.0, outline: Some(outline), attacks, ..Flight::default() };
        let found = thumbnail(&flight, [100.0, 22.0]).unwrap();
        assert_eq!((found.attacks, found.range_m), (vec![[50.0, 100.0]], [0.0, 1.0]));
        assert_eq!(found.path, "M10.0 1.0L30.0 1.0L30.0 3.0L10.0 21.0ZM70.0 9.0L90.0 21.0L90.0 21.0L70.0 11.0Z");
        assert_eq!(found.below, "M10.0 21.0L30.0 3.0L30.0 22.0L10.0 22.0ZM70.0 11.0L90.0 21.0L90.0 22.0L70.0 22.0Z");
        assert_eq!(thumbnail(&Flight::default(), [100.0, 22.0]), None);
    }

    #[test]
    fn a_stretch_is_of_exports_and_several_flights_are_a_tar() {
        let mut part = Part { stretch_s: Some([1.0, 2.5]), ..Part::default() };
        assert_eq!(download("f1", "csv", &part), "/api/v1/flights/f1/csv?from_s=1.000&to_s=2.500");
        assert_eq!(download("f1", "mcap", &part), "/api/v1/flights/f1/mcap");
        (part.columns, part.rate_hz) = (vec!["truth".into(), "height_2".into()], Some(0));
        assert_eq!(part.name(), "1.0 to 2.5 s, 2 columns, every tick");
        let tables = "from_s=1.000&to_s=2.500&columns=truth,height_2&rate_hz=0";
        assert_eq!(download("f1", "mat", &part), format!("/api/v1/flights/f1/mat?{tables}"));
        assert_eq!(download("f1", "ros2", &part), "/api/v1/flights/f1/ros2?from_s=1.000&to_s=2.500");
        assert_eq!(Part::default().name(), "");
        let all = |ids: &[&str]| download_all(&ids.iter().map(|id| (*id).to_owned()).collect::<Vec<_>>(), "mat");
        assert_eq!(all(&[]), None);
        assert_eq!(all(&["f1"]).as_deref(), Some("/api/v1/flights/f1/mat"));
        assert_eq!(all(&["f1", "f2"]).as_deref(), Some("/api/v1/archive?ids=f1,f2&format=mat"));
    }

    #[test]
    fn dates() {
        assert_eq!(when(1_795_262_400_000_000, 0), "2026-11-21 12:00");
        assert_eq!(when(1_795_262_400_000_000, -60), "2026-11-21 13:00");
        assert_eq!(when(951_782_400_000_000, 0), "2000-02-29 00:00");
        assert_eq!(when(0, 0), "—");
    }
}
