//! Revisions of gains: who pushed what when, and what the agent said. Kept beside the flights.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use plumbline_file::write_atomically;
use plumbline_rest::design::Revision;
use serde_json::{Map, Value};

use crate::sync::lock;

/// Most revisions kept per vehicle; the oldest go first.
pub const MAX_REVISIONS: usize = 1000;

/// All revisions of all vehicles.
#[derive(Debug)]
pub struct GainsBook {
    folder: PathBuf,
    books: Mutex<BTreeMap<String, Vec<Revision>>>,
    /// Held while a book is written.
    writing: Mutex<()>,
}

impl GainsBook {
    /// The book kept in `data_folder`. Books are read when first asked for.
    pub fn open(data_folder: &Path) -> Self {
        Self { folder: data_folder.join("gains"), books: Mutex::default(), writing: Mutex::default() }
    }

    /// Revisions of `vehicle`, oldest first.
    pub fn revisions(&self, vehicle: &str) -> Vec<Revision> {
        self.with(vehicle, |book| book.clone())
    }

    /// The revision to go back to: number `wanted`, or without one the last accepted before `in_use`.
    ///
    /// # Errors
    /// A sentence: there is none.
    pub fn earlier(&self, vehicle: &str, wanted: Option<u32>, in_use: u32) -> Result<Revision, String> {
        self.with(vehicle, |book| {
            let found = match wanted {
                Some(number) => book.iter().find(|r| r.revision == number),
                None => book.iter().rev().find(|r| r.revision < in_use && r.stage == "accepted"),
            };
            found.cloned().ok_or_else(|| match wanted {
                Some(number) => format!("there is no revision {number} of {vehicle}"),
                None => format!("no accepted revision before {in_use} of {vehicle}"),
            })
        })
    }

    /// Enters a push that is about to be sent and gives it a number above every known one.
    pub fn begin(
        &self,
        vehicle: &str,
        in_use: u32,
        design: Map<String, Value>,
        operator: &str,
        pushed_unix_us: u64,
    ) -> u32 {
        let revision = self.with(vehicle, |book| {
            let last = book.iter().map(|r| r.revision).max().unwrap_or(0).max(in_use);
            let revision = last.saturating_add(1);
            book.push(Revision {
                revision,
                design,
                operator: operator.to_owned(),
                pushed_unix_us,
                stage: "unanswered".into(),
                reason: String::new(),
            });
            let surplus = book.len().saturating_sub(MAX_REVISIONS);
            book.drain(..surplus);
            revision
        });
        self.save(vehicle);
        revision
    }

    /// Notes what became of a push.
    pub fn answered(&self, vehicle: &str, revision: u32, stage: &str, reason: &str) {
        self.with(vehicle, |book| {
            if let Some(entry) = book.iter_mut().rev().find(|r| r.revision == revision) {
                stage.clone_into(&mut entry.stage);
                reason.clone_into(&mut entry.reason);
            }
        });
        self.save(vehicle);
    }

    fn with<T>(&self, vehicle: &str, work: impl FnOnce(&mut Vec<Revision>) -> T) -> T {
        let mut books = lock(&self.books);
        let book = books.entry(vehicle.to_owned()).or_insert_with(|| self.load(vehicle));
        work(book)
    }

    fn path(&self, vehicle: &str) -> PathBuf {
        let safe = |c: char| if c.is_ascii_alphanumeric() || c == '-' || c == '_' { c } else { '_' };
        self.folder.join(format!("{}.json", vehicle.chars().take(64).map(safe).collect::<String>()))
    }

    fn load(&self, vehicle: &str) -> Vec<Revision> {
        let path = self.path(vehicle);
        let Ok(text) = fs::read(&path) else { return Vec::new() };
        match serde_json::from_slice(&text) {
            Ok(book) => book,
            Err(error) => {
                let aside = path.with_extension("json.corrupt");
                tracing::error!(path = %path.display(), %error, "gains book is damaged, set aside as *.corrupt");
                let _ = fs::rename(&path, aside);
                Vec::new()
            }
        }
    }

    /// Writes a book as it is now. In turn, but not under the lock of the books: whoever reads them waits for no disk.
    fn save(&self, vehicle: &str) {
        let _turn = lock(&self.writing);
        let text = self.with(vehicle, |book| serde_json::to_vec_pretty(book).unwrap_or_default());
        if let Err(error) = write_atomically(&self.path(vehicle), &text) {
            tracing::error!(vehicle, %error, "gains book cannot be written");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn design() -> Map<String, Value> {
        let json = serde_json::json!({ "state_weight": vec![1.0; 16], "input_weight": vec![0.1; 4] });
        json.as_object().unwrap().clone()
    }

    #[test]
    fn revisions_grow_and_survive_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let book = GainsBook::open(folder.path());
        assert_eq!(book.begin("iris/1", 4, design(), "ann", 10), 5);
        assert_eq!(book.begin("iris/1", 0, design(), "bob", 11), 6);
        book.answered("iris/1", 5, "rejected", "slowest pole 0.2 1/s");
        let again = GainsBook::open(folder.path()).revisions("iris/1");
        assert_eq!(again.len(), 2);
        assert_eq!((again[0].stage.as_str(), again[1].stage.as_str()), ("rejected", "unanswered"));
    }

    #[test]
    fn a_damaged_book_is_set_aside() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("gains")).unwrap();
        fs::write(folder.path().join("gains/v.json"), "{").unwrap();
        let book = GainsBook::open(folder.path());
        assert!(book.revisions("v").is_empty());
        assert!(folder.path().join("gains/v.json.corrupt").exists());
    }

    #[test]
    fn the_way_back_is_the_last_accepted_or_the_one_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        let book = GainsBook::open(folder.path());
        for stage in ["accepted", "rejected", "accepted"] {
            let number = book.begin("v", 0, design(), "ann", 10);
            book.answered("v", number, stage, "");
        }
        assert_eq!(book.earlier("v", None, 3).unwrap().revision, 1);
        assert_eq!(book.earlier("v", Some(2), 3).unwrap().design, design());
        assert_eq!(book.earlier("v", None, 1).unwrap_err(), "no accepted revision before 1 of v");
        assert_eq!(book.earlier("v", Some(9), 1).unwrap_err(), "there is no revision 9 of v");
    }
}
