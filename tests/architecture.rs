//! The structure of the crate, read from its own text: which module may import which, that no files import each other
//! in a circle, where modules stand, how long a file may get, and what must not be written anywhere.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use proc_macro2::{Delimiter, TokenStream, TokenTree};

/// Every top module of the crate and the top modules that it may import.
/// `capture` and `formats` import plain types of each other.
const ALLOWED: &[(&str, &[&str])] = &[
    ("scene", &[]),
    ("light", &["scene"]),
    ("engine", &["scene", "light"]),
    ("formats", &["scene", "light"]),
    ("capture", &["scene", "formats"]),
    ("train", &["scene", "light", "engine", "capture", "formats"]),
    ("render", &["scene", "light", "engine", "capture", "formats"]),
    ("eval", &["scene", "engine", "capture", "formats", "train", "render"]),
    ("traces", &[]),
    ("api", &["scene", "capture", "train", "render"]),
    ("store", &["capture", "api"]),
    ("jobs", &["api", "store"]),
    (
        "worker",
        &[
            "scene", "engine", "capture", "formats", "train", "render", "eval", "traces", "api", "store",
            "jobs",
        ],
    ),
    (
        "server",
        &[
            "scene", "engine", "capture", "formats", "train", "render", "traces", "api", "store", "jobs",
            "worker",
        ],
    ),
    ("client", &["capture", "render", "api"]),
    ("farm", &["api", "store", "jobs", "worker", "client"]),
    ("testing", &["*"]),
    ("cli", &["*"]),
];

const LONGEST_FILE: usize = 600;

#[test]
fn imports_point_one_way() {
    let wrong = Crate::read(&sources()).forbidden_imports();
    assert!(wrong.is_empty(), "imports that the table does not allow:\n{}", wrong.join("\n"));
}

#[test]
fn forbidden_imports_are_noticed_however_they_are_written() {
    let imports = |lib: &str, code: &str| {
        let engine = [("engine/mod.rs", "mod a;"), ("engine/a.rs", code)];
        let files = [("lib.rs", lib), engine[0], engine[1], ("api.rs", ""), ("cellar.rs", "")];
        Crate::read(&files.map(|(name, text)| (name.to_owned(), text.to_owned())).into()).forbidden_imports()
    };
    let lib = "mod engine; mod api; pub use api::Server;";
    for code in [
        "use crate::api::router;",
        "use crate::{scene::Model, api::{router, state}};",
        "use crate::api as other;",
        "use super::super::api::router;",
        "use self::super::super::api::*;",
        "use crate::Server;",
        "fn f() { crate::api::serve(); }",
        "fn f() -> Vec<crate::api::Server> { vec![super::super::api::Server] }",
    ] {
        assert!(!imports(lib, code).is_empty(), "not noticed: {code}");
    }
    for code in [
        "//! See [`crate::api`].\n/// [`crate::api::serve`]\nfn f() -> &'static str { \"crate::api::x\" }",
        "#[cfg(test)]\nmod tests { use crate::api::serve; }",
        "#[cfg(test)]\nuse crate::{api::serve};",
        "use super::b; use crate::engine::c; use std::api;",
    ] {
        assert!(imports(lib, code).is_empty(), "a false alarm: {code}");
    }
    assert_eq!(imports("mod cellar;", "").len(), 1, "a module that is not in the table");
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    let circles = Crate::read(&sources()).circles();
    assert!(circles.is_empty(), "{} circles of imports:\n{}", circles.len(), circles.join("\n"));
}

#[test]
fn circles_are_noticed_however_they_are_written() {
    let circles = |a: &str, b: &str, c: &str| {
        let parent = "mod a; mod b; pub mod c; pub use a::A; pub(crate) use b::{B, B as Other};";
        let files =
            [("lib.rs", "mod m;"), ("m/mod.rs", parent), ("m/a.rs", a), ("m/b.rs", b), ("m/c/mod.rs", c)];
        Crate::read(&files.map(|(name, text)| (name.to_owned(), text.to_owned())).into()).circles().len()
    };
    for (a, b) in [
        ("use crate::m::b::B;", "use crate::m::a::A;"),
        ("use crate::m::B;", "use super::{A};"),
        ("use super::Other as X;", "fn f(x: super::a::A) {}"),
        ("use crate::m; fn f() { m::B::new() }", "fn f() { g!(1, super::A) }"),
        ("use super::b; struct A(b::B);", "use crate::m::*; struct B(super::A);"),
    ] {
        assert_eq!(circles(a, b, ""), 1, "not noticed: {a} {b}");
    }
    assert_eq!(circles("use super::B;", "use super::c::C;", "use super::A;"), 1, "a circle of three files");
    assert_eq!(circles("use super::B;", "use super::c::C;", ""), 0, "one way through re-exports");
    assert_eq!(circles("use super::B;", "#[cfg(test)] mod tests { use super::super::A; }", ""), 0);
}

