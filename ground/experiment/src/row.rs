//! One flight of a result: 200 bytes, the same on every machine.
//!
//! | bytes | what |
//! |---|---|
//! | 4 | index, little-endian like everything |
//! | 22 × 8 | measures, each a `f64`; NaN where there is nothing |
//! | 16 | why it was lost; empty when it was not |
//! | 4 | CRC-32 of all before |
//!
//! Another version of the program may have had other measures: which of them a row has stands in the experiment's identity.

use crate::judge::Outcome;

/// A column of numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Measure {
    /// Name, with its unit.
    pub name: &'static str,
    /// For people.
    pub about: &'static str,
}

const fn measure(name: &'static str, about: &'static str) -> Measure {
    Measure { name, about }
}

/// Every measure, in the order of the columns.
pub const MEASURES: [Measure; 22] = [
    measure("altitude_m", "true altitude less setpoint, rms"),
    measure("altitude_most_m", "true altitude less setpoint, most"),
    measure("lateral_m", "true place less setpoint, rms, where it is held"),
    measure("tilt_rad", "between true and estimated vertical, rms"),
    measure("estimate_m", "estimated less true altitude, rms"),
    measure("nees", "altitude's error squared by its variance, mean"),
    measure("nis", "innovations squared by their variance, mean"),
    measure("effort_per_s", "change of the four throttles"),
    measure("outside_s", "time beyond the limits of the vehicle"),
    measure("delay_s", "onset to the first exclusion of a sensor attacked, or of a rotor attacked or broken"),
    measure("missed", "sensors attacked, and rotors attacked or broken, never excluded"),
    measure("false_exclusions", "exclusions of healthy sensors"),
    measure("false_longest_s", "the longest of them"),
    measure("declared_s", "onset to the first doubt or failsafe"),
    measure("outside_bound", "part of the time outside the bound announced"),
    measure("nis_most", "innovation squared by its variance, the most of one signal over half a second"),
    measure("rise_s", "10 % to 90 % of an altitude step by the true altitude, mean"),
    measure("overshoot_percent", "true altitude beyond its step's target, in per cent of the step, the most"),
    measure(
        "settling_s",
        "from a step until inside its band for good, the longest; watched so long where it never was",
    ),
    measure("steady_m", "true altitude less target at the end of a step, mean of a second, the most"),
    measure("quiet_exclusions", "healthy sensors that counted for almost nothing longer than 1 s, announced or not"),
    measure("quiet_longest_s", "the longest that a healthy sensor counted for almost nothing"),
];

/// Measures of an experiment whose identity does not name them.
pub(crate) const FIRST: usize = 15;

const LOST_BYTES: usize = 16;
/// Size of a row.
pub const ROW_BYTES: usize = row_bytes(MEASURES.len());

/// Size of a row with so many measures.
pub(crate) const fn row_bytes(measures: usize) -> usize {
    4 + 8 * measures + LOST_BYTES + 4
}

/// How one flight went.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// Which flight of the plan.
    pub index: u32,
    /// In the order of [`MEASURES`]; NaN where there was nothing to measure.
    pub values: [f64; MEASURES.len()],
    lost: [u8; LOST_BYTES],
}

impl PartialEq for Row {
    /// Bit for bit: a NaN equals itself.
    fn eq(&self, other: &Self) -> bool {
        self.encode() == other.encode()
    }
}

impl Row {
    /// Of a flight that was flown.
    pub fn new(index: u32, outcome: &Outcome) -> Self {
        let first_delay_s = outcome.delays_s.iter().copied().fold(f64::NAN, f64::min);
        Self {
            index,
            values: [
                outcome.altitude_m,
                outcome.altitude_most_m,
                outcome.lateral_m,
                outcome.tilt_rad,
                outcome.estimate_m,
                outcome.nees,
                outcome.nis,
                outcome.effort_per_s,
                outcome.outside_s,
                first_delay_s,
                outcome.missed as f64,
                outcome.false_exclusions as f64,
                outcome.false_longest_s,
                outcome.declared_s.unwrap_or(f64::NAN),
                outcome.outside_bound,
                outcome.nis_most,
                outcome.rise_s,
                outcome.overshoot_percent,
                outcome.settling_s,
                outcome.steady_m,
                outcome.quiet_exclusions as f64,
                outcome.quiet_longest_s,
            ]
            // One NaN: which bits a processor gives it is nobody's result.
            .map(|value| if value.is_nan() { f64::NAN } else { value }),
            lost: clipped(outcome.lost.as_deref().unwrap_or_default()),
        }
    }

    /// Of a flight that could not be flown at all.
    pub fn not_flown(index: u32) -> Self {
        Self { index, values: [f64::NAN; MEASURES.len()], lost: clipped("not flown") }
    }

    /// Why it was lost; empty when it was not.
    pub fn lost(&self) -> &str {
        let end = self.lost.iter().position(|byte| *byte == 0).unwrap_or(LOST_BYTES);
        self.lost.get(..end).and_then(|bytes| std::str::from_utf8(bytes).ok()).unwrap_or_default()
    }

