//! The build script: with the feature `gpu`, compiles the shaders.

#[cfg(feature = "gpu")]
mod generated;
#[cfg(feature = "gpu")]
mod preprocess;
#[cfg(feature = "gpu")]
mod shaders;
#[cfg(feature = "gpu")]
mod viewer;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed=build");
    #[cfg(feature = "gpu")]
    shaders::compile_all()?;
    Ok(())
}