#[test]
fn a_module_with_submodules_is_a_folder_with_mod_rs() {
    let beside: Vec<String> = ["src", "tests"]
        .iter()
        .flat_map(|folder| files_under(&root().join(folder), &["rs"]))
        .filter(|file| file.with_extension("").is_dir())
        .map(|file| shown(&file))
        .collect();
    assert!(beside.is_empty(), "belongs into its folder as mod.rs: {beside:?}");
}

#[test]
fn no_source_file_is_too_long() {
    let lengths = sources().into_iter().map(|(file, text)| (file, text.lines().count()));
    let long: Vec<_> = lengths.filter(|(_, lines)| *lines > LONGEST_FILE).collect();
    assert!(long.is_empty(), "files over {LONGEST_FILE} lines: {long:?}");
}

#[test]
fn no_text_names_a_folder_of_one_machine() {
    let mut found = Vec::new();
    for folder in ["src", "tests", "benches", "examples", "docs", "shaders", "migrations"] {
        let files = files_under(&root().join(folder), &["rs", "md", "wgsl", "sql", "toml", "py"]);
        found.extend(files.iter().filter_map(|f| Some((shown(f), machine_path(&read(f))?))));
    }
    assert!(found.is_empty(), "{found:?}");
    // Spelt in pieces, or this file would be found.
    for path in ["work", "root", "tmp"] {
        assert!(machine_path(&format!("open /{path}/shared/x")).is_some(), "{path}");
    }
    assert_eq!(machine_path("network/shared, ./tmp/x, framework/src"), None);
}

#[test]
fn every_dependency_has_its_line_in_the_architecture_document() {
    let document = read(&root().join("docs/ARCHITECTURE.md"));
    let names = dependencies(&read(&root().join("Cargo.toml")));
    assert!(names.len() > 5, "the manifest was not understood: {names:?}");
    let missing: Vec<&String> = names.iter().filter(|name| !is_explained(name, &document)).collect();
    assert!(missing.is_empty(), "docs/ARCHITECTURE.md says nothing of {missing:?}");
}

#[test]
fn a_dependency_without_its_line_is_noticed() {
    let manifest = "[package]\nname = \"x\"\n[dependencies]\nserde = \"1\"\n# a = \"1\"\nzip = { version = \"9\" }\n\
                    [dependencies.tar]\nversion = \"1\"\n[dev-dependencies]\ndivan = \"1\"\n";
    assert_eq!(dependencies(manifest), ["serde", "zip", "tar"]);
    let document = "We zip files.\n| `serde`, tar | plain data, zip |\n";
    assert!(is_explained("serde", document) && is_explained("tar", document));
    assert!(!is_explained("zip", document) && !is_explained("ser", document));
}

/// A module's path from the crate's root, or a path as it is written.
type Segments = Vec<String>;

/// The modules of the crate, without unit tests.
#[derive(Default)]
struct Crate(BTreeMap<Segments, Module>);

/// What the text of a module names.
#[derive(Default)]
struct Module {
    file: String,
    uses: Vec<Import>,
    /// Paths of two segments or more, outside `use`.
    paths: Vec<Segments>,
    /// Names that stand alone or begin a path, outside `use`.
    names: BTreeSet<String>,
}

/// One leaf of a `use` tree; the name is `*` for a glob.
struct Import {
    name: String,
    path: Segments,
    is_public: bool,
}

impl Crate {
    /// Follows the `mod` items from lib.rs on; `files` are texts by path below src.
    fn read(files: &BTreeMap<String, String>) -> Self {
        let mut found = Self::default();
        found.add_file(files, "lib.rs", Vec::new());
        found
    }

