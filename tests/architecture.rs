//! The shape of the house, read from its own text: which room may use which, how long a file may get, and
//! what must not be written anywhere.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Every room under `src/` and the rooms it may import. What is not listed is an arrow the wrong way.
const ALLOWED: &[(&str, &[&str])] = &[
    ("scene", &[]),
    ("light", &["scene"]),
    ("engine", &["scene", "light"]),
    ("formats", &["scene"]),
    ("capture", &["scene", "formats"]),
    ("train", &["scene", "light", "engine", "capture", "formats"]),
    ("render", &["scene", "light", "engine", "capture", "formats"]),
    ("eval", &["scene", "engine", "capture", "formats", "train", "render"]),
    ("api", &["capture", "train", "render"]),
    ("store", &["capture", "api"]),
    ("jobs", &["api", "store"]),
    ("worker", &["scene", "engine", "capture", "formats", "train", "render", "api", "store", "jobs"]),
    (
        "server",
        &["scene", "engine", "capture", "formats", "train", "render", "api", "store", "jobs", "worker"],
    ),
    ("client", &["capture", "render", "api"]),
    ("testing", &EVERY_ROOM),
    ("cli", &EVERY_ROOM),
];

const EVERY_ROOM: [&str; 16] = [
    "scene", "light", "engine", "formats", "capture", "train", "render", "eval", "api", "store", "jobs",
    "worker", "server", "client", "testing", "cli",
];

const LONGEST_FILE: usize = 600;

#[test]
fn imports_point_one_way() {
    let src = root().join("src");
    let mut wrong = Vec::new();
    for file in files_under(&src, &["rs"]) {
        let Some(room) = room_of(file.strip_prefix(&src).unwrap()) else { continue };
        let found = violations(&room, &read(&file));
        wrong.extend(found.into_iter().map(|v| format!("{}: {v}", shown(&file))));
    }
    assert!(wrong.is_empty(), "arrows the wrong way:\n{}", wrong.join("\n"));
}

#[test]
fn a_made_up_violation_is_caught_however_it_is_written() {
    let direct = "use crate::api::router;\n";
    let grouped = "use crate::{\n    scene::Model,\n    api::{router, state},\n};\n";
    let inline = "fn f() { crate::api::serve(); }\n";
    let renamed = "use crate::api as other;\n";
    let above = "use super::super::api::router;\n";
    for text in [direct, grouped, inline, renamed, above] {
        assert_eq!(violations("engine", text).len(), 1, "not caught: {text}");
    }
    assert!(violations("train", "use crate::{scene::Model, engine::Engine};\n").is_empty());
    assert_eq!(violations("cellar", "").len(), 1, "a room that nobody planned must be noticed");
}

#[test]
fn comments_own_paths_and_unit_tests_are_no_imports() {
    let text = "//! See [`crate::api`].\nuse crate::engine::Tile;\n/// [`crate::cli`]\nfn f() {}\n\
                #[cfg(test)]\nmod tests {\n    use crate::formats::png;\n}\n";
    assert!(violations("engine", text).is_empty());
}

#[test]
fn no_source_file_is_longer_than_a_reader_can_hold() {
    let lengths =
        files_under(&root().join("src"), &["rs"]).into_iter().map(|f| (read(&f).lines().count(), f));
    let long: Vec<String> = lengths
        .filter(|(lines, _)| *lines > LONGEST_FILE)
        .map(|(lines, file)| format!("{}: {lines} lines", shown(&file)))
        .collect();
    assert!(long.is_empty(), "files over {LONGEST_FILE} lines:\n{}", long.join("\n"));
}

#[test]
fn nothing_names_a_machine_or_how_the_text_came_about() {
    let mut found = Vec::new();
    for folder in ["src", "tests", "benches", "examples", "docs", "shaders", "migrations"] {
        for file in files_under(&root().join(folder), &["rs", "md", "wgsl", "sql", "toml"]) {
            let hits = forbidden_in(&read(&file));
            found.extend(hits.into_iter().map(|hit| format!("{}: {hit}", shown(&file))));
        }
    }
    found.extend(forbidden_in(&read(&root().join("Cargo.toml"))));
    assert!(found.is_empty(), "must not be in the repository:\n{}", found.join("\n"));
}

