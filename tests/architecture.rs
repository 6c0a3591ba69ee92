//! The structure of the repository, checked in its text: imports between the modules of the service, the
//! location of modules, the length of files and names, and the contents of documents. Cargo enforces the
//! dependencies between crates.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Every module of the service, with the modules that it may import.
const ALLOWED: &[(&str, &[&str])] = &[
    ("traces", &[]),
    ("camera_path", &[]),
    ("store", &[]),
    ("jobs", &["store"]),
    ("worker", &["traces", "store", "jobs"]),
    ("server", &["traces", "camera_path", "store", "jobs", "worker"]),
    ("remote_worker", &["store", "jobs", "worker"]),
    ("testing", &["store", "server"]),
    ("cli", &["traces", "camera_path", "store", "jobs", "worker", "server", "remote_worker", "testing"]),
];
const LONGEST_FILE: usize = 600;
const LONGEST_TEST_NAME: usize = 60;
/// Folders with texts of this repository.
const FOLDERS: [&str; 12] = [
    "src",
    "crates",
    "tests",
    "benches",
    "examples",
    "docs",
    "shaders",
    "migrations",
    "deploy",
    "docker",
    "clients",
    ".ci",
];

#[test]
fn service_modules_import_only_in_the_allowed_direction() {
    let mut wrong = Vec::new();
    for file in files_under(&root().join("src"), &["rs"]) {
        let path = shown(&file);
        let module = path["src/".len()..].split(['/', '.']).next().unwrap_or_default().to_owned();
        if module != "lib" && module != "main" {
            wrong.extend(
                forbidden(&module, &read(&file)).into_iter().map(|name| format!("{path} imports {name}")),
            );
        }
    }
    assert!(wrong.is_empty(), "imports that the table does not allow:\n{}", wrong.join("\n"));
}

#[test]
fn only_tests_and_benchmarks_name_kernels_of_the_cpu_engine() {
    let mut wrong = Vec::new();
    for folder in ["src", "crates/train/src"] {
        let files = files_under(&root().join(folder), &["rs"]);
        assert!(files.len() > 50, "{folder}");
        let is_test = |file: &PathBuf| file.ends_with("tests.rs");
        for file in files.into_iter().filter(|file| !is_test(file)) {
            wrong.extend(names_kernels(&read(&file)).then(|| shown(&file)));
        }
    }
    assert!(wrong.is_empty(), "these use kernels instead of the interface of the engines: {wrong:?}");
    assert!(names_kernels("use relume_engine::cpu::Pass;\n#[cfg(test)]\nmod tests {}"));
    assert!(!names_kernels("#[cfg(test)]\nmod tests { use relume_engine::cpu::Pass; }"));
}

/// Whether code other than tests names the module `cpu` of the engine.
fn names_kernels(code: &str) -> bool {
    code.split("#[cfg(test)]\nmod ").next().unwrap_or_default().contains("relume_engine::cpu")
}

#[test]
fn a_forbidden_import_is_detected() {
    for code in ["use crate::server::run;", "fn f() { crate::cli::main() }", "use crate::cellar::x;"] {
        assert_eq!(forbidden("store", code).len(), 1, "{code}");
    }
    for code in ["use crate::store::Page;", "//! See [`crate::server`].", "    /// crate::server::x"] {
        assert!(forbidden("store", code).is_empty(), "{code}");
    }
    assert_eq!(forbidden("cellar", "").len(), 1, "a module that is not in the table");
}

#[test]
fn a_module_with_submodules_is_in_its_own_folder() {
    let beside: Vec<String> = ["src", "crates", "tests"]
        .iter()
        .flat_map(|folder| files_under(&root().join(folder), &["rs"]))
        .filter(|file| file.with_extension("").is_dir())
        .map(|file| shown(&file))
        .collect();
    assert!(beside.is_empty(), "belongs into its folder as mod.rs: {beside:?}");
}

#[test]
fn no_source_file_exceeds_the_line_limit() {
    let files = ["src", "crates"].map(|folder| files_under(&root().join(folder), &["rs"]));
    let lengths = files.iter().flatten().map(|file| (shown(file), read(file).lines().count()));
    let long: Vec<_> = lengths.filter(|(_, lines)| *lines > LONGEST_FILE).collect();
    assert!(long.is_empty(), "files over {LONGEST_FILE} lines: {long:?}");
}