    fn add_file(&mut self, files: &BTreeMap<String, String>, file: &str, path: Segments) {
        let Some(text) = files.get(file) else { return };
        let tokens = text.parse().unwrap_or_else(|e| panic!("{file}: {e}"));
        self.0.insert(path.clone(), Module { file: file.to_owned(), ..Module::default() });
        for child in self.add_tokens(tokens, &path) {
            let stem = child.join("/");
            let names = [format!("{stem}.rs"), format!("{stem}/mod.rs")];
            names.iter().for_each(|file| self.add_file(files, file, child.clone()));
        }
    }

    /// Records what `tokens` name and returns the modules that are declared to be in other files.
    fn add_tokens(&mut self, tokens: TokenStream, at: &Segments) -> Vec<Segments> {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let is = |i: usize, text: &str| tokens.get(i).is_some_and(|t| t.to_string() == text);
        let ends_item = |t: &TokenTree| match t {
            TokenTree::Group(g) => g.delimiter() == Delimiter::Brace,
            other => other.to_string() == ";",
        };
        let end_of_item =
            |i: usize| i + tokens[i..].iter().position(ends_item).unwrap_or(tokens.len() - 1 - i);
        let (mut i, mut elsewhere) = (0, Vec::new());
        while i < tokens.len() {
            match &tokens[i] {
                TokenTree::Punct(_) if is(i, "#") && tokens.get(i + 1).is_some_and(is_test_attribute) => {
                    i = end_of_item(i + 2);
                }
                TokenTree::Group(group) => elsewhere.extend(self.add_tokens(group.stream(), at)),
                TokenTree::Ident(word) if *word == "use" && !is(i + 1, "<") => {
                    let end = i + tokens[i..].iter().position(|t| t.to_string() == ";").unwrap_or(1);
                    let is_public = i > 0 && (is(i - 1, "pub") || i > 1 && is(i - 2, "pub"));
                    let uses = &mut self.0.get_mut(at).unwrap().uses;
                    use_leaves(&tokens[i + 1..end], &[], &mut |name, path| {
                        uses.push(Import { name, path, is_public });
                    });
                    i = end;
                }
                TokenTree::Ident(word) if *word == "mod" && (i + 2 < tokens.len()) => {
                    let path = [at.as_slice(), &[tokens[i + 1].to_string()]].concat();
                    if let TokenTree::Group(body) = &tokens[i + 2] {
                        let file = self.0[at].file.clone();
                        self.0.insert(path.clone(), Module { file, ..Module::default() });
                        elsewhere.extend(self.add_tokens(body.stream(), &path));
                    } else {
                        elsewhere.push(path);
                    }
                    i += 2;
                }
                TokenTree::Ident(word) => {
                    let mut path = vec![word.to_string()];
                    while is(i + 1, ":")
                        && is(i + 2, ":")
                        && matches!(tokens.get(i + 3), Some(TokenTree::Ident(_)))
                    {
                        i += 3;
                        path.push(tokens[i].to_string());
                    }
                    let module = self.0.get_mut(at).unwrap();
                    module.names.insert(path[0].clone());
                    module.paths.extend((path.len() > 1).then_some(path));
                }
                _ => {}
            }
            i += 1;
        }
        elsewhere
    }

    /// The path from the crate's root, for one that begins with `crate`, `self` or `super`.
    fn absolute(at: &Segments, path: &[String]) -> Option<Segments> {
        let mut base = match path[0].as_str() {
            "crate" => Vec::new(),
            "self" | "super" => at.clone(),
            _ => return None,
        };
        let ups = path.iter().take_while(|s| ["crate", "self", "super"].contains(&s.as_str()));
        let skipped = ups.clone().count();
        ups.filter(|s| *s == "super").for_each(|_| drop(base.pop()));
        Some([base.as_slice(), &path[skipped..]].concat())
    }

