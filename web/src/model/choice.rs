//! Lists of what was chosen: each thing once, the last chosen at the end.

/// Puts `one` into the list, or takes it out.
pub fn choose<T: PartialEq>(all: &mut Vec<T>, one: T, on: bool) {
    all.retain(|known| *known != one);
    if on {
        all.push(one);
    }
}

/// Takes `one` out where it is in the list, else puts it in.
pub fn toggle<T: PartialEq>(all: &mut Vec<T>, one: T) {
    let on = !all.contains(&one);
    choose(all, one, on);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_chosen_is_there_once_and_last() {
        let mut all = vec![1, 2, 3];
        choose(&mut all, 1, true);
        assert_eq!(all, [2, 3, 1]);
        choose(&mut all, 3, false);
        choose(&mut all, 3, false);
        assert_eq!(all, [2, 1]);
        toggle(&mut all, 2);
        toggle(&mut all, 7);
        assert_eq!(all, [1, 7]);
    }
}
