//! One colour for one thing, on every page. They began as Okabe–Ito; those that were too pale on white, or too near to another,
//! were moved as little as had to be: any two are told apart, in both themes (the tests say how far).
//!
//! The style sheet has the same colours under the names used here; dark pages lighten some of them.

use plumbline_proto::v1::EstimatorKind;

use crate::{
    gpu::{Color, Dash},
    model::curves::{Axis, Curve, Demand},
};

/// A colour in both themes, and its name in the style sheet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ink {
    light: Color,
    dark: Color,
    css: &'static str,
}

impl Ink {
    const fn new(light: u32, dark: u32, css: &'static str) -> Self {
        Self { light: Color::hex(light), dark: Color::hex(dark), css }
    }

    /// For the canvas.
    pub const fn on(self, dark: bool) -> Color {
        if dark { self.dark } else { self.light }
    }

    /// For what has no style sheet: on white.
    pub fn hex(self) -> String {
        format!("#{:02x}{:02x}{:02x}", self.light.r, self.light.g, self.light.b)
    }

    /// For the style sheet.
    pub const fn css(self) -> &'static str {
        self.css
    }
}

/// Setpoint: neutral.
pub const SETPOINT: Ink = Ink::new(0x1c2128, 0xe8ecf1, "var(--setpoint)");
/// Estimate in the loop.
pub const IN_LOOP: Ink = Ink::new(0x0072b2, 0x3d9fe0, "var(--in-loop)");
/// Another estimator: greens and purples, told apart by how light they are.
pub const OTHER_1: Ink = Ink::new(0x009e73, 0x2ab76f, "var(--other-1)");
/// A third.
pub const OTHER_2: Ink = Ink::new(0xcc79a7, 0xf989b6, "var(--other-2)");
const OTHER_3: Ink = Ink::new(0x00461b, 0x117e63, "var(--other-3)");
const OTHER_4: Ink = Ink::new(0x783657, 0x9e5781, "var(--other-4)");
const OTHER_5: Ink = Ink::new(0x1b6e69, 0xaffdd2, "var(--other-5)");
const OTHER_6: Ink = Ink::new(0x918ad8, 0xcab4f4, "var(--other-6)");
const OTHER_7: Ink = Ink::new(0x4a3f9d, 0x7f77ee, "var(--other-7)");
/// Raw sensor.
pub const SENSOR_1: Ink = Ink::new(0x86621f, 0xa17914, "var(--sensor-1)");
/// Raw sensor.
pub const SENSOR_2: Ink = Ink::new(0x4b9fad, 0x74cfd9, "var(--sensor-2)");
/// Raw sensor.
pub const SENSOR_3: Ink = Ink::new(0x9c9643, 0xd4c839, "var(--sensor-3)");
/// Truth: dashed neutral.
pub const TRUTH: Ink = Ink::new(0x74767e, 0x95989f, "var(--truth)");
/// Attacks, gates, rejection.
pub const ATTACK: Ink = Ink::new(0xd55e00, 0xf07a1e, "var(--attack)");

/// Colour and dash of a curve. No two curves that a chart may show together share both, but for the two sides of one bound.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stroke {
    /// Its colour.
    pub ink: Ink,
    /// How it is interrupted.
    pub dash: Dash,
}

impl Stroke {
    const fn new(ink: Ink, dash: Dash) -> Self {
        Self { ink, dash }
    }

    /// The same in dashes: what belongs to it.
    pub const fn dashed(self) -> Self {
        Self::new(self.ink, Dash::Dashed)
    }

    /// Class of its mark in the style sheet.
    pub const fn class(self) -> &'static str {
        match self.dash {
            Dash::None => "swatch",
            Dash::Dashed => "swatch dashed",
            Dash::Dotted => "swatch dotted",
            Dash::Long => "swatch long",
            Dash::Sparse => "swatch sparse",
        }
    }

    /// Style of its mark: the colour.
    pub fn style(self) -> String {
        format!("--swatch:{}", self.ink.css)
    }
}

