//! Checks that `docs/errors.md` lists the problem types in the code.

use std::collections::BTreeSet;
use std::path::Path;

/// Calls that create a problem; the first text in them that looks like a problem type is one.
const MAKERS: [&str; 5] =
    ["Problem::new(", "Self::new(", "Problem::conflict(", "Self::conflict(", "Problem::forbidden("];

#[test]
fn error_page_lists_exactly_the_problem_types_in_the_code() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut made = BTreeSet::new();
    for folder in ["src/server", "crates/api/src"] {
        for file in walkdir(&root.join(folder)) {
            made.extend(kinds(&std::fs::read_to_string(file).unwrap()));
        }
    }
    let page = std::fs::read_to_string(root.join("docs/errors.md")).unwrap();
    assert!(made.len() > 30, "{made:?}");
    assert_eq!(made, documented(&page));
}

#[test]
fn problem_types_are_found_in_code_and_on_the_error_page() {
    let code =
        r#"Err(Problem::conflict("job-gone", detail)); Self::new(StatusCode::GONE, "late", "It is late")"#;
    assert_eq!(kinds(code), BTreeSet::from(["job-gone".to_owned(), "late".to_owned()]));
    assert_eq!(kinds(r#"#[cfg(test)] mod tests { Problem::conflict("not-this", "") }"#), BTreeSet::new());
    let page = "| type | status |\n|---|---|\n| `a`, `b-c` | 403 | `d` |\ntext `e`\n";
    assert_eq!(documented(page), BTreeSet::from(["a".to_owned(), "b-c".to_owned()]));
}

/// Types of the problems that `code` creates outside of its tests.
fn kinds(code: &str) -> BTreeSet<String> {
    let code = code.split("#[cfg(test)]").next().unwrap_or_default();
    let after = |maker: &&str| -> Vec<usize> {
        code.match_indices(*maker).map(|(at, maker)| at + maker.len()).collect()
    };
    let calls = MAKERS.iter().flat_map(after);
    calls.filter_map(|at| first_kind(code[at..].split(';').next().unwrap_or_default())).collect()
}

/// The first text of a call in lower case with hyphens.
fn first_kind(call: &str) -> Option<String> {
    let mut texts = call.split('"').skip(1).step_by(2);
    let is_kind = |text: &&str| {
        !text.is_empty() && text.chars().all(|c| c.is_ascii_lowercase() || c == '-') && !text.starts_with('-')
    };
    texts.next().filter(is_kind).map(str::to_owned)
}

/// Problem types in the first column of the page's tables.
fn documented(page: &str) -> BTreeSet<String> {
    let first_cells = page.lines().filter_map(|line| line.strip_prefix("| `")?.split('|').next());
    let names = first_cells.flat_map(|cell| cell.split(',')).map(|name| name.trim().trim_matches('`'));
    names.map(str::to_owned).collect()
}

/// Rust files in a folder and its subfolders.
fn walkdir(folder: &Path) -> Vec<std::path::PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(walkdir(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
    found
}
