//! `relume doctor --report`: a block for a report of a fault, without names, paths and keys.

use std::path::Path;
use std::process::Command;

use crate::cli::doctor::{describe, explain_choice, features};
use crate::cli::error::CommandResult;
use crate::cli::version;
use crate::store::{DatabaseUrl, failure_codes};
use relume_capture::formats::installed_converter;
use relume_capture::poses::{PoseOptions, colmap_version};
use relume_engine::{AdapterReport, DeviceChoice, choose_adapter};
use relume_train::available_memory;

/// Prints the block, ready to be pasted into a form of Markdown.
pub(super) fn print(
    adapters: &[AdapterReport],
    choice: DeviceChoice,
    database: (&Path, Option<&DatabaseUrl>),
) -> CommandResult {
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    println!("```text");
    println!("relume        {}", version::VERSION);
    println!("commit        {}", version::commit());
    println!("features      {}", version::features());
    println!("system        {} {}{}", std::env::consts::OS, std::env::consts::ARCH, kernel());
    println!("cpu threads   {threads}");
    println!("cpu features  {}", features().join(" "));
    println!("memory        {}", memory());
    adapters.iter().for_each(describe);
    match choose_adapter(adapters, choice) {
        Ok(chosen) => println!("device        {}", explain_choice(choice, chosen, adapters)),
        Err(error) => println!("device        {error}"),
    }
    println!(
        "heic          {}",
        if installed_converter().is_some() { "a converter is installed" } else { "no converter" }
    );
    println!("colmap        {}", colmap());
    println!("ffmpeg        {}", ffmpeg());
    println!("failed jobs   {}", failed_jobs(database)?);
    println!("```");
    Ok(())
}

/// Version of the kernel of Linux.
fn kernel() -> String {
    std::fs::read_to_string("/proc/sys/kernel/osrelease")
        .map(|release| format!(", {}", release.trim()))
        .unwrap_or_default()
}

fn memory() -> String {
    available_memory().map_or_else(|| "unknown".to_owned(), |bytes| format!("{} MiB available", bytes >> 20))
}

fn colmap() -> String {
    let Ok(log) = tempfile::NamedTempFile::new() else { return "unknown".to_owned() };
    match colmap_version(&PoseOptions::default(), log.path()) {
        Ok((major, minor)) => format!("{major}.{minor}"),
        Err(_) => "not found, or too old".to_owned(),
    }
}

fn ffmpeg() -> String {
    let output = Command::new("ffmpeg").arg("-version").output().ok();
    let text = output.map(|output| String::from_utf8_lossy(&output.stdout).into_owned()).unwrap_or_default();
    let words: Vec<&str> = text.lines().next().unwrap_or_default().split_whitespace().take(3).collect();
    match words.as_slice() {
        ["ffmpeg", "version", version] => (*version).to_owned(),
        _ => "not found".to_owned(),
    }
}

/// The codes of failed jobs, with their numbers.
fn failed_jobs((root, url): (&Path, Option<&DatabaseUrl>)) -> CommandResult<String> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    Ok(match runtime.block_on(failure_codes(root, url)) {
        Ok(codes) if codes.is_empty() => "none".to_owned(),
        Ok(codes) => {
            let codes: Vec<String> = codes.iter().map(|(code, count)| format!("{code} {count}")).collect();
            codes.join(", ")
        }
        Err(_) => "the database cannot be read; `relume doctor` says why".to_owned(),
    })
}
