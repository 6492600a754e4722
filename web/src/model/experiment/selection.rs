//! Which conditions and flights of an experiment are shown, and in which order.

use std::collections::{BTreeMap, BTreeSet};

use plumbline_rest::experiment::{Condition, Flight, Results, Spread};

/// A column that conditions are sorted by.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Column {
    /// The levels of the factor with this key.
    Factor(String),
    /// The part of flights that was lost.
    Lost,
    /// Of the measure.
    Median,
    /// 95 of 100 flights are below.
    Of95,
    /// The largest of the measure.
    Worst,
    /// The part of flights whose attacked sensors were all excluded.
    Found,
}

impl Column {
    /// Those that are no factor.
    pub const FIGURES: [Self; 5] = [Self::Lost, Self::Median, Self::Of95, Self::Worst, Self::Found];

    /// As the head of the table and the address name it.
    pub fn name(&self) -> &str {
        match self {
            Self::Factor(key) => key,
            Self::Lost => "lost",
            Self::Median => "median",
            Self::Of95 => "95 of 100",
            Self::Worst => "worst",
            Self::Found => "found",
        }
    }

    fn read(name: &str) -> Self {
        let figure = Self::FIGURES.into_iter().find(|column| column.name() == name);
        figure.unwrap_or_else(|| Self::Factor(name.to_owned()))
    }
}

/// What of an experiment is shown; the page's address keeps it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Selection {
    /// Name of the measure; the first measure where there is none of that name.
    pub measure: String,
    /// The level shown of a factor, by its key; of others all are.
    pub levels: BTreeMap<String, String>,
    /// `None`: conditions are in the order of the plan.
    pub sort: Option<Column>,
    /// The greatest first?
    pub descending: bool,
}

/// Names of what an address keeps.
const MEASURE: &str = "measure";
const LEVEL: &str = "level";
const SORT: &str = "sort";

impl Selection {
    /// What an address keeps, given each value that it has of a name.
    pub fn read(all: impl Fn(&str) -> Vec<String>) -> Self {
        let first = |name| all(name).into_iter().next().unwrap_or_default();
        let sort = first(SORT);
        let column = sort.strip_prefix('-').unwrap_or(&sort);
        let level = |text: &String| text.split_once('=').map(|(key, level)| (key.to_owned(), level.to_owned()));
        Self {
            measure: first(MEASURE),
            levels: all(LEVEL).iter().filter_map(level).collect(),
            sort: (!column.is_empty()).then(|| Column::read(column)),
            descending: sort.starts_with('-'),
        }
    }

    /// The reverse.
    pub fn query(&self) -> Vec<(&'static str, String)> {
        let sign = if self.descending { "-" } else { "" };
        let measure = Some(&self.measure).filter(|name| !name.is_empty()).map(|name| (MEASURE, name.clone()));
        let levels = self.levels.iter().map(|(key, level)| (LEVEL, format!("{key}={level}")));
        let sort = self.sort.iter().map(|column| (SORT, format!("{sign}{}", column.name())));
        measure.into_iter().chain(levels).chain(sort).collect()
    }

    /// Sorts by another column, figures with the greatest first; or by the same the other way round.
    pub fn sort_by(&mut self, column: Column) {
        let same = self.sort.as_ref() == Some(&column);
        self.descending = if same { !self.descending } else { !matches!(column, Column::Factor(_)) };
        self.sort = Some(column);
    }

    /// Place of the measure.
    pub fn measure(&self, results: &Results) -> usize {
        results.measures.iter().position(|measure| measure.name == self.measure).unwrap_or(0)
    }

    /// Conditions that have the levels, in their order. A level that no condition has holds nothing back.
    pub fn conditions<'a>(&self, results: &'a Results) -> Vec<&'a Condition> {
        let all = &results.conditions;
        let has = |condition: &Condition, place: usize, level: &String| condition.levels.get(place) == Some(level);
        let wanted: Vec<(usize, &String)> = results
            .factors
            .iter()
            .enumerate()
            .filter_map(|(place, key)| Some((place, self.levels.get(key)?)))
            .filter(|(place, level)| all.iter().any(|condition| has(condition, *place, level)))
            .collect();
        let shown = all.iter().filter(|condition| wanted.iter().all(|(place, level)| has(condition, *place, level)));
        let Some(column) = &self.sort else { return shown.collect() };
        let figure = Figure::new(column, self.measure(results), results);
        let sign = if self.descending { -1.0 } else { 1.0 };
        // Conditions without a figure come last, whichever way.
        let key = |condition: &Condition| figure.of(condition).map_or(f64::INFINITY, |figure| sign * figure);
        let mut sorted: Vec<_> = shown.map(|condition| (key(condition), condition)).collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        sorted.into_iter().map(|(_, condition)| condition).collect()
    }

    /// The condition whose own flights are asked for: the only one shown of more than `most` flights.
    pub fn alone(&self, results: &Results, most: usize) -> Option<u64> {
        match self.conditions(results).as_slice() {
            [condition] if flown(&results.conditions) > most as u64 => Some(condition.number),
            _ => None,
        }
    }
}

