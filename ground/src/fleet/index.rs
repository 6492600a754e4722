//! The shared index: a table in PostgreSQL, of which every ground keeps a copy.
//!
//! Each change has a number. Changes are made one at a time, under a lock of the table: whoever has seen one has seen all before it.

use std::sync::Arc;
use std::time::Duration;

use rustls::{ClientConfig, RootCertStore};
use tokio_postgres::config::Host;
use tokio_postgres::{Client, Config, Error, Row, Transaction};
use tokio_postgres_rustls::MakeRustlsConnect;

use super::FleetError;
use super::mirror::Entry;
use crate::recorder::Labels;

/// A server that does not answer for so long is away.
const PATIENCE: Duration = Duration::from_secs(5);
/// Changes read at a time.
const PAGE: i64 = 500;

const TABLES: &str = "
CREATE TABLE IF NOT EXISTS plumbline_database (id UUID NOT NULL DEFAULT gen_random_uuid());
CREATE TABLE IF NOT EXISTS plumbline_flights (
    id TEXT PRIMARY KEY, revision BIGINT NOT NULL UNIQUE, ground TEXT NOT NULL, object TEXT NOT NULL, sha256 TEXT NOT NULL,
    size BIGINT NOT NULL, messages BIGINT NOT NULL, name TEXT NOT NULL, notes TEXT NOT NULL, flight JSONB NOT NULL,
    deleted BOOLEAN NOT NULL DEFAULT false)";
const COLUMNS: &str = "id, revision, ground, object, sha256, size, messages, name, notes, flight::text, deleted";
/// Two grounds that make the tables at the same time would be in each other's way.
const MAKING: i64 = 0x706c_756d_626c;
const LOCK: &str = "LOCK TABLE plumbline_flights IN EXCLUSIVE MODE";
const NEXT: &str = "(SELECT coalesce(max(revision), 0) + 1 FROM plumbline_flights)";

/// How the server is reached.
#[derive(Debug, Clone)]
pub(super) struct Database {
    config: Config,
    at: String,
}

/// A connection to it.
pub(super) struct Connected {
    client: Client,
    at: String,
    /// Which database this is; one made anew has another.
    pub(super) database: String,
}

/// The server's own words.
fn explain(error: &Error) -> String {
    let mut text = error.as_db_error().map_or_else(|| error.to_string(), |error| error.message().to_owned());
    if error.as_db_error().is_none()
        && let Some(source) = std::error::Error::source(error)
    {
        text = format!("{text}: {source}");
    }
    text
}

impl Database {
    /// Of a URL or a line of `key=value`, as libpq has them.
    ///
    /// # Errors
    /// [`FleetError::Settings`]; the line is not told, for it may hold a password.
    pub(super) fn parse(text: &str) -> Result<Self, FleetError> {
        let mut config: Config =
            text.parse().map_err(|error: Error| FleetError::Settings(format!("fleet_index: {}", explain(&error))))?;
        if config.get_hosts().is_empty() {
            return Err(FleetError::Settings("fleet_index names no host".into()));
        }
        let hosts = config.get_hosts().iter().map(|host| match host {
            Host::Tcp(name) => name.clone(),
            Host::Unix(path) => path.display().to_string(),
        });
        let at = format!("{}/{}", hosts.collect::<Vec<_>>().join(","), config.get_dbname().unwrap_or("postgres"));
        config.connect_timeout(PATIENCE).tcp_user_timeout(PATIENCE).application_name("plumbline");
        Ok(Self { config, at })
    }

    pub(super) fn at(&self) -> &str {
        &self.at
    }

    fn failed(&self, error: &Error) -> FleetError {
        FleetError::Index { at: self.at.clone(), reason: explain(error) }
    }

    /// Connects, and makes the tables where they are not there.
    pub(super) async fn connect(&self) -> Result<Connected, FleetError> {
        let mut roots = RootCertStore::empty();
        roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let tls = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions();
        let tls = tls.map_err(|error| FleetError::Settings(error.to_string()))?;
        let tls = MakeRustlsConnect::new(tls.with_root_certificates(roots).with_no_client_auth());
        let (client, connection) = self.config.connect(tls).await.map_err(|error| self.failed(&error))?;
        // It ends with the client.
        tokio::spawn(async move {
            if let Err(error) = connection.await {
                tracing::debug!(%error, "connection to PostgreSQL");
            }
        });
        let made = async {
            client.execute("SELECT pg_advisory_lock($1)", &[&MAKING]).await?;
            client.batch_execute(TABLES).await?;
            let known = "INSERT INTO plumbline_database SELECT WHERE NOT EXISTS (SELECT FROM plumbline_database)";
            client.batch_execute(known).await?;
            client.execute("SELECT pg_advisory_unlock($1)", &[&MAKING]).await?;
            client.query_one("SELECT id::text FROM plumbline_database", &[]).await
        };
        let database = made.await.and_then(|row| row.try_get(0)).map_err(|error| self.failed(&error))?;
        Ok(Connected { client, at: self.at.clone(), database })
    }
}

impl Connected {
    fn failed(&self) -> impl Fn(Error) -> FleetError + use<> {
        let at = self.at.clone();
        move |error| FleetError::Index { at: at.clone(), reason: explain(&error) }
    }

