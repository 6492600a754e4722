//! The operator's name: what a person chose, and four digits that tell this tab from others. `early.js` makes the first.

/// Longest name, characters; the ground takes 64 with the tab's digits.
const MOST: usize = 40;
/// Who has not said.
const NOBODY: &str = "Operator";

/// The name without what tells the tab.
pub fn name(operator: &str) -> &str {
    operator.rsplit_once(' ').map_or(operator, |(name, _)| name)
}

/// What a person typed, as the ground takes it: printable ASCII, no longer than it may be; "Operator" where nothing is left.
pub fn cleaned(typed: &str) -> String {
    let printable: String = typed.chars().filter(|c| c.is_ascii_graphic() || *c == ' ').collect();
    let short: String = printable.trim().chars().take(MOST).collect();
    if short.is_empty() { NOBODY.to_owned() } else { short.trim_end().to_owned() }
}

/// The same tab under a name that was cleaned.
pub fn renamed(operator: &str, name: &str) -> String {
    let tab = operator.rsplit_once(' ').map_or("", |(_, tab)| tab);
    format!("{name} {tab}").trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_what_the_ground_takes_and_the_tab_stays() {
        assert_eq!(cleaned("  Carla \u{d6} "), "Carla");
        assert_eq!(cleaned("Ann-Marie O'Neil"), "Ann-Marie O'Neil");
        assert_eq!(cleaned(" \t\u{1f681}"), "Operator");
        assert_eq!(cleaned(&format!("{} b", "a".repeat(39))), "a".repeat(39));
        let operator = renamed("Operator 0a1b", &cleaned("Carla B"));
        assert_eq!((operator.as_str(), name(&operator)), ("Carla B 0a1b", "Carla B"));
        assert_eq!(renamed(&operator, "Dora"), "Dora 0a1b");
        // A browser without storage gave no tab.
        assert_eq!(renamed("", "Dora"), "Dora");
    }
}
