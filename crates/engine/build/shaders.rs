//! Expands and validates every permutation of the shaders, so that an error in WGSL fails the build.

use std::fmt::Write as _;
use std::path::Path;

use naga::valid::{Capabilities, ValidationFlags, Validator};

use crate::preprocess::{Accumulation, Permutation, expand, parse_permutations};
use crate::{generated, viewer};

pub type Failure = Box<dyn std::error::Error>;

/// Writes the validated text of every permutation to a Rust file in the output folder.
pub fn compile_all() -> Result<(), Failure> {
    let folder = Path::new(&std::env::var("CARGO_MANIFEST_DIR")?).join("../../shaders");
    println!("cargo::rerun-if-changed={}", folder.display());
    let mut out = String::new();
    let mut names = Vec::new();
    for permutation in parse_permutations(&std::fs::read_to_string(folder.join("permutations.txt"))?)? {
        let text = compile(&folder, &permutation)
            .map_err(|e| format!("shaders/{}.wgsl ({}): {e}", permutation.file, permutation.name))?;
        out.push_str(&text);
        names.push(format!("&{}", permutation.name));
    }
    writeln!(out, "/// Every shader.\npub static ALL: &[&Kernel] = &[{}];", names.join(", "))?;
    let out_dir = std::env::var("OUT_DIR")?;
    std::fs::write(Path::new(&out_dir).join("shaders.rs"), out)?;
    std::fs::write(Path::new(&out_dir).join("generated.wgsl"), generated::all())?;
    viewer::compile_all(&folder)
}

/// The Rust text of one permutation's `Kernel`.
fn compile(folder: &Path, permutation: &Permutation) -> Result<String, Failure> {
    let native = expanded(folder, permutation, Accumulation::Native)?;
    let exchange = expanded(folder, permutation, Accumulation::CompareExchange)?;
    let module = check(&native)?;
    let fallback = if exchange == native {
        "None".to_owned()
    } else {
        check(&exchange)?;
        format!("Some({exchange:?})")
    };
    let [main] = &module.entry_points[..] else { return Err("must have exactly one entry point".into()) };
    if main.name != "main" {
        return Err("the entry point must be called main".into());
    }
    Ok(format!(
        "/// `{file}.wgsl`.\npub static {name}: Kernel = Kernel {{ name: {name:?}, source: {native:?}, fallback: {fallback}, \
         workgroup: {size:?}, bindings: &[{bindings}], structs: &[{structs}] }};\n",
        file = permutation.file,
        name = permutation.name,
        size = main.workgroup_size,
        bindings = bindings(&module)?,
        structs = structs(&module),
    ))
}

/// The text of one permutation.
pub fn expanded(folder: &Path, permutation: &Permutation, sums: Accumulation) -> Result<String, String> {
    let read =
        |path: &str| std::fs::read_to_string(folder.join(path)).map_err(|e| format!("shaders/{path}: {e}"));
    let entry = read(&format!("{}.wgsl", permutation.file))?;
    let import = |name: &str| match name.strip_prefix("generated/") {
        Some(piece) => generated::piece(piece).ok_or_else(|| format!("{name}: no such piece")),
        None => read(&format!("shared/{name}.wgsl")),
    };
    expand(&entry, &permutation.defines, sums, &import)
}

/// Parses and validates WGSL.
pub fn check(source: &str) -> Result<naga::Module, Failure> {
    let module = naga::front::wgsl::parse_str(source).map_err(|e| e.emit_to_string(source))?;
    let capabilities = Capabilities::SHADER_FLOAT32_ATOMIC;
    Validator::new(ValidationFlags::all(), capabilities)
        .validate(&module)
        .map_err(|e| e.emit_to_string(source))?;
    Ok(module)
}

/// The kinds of the bindings, which must be numbered 0, 1, 2, ... in group 0.
fn bindings(module: &naga::Module) -> Result<String, Failure> {
    let mut kinds = Vec::new();
    for (_, variable) in module.global_variables.iter() {
        let Some(binding) = &variable.binding else { continue };
        let kind = match variable.space {
            naga::AddressSpace::Uniform => "Uniform",
            naga::AddressSpace::Storage { access } if access.contains(naga::StorageAccess::STORE) => "Write",
            naga::AddressSpace::Storage { .. } => "Read",
            _ => return Err(format!("{:?}: unexpected address space", variable.name).into()),
        };
        if binding.group != 0 {
            return Err(format!("{:?}: must be in group 0", variable.name).into());
        }
        kinds.push((binding.binding, kind));
    }
    kinds.sort_unstable();
    if kinds.iter().enumerate().any(|(i, (number, _))| *number != i as u32) {
        return Err(format!("bindings must be numbered from 0 without gaps: {kinds:?}").into());
    }
    Ok(kinds.iter().map(|(_, kind)| format!("BindingKind::{kind}")).collect::<Vec<_>>().join(", "))
}

/// Named struct types with size and member offsets. A test compares them with the host's structs.
fn structs(module: &naga::Module) -> String {
    let mut out = Vec::new();
    for (_, ty) in module.types.iter() {
        let (Some(name), naga::TypeInner::Struct { members, span }) = (&ty.name, &ty.inner) else { continue };
        let members: Vec<String> = members
            .iter()
            .map(|m| format!("({:?}, {})", m.name.as_deref().unwrap_or(""), m.offset))
            .collect();
        out.push(format!(
            "StructLayout {{ name: {name:?}, size: {span}, members: &[{}] }}",
            members.join(", ")
        ));
    }
    out.join(", ")
}
