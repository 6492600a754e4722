//! Samples taken of a vehicle in somebody's hands, as they are shown: which poses are held, which sectors of the sphere were seen, and
//! in which words. What is enough is counted by the ground, with the fits' own code.

use std::f64::consts::{PI, TAU};

use plumbline_rest::calibration::{Aim, Taken};

/// The six sides a vehicle can be put on: name, and where up is then, body FLU.
pub const FACES: [(&str, [f64; 3]); 6] = [
    ("level", [0.0, 0.0, 1.0]),
    ("upside down", [0.0, 0.0, -1.0]),
    ("nose up", [1.0, 0.0, 0.0]),
    ("nose down", [-1.0, 0.0, 0.0]),
    ("on its left side", [0.0, -1.0, 0.0]),
    ("on its right side", [0.0, 1.0, 0.0]),
];
/// A pose nearer than this to a side is that side: 35°.
const NEAR: f64 = 0.819;

/// The side a vehicle is on when up is there in its body; `None` in between.
pub fn face(up: [f64; 3]) -> Option<usize> {
    let along = |of: &[f64; 3]| of.iter().zip(up).map(|(a, b)| a * b).sum::<f64>();
    FACES.iter().position(|(_, of)| along(of) >= NEAR)
}

/// A place for a pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Tile {
    /// What is asked for.
    pub name: String,
    /// Which side; `None` for one in between.
    pub face: Option<usize>,
    /// Was it held?
    pub done: bool,
    /// Is the vehicle in it now?
    pub now: bool,
}

/// The places to fill: the six sides, then as many in between as make `best` poses.
pub fn tiles(taken: &Taken) -> Vec<Tile> {
    let best = taken.aims.first().map_or(0, |aim| aim.best) as usize;
    let mut done = [false; FACES.len()];
    // A second pose near a side is one in between.
    let mut between = 0;
    for side in taken.poses.iter().map(|pose| face(*pose)) {
        match side.and_then(|side| done.get_mut(side)) {
            Some(done) if !*done => *done = true,
            _ => between += 1,
        }
    }
    let at = taken.up.map(face);
    let sides = FACES.iter().zip(done).enumerate().map(|(n, ((name, _), done))| Tile {
        name: (*name).to_owned(),
        face: Some(n),
        done,
        now: at == Some(Some(n)),
    });
    let room = best.saturating_sub(FACES.len()).max(between);
    let others = (0..room).map(|n| Tile {
        name: format!("in between {}", n + 1),
        face: None,
        done: n < between,
        now: at == Some(None) && n == between,
    });
    sides.chain(others).collect()
}

/// How to draw a vehicle on this side, seen from its left or, for the sides left and right, from behind: turn, ° clockwise.
pub fn turn_deg(face: usize) -> f64 {
    match FACES.get(face).map_or([0.0, 0.0, 1.0], |(_, up)| *up) {
        [_, _, z] if z < 0.0 => 180.0,
        [x, ..] if x > 0.0 => 90.0,
        [x, ..] if x < 0.0 => -90.0,
        [_, y, _] if y > 0.0 => 90.0,
        [_, y, _] if y < 0.0 => -90.0,
        _ => 0.0,
    }
}

/// How much is there of what is counted, in words: "4 of 10 …", and from when on the fit takes it.
pub fn told(aim: &Aim) -> String {
    let Aim { what, found, needed, best } = aim;
    // More than enough is enough.
    let found = if what.starts_with('%') { found } else { found.min(best) };
    if what.starts_with('%') {
        return format!("{found} {what}; {needed} % are enough");
    }
    let enough = if needed < best { format!("; {needed} are enough") } else { String::new() };
    // "9 of 18 sectors" has said how many there are.
    if what.starts_with("of ") {
        format!("{found} {what}{enough}")
    } else {
        format!("{found} of {best} {what}{enough}")
    }
}

/// What is to be done now, in a few words.
pub fn now(taken: &Taken) -> String {
    let whole = taken.aims.iter().all(|aim| aim.found >= aim.best);
    let side = taken.up.and_then(face).and_then(|face| FACES.get(face)).map_or("in between", |(name, _)| name);
    if !taken.problem.is_empty() {
        format!("Nothing is taken: {}.", taken.problem)
    } else if taken.aims.is_empty() || taken.samples == 0 {
        "Waiting for the first samples…".to_owned()
    } else if !taken.undetermined.is_empty() {
        format!("Turn it on, in directions that were not there yet: {}.", taken.undetermined)
    } else if whole {
        "Complete: fit it.".to_owned()
    } else if taken.up.is_some() {
        match taken.still {
            still if still >= 1.0 => format!("Held still, {side}: turn it on to the next pose."),
            still if still > 0.0 => format!("Hold it still, {side}…"),
            _ => "It moves: hold it still in a pose that is not there yet.".to_owned(),
        }
    } else {
        "Turn it slowly, until the field has come from everywhere.".to_owned()
    }
}

