//! Receiver operating characteristic: what a threshold on a measure tells attacked flights from others by.
//!
//! A flight raises the alarm where its score exceeds the threshold. The area under the curve is the probability that an attacked
//! flight scores higher than another, ties counting half (Mann & Whitney 1947).

/// A curve, from no alarm at all to every flight alarmed.
#[derive(Debug, Clone, PartialEq)]
pub struct Roc {
    /// Part of the flights without an attack that are alarmed, part of the attacked ones; rising.
    pub points: Vec<[f64; 2]>,
    /// Area under it, 0 to 1; one half is chance.
    pub area: f64,
}

/// Of these scores; `None` where one of the two has none.
pub fn roc(attacked: &[f64], clean: &[f64]) -> Option<Roc> {
    let mut scores: Vec<(f64, bool)> = attacked.iter().map(|score| (*score, true)).collect();
    scores.extend(clean.iter().map(|score| (*score, false)));
    scores.retain(|(score, _)| score.is_finite());
    scores.sort_by(|a, b| b.0.total_cmp(&a.0));
    let positives = scores.iter().filter(|(_, attacked)| *attacked).count();
    let totals = [(scores.len() - positives) as f64, positives as f64];
    if totals.contains(&0.0) {
        return None;
    }
    let (mut points, mut alarmed) = (vec![[0.0; 2]], [0.0; 2]);
    // Flights of the same score are alarmed together.
    for tied in scores.chunk_by(|a, b| a.0 == b.0) {
        let found = tied.iter().filter(|(_, attacked)| *attacked).count() as f64;
        alarmed = [alarmed[0] + tied.len() as f64 - found, alarmed[1] + found];
        points.push([alarmed[0] / totals[0], alarmed[1] / totals[1]]);
    }
    let area = points.windows(2).map(|pair| match pair {
        [from, to] => (to[0] - from[0]) * 0.5 * (from[1] + to[1]),
        _ => 0.0,
    });
    let area = area.sum();
    Some(Roc { points, area })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_is_the_probability_that_an_attacked_flight_scores_higher() {
        let area = |attacked: &[f64], clean: &[f64]| roc(attacked, clean).unwrap().area;
        assert_eq!(area(&[3.0, 4.0], &[1.0, 2.0]), 1.0);
        assert_eq!(area(&[1.0, 2.0], &[3.0, 4.0]), 0.0);
        assert_eq!(area(&[1.0, 1.0], &[1.0, 1.0, 1.0]), 0.5);
        // Pairs: 2 > 1, 2 = 2, 4 > 1, 4 > 2.
        assert_eq!(area(&[2.0, 4.0], &[1.0, 2.0]), 0.875);
        // What was not measured counts nowhere; of nothing there is no curve.
        assert_eq!(area(&[f64::NAN, 3.0], &[1.0]), 1.0);
        assert!(roc(&[f64::NAN], &[1.0]).is_none() && roc(&[1.0], &[]).is_none());
    }

    #[test]
    fn a_curve_rises_from_no_alarm_to_all() {
        let curve = roc(&[2.0, 4.0], &[1.0, 2.0]).unwrap();
        assert_eq!(curve.points, [[0.0, 0.0], [0.0, 0.5], [0.5, 1.0], [1.0, 1.0]]);
    }
}
