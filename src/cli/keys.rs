//! `relume keys`: manages the API keys in a data directory. A server may run on it at the same time.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use crate::cli::CommandResult;
use crate::cli::database::DatabaseArgs;
use crate::jobs::{Clock, SystemClock};
use crate::server::rotate_signing_secret;
use crate::store::{DataDirLock, DatabaseUrl, KeyRecord, NewKeyRecord, Page, Paginated, Store, StoreError};
use relume_api::keys::{NewKey, Scope};
use relume_api::{KeyId, TenantId};

/// Options of `relume keys`.
#[derive(Debug, Args)]
pub(super) struct KeysArgs {
    #[command(subcommand)]
    command: KeysCommand,
}

#[derive(Debug, Subcommand)]
enum KeysCommand {
    /// Create a key and print it. The key is shown only once.
    Create(CreateArgs),
    /// List keys, including revoked and expired ones.
    List(KeyStoreArgs),
    /// Revoke a key, and the keys that were created with it.
    Revoke(RevokeArgs),
    /// Invalidate all signed URLs that exist.
    EndSignedUrls(KeyStoreArgs),
}

/// Options for the location of the keys.
#[derive(Debug, Args)]
struct KeyStoreArgs {
    /// The server's data directory. Run this command as the user of the server, so that the server owns the files that it
    /// creates.
    #[arg(long, env = "RELUME_DATA_DIR", default_value = "relume-data")]
    data_dir: PathBuf,
    #[command(flatten)]
    database: DatabaseArgs,
}

#[derive(Debug, Args)]
struct CreateArgs {
    #[command(flatten)]
    key_store: KeyStoreArgs,
    /// A descriptive name for the key.
    #[arg(long)]
    name: String,
    /// Tenant of the key. Tenants cannot see resources of each other. Administrators of `default` manage the keys of all tenants.
    #[arg(long, default_value = "default")]
    tenant: String,
    /// Scopes of the key, separated by commas: `read`, `render`, `submit`, `admin`, `priority`; in the tenant `default` also
    /// `metrics` and `work`.
    #[arg(long, value_delimiter = ',', default_value = "read,render,submit")]
    scopes: Vec<Scope>,
    /// Days until the key expires. Default: never.
    #[arg(long, value_name = "DAYS", value_parser = clap::value_parser!(u64).range(1..=3650))]
    expires_in_days: Option<u64>,
}

#[derive(Debug, Args)]
struct RevokeArgs {
    #[command(flatten)]
    key_store: KeyStoreArgs,
    /// Identifier of the key, as printed by `relume keys list`.
    id: String,
}

pub(super) fn run(args: KeysArgs) -> CommandResult {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        match args.command {
            KeysCommand::Create(args) => create(args).await,
            KeysCommand::List(key_store) => list(&existing(&key_store).await?).await,
            KeysCommand::Revoke(args) => {
                let store = existing(&args.key_store).await?;
                revoke(&store, &args.id.into()).await
            }
            KeysCommand::EndSignedUrls(key_store) => Ok(rotate_signing_secret(&key_store.data_dir)?),
        }
    })
}

async fn create(args: CreateArgs) -> CommandResult {
    let tenant = TenantId::from(args.tenant);
    let expires_in = args.expires_in_days.map(|days| days * 24 * 3600);
    let key = NewKey { name: args.name, tenant: Some(tenant.clone()), scopes: args.scopes, expires_in };
    if let Some((field, why)) = key.validation_error(&tenant) {
        return Err(format!("--{field}: {why}").into());
    }
    let now_ms = SystemClock.now_ms();
    let expires_ms = expires_in.map(|seconds| now_ms.saturating_add_unsigned(seconds * 1000));
    let record = NewKeyRecord { name: key.name, tenant, scopes: key.scopes, expires_ms, made_by: None };
    let data_dir = std::path::absolute(&args.key_store.data_dir)?;
    let url = args.key_store.database.database_url.as_ref();
    let store = open(&data_dir, url).await.map_err(|error| format!("{}: {error}", data_dir.display()))?;
    let (made, secret) = store.create_key(&record, now_ms).await?;
    store.close().await;
    eprintln!("key {} of tenant {} in {}, shown only once:", made.id, made.tenant, data_dir.display());
    println!("{secret}");
    Ok(())
}

async fn list(store: &Store) -> CommandResult {
    let now_ms = SystemClock.now_ms();
    let mut page = Page { limit: 200, before: None };
    println!(
        "{:<16}  {:<8}  {:<20}  {:<25}  {:<10}  {:<10}  name",
        "id", "state", "tenant", "scopes", "made", "used"
    );
    loop {
        let keys = store.keys(None, &page).await?;
        keys.iter().for_each(|key| print(key, now_ms));
        match keys.last() {
            Some(last) if keys.len() == page.limit as usize => page.before = Some(last.cursor()),
            _ => break,
        }
    }
    store.close().await;
    Ok(())
}

fn print(key: &KeyRecord, now_ms: i64) {
    let state = match key {
        key if key.is_valid(now_ms) => "valid",
        key if key.revoked_ms.is_some() => "revoked",
        _ => "expired",
    };
    let scopes: Vec<&str> = key.scopes.iter().map(|scope| scope.name()).collect();
    let (id, tenant, scopes, made) =
        (key.id.as_str(), key.tenant.as_str(), scopes.join(","), day(key.created_ms));
    let used = key.last_used_ms.map_or_else(|| "never".to_owned(), day);
    println!("{id:<16}  {state:<8}  {tenant:<20}  {scopes:<25}  {made:<10}  {used:<10}  {}", key.name);
}

fn day(ms: i64) -> String {
    let time = jiff::Timestamp::from_millisecond(ms).unwrap_or_default();
    time.strftime("%Y-%m-%d").to_string()
}

async fn revoke(store: &Store, id: &KeyId) -> CommandResult {
    let revoked = store.revoke_key(None, id, SystemClock.now_ms()).await?;
    store.close().await;
    let (key, took_along) = revoked.ok_or_else(|| format!("no key {id:?}", id = id.as_str()))?;
    eprintln!("key {} is revoked", key.id);
    for other in took_along {
        eprintln!("key {other}, which was created with it, is revoked");
    }
    Ok(())
}

/// Opens the store of an existing data directory or database.
async fn existing(key_store: &KeyStoreArgs) -> CommandResult<Store> {
    let (data_dir, url) = (&key_store.data_dir, key_store.database.database_url.as_ref());
    let database = data_dir.join("relume.db");
    match url.map_or_else(|| database.try_exists(), |_| Ok(true)) {
        Ok(true) => {}
        Ok(false) => return Err(format!("{}: no database", data_dir.display()).into()),
        Err(error) => return Err(format!("{}: {error}", database.display()).into()),
    }
    open(data_dir, url).await
}

/// Opens the store of a data directory. Migrates it if no server runs on it; otherwise opens it as it is.
async fn open(data_dir: &Path, url: Option<&DatabaseUrl>) -> CommandResult<Store> {
    match DataDirLock::acquire(data_dir) {
        Ok(_until_it_is_open) => Ok(Store::open_with(data_dir, url).await?),
        Err(StoreError::Locked(_)) => Ok(Store::open_existing(data_dir, url).await?),
        Err(error) => Err(error.into()),
    }
}
