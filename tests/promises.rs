//! docs/promises.md names tests; each of them exists.

use std::collections::BTreeSet;
use std::path::Path;

/// The names of all test functions in the Rust files under `folder`.
fn tests_under(folder: &Path, names: &mut BTreeSet<String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            tests_under(&path, names);
        } else if path.extension().is_some_and(|e| e == "rs") {
            let mut is_test = false;
            for line in std::fs::read_to_string(&path).unwrap().lines().map(str::trim) {
                if line.starts_with("#[test]") || line.starts_with("#[tokio::test") {
                    is_test = true;
                } else if let Some((_, name)) = line.split_once("fn ").filter(|_| is_test) {
                    names.insert(name.split('(').next().unwrap_or_default().to_owned());
                    is_test = false;
                }
            }
        }
    }
}

#[test]
fn every_promise_names_tests_that_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut tests = BTreeSet::new();
    ["src", "crates", "tests"].iter().for_each(|folder| tests_under(&root.join(folder), &mut tests));
    assert!(tests.contains("every_promise_names_tests_that_exist") && !tests.contains("tests_under"));
    let promises = std::fs::read_to_string(root.join("docs/promises.md")).unwrap();
    let rows = promises.lines().filter(|l| l.starts_with("| ") && !l.starts_with("| promise"));
    let mut promised = 0;
    for row in rows {
        let named: Vec<&str> = row.split('`').skip(1).step_by(2).filter(|n| n.contains('_')).collect();
        assert!(!named.is_empty(), "{row}");
        for name in named {
            assert!(tests.contains(name), "no test is named {name}");
            promised += 1;
        }
    }
    assert!(promised > 40);
}