/// How a curve is drawn, wherever it is; channels of a residual go by their order, see [`series`].
pub fn stroke(curve: Curve, in_loop: u16) -> Stroke {
    let (ink, dash) = match curve {
        Curve::Altitude(n)
        | Curve::Velocity(n, _)
        | Curve::AltitudeError(n)
        | Curve::AttitudeError(n, _)
        | Curve::AltitudeSigma(n)
        | Curve::AttitudeSigma(n, _) => return estimator(n, in_loop),
        Curve::Height(instance) => return sensor(instance),
        Curve::TruthAltitude | Curve::TruthVelocity(_) => (IN_LOOP, Dash::Dashed),
        Curve::Reach(_) => (ATTACK, Dash::None),
        Curve::Attitude(_, axis) | Curve::Asked(Demand::Rate(axis)) => (axis_ink(axis), Dash::None),
        Curve::TruthAttitude(axis) | Curve::AimedAt(Demand::Rate(axis)) => (axis_ink(axis), Dash::Dashed),
        Curve::AimedAt(Demand::Thrust) => (SETPOINT, Dash::Dashed),
        // The colour says whose it is. An axis has that of an estimator, too, and truth its dashes.
        Curve::AgainAltitude(n) => (own(n).ink, Dash::Dashed),
        Curve::AgainAttitude(n, Axis::Roll) => (own(n).ink, Dash::Long),
        Curve::AgainAttitude(n, Axis::Pitch) => (own(n).ink, Dash::Dotted),
        Curve::AgainAttitude(n, Axis::Yaw) => (own(n).ink, Dash::Sparse),
        Curve::Motor(i) | Curve::Signal(i) | Curve::Compared(i) | Curve::Difference(i) => {
            return series(usize::from(i));
        }
        Curve::ComparedSetpoint(i) => return series(usize::from(i)).dashed(),
        Curve::TickMedian => (IN_LOOP, Dash::None),
        Curve::TickP99 => (SENSOR_1, Dash::None),
        Curve::TickJitter => (TRUTH, Dash::Dashed),
        _ => (SETPOINT, Dash::None),
    };
    Stroke::new(ink, dash)
}

/// An estimator's.
pub fn estimator(number: u16, in_loop: u16) -> Stroke {
    if number == in_loop { Stroke::new(IN_LOOP, Dash::None) } else { own(number) }
}

/// That of an estimator which is not in the loop: it keeps it when another goes there.
fn own(number: u16) -> Stroke {
    use EstimatorKind as Kind;
    let (ink, dash) = match Kind::try_from(i32::from(number)).unwrap_or_default() {
        Kind::EkfBias => (OTHER_1, Dash::None),
        Kind::Complementary => (OTHER_6, Dash::None),
        Kind::EkfHybrid => (OTHER_3, Dash::None),
        Kind::Ukf => (OTHER_4, Dash::None),
        Kind::ConstantAcceleration => (OTHER_5, Dash::None),
        Kind::Lanes => (OTHER_7, Dash::None),
        Kind::Secure | Kind::Unspecified => (OTHER_2, Dash::None),
        // Filters of attitude alone, in dashes: sensors have these colours where there are altitudes.
        Kind::Vqf => (SENSOR_2, Dash::Dashed),
        Kind::AttitudeEkf => (SENSOR_3, Dash::Dashed),
    };
    Stroke::new(ink, dash)
}

/// That of a sensor's instance, numbered from 1.
pub fn sensor(instance: u16) -> Stroke {
    let index = usize::from(instance.saturating_sub(1));
    let dash = [Dash::None, Dash::Dashed, Dash::Dotted, Dash::Long, Dash::Sparse][index / 3 % 5];
    Stroke::new([SENSOR_1, SENSOR_2, SENSOR_3][index % 3], dash)
}

fn axis_ink(axis: Axis) -> Ink {
    match axis {
        Axis::Roll => IN_LOOP,
        Axis::Pitch => OTHER_1,
        Axis::Yaw => OTHER_2,
    }
}

