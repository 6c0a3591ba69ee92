//! The table of `relume bench service`, with so few measurements that only its shape is tested.

use std::process::Command;

/// Options with which the loads take little time.
const TINY: &str = "--thumbnails 3 --size 16 --iterations 5 --gaussians 64 --photographs 3 --megapixels 0.01 --renders 2 --sockets 9";

fn bench(more: &[&str]) -> (bool, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command
        .args(["bench", "service", "--device", "cpu", "--render-size", "32"])
        .args(TINY.split(' '))
        .args(more);
    let output = command.output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.success(), text(&output.stdout), text(&output.stderr))
}

/// The cells of the rows below the header.
fn rows(table: &str) -> Vec<Vec<String>> {
    let cells = |line: &str| line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect();
    table.lines().filter(|line| line.starts_with('|')).skip(2).map(cells).collect()
}

#[test]
fn load_report_has_a_row_per_load_with_increasing_quantiles() {
    let (ended_well, table, log) = bench(&[]);
    assert!(ended_well, "{log}");
    let rows = rows(&table);
    let names = ["idle", "training", "3 JPEGs of 0.01 megapixels", "2 renders of 32 x 32", "9 half-sent"];
    assert_eq!(rows.len(), names.len(), "{table}");
    for (row, name) in rows.iter().zip(names) {
        assert!(row[0].contains(name), "{row:?}");
        assert_eq!(row[1..3], ["3", "0"], "all are answered: {row:?}");
        let times: Vec<f64> = row[3..7].iter().map(|cell| cell.parse().unwrap()).collect();
        assert!(times[0] > 0.0 && times.is_sorted(), "{row:?}");
        assert!(!cfg!(target_os = "linux") || row[7].parse::<u64>().unwrap() > 0, "{row:?}");
    }
    assert!(table.contains("Device: ") && !log.contains("refused"), "{table}{log}");
}

#[test]
fn loads_are_selected_by_name_and_unknown_ones_are_refused() {
    let (ended_well, table, log) = bench(&["--only", "sockets,idle"]);
    assert!(ended_well, "{log}");
    let names: Vec<String> = rows(&table).into_iter().map(|row| row[0].clone()).collect();
    assert_eq!(names, ["idle", "beside 9 half-sent requests"]);
    let (ended_well, _, log) = bench(&["--only", "storms"]);
    assert!(!ended_well && log.contains("storms"), "{log}");
}
