//! Where shards lie: in [object storage](crate::objects).

use std::collections::BTreeSet;

use futures_util::TryStreamExt as _;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt as _};
use plumbline_experiment::part::{self, Part};
use plumbline_experiment::plan::Plan;
use plumbline_experiment::row::Row;

use super::ManyError;

/// What ends the name of a part's rows.
const ROWS: &str = ".rows";

/// A place for shards.
#[derive(Debug)]
pub struct Shards {
    store: Box<dyn ObjectStore>,
    prefix: Path,
    address: String,
}

impl Shards {
    /// A folder, which is made, or a URL.
    ///
    /// # Errors
    /// [`ManyError::Storage`]: neither.
    pub fn open(address: &str) -> Result<Self, ManyError> {
        let opened = crate::objects::open(address);
        let (store, prefix) = opened.map_err(|reason| ManyError::Storage { at: address.to_owned(), reason })?;
        Ok(Self { store, prefix, address: address.to_owned() })
    }

    fn failed(&self, error: &object_store::Error) -> ManyError {
        ManyError::Storage { at: self.address.clone(), reason: error.to_string() }
    }

    fn path(&self, id: &str, name: &str) -> Path {
        self.prefix.clone().join(id).join(name)
    }

    fn rows_path(&self, id: &str, part: Part) -> Path {
        self.path(id, &format!("{}{ROWS}", part.name()))
    }

    /// Is the shard of this part there?
    ///
    /// # Errors
    /// [`ManyError::Storage`].
    pub async fn has(&self, id: &str, part: Part) -> Result<bool, ManyError> {
        match self.store.head(&self.rows_path(id, part)).await {
            Ok(_) => Ok(true),
            Err(object_store::Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(self.failed(&error)),
        }
    }

    /// Keeps a shard: the table first, the rows with which it is there last.
    ///
    /// # Errors
    /// [`ManyError::Storage`]: the shard is not there.
    pub async fn put(&self, id: &str, plan: &Plan, part: Part, rows: &[Row]) -> Result<(), ManyError> {
        let failed = |error: std::io::Error| ManyError::Storage { at: self.address.clone(), reason: error.to_string() };
        let table = part::table(plan, rows).map_err(failed)?;
        let path = self.path(id, &format!("{}.parquet", part.name()));
        self.store.put(&path, table.into()).await.map_err(|error| self.failed(&error))?;
        let path = self.rows_path(id, part);
        self.store.put(&path, part::encode(rows).into()).await.map_err(|error| self.failed(&error))?;
        Ok(())
    }

    /// The names of all shards of an experiment.
    ///
    /// # Errors
    /// [`ManyError::Storage`].
    pub async fn names(&self, id: &str) -> Result<BTreeSet<String>, ManyError> {
        let listed = self.store.list(Some(&self.prefix.clone().join(id)));
        let names = listed.try_filter_map(|meta| {
            let name = meta.location.filename().filter(|name| name.ends_with(ROWS)).map(str::to_owned);
            std::future::ready(Ok(name))
        });
        names.try_collect().await.map_err(|error| self.failed(&error))
    }

    /// The rows of a shard; `None` when it is damaged, and is no longer there: it is to be flown again.
    ///
    /// # Errors
    /// [`ManyError::Storage`].
    pub async fn rows(&self, id: &str, name: &str) -> Result<Option<Vec<Row>>, ManyError> {
        let path = self.path(id, name);
        let got = self.store.get(&path).await.map_err(|error| self.failed(&error))?;
        let bytes = got.bytes().await.map_err(|error| self.failed(&error))?;
        let rows = part::decode(&bytes);
        if rows.is_none() {
            tracing::warn!(%path, "a damaged shard: its flights are flown again");
            self.store.delete(&path).await.map_err(|error| self.failed(&error))?;
        }
        Ok(rows)
    }
}