/// What a condition is sorted by.
struct Figure<'a> {
    column: &'a Column,
    measure: usize,
    /// Place of the factor, and its levels.
    factor: Option<(usize, Vec<&'a str>)>,
}

impl<'a> Figure<'a> {
    fn new(column: &'a Column, measure: usize, results: &'a Results) -> Self {
        let place = results.factors.iter().position(|key| key == column.name());
        Self { column, measure, factor: place.map(|place| (place, levels(&results.conditions, place))) }
    }

    fn of(&self, condition: &Condition) -> Option<f64> {
        let spread = |of: fn(Spread) -> f64| condition.measures.get(self.measure).copied().flatten().map(of);
        let part = |count: u64, of: u64| (of > 0).then(|| count as f64 / of as f64);
        match self.column {
            Column::Factor(_) => {
                let (place, levels) = self.factor.as_ref()?;
                let own = condition.levels.get(*place)?;
                levels.iter().position(|level| level == own).map(|rank| rank as f64)
            }
            Column::Lost => part(condition.lost.values().sum(), condition.flights),
            Column::Median => spread(|spread| spread.median),
            Column::Of95 => spread(|spread| spread.of_95),
            Column::Worst => spread(|spread| spread.most),
            Column::Found => condition.detected.and_then(|found| part(found.count, found.of)),
        }
    }
}

/// The levels of the factor at this place, each once: numbers by size, others as the plan has them.
pub fn levels(conditions: &[Condition], place: usize) -> Vec<&str> {
    let mut seen = BTreeSet::new();
    let levels = conditions.iter().filter_map(|condition| condition.levels.get(place)).map(String::as_str);
    let mut levels: Vec<&str> = levels.filter(|level| seen.insert(*level)).collect();
    let number = |level: &str| level.parse::<f64>();
    // A list of conditions may leave a factor as it is.
    if levels.iter().all(|level| level.is_empty() || number(level).is_ok()) {
        let size = |level: &str| number(level).unwrap_or(f64::NEG_INFINITY);
        levels.sort_by(|a, b| size(a).total_cmp(&size(b)));
    }
    levels
}

/// Flights that are there of these conditions.
pub fn flown<'a>(conditions: impl IntoIterator<Item = &'a Condition>) -> u64 {
    conditions.into_iter().map(|condition| condition.flights).sum()
}

/// The flights of these conditions, the worst of a measure first: before all the lost ones, last those of which it is not known.
pub fn worst_first<'a>(
    flights: &'a [Flight],
    conditions: &[&'a Condition],
    measure: usize,
) -> Vec<(&'a Flight, &'a Condition)> {
    let of: BTreeMap<u64, &Condition> = conditions.iter().map(|condition| (condition.number, *condition)).collect();
    let mut listed: Vec<_> = flights.iter().filter_map(|flight| Some((flight, *of.get(&flight.condition)?))).collect();
    let badness = |flight: &Flight| {
        if flight.lost.is_empty() { value(flight, measure).unwrap_or(f64::NEG_INFINITY) } else { f64::INFINITY }
    };
    listed.sort_by(|a, b| badness(b.0).total_cmp(&badness(a.0)));
    listed
}

/// What a flight has of a measure.
pub fn value(flight: &Flight, measure: usize) -> Option<f64> {
    flight.values.get(measure).copied().flatten()
}

#[cfg(test)]
mod tests {
    use plumbline_rest::experiment::{Measure, Part};

    use super::*;

    /// Two estimators at three sizes; the last has no measure.
    fn results() -> Results {
        let condition = |number: u64, estimator: &str, size: &str, most: Option<f64>| Condition {
            number,
            levels: vec![estimator.into(), size.into(), "free".into()],
            flights: 10,
            lost: [("fell".to_owned(), number % 3)].into(),
            measures: vec![None, most.map(|most| Spread { most, median: most / 2.0, ..Spread::default() })],
            detected: (number > 0).then(|| Part { count: 6 - number, of: 10, ..Part::default() }),
            ..Condition::default()
        };
        Results {
            factors: ["agent.estimators.in_loop", "attack.magnitude", "rig"].map(str::to_owned).into(),
            measures: ["first", "second"].map(|name| Measure { name: name.into(), ..Measure::default() }).into(),
            conditions: vec![
                condition(0, "lanes", "0.5", Some(3.0)),
                condition(1, "lanes", "2", Some(1.0)),
                condition(2, "lanes", "10", Some(2.0)),
                condition(3, "ekf_bias", "0.5", Some(5.0)),
                condition(4, "ekf_bias", "2", Some(4.0)),
                condition(5, "ekf_bias", "10", None),
            ],
            ..Results::default()
        }
    }

    fn shown(selection: &Selection) -> Vec<u64> {
        selection.conditions(&results()).iter().map(|condition| condition.number).collect()
    }

