//! Choosing among the signals of a recording or a vehicle, their place in an address, and what a picture of a spectrum needs.

use plumbline_rest::flight::{Signal, Spectrum};

/// Signals offered at a time; whoever wants others types more of their names.
pub const OFFERED: usize = 80;
/// Power of nothing at all, dB.
const LEAST_DB: f64 = -200.0;

/// Signals whose name holds every word of `search`, and how many there are beyond those offered.
pub fn found<'a>(all: &'a [Signal], search: &str) -> (Vec<&'a Signal>, usize) {
    let words: Vec<String> = search.split_whitespace().map(str::to_lowercase).collect();
    let holds = |signal: &&Signal| {
        let name = signal.name.to_lowercase();
        words.iter().all(|word| name.contains(word))
    };
    let mut found: Vec<_> = all.iter().filter(holds).collect();
    let beyond = found.len().saturating_sub(OFFERED);
    found.truncate(OFFERED);
    (found, beyond)
}

/// Names and whether their spectrum is shown, as one text for an address; names hold no comma.
pub fn told<'a>(charted: impl Iterator<Item = (&'a str, bool)>) -> String {
    charted
        .map(|(name, spectrum)| if spectrum { format!("~{name}") } else { name.to_owned() })
        .collect::<Vec<_>>()
        .join(",")
}

/// The reverse.
pub fn read(text: &str) -> Vec<(String, bool)> {
    let one =
        |part: &str| part.strip_prefix('~').map_or_else(|| (part.to_owned(), false), |name| (name.to_owned(), true));
    text.split(',').filter(|part| !part.is_empty()).map(one).collect()
}

/// Frequency, Hz, and density, dB.
pub fn decibels(spectrum: &Spectrum) -> Vec<[f64; 2]> {
    // The mean was taken out: the first one says nothing.
    let points = spectrum.frequency_hz.iter().zip(&spectrum.density).skip(1);
    points.map(|(hz, density)| [*hz, (10.0 * density.log10()).max(LEAST_DB)]).collect()
}

/// Where the density is greatest, Hz.
pub fn peak_hz(spectrum: &Spectrum) -> Option<f64> {
    let points = spectrum.frequency_hz.iter().zip(&spectrum.density).skip(1);
    points.max_by(|a, b| a.1.total_cmp(b.1)).map(|(hz, _)| *hz)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_word_narrows_the_choice() {
        let signal = |name: &str| Signal { name: name.into(), unit: String::new() };
        let all = ["imu_1.gyro_radps.x", "imu_2.gyro_radps.x", "imu_1.accel_mps2.x"].map(signal);
        let names = |search| found(&all, search).0.into_iter().map(|s| s.name.as_str()).collect::<Vec<_>>();
        assert_eq!(names("Gyro 2"), ["imu_2.gyro_radps.x"]);
        assert_eq!((names("").len(), names("gyro mag").len()), (3, 0));
        let many = vec![signal("a"); OFFERED + 7];
        assert_eq!((found(&many, "a").0.len(), found(&many, "a").1), (OFFERED, 7));
    }

    #[test]
    fn an_address_holds_what_is_charted() {
        let charted = [("residuals_1[height 2 altitude].innovation", false), ("imu_1.gyro_radps.x", true)];
        let back = read(&told(charted.into_iter()));
        assert_eq!(back.iter().map(|(name, on)| (name.as_str(), *on)).collect::<Vec<_>>(), charted);
        assert_eq!((read(""), told([].into_iter())), (Vec::new(), String::new()));
    }

    #[test]
    fn a_spectrum_has_a_peak_and_silence_has_an_end() {
        let spectrum =
            Spectrum { frequency_hz: vec![0.0, 1.0, 2.0], density: vec![9.0, 0.0, 0.01], ..Spectrum::default() };
        assert_eq!(peak_hz(&spectrum), Some(2.0));
        assert_eq!(decibels(&spectrum), [[1.0, -200.0], [2.0, -20.0]]);
        assert_eq!(peak_hz(&Spectrum::default()), None);
    }
}
