//! `plumbline-ground account add|list|remove|password|one-step`.

use std::io::{BufRead as _, IsTerminal as _, Write as _};

use clap::Subcommand;
use clap::builder::{PossibleValuesParser, TypedValueParser as _};
use plumbline_ground::people::{Accounts, Role};

use super::DataFolder;

/// What to do with which accounts. Changes count within a quarter of a second, also for a ground that runs.
#[derive(Debug, clap::Args)]
pub struct AccountArguments {
    #[command(subcommand)]
    deed: Deed,
}

#[derive(Debug, Subcommand)]
enum Deed {
    /// Makes an account; the password is asked for, or read from standard input.
    Add {
        /// Name to sign in with.
        name: String,
        /// What it may do.
        #[arg(long, value_parser = PossibleValuesParser::new(Role::ALL.map(Role::name)).map(role))]
        role: Role,
        #[command(flatten)]
        data: DataFolder,
    },
    /// Lists all accounts.
    List {
        #[command(flatten)]
        data: DataFolder,
    },
    /// Removes an account and ends its sessions.
    Remove {
        /// Its name.
        name: String,
        #[command(flatten)]
        data: DataFolder,
    },
    /// Takes the authenticator of an account away: its password is enough from then on. For somebody who lost it.
    OneStep {
        /// Its name.
        name: String,
        #[command(flatten)]
        data: DataFolder,
    },
    /// Gives an account another password and ends its sessions.
    Password {
        /// Its name.
        name: String,
        #[command(flatten)]
        data: DataFolder,
    },
}

/// Of a name that is one of theirs.
fn role(name: String) -> Role {
    Role::named(&name).unwrap_or(Role::Viewer)
}

/// Does it.
///
/// # Errors
/// A sentence for people.
pub fn run(arguments: AccountArguments) -> Result<(), String> {
    let of = |folder: &DataFolder| Accounts::of(&folder.data);
    match arguments.deed {
        Deed::Add { name, role, data } => of(&data).add(&name, role, &password()?),
        Deed::Remove { name, data } => of(&data).remove(&name),
        Deed::Password { name, data } => of(&data).change(&name, None, Some(&password()?)),
        Deed::OneStep { name, data } => of(&data).set_totp(&name, None),
        Deed::List { data } => {
            let accounts = of(&data).all().map_err(|error| error.to_string())?;
            let mut out = std::io::stdout().lock();
            return accounts
                .iter()
                .try_for_each(|account| {
                    let steps = if account.two_steps() { "  two steps" } else { "" };
                    writeln!(out, "{:<24} {}{steps}", account.name, account.role.name())
                })
                .map_err(|error| format!("standard output: {error}"));
        }
    }
    .map_err(|error| error.to_string())
}

/// Asked for twice at a terminal; otherwise the first line of standard input.
fn password() -> Result<String, String> {
    if !std::io::stdin().is_terminal() {
        let mut line = String::new();
        std::io::stdin().lock().read_line(&mut line).map_err(|error| format!("standard input: {error}"))?;
        return Ok(line.trim_end_matches(['\r', '\n']).to_owned());
    }
    let ask = |what| rpassword::prompt_password(what).map_err(|error| format!("terminal: {error}"));
    let first = ask("Password: ")?;
    if ask("Once more: ")? != first {
        return Err("the two passwords differ".into());
    }
    Ok(first)
}