#[test]
fn no_test_name_exceeds_the_length_limit() {
    let mut long = Vec::new();
    for folder in ["src", "crates", "tests"] {
        for file in files_under(&root().join(folder), &["rs"]) {
            long.extend(tests_of(&read(&file)).into_iter().filter(|name| name.len() > LONGEST_TEST_NAME));
        }
    }
    assert!(long.is_empty(), "tests with names over {LONGEST_TEST_NAME} characters:\n{}", long.join("\n"));
    let code = "#[test]\nfn a() {}\n#[tokio::test(start_paused = true)]\n#[ignore = \"x\"]\nasync fn b() {}\nfn c() {}";
    assert_eq!(tests_of(code), ["a", "b"]);
}

#[test]
fn every_test_in_the_table_of_formats_exists() {
    let files = ["src", "crates", "tests"].map(|folder| files_under(&root().join(folder), &["rs"]));
    let tests: BTreeSet<String> = files.iter().flatten().flat_map(|file| tests_of(&read(file))).collect();
    let named = named_tests(&read(&root().join("docs/guide/compatibility.md")));
    assert!(named.len() > 30, "{named:?}");
    let missing: Vec<&String> = named.iter().filter(|name| !tests.contains(*name)).collect();
    assert!(missing.is_empty(), "docs/guide/compatibility.md names tests that do not exist: {missing:?}");
    assert_eq!(named_tests("| `a` | `b.rs::c`, `d::e` (data) | f::g |"), ["c", "e"]);
    assert!(!tests.contains("c"), "the control");
}

/// The functions of names such as `FILE::FUNCTION` in the code spans of a text.
fn named_tests(text: &str) -> Vec<String> {
    let spans = text.split('`').skip(1).step_by(2);
    spans.filter_map(|span| Some(span.rsplit_once("::")?.1.to_owned())).collect()
}

#[test]
fn no_text_contains_a_machine_specific_path() {
    let mut found = Vec::new();
    for file in texts() {
        found.extend(machine_path(&read(&file)).map(|path| (shown(&file), path)));
    }
    assert!(found.is_empty(), "{found:?}");
    // The paths are composed, so that this file is not reported.
    for path in ["work", "root", "tmp"] {
        assert!(machine_path(&format!("open /{path}/shared/x")).is_some(), "{path}");
    }
    assert_eq!(machine_path("network/shared, ./tmp/x, framework/src"), None);
}

#[test]
fn every_file_named_in_a_text_exists() {
    let known = repository_files();
    let mut missing = Vec::new();
    for file in texts() {
        let path = shown(&file);
        for name in named_files(&path, &read(&file)) {
            if !exists(&name, &path, &known) {
                missing.push(format!("{path}: {name}"));
            }
        }
    }
    assert!(missing.is_empty(), "texts name files that do not exist:\n{}", missing.join("\n"));
}

#[test]
fn a_missing_file_is_detected() {
    let known: BTreeSet<String> =
        ["src/store/sql.rs", "shaders/blend.wgsl", "docs/MODEL.md"].map(str::to_owned).into();
    let missing = |path: &str, text: &str| {
        let names = named_files(path, text).into_iter();
        names.filter(|name| !exists(name, path, &known)).collect::<Vec<_>>()
    };
    let text =
        "See `store/sql.rs`, docs/MODEL.md, [it](MODEL.md) and blend.wgsl; photographs/cat.png is yours.";
    assert!(missing("docs/a.md", text).is_empty(), "{:?}", missing("docs/a.md", text));
    assert_eq!(missing("docs/a.md", "See `store/gone.rs`."), ["store/gone.rs"]);
    let comment = format!("{0}{0} losses.wgsl\nlet x = \"other.wgsl\";", '/');
    assert_eq!(missing("src/a.rs", &comment), ["losses.wgsl"]);
    assert!(missing("docs/a.md", "[up](../src/store/sql.rs), sql.rs.").is_empty());
    assert_eq!(missing("docs/a.md", "[there](docs/GONE.md)"), ["docs/GONE.md"]);
}

#[test]
fn decision_index_lists_every_record() {
    let folder = root().join("docs/decisions");
    let index = read(&folder.join("README.md"));
    let records = files_under(&folder, &["md"]).into_iter().map(|file| shown(&file));
    let names = records.filter_map(|path| Some(path.rsplit_once('/')?.1.to_owned()));
    let missing: Vec<String> =
        names.filter(|name| name != "README.md" && !index.contains(&format!("({name})"))).collect();
    assert!(missing.is_empty(), "docs/decisions/README.md does not list {missing:?}");
}

#[test]
fn every_dependency_is_explained_in_the_architecture_document() {
    let document = read(&root().join("docs/ARCHITECTURE.md"));
    let names = dependencies(&read(&root().join("Cargo.toml")));
    assert!(names.len() > 5, "the manifest was not understood: {names:?}");
    let missing: Vec<&String> = names.iter().filter(|name| !is_explained(name, &document)).collect();
    assert!(missing.is_empty(), "docs/ARCHITECTURE.md says nothing of {missing:?}");
}

