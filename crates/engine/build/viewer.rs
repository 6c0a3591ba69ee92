//! The shaders of the browser viewer, as one JSON file: kernels of the engine and shaders that draw their splats.
//!
//! The viewer sets S, the number of visibility coefficients: it puts e.g. `const S = 16u;` before a shader text.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use naga::{Module, TypeInner};

use crate::generated;
use crate::preprocess::{Accumulation, parse_permutations};
use crate::shaders::{Failure, check, expanded};

/// Possible numbers of visibility coefficients of a model.
const COEFFICIENTS: [u32; 7] = [1, 4, 9, 16, 25, 36, 49];

/// Writes the validated shaders of `shaders/viewer.txt` to `OUT_DIR/viewer_shaders.json`: texts and kinds of bindings, layouts
/// of structs in bytes, and the numbers that encode forms of the model.
pub fn compile_all(folder: &Path) -> Result<(), Failure> {
    let mut shaders = Vec::new();
    let mut structs = BTreeMap::new();
    for permutation in parse_permutations(&std::fs::read_to_string(folder.join("viewer.txt"))?)? {
        let text = without_comments(&expanded(folder, &permutation, Accumulation::CompareExchange)?);
        let mut module = Module::default();
        for n in COEFFICIENTS {
            module = check(&format!("const S = {n}u;\n{text}"))
                .map_err(|e| format!("shaders/{}.wgsl ({}): {e}", permutation.file, permutation.name))?;
        }
        let kinds = bindings(&module)?;
        shaders.push(format!("{:?}: {{ \"bindings\": {kinds:?}, \"source\": {text:?} }}", permutation.name));
        structs.extend(layouts(&module));
    }
    let structs: Vec<String> =
        structs.into_iter().map(|(name, layout)| format!("{name:?}: {layout}")).collect();
    let out = format!(
        "{{\n\"shaders\": {{\n{}\n}},\n\"structs\": {{\n{}\n}},\n\"codes\": {{ {} }}\n}}\n",
        shaders.join(",\n"),
        structs.join(",\n"),
        codes().join(", ")
    );
    std::fs::write(Path::new(&std::env::var("OUT_DIR")?).join("viewer_shaders.json"), out)?;
    Ok(())
}

/// The lines with code, without indentation.
fn without_comments(text: &str) -> String {
    let lines = text.lines().map(|line| line.split("//").next().unwrap_or("").trim());
    lines.filter(|line| !line.is_empty()).fold(String::new(), |out, line| out + line + "\n")
}

/// Kinds of the bindings of group 0 as WebGPU names them, in order; empty where a binding has no number.
fn bindings(module: &Module) -> Result<Vec<&'static str>, Failure> {
    let mut kinds = BTreeMap::new();
    for (_, variable) in module.global_variables.iter() {
        let Some(binding) = &variable.binding else { continue };
        let kind = match variable.space {
            naga::AddressSpace::Uniform => "uniform",
            naga::AddressSpace::Storage { access } if access.contains(naga::StorageAccess::STORE) => {
                "storage"
            }
            naga::AddressSpace::Storage { .. } => "read-only-storage",
            naga::AddressSpace::Handle => "texture",
            _ => return Err(format!("{:?}: unexpected address space", variable.name).into()),
        };
        kinds.insert(binding.binding, kind);
    }
    if kinds.keys().copied().ne(0..kinds.len() as u32) {
        return Err(format!("bindings must be numbered from 0 without gaps: {kinds:?}").into());
    }
    Ok(kinds.into_values().collect())
}

/// Size and offsets of the members of each named struct, bytes.
fn layouts(module: &Module) -> BTreeMap<String, String> {
    let named = module.types.iter().filter_map(|(_, ty)| match (&ty.name, &ty.inner) {
        (Some(name), TypeInner::Struct { members, span }) => Some((name, members, span)),
        _ => None,
    });
    named
        .map(|(name, members, span)| {
            let mut text = String::new();
            for member in members {
                let _ = write!(text, ", {:?}: {}", member.name.as_deref().unwrap_or(""), member.offset);
            }
            (
                name.clone(),
                format!("{{ \"size\": {span}, \"members\": {{ {} }} }}", text.trim_start_matches(", ")),
            )
        })
        .collect()
}

/// The numbers that encode forms of the model, e.g. `"NORMAL_FREE": 0`.
fn codes() -> Vec<String> {
    let text = generated::piece("parameters").unwrap_or_default();
    let constant = |line: &str| {
        let (name, value) = line.strip_prefix("const ")?.strip_suffix("u;")?.split_once(" = ")?;
        Some(format!("{name:?}: {value}"))
    };
    text.lines().filter(|line| !line.contains("FIELD")).filter_map(constant).collect()
}
