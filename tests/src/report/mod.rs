//! Reports of campaigns: JSON lines on standard output, and a folder with `index.html` (plots inline
//! as SVG), a CSV for every figure and table, and the same JSON lines in `values.jsonl`.
//!
//! ```no_run
//! # use plumbline_tests::report::{Plot, Report, Series};
//! # fn main() -> Result<(), plumbline_tests::report::ReportError> {
//! let mut report = Report::open("reproduce", "clinic", "Secure state estimation, [Clinic]")?;
//! report.value("table_1/none", 1.03, "e*", serde_json::json!({ "limit": 1.2 }));
//! let plot = Plot::new("Height error", "t, s", "e, m").with(Series::line("secure", vec![(0.0, 0.1), (1.0, 0.05)]));
//! report.figure("height_error", "Height 2 lies from 5 s on.", &plot)?;
//! report.finish()?;
//! # Ok(())
//! # }
//! ```

mod html;
mod plot;

use std::path::{Path, PathBuf};

pub use plot::{Axis, Plot, Series, Style};
use serde_json::Value;

/// Why a report could not be written.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// A file of the report.
    #[error("{}: {source}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// A plot.
    #[error("plot `{plot}`: {reason}")]
    Plot {
        /// Its title.
        plot: String,
        /// Cause.
        reason: String,
    },
}

/// A report being written. What was measured is on standard output at once, the page at [`Report::finish`].
#[derive(Debug)]
pub struct Report {
    folder: PathBuf,
    kind: String,
    name: String,
    title: String,
    body: String,
    values: Vec<Value>,
}

impl Report {
    /// A report in `target/KIND/NAME` of the workspace; one that is there already is replaced.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub fn open(kind: &str, name: &str, title: &str) -> Result<Self, ReportError> {
        let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(
            || Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new(".")).join("target"),
            PathBuf::from,
        );
        Self::open_in(&target.join(kind).join(name), kind, name, title)
    }

    /// A report in `folder`.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub fn open_in(folder: &Path, kind: &str, name: &str, title: &str) -> Result<Self, ReportError> {
        std::fs::create_dir_all(folder).map_err(|source| ReportError::File { path: folder.into(), source })?;
        Ok(Self {
            folder: folder.into(),
            kind: kind.into(),
            name: name.into(),
            title: title.into(),
            body: String::new(),
            values: Vec::new(),
        })
    }

    /// A heading.
    pub fn heading(&mut self, text: &str) {
        self.body += &format!("<h2>{}</h2>\n", html::escape(text));
    }

    /// A paragraph of plain text.
    pub fn paragraph(&mut self, text: &str) {
        self.body += &format!("<p>{}</p>\n", html::escape(text));
    }

    /// One figure measured: `{"KIND": "NAME", "name", "value", "unit", …more}`; a value that is not finite is `null`.
    pub fn value(&mut self, name: &str, value: f64, unit: &str, more: Value) {
        let mut line = serde_json::json!({ "name": name, "value": value, "unit": unit });
        if let (Value::Object(line), Value::Object(more)) = (&mut line, more) {
            line.insert(self.kind.clone(), Value::String(self.name.clone()));
            line.extend(more);
        }
        println!("{line}");
        self.values.push(line);
    }

    /// Something that could not be measured here, and why: `{…, "name", "skipped": "reason"}`.
    pub fn skipped(&mut self, name: &str, reason: &str) {
        let mut line = serde_json::json!({ "name": name, "skipped": reason });
        if let Value::Object(line) = &mut line {
            line.insert(self.kind.clone(), Value::String(self.name.clone()));
        }
        println!("{line}");
        self.values.push(line);
        self.body += &format!("<p class=skipped>{}: skipped: {}</p>\n", html::escape(name), html::escape(reason));
    }

    /// A plot; its points are beside the page as `STEM.csv`.
    ///
    /// # Errors
    /// The plot has no finite point, or a file cannot be written.
    pub fn figure(&mut self, stem: &str, caption: &str, plot: &Plot) -> Result<(), ReportError> {
        let svg = plot.svg()?;
        self.write(&format!("{stem}.csv"), &plot.csv())?;
        self.body += &format!(
            "<figure>{svg}<figcaption>{} <a href=\"{stem}.csv\">CSV</a></figcaption></figure>\n",
            html::escape(caption)
        );
        Ok(())
    }

    /// A table, also as `STEM.csv`. Cells that begin with a digit or a sign are set as numbers.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn table(
        &mut self,
        stem: &str,
        caption: &str,
        headers: &[&str],
        rows: &[Vec<String>],
    ) -> Result<(), ReportError> {
        let line =
            |cells: &mut dyn Iterator<Item = &str>| cells.map(html::csv_cell).collect::<Vec<_>>().join(",") + "\n";
        let mut csv = line(&mut headers.iter().copied());
        rows.iter().for_each(|row| csv += &line(&mut row.iter().map(String::as_str)));
        self.write(&format!("{stem}.csv"), &csv)?;
        self.body += &html::table(stem, caption, headers, rows);
        Ok(())
    }

    /// Writes the page and the values.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn finish(self) -> Result<PathBuf, ReportError> {
        let lines: String = self.values.iter().map(|line| format!("{line}\n")).collect();
        self.write("values.jsonl", &lines)?;
        let page = html::page(&self.title, &self.body, &self.values);
        let path = self.write("index.html", &page)?;
        eprintln!("report: {}", path.display());
        Ok(path)
    }

    fn write(&self, file: &str, text: &str) -> Result<PathBuf, ReportError> {
        let path = self.folder.join(file);
        match std::fs::write(&path, text) {
            Ok(()) => Ok(path),
            Err(source) => Err(ReportError::File { path, source }),
        }
    }
}

#[cfg(test)]
mod tests;