#[test]
fn forbidden_text_is_noticed_and_its_innocent_relatives_are_not() {
    // Spelt in pieces, or this file would accuse itself.
    for pieces in [["open /", "work/shared/x"], ["the next ses", "sion will"], ["an a", "gent wrote"]] {
        assert_eq!(forbidden_in(&pieces.concat()).len(), 1, "{pieces:?}");
    }
    let innocent = "User-Agent, SessionStore, network/shared, ./tmp/x, obsession, framework/src";
    assert!(forbidden_in(innocent).is_empty(), "{:?}", forbidden_in(innocent));
}

#[test]
fn every_dependency_earns_its_line_in_the_architecture_document() {
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

/// The crate's folder.
fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
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

/// The room a file belongs to: its top folder or its own stem; none for the crate's two roots.
fn room_of(relative: &Path) -> Option<String> {
    let first = relative.iter().next()?.to_str()?;
    let room = first.strip_suffix(".rs").unwrap_or(first);
    (!["lib", "main"].contains(&room)).then(|| room.to_owned())
}

/// What `room` imports and may not, one line each.
fn violations(room: &str, source: &str) -> Vec<String> {
    let Some((_, allowed)) = ALLOWED.iter().find(|(name, _)| *name == room) else {
        return vec![format!("the room `{room}` is in no layer: add it to the table")];
    };
    let code = production_code(source);
    let mut wrong: Vec<String> = imported_rooms(&code)
        .into_iter()
        .filter(|used| used != room && !allowed.contains(&used.as_str()))
        .map(|used| format!("`{room}` imports `{used}`"))
        .collect();
    if code.contains("super::super::") {
        wrong.push("`super::super::` hides where it leads: write `crate::`".to_owned());
    }
    wrong
}

/// The source without comments and without what follows the unit tests' attribute.
fn production_code(source: &str) -> String {
    let lines = source.lines().take_while(|line| line.trim() != "#[cfg(test)]");
    lines.map(|line| line.split("//").next().unwrap_or("")).collect::<Vec<_>>().join("\n")
}

/// The first segment of every path that starts at the crate's root, groups included.
fn imported_rooms(code: &str) -> BTreeSet<String> {
    let mut rooms = BTreeSet::new();
    for (at, marker) in code.match_indices("crate::") {
        let rest = &code[at + marker.len()..];
        match rest.strip_prefix('{') {
            Some(group) => rooms.extend(top_level_items(group).into_iter().map(first_segment)),
            None => drop(rooms.insert(first_segment(rest))),
        }
    }
    // What lies at the crate's root itself is no room: macros, constants, `self`.
    rooms.retain(|room| EVERY_ROOM.contains(&room.as_str()) || ALLOWED.iter().any(|(name, _)| name == room));
    rooms
}

/// The comma-separated items of a brace group whose opening brace was just read.
fn top_level_items(group: &str) -> Vec<&str> {
    let (mut depth, mut start, mut items) = (0, 0, Vec::new());
    for (i, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth == 0 => {
                items.push(&group[start..i]);
                break;
            }
            '}' => depth -= 1,
            ',' if depth == 0 => {
                items.push(&group[start..i]);
                start = i + 1;
            }
            _ => {}
        }
    }
    items
}

fn first_segment(path: &str) -> String {
    path.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
}

/// Machine paths and words that have no place in the repository, found in `text`.
fn forbidden_in(text: &str) -> Vec<String> {
    let paths = ["/work", "/root", "/tmp"].map(|folder| format!("{folder}/"));
    let begins_a_path = |at: usize| {
        let before = text[..at].chars().next_back();
        !before.is_some_and(|c| c.is_alphanumeric() || "._-}".contains(c))
    };
    let found = paths
        .iter()
        .filter(|path| text.match_indices(path.as_str()).any(|(at, _)| begins_a_path(at)))
        .cloned();
    let words =
        [["ses", "sion"], ["ses", "sions"], ["a", "gent"], ["a", "gents"]].map(|pieces| pieces.concat());
    let lower = text.to_lowercase().replace("user-agent", "").replace("user_agent", "");
    let spoken: BTreeSet<&str> = lower.split(|c: char| !c.is_alphanumeric() && c != '_').collect();
    found.chain(words.into_iter().filter(|word| spoken.contains(word.as_str()))).collect()
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