#[test]
fn every_crate_is_tested_and_uses_workspace_dependencies() {
    let manifest = read(&root().join("Cargo.toml"));
    let (_, rest) = manifest.split_once("default-members = [").unwrap();
    let (members, _) = rest.split_once(']').unwrap();
    let manifests = files_under(&root().join("crates"), &["toml"]);
    let manifests: Vec<_> = manifests.into_iter().filter(|file| file.ends_with("Cargo.toml")).collect();
    assert!(manifests.len() > 10, "{manifests:?}");
    for file in manifests {
        let folder = shown(&file).trim_end_matches("/Cargo.toml").to_owned();
        let is_tested = members.contains(&format!("\"{folder}\""));
        assert!(is_tested || folder == "crates/bench", "default-members does not list {folder}");
        let own = own_versions(&read(&file));
        assert!(own.is_empty(), "{folder}: not from [workspace.dependencies]: {own:?}");
    }
    assert_eq!(own_versions("[dependencies]\na.workspace = true\nb = \"1\"\n[features]\nc = []\n"), ["b"]);
}

/// The dependencies of a manifest that do not refer to those of the workspace.
fn own_versions(manifest: &str) -> Vec<String> {
    let (mut inside, mut names) = (false, Vec::new());
    for line in manifest.lines().map(str::trim) {
        if let Some(section) = line.strip_prefix('[') {
            inside = section.trim_end_matches(']').ends_with("dependencies");
        } else if let Some((name, value)) = line.split_once('=').filter(|_| inside && !line.starts_with('#'))
        {
            let of_workspace = name.trim().ends_with(".workspace") || value.contains("workspace = true");
            names.extend((!of_workspace).then(|| name.trim().to_owned()));
        }
    }
    names
}

#[test]
fn an_unexplained_dependency_is_detected() {
    let manifest = "[package]\nname = \"x\"\n[workspace.dependencies]\nserde = \"1\"\n# a = \"1\"\n\
                    relume-x = { path = \"x\" }\nzip = { version = \"9\" }\n[dev-dependencies]\ndivan = \"1\"\n";
    assert_eq!(dependencies(manifest), ["serde", "zip"]);
    let document = "We zip files.\n| `serde`, tar | plain data, zip |\n";
    assert!(is_explained("serde", document) && is_explained("tar", document));
    assert!(!is_explained("zip", document) && !is_explained("ser", document));
}

/// Modules of the service that `code` of `module` names without permission.
fn forbidden(module: &str, code: &str) -> Vec<String> {
    let Some((_, allowed)) = ALLOWED.iter().find(|(name, _)| *name == module) else {
        return vec![format!("{module}, which is not in the table")];
    };
    let code = code.split("#[cfg(test)]\nmod ").next().unwrap_or_default();
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    let names = lines.flat_map(|line| line.split("crate::").skip(1)).map(|rest| {
        rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default().to_owned()
    });
    let is_forbidden =
        |name: &String| !name.is_empty() && name != module && !allowed.contains(&name.as_str());
    names.filter(is_forbidden).collect()
}

/// Names of the test functions in `code`.
fn tests_of(code: &str) -> Vec<String> {
    let mut is_test = false;
    let mut names = Vec::new();
    for line in code.lines().map(str::trim_start) {
        if line.starts_with("#[test]") || line.starts_with("#[tokio::test") {
            is_test = true;
        } else if let Some((before, rest)) = line.split_once("fn ") {
            if is_test && ["", "async ", "pub ", "pub async "].contains(&before) {
                names.extend(rest.split('(').next().map(str::to_owned));
            }
            is_test = false;
        }
    }
    names
}

/// Files that a text names by relative paths: in code only the comments count, in documents the whole text.
fn named_files(path: &str, text: &str) -> BTreeSet<String> {
    let is_code = path.ends_with(".rs") || path.ends_with(".wgsl");
    let lines = text
        .lines()
        .filter_map(|line| if is_code { line.split_once("//").map(|(_, c)| c) } else { Some(line) });
    let words =
        lines.flat_map(|line| line.split(|c: char| !(c.is_ascii_alphanumeric() || "_./-".contains(c))));
    let ends =
        |word: &str| [".rs", ".wgsl", ".md"].iter().any(|end| word.ends_with(end) && word.len() > end.len());
    let is_ours = |word: &&str| ends(word) && !word.starts_with('/');
    words.map(|word| word.trim_end_matches('.')).filter(is_ours).map(str::to_owned).collect()
}

