//! Puts the licences of the packages in the program into the build. `.ci/licences FILE` writes them, and `RELUME_LICENCES` names the file.
//! A build without this variable has an empty list.

use std::path::PathBuf;
use std::{env, fs, io};

fn main() -> io::Result<()> {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=RELUME_LICENCES");
    let folder = env::var_os("OUT_DIR").ok_or_else(|| io::Error::other("cargo sets OUT_DIR"))?;
    let to = PathBuf::from(folder).join("licences.txt");
    let Some(from) = env::var("RELUME_LICENCES").ok().filter(|path| !path.is_empty()) else {
        return fs::write(to, "");
    };
    println!("cargo::rerun-if-changed={from}");
    let licences = fs::read(&from).map_err(|error| {
        io::Error::other(format!("RELUME_LICENCES={from}: {error}; .ci/licences writes this file"))
    })?;
    fs::write(to, licences)
}