    /// The value of a measure; NaN where there is no such.
    pub fn value(&self, measure: &str) -> f64 {
        let at = MEASURES.iter().position(|known| known.name == measure);
        at.and_then(|at| self.values.get(at)).copied().unwrap_or(f64::NAN)
    }

    /// Was anything attacked in it, or did anything break?
    pub(crate) fn attacked(&self) -> bool {
        self.value("missed") > 0.0 || self.value("delay_s").is_finite()
    }

    /// Was all of that excluded?
    pub(crate) fn detected(&self) -> bool {
        self.attacked() && self.value("missed") == 0.0
    }

    /// As it is kept.
    pub fn encode(&self) -> [u8; ROW_BYTES] {
        let mut bytes = [0; ROW_BYTES];
        let values = self.values.iter().flat_map(|value| value.to_le_bytes());
        let content = self.index.to_le_bytes().into_iter().chain(values).chain(self.lost);
        bytes.iter_mut().zip(content).for_each(|(to, from)| *to = from);
        let (content, check) = bytes.split_at_mut(ROW_BYTES - 4);
        check.copy_from_slice(&crc32fast::hash(content).to_le_bytes());
        bytes
    }

    /// Of what was kept by whoever had measures at these [`places`]; `None` when it is damaged.
    pub fn decode(bytes: &[u8], places: &[Option<usize>]) -> Option<Self> {
        let (content, check) = bytes.split_last_chunk::<4>()?;
        if bytes.len() != row_bytes(places.len()) || crc32fast::hash(content) != u32::from_le_bytes(*check) {
            return None;
        }
        let (index, rest) = content.split_first_chunk::<4>()?;
        let (values, lost) = rest.split_last_chunk::<LOST_BYTES>()?;
        let mut row = Self { index: u32::from_le_bytes(*index), values: [f64::NAN; MEASURES.len()], lost: *lost };
        for (place, bytes) in places.iter().zip(values.as_chunks::<8>().0) {
            if let Some(value) = place.and_then(|at| row.values.get_mut(at)) {
                *value = f64::from_le_bytes(*bytes);
            }
        }
        Some(row)
    }
}

/// Where measures of these names stand among [`MEASURES`]; `None` where nobody knows one any more.
pub fn places(names: &[String]) -> Vec<Option<usize>> {
    names.iter().map(|name| MEASURES.iter().position(|known| known.name == name)).collect()
}

/// The names of these measures.
pub(crate) fn names(measures: &[Measure]) -> Vec<String> {
    measures.iter().map(|measure| measure.name.to_owned()).collect()
}

/// The beginning of a text, not in the middle of a character.
fn clipped(text: &str) -> [u8; LOST_BYTES] {
    let mut end = text.len().min(LOST_BYTES);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    let mut lost = [0; LOST_BYTES];
    lost.iter_mut().zip(text.bytes().take(end)).for_each(|(to, from)| *to = from);
    lost
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_comes_back_bit_for_bit_and_damage_is_seen() {
        let outcome = Outcome {
            altitude_m: 0.1 + 0.2,
            lateral_m: -f64::NAN,
            lost: Some("EstimatorDescend und länger".into()),
            delays_s: vec![0.4, 0.3],
            ..Outcome::default()
        };
        let row = Row::new(7, &outcome);
        let (bytes, measures) = (row.encode(), places(&names(&MEASURES)));
        assert_eq!(Row::decode(&bytes, &measures), Some(row));
        assert_eq!((row.lost(), row.value("delay_s")), ("EstimatorDescend", 0.3));
        assert_eq!(row.value("lateral_m").to_bits(), f64::NAN.to_bits());
        for at in 0..ROW_BYTES {
            let mut damaged = bytes;
            damaged[at] ^= 0x10;
            assert_eq!(Row::decode(&damaged, &measures), None, "byte {at}");
        }
    }

    #[test]
    fn a_row_of_another_version_is_read_by_the_names_of_its_measures() {
        let row = Row::new(7, &Outcome { altitude_m: 0.1, quiet_longest_s: 4.0, ..Outcome::default() });
        let names = names(&MEASURES);
        let swapped: Vec<_> = names.iter().rev().cloned().collect();
        let read = Row::decode(&row.encode(), &places(&swapped)).unwrap();
        assert_eq!((read.value("altitude_m"), read.value("quiet_longest_s")), (4.0, 0.1));
        // One measure fewer, and one that nobody knows any more.
        let mut older = row.encode()[..4 + 8 * 2].to_vec(); // index, altitude_m, and another
        older.extend([0; LOST_BYTES]);
        older.extend(crc32fast::hash(&older).to_le_bytes());
        let read = Row::decode(&older, &places(&["altitude_m".into(), "gone".into()])).unwrap();
        assert_eq!(read.value("altitude_m"), 0.1);
        assert!(read.value("nis_most").is_nan() && read.value("altitude_most_m").is_nan());
        assert_eq!(Row::decode(&older, &places(&names)), None);
    }
}
