//! Numbers as the page writes them: fixed width, unit, sign, true minus, and "—" where nothing is known.

/// What stands where there is no value. Never 0.
pub const NONE: &str = "—";

/// `value` with `decimals` places and a typographic minus; "—" when it is not finite.
pub fn fixed(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return NONE.to_owned();
    }
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        // No "−0.00": a sign that means nothing.
        Some(rest) if rest.chars().all(|c| c == '0' || c == '.') => rest.to_owned(),
        Some(rest) => format!("\u{2212}{rest}"),
        None => text,
    }
}

/// `value` with four figures at least: "0.001235", "12.35", "101325"; "—" when it is not finite.
pub fn figures(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return fixed(value, 0);
    }
    let places = 3 - value.abs().log10().floor() as i32;
    fixed(value, places.clamp(0, 9) as usize)
}

/// As [`fixed`], with a plus sign for positive values.
pub fn signed(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    if value.is_finite() && !text.starts_with('\u{2212}') && text.chars().any(|c| ('1'..='9').contains(&c)) {
        format!("+{text}")
    } else {
        text
    }
}

/// What is shown of a `value` that trembles: `shown`, while they differ by no more than `band`.
pub fn steady(shown: f64, value: f64, band: f64) -> f64 {
    if (value - shown).abs() <= band { shown } else { value }
}

/// [`fixed`] of a value that may be absent.
pub fn maybe(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| NONE.to_owned(), |v| fixed(v, decimals))
}

/// A length that may be absent, m, in mm.
pub fn millimetres(m: Option<f64>, decimals: usize) -> String {
    m.map_or_else(|| NONE.to_owned(), |m| format!("{} mm", fixed(m * 1e3, decimals)))
}

/// A duration as `m:ss`, or `h:mm:ss` from one hour.
pub fn clock(seconds: f64) -> String {
    if !seconds.is_finite() {
        return NONE.to_owned();
    }
    let total = seconds.max(0.0) as u64;
    let (h, m, s) = (total / 3600, total / 60 % 60, total % 60);
    if h > 0 { format!("{h}:{m:02}:{s:02}") } else { format!("{m}:{s:02}") }
}

/// An age, short: `85 ms`, `2.4 s`, `3 min`, `2 h`.
pub fn age(seconds: f64) -> String {
    match seconds {
        s if !s.is_finite() => NONE.to_owned(),
        s if s < 0.9995 => format!("{:.0} ms", s.max(0.0) * 1e3),
        s if s < 60.0 => format!("{s:.1} s"),
        s if s < 3600.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.0} h", s / 3600.0),
    }
}

/// "1 flight", "3 flights"
pub fn plural(n: u64, noun: &str) -> String {
    if n == 1 { format!("1 {noun}") } else { format!("{n} {noun}s") }
}

/// A size in bytes with a binary unit: `4.2 MiB`.
pub fn bytes(count: u64) -> String {
    const UNITS: [&str; 5] = ["B", "KiB", "MiB", "GiB", "TiB"];
    let mut value = count as f64;
    let mut unit = UNITS[0];
    for next in &UNITS[1..] {
        if value < 1024.0 {
            break;
        }
        value /= 1024.0;
        unit = next;
    }
    if unit == "B" { format!("{value:.0} B") } else { format!("{value:.1} {unit}") }
}

/// A count with thin spaces between thousands.
pub fn count(value: u64) -> String {
    let digits = value.to_string();
    let mut out = String::with_capacity(digits.len() + digits.len() / 3 * 3);
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push('\u{2009}');
        }
        out.push(c);
    }
    out
}

/// What a person types as a list, part by part: apart by blanks, lines or semicolons, and a comma may end a part.
pub fn list(text: &str) -> impl Iterator<Item = &str> {
    let parts = text.split(|c: char| c.is_whitespace() || c == ';').map(|part| part.trim_end_matches(','));
    parts.filter(|part| !part.is_empty())
}

/// Parses what a person types into a number field: a comma or a true minus is understood.
///
/// # Errors
/// A sentence with the text as typed.
pub fn parse_number(text: &str) -> Result<f64, String> {
    let cleaned: String = text.trim().replace('\u{2212}', "-").replace(',', ".");
    match cleaned.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ if cleaned.is_empty() => Err("a number is needed".to_owned()),
        _ => Err(format!("\u{201c}{}\u{201d} is not a number", text.trim())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_four() {
        let texts = [0.001_234_6, -12.345_6, 101_325.4, 0.0, f64::NAN].map(figures);
        assert_eq!(texts, ["0.001235", "\u{2212}12.35", "101325", "0", NONE]);
    }

    #[test]
    fn numbers_keep_their_width_and_no_value_is_no_number() {
        assert_eq!(fixed(0.8, 2), "0.80");
        assert_eq!(fixed(-0.04, 1), "0.0");
        assert_eq!(fixed(-1.26, 1), "\u{2212}1.3");
        assert_eq!(fixed(f64::NAN, 2), NONE);
        assert_eq!(signed(0.5, 1), "+0.5");
        assert_eq!(signed(0.0, 1), "0.0");
        assert_eq!(signed(-0.5, 1), "\u{2212}0.5");
        assert_eq!(maybe(None, 2), NONE);
        assert_eq!((millimetres(Some(0.0214), 1).as_str(), millimetres(None, 1).as_str()), ("21.4 mm", NONE));
    }

    #[test]
    fn durations_ages_sizes_and_counts() {
        assert_eq!(clock(42.9), "0:42");
        assert_eq!(clock(3723.0), "1:02:03");
        assert_eq!(age(0.085), "85 ms");
        assert_eq!(age(2.44), "2.4 s");
        assert_eq!(age(7200.0), "2 h");
        assert_eq!(bytes(512), "512 B");
        assert_eq!(bytes(4_400_000), "4.2 MiB");
        assert_eq!(count(1234567), "1\u{2009}234\u{2009}567");
        assert_eq!(count(999), "999");
    }

    #[test]
    fn a_trembling_value_is_shown_steadily_and_followed() {
        let volts = [12.44, 12.46, 12.43, 12.47, 12.40];
        let shown = volts.iter().fold(vec![12.45], |mut shown: Vec<f64>, volts| {
            shown.push(steady(*shown.last().unwrap(), *volts, 0.08));
            shown
        });
        assert_eq!(shown, [12.45; 6]);
        assert_eq!(steady(12.45, 12.36, 0.08), 12.36);
        assert!(steady(12.45, f64::NAN, 0.08).is_nan(), "what is not known is not what it was");
    }

    #[test]
    fn typed_numbers() {
        assert_eq!(parse_number(" 0,8 "), Ok(0.8));
        assert_eq!(parse_number("\u{2212}1.5"), Ok(-1.5));
        assert!(parse_number("").is_err());
        assert!(parse_number("1e999").is_err());
        assert_eq!(parse_number("abc").unwrap_err(), "\u{201c}abc\u{201d} is not a number");
    }
}