    /// The modules whose text defines what `path`, written in module `at`, leads to. None for another crate's items,
    /// and for modules themselves: naming one imports nothing yet.
    fn defined_in(&self, at: &Segments, path: &[String], hops: usize) -> Vec<Segments> {
        let known = |name: &String| {
            self.0.contains_key(&[at.as_slice(), std::slice::from_ref(name)].concat())
                || self.0[at].uses.iter().any(|u| u.name == *name)
        };
        let absolute = match Self::absolute(at, path) {
            Some(absolute) => absolute,
            None if known(&path[0]) => [at.as_slice(), path].concat(),
            None => return Vec::new(),
        };
        let inside = (0..=absolute.len()).rev().find(|n| self.0.contains_key(&absolute[..*n])).unwrap_or(0);
        let (module, rest) = (absolute[..inside].to_vec(), &absolute[inside..]);
        let Some(name) = rest.first() else { return Vec::new() };
        if name == "*" {
            return vec![module];
        }
        let again: Vec<&Import> = self.0[&module].uses.iter().filter(|u| u.name == *name).collect();
        if again.is_empty() {
            return vec![module];
        }
        let follow = |u: &&Import| self.defined_in(&module, &[&u.path, &rest[1..]].concat(), hops - 1);
        if hops == 0 { Vec::new() } else { again.iter().flat_map(follow).collect() }
    }

    /// Imports between top modules that the table does not allow, and top modules that it does not know.
    fn forbidden_imports(&self) -> Vec<String> {
        let mut wrong = BTreeSet::new();
        for (at, module) in self.0.iter().filter(|(at, _)| !at.is_empty()) {
            let Some((_, allowed)) = ALLOWED.iter().find(|(name, _)| *name == at[0]) else {
                wrong.insert(format!("the module `{}` is not in the table", at[0]));
                continue;
            };
            for path in module.uses.iter().map(|u| &u.path).chain(&module.paths) {
                let Some(absolute) = Self::absolute(at, path) else { continue };
                let tops = match absolute.first() {
                    Some(top) if self.0.contains_key(std::slice::from_ref(top)) => vec![top.clone()],
                    _ => self
                        .defined_in(at, path, 9)
                        .into_iter()
                        .filter_map(|m| m.into_iter().next())
                        .collect(),
                };
                let is_allowed =
                    |top: &String| *top == at[0] || allowed.iter().any(|a| a == top || *a == "*");
                if !tops.iter().all(is_allowed) {
                    wrong.insert(format!("{} imports {}", module.file, path.join("::")));
                }
            }
        }
        wrong.into_iter().collect()
    }

    /// For each file the files that it imports from, and by which path.
    fn imports(&self) -> BTreeMap<&str, BTreeMap<&str, String>> {
        let mut found: BTreeMap<&str, BTreeMap<&str, String>> = BTreeMap::new();
        for (at, module) in &self.0 {
            // A re-export alone imports nothing; what the module's own code does with the name counts.
            let uses = module.uses.iter().filter(|u| !u.is_public || module.names.contains(&u.name));
            for path in uses.map(|u| &u.path).chain(&module.paths) {
                for target in self.defined_in(at, path, 9) {
                    let file = self.0[&target].file.as_str();
                    if file != module.file {
                        found.entry(&module.file).or_default().insert(file, path.join("::"));
                    }
                }
            }
        }
        found
    }

    /// Groups of files that reach each other by imports, with the imports inside the group.
    fn circles(&self) -> Vec<String> {
        let imports = self.imports();
        let reach = |file: &str| {
            let (mut seen, mut open) = (BTreeSet::new(), vec![file]);
            while let Some(next) = open.pop() {
                let unseen = imports.get(next).into_iter().flat_map(|m| m.keys().copied());
                open.extend(unseen.filter(|f| seen.insert(*f)).collect::<Vec<_>>());
            }
            seen
        };
        let reached: BTreeMap<&str, BTreeSet<&str>> =
            imports.keys().map(|file| (*file, reach(file))).collect();
        let group = |file: &str| -> BTreeSet<&str> {
            let back = |other: &&str| reached.get(other).is_some_and(|r| r.contains(file));
            reached[file].iter().copied().filter(back).collect()
        };
        let groups: BTreeSet<BTreeSet<&str>> = reached.keys().map(|file| group(file)).collect();
        let listed = |group: &BTreeSet<&str>| {
            let inside = |(from, to): &(&str, &str)| imports.get(from).and_then(|m| m.get(to)).cloned();
            let pairs = group.iter().flat_map(|from| group.iter().map(move |to| (*from, *to)));
            let lines = pairs.filter_map(|p| Some(format!("  {} -> {} ({})\n", p.0, p.1, inside(&p)?)));
            lines.collect::<String>()
        };
        groups.iter().filter(|g| !g.is_empty()).map(listed).collect()
    }
}