    fn holding(levels: &[(&str, &str)]) -> Selection {
        let levels = levels.iter().map(|(key, level)| ((*key).to_owned(), (*level).to_owned())).collect();
        Selection { measure: "second".into(), levels, ..Selection::default() }
    }

    #[test]
    fn conditions_with_the_levels_are_shown() {
        assert_eq!(shown(&Selection::default()), [0, 1, 2, 3, 4, 5]);
        assert_eq!(shown(&holding(&[("attack.magnitude", "2")])), [1, 4]);
        assert_eq!(shown(&holding(&[("attack.magnitude", "2"), ("agent.estimators.in_loop", "ekf_bias")])), [4]);
        let unknown = holding(&[("attack.magnitude", "3"), ("no.factor", "2")]);
        assert_eq!(shown(&unknown), [0, 1, 2, 3, 4, 5], "what no condition has holds nothing back");
    }

    #[test]
    fn every_column_sorts_both_ways_and_what_has_no_figure_comes_last() {
        let mut selection = holding(&[]);
        let mut press = |column: &Column| {
            selection.sort_by(column.clone());
            shown(&selection)
        };
        assert_eq!(press(&Column::Worst), [3, 4, 0, 2, 1, 5]);
        assert_eq!(press(&Column::Worst), [1, 2, 0, 4, 3, 5]);
        assert_eq!(press(&Column::Median), [3, 4, 0, 2, 1, 5]);
        assert_eq!(press(&Column::Lost), [2, 5, 1, 4, 0, 3]);
        assert_eq!(press(&Column::Found), [1, 2, 3, 4, 5, 0]);
        assert_eq!(press(&Column::Of95), [0, 1, 2, 3, 4, 5], "equal ones stay in the order of the plan");
        let size = Column::Factor("attack.magnitude".into());
        assert_eq!([press(&size), press(&size)], [[0, 3, 1, 4, 2, 5], [2, 5, 1, 4, 0, 3]], "numbers by size");
        assert_eq!(press(&Column::Factor("agent.estimators.in_loop".into())), [0, 1, 2, 3, 4, 5], "words as planned");
    }

    #[test]
    fn levels_are_named_once_and_numbers_are_sorted() {
        let results = results();
        assert_eq!(levels(&results.conditions, 0), ["lanes", "ekf_bias"]);
        assert_eq!(levels(&results.conditions, 1), ["0.5", "2", "10"]);
        assert_eq!((levels(&results.conditions, 2), levels(&results.conditions, 9)), (vec!["free"], vec![]));
        let sparse = ["3", "", "-1"].map(|level| Condition { levels: vec![level.into()], ..Condition::default() });
        assert_eq!(levels(&sparse, 0), ["", "-1", "3"]);
    }

    #[test]
    fn an_address_keeps_what_is_shown() {
        let sorted = |sort: Option<Column>, descending| Selection {
            sort,
            descending,
            ..holding(&[("scenario.rig", "free height_m=0.0"), ("attack.magnitude", "")])
        };
        for selection in [
            Selection::default(),
            sorted(Some(Column::Of95), true),
            sorted(Some(Column::Factor("attack.magnitude".into())), false),
        ] {
            let query = selection.query();
            let all = |name: &str| query.iter().filter(|(key, _)| *key == name).map(|(_, text)| text.clone()).collect();
            assert_eq!(Selection::read(all), selection);
        }
        assert!(Selection::default().query().is_empty());
        assert_eq!(holding(&[]).measure(&results()), 1);
        let unknown = Selection { measure: "third".into(), ..Selection::default() };
        assert_eq!(unknown.measure(&results()), 0);
    }

    #[test]
    fn one_condition_of_too_many_flights_has_its_own_asked_for() {
        let alone = holding(&[("attack.magnitude", "2"), ("agent.estimators.in_loop", "ekf_bias")]);
        assert_eq!([59, 60].map(|most| alone.alone(&results(), most)), [Some(4), None]);
        assert_eq!(holding(&[("attack.magnitude", "2")]).alone(&results(), 10), None);
    }

    #[test]
    fn the_worst_flights_are_listed_first() {
        let flight = |index: u64, condition: u64, value: Option<f64>, lost: &str| Flight {
            index,
            condition,
            lost: lost.into(),
            values: vec![None, value],
            ..Flight::default()
        };
        let flights = [
            flight(0, 1, Some(0.1), ""),
            flight(1, 1, None, ""),
            flight(2, 2, Some(9.0), ""),
            flight(3, 1, Some(0.3), ""),
            flight(4, 4, Some(0.2), "fell"),
            flight(5, 4, Some(0.3), ""),
        ];
        let (results, selection) = (results(), holding(&[("attack.magnitude", "2")]));
        let listed = worst_first(&flights, &selection.conditions(&results), 1);
        let found: Vec<_> = listed.iter().map(|(flight, condition)| (flight.index, condition.number)).collect();
        assert_eq!(found, [(4, 4), (3, 1), (5, 4), (0, 1), (1, 1)]);
    }
}