/// Number `index` of at most eight like things: flights compared, channels of one sensor.
pub fn series(index: usize) -> Stroke {
    let inks = [IN_LOOP, SENSOR_1, OTHER_1, OTHER_2, SENSOR_2, SENSOR_3, TRUTH, OTHER_7];
    Stroke::new(inks[index % 8], Dash::None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{curves::Way, names};

    /// Every one of them.
    const ALL: [Ink; 14] = [
        SETPOINT, IN_LOOP, OTHER_1, OTHER_2, OTHER_3, OTHER_4, OTHER_5, OTHER_6, OTHER_7, SENSOR_1, SENSOR_2, SENSOR_3,
        TRUTH, ATTACK,
    ];

    #[test]
    fn an_attack_never_looks_like_a_curve() {
        for stroke in (0..8).map(series).chain((1..6).map(sensor)) {
            assert_ne!(stroke.ink, ATTACK);
        }
        assert_eq!(estimator(3, 3).ink, IN_LOOP);
    }

    #[test]
    fn no_two_curves_of_a_chart_share_colour_and_dash() {
        let kinds = || EstimatorKind::all().map(|kind| kind as u16);
        let with_altitude =
            || EstimatorKind::all().filter(|kind| names::estimates_altitude(*kind)).map(|kind| kind as u16);
        let axes = |curve: fn(Axis) -> Curve| Axis::ALL.into_iter().map(curve);
        assert_eq!((kinds().count(), with_altitude().count()), (9, 7));
        for in_loop in kinds() {
            let altitude = with_altitude().map(Curve::Altitude).chain(with_altitude().map(Curve::AgainAltitude));
            let altitude = altitude.chain((1..13).map(Curve::Height)).chain([
                Curve::SetpointAltitude,
                Curve::TruthAltitude,
                Curve::Reach(true),
            ]);
            let own = Axis::ALL.into_iter().map(|axis| Curve::Attitude(in_loop, axis));
            let again = kinds().flat_map(|n| Axis::ALL.map(|axis| Curve::AgainAttitude(n, axis)));
            let attitude = own.chain(axes(Curve::TruthAttitude)).chain(again);
            let rates =
                axes(|axis| Curve::Asked(Demand::Rate(axis))).chain(axes(|axis| Curve::AimedAt(Demand::Rate(axis))));
            let velocity = with_altitude().map(|n| Curve::Velocity(n, Way::Up));
            let charts: [Vec<Curve>; 9] = [
                velocity.chain([Curve::TruthVelocity(Way::Up)]).collect(),
                altitude.collect(),
                attitude.collect(),
                with_altitude().map(Curve::AltitudeError).collect(),
                kinds().map(|n| Curve::AttitudeError(n, Axis::Yaw)).collect(),
                (0..8).map(Curve::Motor).collect(),
                (0..8).flat_map(|i| [Curve::Compared(i), Curve::ComparedSetpoint(i)]).collect(),
                vec![Curve::TickMedian, Curve::TickP99, Curve::TickJitter],
                rates.collect(),
            ];
            for chart in charts {
                for (i, one) in chart.iter().enumerate() {
                    let drawn = stroke(*one, in_loop);
                    let same = chart[..i].iter().find(|other| stroke(**other, in_loop) == drawn);
                    assert_eq!(same, None, "as {one:?}, with {in_loop} in the loop");
                }
            }
        }
        // Channels of a residual, each with its gate.
        let all: Vec<_> = (0..8).map(series).flat_map(|channel| [channel, channel.dashed()]).collect();
        assert!(all.iter().enumerate().all(|(i, one)| !all[..i].contains(one)));
    }

    /// By CIEDE2000, and by how far they lie apart in L*a*b*.
    #[test]
    fn any_two_curves_are_told_apart_and_each_stands_out_from_its_chart() {
        use palette::color_difference::{Ciede2000 as _, EuclideanDistance as _};
        use palette::{FromColor as _, Lab, Srgb};
        let lab = |color: Color| Lab::from_color(Srgb::new(color.r, color.g, color.b).into_format::<f64>());
        let hex = |color: Color| format!("#{:02x}{:02x}{:02x}", color.r, color.g, color.b);
        for (dark, plot) in [(false, "#ffffff"), (true, "#161a20")] {
            for (i, one) in ALL.iter().enumerate() {
                let (a, b) = (luminance(&hex(one.on(dark))), luminance(plot));
                let contrast = (a.max(b) + 0.05) / (a.min(b) + 0.05);
                assert!(contrast >= 3.0, "{} has a contrast of {contrast:.2} (dark: {dark})", one.css);
                for other in &ALL[..i] {
                    let (x, y) = (lab(one.on(dark)), lab(other.on(dark)));
                    let (seen, apart) = (x.difference(y), x.distance(y));
                    assert!(seen >= 20.0 && apart >= 20.0, "{} and {}: ΔE {seen:.1}, {apart:.1}", one.css, other.css);
                }
            }
        }
    }

    #[test]
    fn both_style_sheets_have_these_colours_for_whatever_they_show() {
        let (light, dark) = include_str!("../style.css").split_once(":root[data-theme=\"dark\"]").unwrap();
        let report = include_str!("../report.css");
        let named = |ink: &Ink, color: Color| {
            let name = ink.css.trim_start_matches("var(").trim_end_matches(')');
            format!("{name}: #{:02x}{:02x}{:02x};", color.r, color.g, color.b)
        };
        for ink in ALL {
            assert!(light.contains(&named(&ink, ink.light)), "{}", ink.css);
            assert!(dark.contains(&named(&ink, ink.dark)), "{}, dark", ink.css);
        }
        // Kept as a file, or printed: what its figures are drawn in.
        let altitudes = EstimatorKind::all().filter(|kind| names::estimates_altitude(*kind));
        let estimators = altitudes.map(|kind| estimator(kind as u16, 0).ink);
        for ink in estimators.chain([SETPOINT, IN_LOOP, TRUTH, ATTACK]) {
            assert_eq!(report.matches(&named(&ink, ink.light)).count(), 2, "{}", ink.css);
        }
    }

    /// Relative luminance of `#rrggbb` (WCAG 2).
    fn luminance(hex: &str) -> f64 {
        let channel = |at: usize| {
            let c = f64::from(u8::from_str_radix(&hex[at..at + 2], 16).unwrap()) / 255.0;
            if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
        };
        0.2126 * channel(1) + 0.7152 * channel(3) + 0.0722 * channel(5)
    }

    #[test]
    fn letters_and_spaces_come_from_their_scales_and_none_is_below_twelve_pixels() {
        let sheets = [include_str!("../style.css"), include_str!("../report.css")];
        for size in ["--small: 12px", "--text: 13px", "--large: 16px", "--title: 22px"] {
            assert!(sheets.iter().all(|sheet| sheet.matches(size.split_once(' ').unwrap().0).count() == 1), "{size}");
            assert!(sheets.iter().all(|sheet| sheet.contains(size)), "{size}");
        }
        let rules = || sheets.into_iter().flat_map(|sheet| sheet.split(['{', '}', ';']).map(str::trim));
        for (name, value) in rules().filter_map(|rule| rule.split_once(": ")) {
            let sized = ["inherit", "var(--small)", "var(--text)", "var(--large)", "var(--title)"];
            match name {
                "font-size" => assert!(sized.contains(&value), "font-size: {value}"),
                // What stands alone may name its own.
                "font" if !value.starts_with("13px/") => {
                    assert!(sized.iter().any(|size| value.contains(size)), "font: {value}");
                }
                _ if ["padding", "margin", "gap"].iter().any(|space| name.starts_with(space)) => {
                    let pixels = value.split([' ', '(', ')']).filter_map(|part| part.strip_suffix("px")?.parse().ok());
                    for space in pixels.filter(|px: &f64| (0.0..=16.0).contains(px)) {
                        assert!([0.0, 2.0, 4.0, 6.0, 8.0, 12.0, 16.0].contains(&space), "{name}: {value}");
                    }
                }
                _ => {}
            }
        }
    }

    #[test]
    fn the_style_sheet_names_every_colour_and_words_stand_out_from_what_they_are_written_on() {
        let style = include_str!("../style.css");
        let (light, rest) = style.split_once("\n}\n").unwrap();
        let (dark, rules) = rest.split_once("\n}\n").unwrap();
        for literal in ["rgb(", "hsl(", "#"] {
            assert!(!rules.contains(literal), "{literal} outside of the two themes: the dark one would not change it");
        }
        let of = |theme: &str, name: &str| {
            let name = format!("--{name}: ");
            theme.split_once(&name).map(|(_, value)| value[..7].to_owned())
        };
        let pairs = [
            ("ink", "card"),
            ("ink", "page"),
            ("quiet", "card"),
            ("quiet", "page"),
            ("faint", "card"),
            ("good", "card"),
            ("warn", "card"),
            ("bad", "card"),
            ("ink", "warn-fill"),
            ("ink", "bad-fill"),
            ("pressed-ink", "pressed"),
            ("cut-ink", "cut"),
            ("armed-ink", "armed"),
            ("attack-ink", "attack"),
            ("rejected-ink", "rejected"),
        ];
        for (name, theme) in [("light", light), ("dark", dark)] {
            // What the dark theme does not name is as in the light one.
            let color = |part| of(theme, part).or_else(|| of(light, part)).unwrap();
            for (ink, fill) in pairs {
                let (a, b) = (luminance(&color(ink)), luminance(&color(fill)));
                let contrast = (a.max(b) + 0.05) / (a.min(b) + 0.05);
                assert!(contrast >= 4.5, "{name}: --{ink} on --{fill} has a contrast of {contrast:.2}");
            }
        }
    }
}
