//! The list of flights: what is shown, in which order.

use plumbline_proto::time::WallTime;
use plumbline_rest::flight::Flight;

/// A column of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

    /// Its head.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Started => "when",
            Self::Name => "name",
            Self::Vehicle => "vehicle",
            Self::Rig => "rig",
            Self::Duration => "duration",
            Self::Steps => "steps",
            Self::Attacks => "attacks",
            Self::Tracking => "error RMS",
            Self::Completeness => "state",
            Self::Size => "size",
        }
    }

    /// Aligned to the right?
    pub const fn is_number(self) -> bool {
        matches!(self, Self::Duration | Self::Steps | Self::Attacks | Self::Tracking | Self::Size)
    }
}

/// The flights that match every word of `filter`, in order.
pub fn select(mut flights: Vec<Flight>, filter: &str, column: Column, descending: bool) -> Vec<Flight> {
    let words: Vec<String> = filter.split_whitespace().map(str::to_lowercase).collect();
    flights.retain(|f| {
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
        let text = text.to_lowercase();
        words.iter().all(|w| text.contains(w))
    });
    flights.sort_by(|a, b| {
        let by = match column {
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
        let by = if descending { by.reverse() } else { by };
        by.then_with(|| b.started_unix_us.cmp(&a.started_unix_us)).then_with(|| a.id.cmp(&b.id))
    });
    flights
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

#[cfg(test)]
mod tests {
    use super::*;

    fn flight(id: &str, rig: &str, duration_s: f64, rms: Option<f64>) -> Flight {
        Flight { id: id.into(), rig: rig.into(), duration_s, tracking_rms_m: rms, ..Default::default() }
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

    #[test]
    fn dates() {
        assert_eq!(when(1_795_262_400_000_000, 0), "2026-11-21 12:00");
        assert_eq!(when(1_795_262_400_000_000, -60), "2026-11-21 13:00");
        assert_eq!(when(951_782_400_000_000, 0), "2000-02-29 00:00");
        assert_eq!(when(0, 0), "—");
    }
}