/// Whether `name`, named in the file at `path`, is a file of the repository: by its whole path, by the end of it, or relative to
/// the file that names it.
fn exists(name: &str, path: &str, known: &BTreeSet<String>) -> bool {
    let name = name.trim_start_matches("./");
    let mut folder: Vec<&str> = path.split('/').collect();
    folder.pop();
    let mut rest = name;
    while let Some(up) = rest.strip_prefix("../") {
        folder.pop();
        rest = up;
    }
    let relative = folder.iter().copied().chain([rest]).collect::<Vec<_>>().join("/");
    let is_end = |file: &String| file == rest || file.ends_with(&format!("/{rest}"));
    known.contains(&relative) || known.iter().any(is_end)
}

/// The paths of all files of the repository, without build outputs and downloads.
fn repository_files() -> BTreeSet<String> {
    let top = std::fs::read_dir(root()).unwrap().map(|entry| entry.unwrap().path());
    let (folders, files): (Vec<_>, Vec<_>) = top.partition(|path| path.is_dir());
    let is_ours = |path: &PathBuf| !["target", ".git"].iter().any(|name| path.ends_with(name));
    let below = folders.iter().filter(|path| is_ours(path)).flat_map(|folder| files_under(folder, &[]));
    below.chain(files).map(|file| shown(&file)).collect()
}

/// The texts of this repository, including scripts without an extension.
fn texts() -> Vec<PathBuf> {
    let kinds = ["rs", "md", "wgsl", "sql", "toml", "py", "yml", "yaml", "mjs", "ts", "service"];
    let is_text = |file: &PathBuf| match file.extension() {
        Some(extension) => kinds.iter().any(|kind| extension == *kind),
        None => std::fs::read_to_string(file).is_ok(),
    };
    let mut files: Vec<PathBuf> =
        FOLDERS.iter().flat_map(|folder| files_under(&root().join(folder), &[])).filter(is_text).collect();
    files.extend(["README.md", "CONTRIBUTING.md"].map(|name| root().join(name)));
    files.retain(|file| !shown(file).contains("/node_modules/"));
    files
}

/// The repository's folder.
fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn read(file: &Path) -> String {
    std::fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", shown(file)))
}

fn shown(file: &Path) -> String {
    file.strip_prefix(root()).unwrap_or(file).display().to_string()
}

/// All files under `folder` with one of these extensions, or all files where none is given, sorted.
fn files_under(folder: &Path, extensions: &[&str]) -> Vec<PathBuf> {
    let mut out = Vec::new();
    let entries = std::fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", shown(folder)));
    for path in entries.map(|entry| entry.unwrap().path()) {
        let is_kind = |e: &std::ffi::OsStr| extensions.iter().any(|wanted| e == *wanted);
        if path.is_dir() && !path.is_symlink() && !path.ends_with("node_modules") {
            out.extend(files_under(&path, extensions));
        } else if extensions.is_empty() || path.extension().is_some_and(is_kind) {
            out.push(path);
        }
    }
    out.sort();
    out
}

/// An absolute path to a folder that exists only on some machines.
fn machine_path(text: &str) -> Option<&'static str> {
    let begins_a_path = |at: usize| {
        let before = text[..at].chars().next_back();
        !before.is_some_and(|c| c.is_alphanumeric() || "._-}".contains(c))
    };
    let folders = [concat!("/wo", "rk/"), concat!("/ro", "ot/"), concat!("/t", "mp/")];
    folders.into_iter().find(|folder| text.match_indices(folder).any(|(at, _)| begins_a_path(at)))
}

/// The names under `[workspace.dependencies]` other than our own crates, in the manifest's order.
fn dependencies(manifest: &str) -> Vec<String> {
    let (mut inside, mut names) = (false, Vec::new());
    for line in manifest.lines().map(str::trim) {
        if let Some(section) = line.strip_prefix('[') {
            inside = section == "workspace.dependencies]";
        } else if let Some((name, _)) = line.split_once('=').filter(|_| inside && !line.starts_with('#')) {
            names.push(name.trim().to_owned());
        }
    }
    names.retain(|name| !name.starts_with("relume-"));
    names
}

/// True when the first cell of a table row lists the crate. Words of sentences do not count.
fn is_explained(name: &str, document: &str) -> bool {
    let first_cells = document.lines().filter_map(|line| line.trim().strip_prefix('|')?.split('|').next());
    first_cells.flat_map(|cell| cell.split(',')).any(|item| {
        item.trim().trim_end_matches("(tests)").trim_end_matches("(build)").trim().trim_matches('`') == name
    })
}
