//! What of a list of flights is shown, in which order: asked by the page, answered by the ground.

use serde::{Deserialize, Serialize};

use super::Flight;

/// Flights on a page, where nothing else is asked for.
pub const PAGE: usize = 100;
/// Most flights on a page.
pub const MAX_PAGE: usize = 1000;

/// The query of `GET /api/v1/flights`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Listing {
    /// Words that all must be found in a flight's id, name, notes, vehicle, rig, state or attacks.
    pub search: String,
    /// Of this vehicle only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vehicle: Option<String>,
    /// Begun then or later, µs since the Unix epoch, by the agent's clock.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from_unix_us: Option<u64>,
    /// Begun earlier than that.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub to_unix_us: Option<u64>,
    /// By which column.
    pub sort: Column,
    /// The largest, or newest, first?
    pub descending: bool,
    /// So many of them are passed over.
    pub offset: usize,
    /// Most that are answered, 1 to [`MAX_PAGE`].
    pub limit: usize,
}

impl Default for Listing {
    fn default() -> Self {
        let (vehicle, from_unix_us, to_unix_us) = (None, None, None);
        let (search, sort, descending) = (String::new(), Column::Started, true);
        Self { search, vehicle, from_unix_us, to_unix_us, sort, descending, offset: 0, limit: PAGE }
    }
}

/// A column of the list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Column {
    /// When it began.
    Started,
    /// Name.
    Name,
    /// Vehicle.
    Vehicle,
    /// Rig.
    Rig,
    /// Length.
    Duration,
    /// Setpoint steps.
    Steps,
    /// Attacks.
    Attacks,
    /// Tracking error.
    Tracking,
    /// Is every message there?
    Completeness,
    /// Size.
    Size,
}

impl Column {
    /// From left to right.
    pub const ALL: [Self; 10] = [
        Self::Started,
        Self::Name,
        Self::Vehicle,
        Self::Rig,
        Self::Duration,
        Self::Steps,
        Self::Attacks,
        Self::Tracking,
        Self::Completeness,
        Self::Size,
    ];

    /// As the query names it.
    pub const fn query(self) -> &'static str {
        match self {
            Self::Started => "started",
            Self::Name => "name",
            Self::Vehicle => "vehicle",
            Self::Rig => "rig",
            Self::Duration => "duration",
            Self::Steps => "steps",
            Self::Attacks => "attacks",
            Self::Tracking => "tracking",
            Self::Completeness => "completeness",
            Self::Size => "size",
        }
    }
}

/// Whether a text has every word of a search, in any case of its letters.
pub fn finds(search: &str) -> impl Fn(&str) -> bool + use<> {
    let words: Vec<String> = search.split_whitespace().map(str::to_lowercase).collect();
    move |text| {
        let text = text.to_lowercase();
        words.iter().all(|word| text.contains(word))
    }
}