/// A half of the sphere as a disc of one area: which one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Half {
    /// z above 0.
    Upper,
    /// z below 0.
    Lower,
}

/// Radius of a height z on its disc, 0 to 1: Lambert's azimuthal projection, which keeps areas.
fn radius(z: f64) -> f64 {
    (1.0 - z.abs().min(1.0)).sqrt()
}

/// Where a direction is on its disc: x ahead is up, y left is left, as one looks down on the vehicle.
pub fn place([x, y, z]: [f64; 3]) -> (Half, [f64; 2]) {
    let (half, flat) = (if z < 0.0 { Half::Lower } else { Half::Upper }, x.hypot(y).max(1e-12));
    (half, [-y / flat * radius(z), -x / flat * radius(z)])
}

/// A sector of the sphere on one of the discs.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// Which disc.
    pub half: Half,
    /// Its outline, as SVG has it, the disc's radius being 1.
    pub path: String,
    /// Was the field seen in it?
    pub seen: bool,
}

/// Every sector; one that lies on both halves is drawn on both.
pub fn cells(bands: usize, seen: &[bool]) -> Vec<Cell> {
    let around = seen.len().checked_div(bands).unwrap_or(0);
    let mut cells = Vec::new();
    for (band, seen) in seen.chunks(around.max(1)).enumerate() {
        let height = |n: usize| 2.0 * n as f64 / bands as f64 - 1.0;
        let (low, high) = (height(band), height(band + 1));
        for half in [Half::Upper, Half::Lower] {
            let (near, far) = match half {
                Half::Upper => (high, low.max(0.0)),
                Half::Lower => (low, high.min(0.0)),
            };
            let is_on = match half {
                Half::Upper => high > 1e-9,
                Half::Lower => low < -1e-9,
            };
            for (n, seen) in seen.iter().enumerate().filter(|_| is_on) {
                let angle = |n: usize| TAU * n as f64 / around as f64 - PI;
                cells.push(Cell {
                    half,
                    path: outline(radius(near), radius(far), angle(n), angle(n + 1)),
                    seen: *seen,
                });
            }
        }
    }
    cells
}

