//! `relume doctor`: lists the devices of this machine, shows which one the service uses and why, and checks whether the service
//! can run and whether its stored data are intact.

mod report;

use std::path::{Path, PathBuf};

use crate::cli::artifacts::ArtifactsArgs;
use crate::cli::database::DatabaseArgs;
use crate::cli::error::CommandResult;
use crate::store::{Store, inspect_with};
use relume_capture::formats::{CONVERTER_PACKAGE, installed_converter};
use relume_engine::{AdapterReport, Device, DeviceChoice, adapters, choose_adapter};

/// The data directory of `relume serve` without an option.
const DEFAULT_DATA_DIR: &str = "relume-data";

/// Options of `relume doctor`.
#[derive(Debug, clap::Args)]
pub(super) struct DoctorArgs {
    /// The data directory to check. A directory that is named must exist. Default: `relume-data`, which may not exist yet.
    #[arg(long, env = "RELUME_DATA_DIR")]
    data_dir: Option<PathBuf>,
    #[command(flatten)]
    artifacts: ArtifactsArgs,
    #[command(flatten)]
    database: DatabaseArgs,
    /// The device to check: `auto`, `cpu`, `gpu` or `gpu:N`.
    #[arg(long, default_value_t)]
    device: DeviceChoice,
    /// Print a block for a report of a fault: versions, devices, programs and the codes of failed jobs, without names, paths and keys.
    /// Stored data are not checked.
    #[arg(long)]
    report: bool,
}

pub(super) fn run(args: &DoctorArgs) -> CommandResult {
    if args.report {
        let path = args.data_dir.as_deref().unwrap_or(Path::new(DEFAULT_DATA_DIR));
        return report::print(&adapters(), args.device, (path, args.database.database_url.as_ref()));
    }
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    println!("relume        {}", env!("CARGO_PKG_VERSION"));
    println!("cpu threads   {threads}");
    println!("cpu features  {}", features().join(" "));
    let adapters = adapters();
    if adapters.is_empty() {
        println!("gpus          none: no Vulkan, Metal or DX12 driver found");
    }
    adapters.iter().for_each(describe);
    if args.database.database_url.is_none() {
        println!("database      {}", database_version()?);
    }
    println!("heic          {}", heic_converter());
    let path = args.data_dir.as_deref().unwrap_or(Path::new(DEFAULT_DATA_DIR));
    if args.data_dir.is_some() && !path.is_dir() {
        println!("data dir      {} does not exist", path.display());
        let reason = "is not an existing folder; name the data directory of a server, or start `relume serve`, which creates it";
        return Err(format!("--data-dir {}: {reason}", path.display()).into());
    }
    println!("data dir      {}", data_dir(path)?);
    let faults = check_stored_data(args, path)?;
    let chosen = choose_adapter(&adapters, args.device)?;
    println!("device        {}", explain_choice(args.device, chosen, &adapters));
    if let Some(index) = chosen {
        // Opening a device tests it.
        Device::open(DeviceChoice::Gpu(Some(index)))?;
        println!("self-test     passed");
    }
    if faults > 0 {
        return Err(format!("{}: {faults} faults found; they are listed above", path.display()).into());
    }
    Ok(())
}

/// Prints a summary of the stored data and their faults. Returns the number of faults.
fn check_stored_data(args: &DoctorArgs, path: &Path) -> CommandResult<usize> {
    let (url, place) = (args.database.database_url.as_ref(), args.artifacts.place());
    if url.is_none() && !path.exists() {
        return Ok(0);
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let found = runtime.block_on(inspect_with(path, url, place.as_ref()))?;
    match found.schema {
        Some(schema) => println!("database      schema {schema}"),
        None if found.faults.is_empty() => println!("database      none yet"),
        None => println!("database      cannot be used"),
    }
    println!("artifacts     {} referenced by the database, {} not", found.artifacts, found.orphans.len());
    found.orphans.iter().for_each(|key| {
        println!("orphan        artifacts/{key}: not referenced; the server deletes it at a start");
    });
    found.faults.iter().for_each(|fault| println!("fault         {fault}"));
    Ok(found.faults.len())
}

fn describe(r: &AdapterReport) {
    let mib = |bytes: u64| bytes >> 20;
    let yes = |on: bool| if on { "yes" } else { "no" };
    println!(
        "gpu:{:<9} {} ({}, {}{})",
        r.index,
        r.name,
        r.backend,
        r.driver,
        if r.software { ", software" } else { "" }
    );
    println!(
        "              buffers to {} MiB, bindings to {} MiB, workgroup memory {} KiB, float atomics {}, timestamps {}",
        mib(r.max_buffer),
        mib(r.max_binding),
        r.workgroup_memory >> 10,
        yes(r.float_atomics),
        yes(r.timestamps)
    );
    r.lacks.iter().for_each(|what| println!("              cannot be used: {what}"));
}

/// The device that will be used, and the reason.
fn explain_choice(choice: DeviceChoice, chosen: Option<usize>, reports: &[AdapterReport]) -> String {
    match (choice, chosen) {
        (_, Some(index)) => format!("gpu:{index} ({choice})"),
        (DeviceChoice::Cpu, None) => "cpu (as requested)".to_owned(),
        _ if reports.is_empty() => "cpu (no GPU found)".to_owned(),
        _ if reports.iter().all(|r| r.software) => {
            "cpu (a software GPU is slower than the CPU engine; gpu:N selects it anyway)".to_owned()
        }
        _ => "cpu (no GPU meets the requirements of the engine)".to_owned(),
    }
}

/// Instruction sets for which the CPU engine has code.
#[cfg(target_arch = "x86_64")]
fn features() -> Vec<&'static str> {
    let known = [
        ("sse4.2", std::is_x86_feature_detected!("sse4.2")),
        ("avx", std::is_x86_feature_detected!("avx")),
        ("avx2", std::is_x86_feature_detected!("avx2")),
        ("fma", std::is_x86_feature_detected!("fma")),
        ("avx512f", std::is_x86_feature_detected!("avx512f")),
    ];
    known.into_iter().filter_map(|(name, there)| there.then_some(name)).collect()
}

/// Instruction sets for which the CPU engine has code.
#[cfg(not(target_arch = "x86_64"))]
fn features() -> Vec<&'static str> {
    vec![std::env::consts::ARCH]
}

/// The program that converts HEIC and AVIF photographs, or how to install one.
fn heic_converter() -> String {
    match installed_converter() {
        Some(program) => program.display().to_string(),
        None => format!("no converter for HEIC and AVIF photographs: {CONVERTER_PACKAGE}"),
    }
}

/// Opens a database with the schema of the service in a temporary folder.
fn database_version() -> CommandResult<String> {
    let folder = tempfile::tempdir()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    Ok(runtime.block_on(async {
        let store = Store::open(folder.path()).await?;
        let version = store.database_version().await;
        store.close().await;
        version
    })?)
}

/// Checks whether files can be written to the directory, or to its nearest existing ancestor.
fn data_dir(path: &Path) -> CommandResult<String> {
    let absolute = std::path::absolute(path)?;
    let there = absolute.ancestors().find(|p| p.exists()).unwrap_or(Path::new("/"));
    let state = match tempfile::tempfile_in(there) {
        Ok(_) if there == absolute => "writable".to_owned(),
        Ok(_) => "will be created".to_owned(),
        Err(error) => return Err(format!("data dir {}: {error}", absolute.display()).into()),
    };
    Ok(format!("{} ({state})", absolute.display()))
}