/// True for the brackets of `#[cfg(test)]` and `#[cfg(all(test, ..))]`.
fn is_test_attribute(token: &TokenTree) -> bool {
    let text = token.to_string().replace(' ', "");
    text.starts_with("[cfg(test)") || text.starts_with("[cfg(all(test,")
}

/// Calls `leaf` with the bound name and the path of every leaf of a `use` tree.
fn use_leaves(tree: &[TokenTree], before: &[String], leaf: &mut impl FnMut(String, Segments)) {
    let mut path = before.to_vec();
    for (i, token) in tree.iter().enumerate() {
        match token {
            TokenTree::Group(group) => {
                let items: Vec<TokenTree> = group.stream().into_iter().collect();
                let items = items.split(|t| t.to_string() == ",").filter(|item| !item.is_empty());
                return items.for_each(|item| use_leaves(item, &path, leaf));
            }
            TokenTree::Ident(word) if *word == "as" => return leaf(tree[i + 1].to_string(), path),
            TokenTree::Ident(word) if *word == "self" && !path.is_empty() => {}
            TokenTree::Punct(p) if p.as_char() == ':' => {}
            name => path.push(name.to_string()),
        }
    }
    leaf(path.last().cloned().unwrap_or_default(), path);
}

/// The crate's folder.
fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The texts of src by path below it.
fn sources() -> BTreeMap<String, String> {
    let src = root().join("src");
    let name = |file: &Path| file.strip_prefix(&src).unwrap().display().to_string();
    files_under(&src, &["rs"]).iter().map(|file| (name(file), read(file))).collect()
}

fn read(file: &Path) -> String {
    std::fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", shown(file)))
}

fn shown(file: &Path) -> String {
    file.strip_prefix(root()).unwrap_or(file).display().to_string()
}

/// All files under `folder` with one of these extensions, sorted; none when the folder is not there.
fn files_under(folder: &Path, extensions: &[&str]) -> Vec<PathBuf> {
    let mut out = Vec::new();
    let Ok(entries) = std::fs::read_dir(folder) else { return out };
    for path in entries.map(|entry| entry.unwrap().path()) {
        if path.is_dir() {
            out.extend(files_under(&path, extensions));
        } else if path.extension().is_some_and(|e| extensions.iter().any(|wanted| e == *wanted)) {
            out.push(path);
        }
    }
    out.sort();
    out
}

/// An absolute path into a folder that only some machines have.
fn machine_path(text: &str) -> Option<&'static str> {
    let begins_a_path = |at: usize| {
        let before = text[..at].chars().next_back();
        !before.is_some_and(|c| c.is_alphanumeric() || "._-}".contains(c))
    };
    let folders = [concat!("/wo", "rk/"), concat!("/ro", "ot/"), concat!("/t", "mp/")];
    folders.into_iter().find(|folder| text.match_indices(folder).any(|(at, _)| begins_a_path(at)))
}

/// The names under `[dependencies]`, in the manifest's order.
fn dependencies(manifest: &str) -> Vec<String> {
    let (mut inside, mut names) = (false, Vec::new());
    for line in manifest.lines().map(str::trim) {
        if let Some(section) = line.strip_prefix('[') {
            inside = section == "dependencies]";
            let named = section.strip_prefix("dependencies.").and_then(|s| s.strip_suffix(']'));
            names.extend(named.map(str::to_owned));
        } else if let Some((name, _)) = line.split_once('=').filter(|_| inside && !line.starts_with('#')) {
            names.push(name.trim().to_owned());
        }
    }
    names
}

/// True when the first cell of some table row lists the crate, so that no word in a sentence is taken for it.
fn is_explained(name: &str, document: &str) -> bool {
    let first_cells = document.lines().filter_map(|line| line.trim().strip_prefix('|')?.split('|').next());
    first_cells.flat_map(|cell| cell.split(',')).any(|item| item.trim().trim_matches('`') == name)
}