    /// Changes after `revision`, in their order, some of them; none when there are none.
    pub(super) async fn changes(&self, revision: i64) -> Result<Vec<Entry>, FleetError> {
        let text =
            format!("SELECT {COLUMNS} FROM plumbline_flights WHERE revision > $1 ORDER BY revision LIMIT {PAGE}");
        let rows = self.client.query(&text, &[&revision]).await.map_err(self.failed())?;
        rows.iter().map(|row| read(row).map_err(self.failed())).collect()
    }

    /// Has it nothing, not even what was deleted?
    pub(super) async fn is_empty(&self) -> Result<bool, FleetError> {
        let row = self.client.query_one("SELECT NOT EXISTS (SELECT FROM plumbline_flights)", &[]).await;
        row.and_then(|row| row.try_get(0)).map_err(self.failed())
    }

    /// Enters a flight, or more of it than there was; its labels are those that are there already. Answers what there is now.
    pub(super) async fn put(&mut self, e: &Entry) -> Result<Entry, FleetError> {
        let failed = self.failed();
        let change = self.begin().await?;
        let text = format!(
            "INSERT INTO plumbline_flights VALUES ($1, {NEXT}, $2, $3, $4, $5, $6, $7, $8, $9::text::jsonb)
             ON CONFLICT (id) DO UPDATE SET revision = EXCLUDED.revision, ground = $2, object = $3, sha256 = $4, size = $5,
                messages = $6, flight = EXCLUDED.flight
             WHERE NOT plumbline_flights.deleted AND plumbline_flights.messages < $6"
        );
        let values: [&(dyn tokio_postgres::types::ToSql + Sync); 9] =
            [&e.id, &e.ground, &e.object, &e.sha256, &e.size, &e.messages, &e.name, &e.notes, &e.flight];
        change.execute(&text, &values).await.map_err(&failed)?;
        let kept = found(&change, &e.id).await.map_err(&failed)?;
        change.commit().await.map_err(&failed)?;
        Ok(kept.unwrap_or_else(|| e.clone()))
    }

    /// Changes name and notes. Answers what there is now.
    pub(super) async fn label(&mut self, id: &str, labels: &Labels) -> Result<Option<Entry>, FleetError> {
        let text = "UPDATE plumbline_flights SET name = $2, notes = $3";
        self.change(id, text, &[&labels.name, &labels.notes]).await
    }

    /// Deletes a flight for good. Answers what there was; `None` where there was none.
    pub(super) async fn delete(&mut self, id: &str) -> Result<Option<Entry>, FleetError> {
        self.change(id, "UPDATE plumbline_flights SET deleted = true", &[]).await
    }

    async fn change(
        &mut self,
        id: &str,
        what: &str,
        values: &[&(dyn tokio_postgres::types::ToSql + Sync)],
    ) -> Result<Option<Entry>, FleetError> {
        let failed = self.failed();
        let change = self.begin().await?;
        let mut all: Vec<&(dyn tokio_postgres::types::ToSql + Sync)> = vec![&id];
        all.extend_from_slice(values);
        let text = format!("{what}, revision = {NEXT} WHERE id = $1 AND NOT deleted");
        let changed = change.execute(&text, &all).await.map_err(&failed)? > 0;
        let entry = found(&change, id).await.map_err(&failed)?;
        change.commit().await.map_err(&failed)?;
        Ok(entry.filter(|_| changed))
    }

    async fn begin(&mut self) -> Result<Transaction<'_>, FleetError> {
        let failed = self.failed();
        let change = self.client.transaction().await.map_err(&failed)?;
        change.batch_execute(LOCK).await.map_err(&failed)?;
        Ok(change)
    }
}

async fn found(change: &Transaction<'_>, id: &str) -> Result<Option<Entry>, Error> {
    let text = format!("SELECT {COLUMNS} FROM plumbline_flights WHERE id = $1");
    change.query_opt(&text, &[&id]).await?.map(|row| read(&row)).transpose()
}

fn read(row: &Row) -> Result<Entry, Error> {
    Ok(Entry {
        id: row.try_get(0)?,
        revision: row.try_get(1)?,
        ground: row.try_get(2)?,
        object: row.try_get(3)?,
        sha256: row.try_get(4)?,
        size: row.try_get(5)?,
        messages: row.try_get(6)?,
        name: row.try_get(7)?,
        notes: row.try_get(8)?,
        flight: row.try_get(9)?,
        deleted: row.try_get(10)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_database_is_refused_without_telling_a_password() {
        let at = |text: &str| Database::parse(text).map(|database| database.at);
        assert_eq!(at("postgresql://me:secret@db.lab/flights"), Ok("db.lab/flights".into()));
        assert_eq!(at("host=/run/postgresql user=me"), Ok("/run/postgresql/postgres".into()));
        for text in ["postgresql://me:secret@db.lab:port/x", "secret", "user=secret", ""] {
            let error = at(text).unwrap_err().to_string();
            assert!(error.contains("fleet_index") && !error.contains("secret"), "{text}: {error}");
        }
    }
}