/// Between two radii and two angles about z.
fn outline(inner: f64, outer: f64, from: f64, to: f64) -> String {
    let at = |radius: f64, angle: f64| format!("{:.4} {:.4}", -angle.sin() * radius, -angle.cos() * radius);
    let (a, b) = (at(outer, from), at(outer, to));
    // About z to the left: on the disc, whose y points down, that is against the clock.
    let arc = |radius: f64, sweep: u8, to: &str| format!("A{radius:.4} {radius:.4} 0 0 {sweep} {to}");
    if inner < 1e-6 {
        return format!("M0 0L{a}{}Z", arc(outer, 0, &b));
    }
    let (c, d) = (at(inner, to), at(inner, from));
    format!("M{a}{}L{c}{}Z", arc(outer, 0, &b), arc(inner, 1, &d))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn aim(found: u64, needed: u64, best: u64) -> Aim {
        Aim { what: "poses".into(), found, needed, best }
    }

    #[test]
    fn a_pose_fills_its_side_once_and_then_those_in_between() {
        let slant = [0.7, 0.1, 0.7];
        let taken = Taken {
            poses: vec![[0.0, 0.1, 0.99], [0.3, 0.0, 0.95], [0.0, -1.0, 0.0], slant],
            up: Some([-0.9, 0.0, 0.4]),
            aims: vec![aim(4, 7, 10)],
            ..Taken::default()
        };
        let all = tiles(&taken);
        let names = |of: fn(&Tile) -> bool| all.iter().filter(|t| of(t)).map(|t| t.name.as_str()).collect::<Vec<_>>();
        assert_eq!(all.len(), 10);
        assert_eq!(names(|t| t.done), ["level", "on its left side", "in between 1", "in between 2"]);
        assert_eq!(names(|t| t.now), ["nose down"]);
        let held = Taken { up: Some(slant), ..taken };
        assert_eq!(tiles(&held).iter().find(|t| t.now).map(|t| t.name.as_str()), Some("in between 3"));
        assert_eq!((face([0.0, 0.0, -1.0]), face(slant)), (Some(1), None));
        assert!(tiles(&Taken::default()).iter().all(|t| !t.done && !t.now));
    }

    #[test]
    fn the_vehicle_is_drawn_the_way_it_is_held() {
        assert_eq!(
            FACES
                .map(|(name, _)| name)
                .map(|name| { turn_deg(FACES.iter().position(|(of, _)| *of == name).unwrap_or_default()) }),
            [0.0, 180.0, 90.0, -90.0, -90.0, 90.0]
        );
    }

    #[test]
    fn the_sphere_lies_on_two_discs_of_one_area() {
        let mut seen = vec![false; 18];
        seen[17] = true;
        let cells = cells(3, &seen);
        // The middle band is on both.
        assert_eq!(cells.iter().filter(|c| c.half == Half::Upper).count(), 12);
        assert_eq!(cells.iter().filter(|c| c.seen).count(), 1);
        assert!(cells.iter().any(|c| c.path.starts_with("M0 0L")));
        assert_eq!(place([0.0, 0.0, 1.0]), (Half::Upper, [0.0, 0.0]));
        let (half, [x, y]) = place([0.6, 0.0, -0.8]);
        assert!(half == Half::Lower && x.abs() < 1e-9 && (y + 0.2_f64.sqrt()).abs() < 1e-9);
        // A third of the sphere's upper half is a third of the disc.
        assert!((radius(2.0 / 3.0).powi(2) - 1.0 / 3.0).abs() < 1e-9);
        assert!(super::cells(0, &[]).is_empty());
    }

    #[test]
    fn a_direction_lies_in_the_cell_of_its_sector() {
        // The sector of azimuth 0 to 60° about z: ahead and to the left, on the disc above and left of the middle.
        let mut seen = vec![false; 18];
        seen[12 + 3] = true;
        let all = cells(3, &seen);
        let cell = all.iter().find(|c| c.seen).map(|c| c.path.clone()).unwrap_or_default();
        let (_, at) = place([0.5_f64.cos() * 0.5, 0.5_f64.sin() * 0.5, 0.866]);
        assert!(at[0] < 0.0 && at[1] < 0.0);
        // From straight ahead to 60° to the left.
        let rim = radius(1.0 / 3.0);
        assert!(
            cell.starts_with(&format!("M0 0L{:.4} {:.4}A", 0.0, -rim))
                || cell.starts_with(&format!("M0 0L-{:.4} {:.4}A", 0.0, -rim)),
            "{cell}"
        );
        assert!(cell.contains(&format!("{:.4} {:.4}Z", -(PI / 3.0).sin() * rim, -(PI / 3.0).cos() * rim)), "{cell}");
    }

    #[test]
    fn words_say_what_is_missing() {
        assert_eq!(told(&aim(4, 7, 10)), "4 of 10 poses; 7 are enough");
        assert_eq!(told(&aim(12, 7, 10)), "10 of 10 poses; 7 are enough");
        let aim = |what: &str| Aim { what: what.into(), found: 5, needed: 8, best: 8 };
        assert_eq!(told(&aim("of 18 sectors")), "5 of 18 sectors");
        assert_eq!(told(&aim("% of its width")), "5 % of its width; 8 % are enough");
        let lost = Taken { problem: "the link is lost".into(), ..Taken::default() };
        assert_eq!(now(&lost), "Nothing is taken: the link is lost.");
        let held = Taken {
            up: Some([0.0, 0.0, 1.0]),
            still: 0.5,
            samples: 9,
            aims: vec![Aim { found: 1, ..aim("poses") }],
            ..Taken::default()
        };
        assert_eq!(now(&held), "Hold it still, level…");
        assert_eq!(now(&Taken { still: 1.0, ..held.clone() }), "Held still, level: turn it on to the next pose.");
        assert!(now(&Taken { still: 0.0, ..held.clone() }).contains("It moves"));
        let counted = Taken { aims: vec![Aim { found: 10, ..aim("poses") }], ..held };
        assert_eq!(now(&counted), "Complete: fit it.");
        let open = Taken { undetermined: "hard_y is not determined".into(), ..counted };
        assert_eq!(now(&open), "Turn it on, in directions that were not there yet: hard_y is not determined.");
    }
}
