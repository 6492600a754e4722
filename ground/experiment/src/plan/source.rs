//! The text of a plan: where in it a key stands, and what is wrong there.

use std::ops::Range;

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};

/// A plan that cannot be flown: the line, and what stands there that cannot be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("plan, line {line}: {message}")]
pub struct PlanError {
    /// Counted from 1.
    pub line: usize,
    /// Key, value and what is expected.
    pub message: String,
}

/// The text, to find lines in.
#[derive(Debug, Clone, Copy)]
pub(super) struct Source<'a> {
    text: &'a str,
}

impl<'a> Source<'a> {
    pub(super) fn new(text: &'a str) -> Self {
        Self { text }
    }

    fn line_of(self, offset: usize) -> usize {
        1 + self.text.bytes().take(offset).filter(|byte| *byte == b'\n').count()
    }

    /// What is wrong at `span`.
    pub(super) fn at(self, span: &Range<usize>, message: impl Into<String>) -> PlanError {
        PlanError { line: self.line_of(span.start), message: message.into() }
    }

    /// What is wrong with the key of this path; the line is that of the deepest part of it that is written.
    pub(super) fn of(self, path: &str, message: impl Into<String>) -> PlanError {
        let offset = DeTable::parse(self.text).map_or(0, |table| deepest(table.get_ref(), path));
        PlanError { line: self.line_of(offset), message: message.into() }
    }

    /// The whole text, read.
    ///
    /// # Errors
    /// What is no TOML, no key of a plan, or of another type.
    pub(super) fn read<T: DeserializeOwned>(self) -> Result<T, PlanError> {
        toml::from_str(self.text).map_err(|error| {
            let span = error.span().unwrap_or(0..0);
            let shown = self.text.get(span.clone()).unwrap_or_default().lines().next().unwrap_or_default();
            let value = if shown.is_empty() { String::new() } else { format!("`{}`: ", shown.trim()) };
            self.at(&span, format!("{value}{}", error.message()))
        })
    }

    /// The first number that is not finite.
    pub(super) fn not_finite(self) -> Option<PlanError> {
        let table = DeTable::parse(self.text).ok()?;
        let span = table.get_ref().values().find_map(|value| not_finite(value.get_ref(), &value.span()))?;
        let shown = self.text.get(span.clone()).unwrap_or_default();
        Some(self.at(&span, format!("{shown} is not a finite number")))
    }

    /// What a document made of the plan's tables complains about: a key in backticks is looked for by its name.
    pub(super) fn about(self, section: &str, complaint: &str) -> PlanError {
        // TOML's own messages show a text that is not the plan's; their last line says what is wrong.
        let message = complaint.lines().map(str::trim).rfind(|line| !line.is_empty()).unwrap_or_default();
        let quoted = message.split('`').nth(1);
        let assigned = message.split_once(" = ").and_then(|(before, _)| before.rsplit([' ', '.']).next());
        let inside = self.of(section, "").line;
        let lines = || self.text.lines().enumerate().skip(inside.saturating_sub(1));
        let key = |line: &'a str| line.split_once('=').map(|(key, _)| key.trim()).filter(|key| !key.is_empty());
        let named = |name: Option<&str>| lines().find(|(_, line)| name.is_some() && key(line) == name);
        let valued = || lines().find(|(_, line)| quoted.is_some_and(|quoted| line.contains(quoted)));
        let mentioned =
            || lines().find(|(_, line)| key(line).is_some_and(|key| message.split(' ').any(|word| word == key)));
        let line = named(quoted).or_else(|| named(assigned)).or_else(valued).or_else(mentioned);
        PlanError { line: line.map_or(inside, |(index, _)| index + 1), message: format!("{section}: {message}") }
    }
}

/// Where the deepest part of `path` stands, bytes.
fn deepest(table: &DeTable<'_>, path: &str) -> usize {
    let mut offset = 0;
    let mut table = table;
    for part in path.split('.') {
        let Some((key, value)) = table.iter().find(|(key, _)| key.get_ref() == part) else { break };
        offset = key.span().start;
        let Some(inner) = value.get_ref().as_table() else { break };
        table = inner;
    }
    offset
}

fn not_finite(value: &DeValue<'_>, span: &Range<usize>) -> Option<Range<usize>> {
    match value {
        DeValue::Float(float) => {
            let number: f64 = float.as_str().replace('_', "").parse().unwrap_or(f64::NAN);
            (!number.is_finite()).then(|| span.clone())
        }
        DeValue::Array(array) => array.iter().find_map(|value| not_finite(value.get_ref(), &value.span())),
        DeValue::Table(table) => table.values().find_map(|value| not_finite(value.get_ref(), &value.span())),
        _ => None,
    }
}
