//! The list of flights: heads of its columns, and times.

use plumbline_proto::time::WallTime;
use plumbline_rest::flight::Column;

/// Forms of a flight to download: the route below it, and its name.
pub const FORMS: [(&str, &str); 5] =
    [("mcap", "MCAP"), ("csv", "CSV"), ("parquet", "Parquet"), ("mat", "MATLAB"), ("ros2", "ROS 2 bag")];

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates() {
        assert_eq!(when(1_795_262_400_000_000, 0), "2026-11-21 12:00");
        assert_eq!(when(1_795_262_400_000_000, -60), "2026-11-21 13:00");
        assert_eq!(when(951_782_400_000_000, 0), "2000-02-29 00:00");
        assert_eq!(when(0, 0), "—");
    }
}