/// One page of the flights that match, and how many match.
pub fn page(mut flights: Vec<Flight>, asked: &Listing) -> (Vec<Flight>, u64) {
    let found = finds(&asked.search);
    let (from, to) = (asked.from_unix_us.unwrap_or(0), asked.to_unix_us.unwrap_or(u64::MAX));
    flights.retain(|f| {
        let begun = f.started_unix_us >= from && (f.started_unix_us < to || asked.to_unix_us.is_none());
        if !begun || asked.vehicle.as_ref().is_some_and(|vehicle| f.vehicle_id != *vehicle) {
            return false;
        }
        let attacks: String = f
            .attacks
            .iter()
            .map(|a| format!(" {} {} {}", a.planned.sensor, a.planned.instance, a.planned.kind))
            .collect();
        let notes = &f.notes;
        let text = format!(
            "{} {} {notes} {} {} {} {}{attacks}",
            f.id,
            f.title(),
            f.vehicle_id,
            f.vehicle,
            f.rig,
            f.completeness.name()
        );
        found(&text)
    });
    flights.sort_by(|a, b| {
        let by = match asked.sort {
            Column::Started => a.started_unix_us.cmp(&b.started_unix_us),
            Column::Name => a.title().to_lowercase().cmp(&b.title().to_lowercase()),
            Column::Vehicle => a.vehicle_id.cmp(&b.vehicle_id),
            Column::Rig => a.rig.cmp(&b.rig),
            Column::Duration => a.duration_s.total_cmp(&b.duration_s),
            Column::Steps => a.steps.len().cmp(&b.steps.len()),
            Column::Attacks => a.attacks.len().cmp(&b.attacks.len()),
            // Flights without a figure come last when the worst is wanted first.
            Column::Tracking => a.tracking_rms_m.unwrap_or(-1.0).total_cmp(&b.tracking_rms_m.unwrap_or(-1.0)),
            Column::Completeness => a.completeness.name().cmp(b.completeness.name()),
            Column::Size => a.size_bytes.cmp(&b.size_bytes),
        };
        let by = if asked.descending { by.reverse() } else { by };
        by.then_with(|| b.started_unix_us.cmp(&a.started_unix_us)).then_with(|| a.id.cmp(&b.id))
    });
    let total = flights.len() as u64;
    (flights.into_iter().skip(asked.offset).take(asked.limit).collect(), total)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flight(id: &str, rig: &str, duration_s: f64, rms: Option<f64>) -> Flight {
        Flight { id: id.into(), rig: rig.into(), duration_s, tracking_rms_m: rms, ..Default::default() }
    }

    fn select(flights: Vec<Flight>, search: &str, sort: Column, descending: bool) -> Vec<Flight> {
        page(flights, &Listing { search: search.into(), sort, descending, ..Listing::default() }).0
    }

    #[test]
    fn columns_have_the_names_of_their_json() {
        for column in Column::ALL {
            assert_eq!(serde_json::to_value(column).unwrap(), column.query());
        }
    }

    #[test]
    fn pages_follow_each_other_without_gap_or_repetition() {
        let all: Vec<_> = (0..7).map(|n| Flight { started_unix_us: n, ..flight("f", "", 0.0, None) }).collect();
        let starts = |offset| {
            let (flights, total) = page(all.clone(), &Listing { offset, limit: 3, ..Listing::default() });
            assert_eq!(total, 7);
            flights.iter().map(|f| f.started_unix_us).collect::<Vec<_>>()
        };
        assert_eq!([starts(0), starts(3), starts(6), starts(9)], [vec![6, 5, 4], vec![3, 2, 1], vec![0], vec![]]);
    }

    #[test]
    fn flights_of_one_vehicle_or_of_a_stretch_of_time_are_found_by_themselves() {
        let flown = |id: &str, vehicle: &str, started_unix_us| Flight {
            vehicle_id: vehicle.into(),
            started_unix_us,
            ..flight(id, "", 0.0, None)
        };
        let all =
            [flown("a", "iris-1", 10), flown("b", "iris-10", 20), flown("c", "iris-1", 30), flown("d", "x", u64::MAX)];
        let ids = |asked: Listing| {
            let (flights, total) = page(all.to_vec(), &asked);
            assert_eq!(total, flights.len() as u64);
            flights.into_iter().map(|f| f.id).collect::<String>()
        };
        let base = Listing { descending: false, ..Listing::default() };
        assert_eq!(ids(base.clone()), "abcd");
        assert_eq!(ids(Listing { vehicle: Some("iris-1".into()), ..base.clone() }), "ac");
        assert_eq!(ids(Listing { from_unix_us: Some(20), ..base.clone() }), "bcd");
        assert_eq!(ids(Listing { to_unix_us: Some(20), ..base.clone() }), "a");
        let both = Listing { from_unix_us: Some(10), to_unix_us: Some(30), ..base.clone() };
        assert_eq!(ids(Listing { vehicle: Some("iris-1".into()), ..both }), "a");
        assert_eq!(ids(Listing { from_unix_us: Some(20), to_unix_us: Some(10), ..base }), "");
    }

    #[test]
    fn every_word_must_match_and_the_order_is_stable() {
        let all = vec![
            flight("a", "hanging strings", 5.0, None),
            flight("b", "free", 9.0, Some(0.1)),
            flight("c", "hanging strings", 7.0, Some(0.2)),
        ];
        let ids = |f: Vec<Flight>| f.into_iter().map(|f| f.id).collect::<String>();
        assert_eq!(ids(select(all.clone(), "", Column::Duration, true)), "bca");
        assert_eq!(ids(select(all.clone(), "STRINGS hang", Column::Duration, false)), "ac");
        assert_eq!(ids(select(all.clone(), "strings free", Column::Name, false)), "");
        assert_eq!(ids(select(all, "", Column::Tracking, true)), "cba");
    }
}
