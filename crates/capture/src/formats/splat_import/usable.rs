//! Selects the rows of a table that become Gaussians, and counts the rows that it leaves out or repairs.

use crate::formats::ply_table::{PlyError, PlyTable, bad};
use crate::formats::splat_import::columns::SplatColumns;

/// The usable rows, and the numbers of unusable and of repaired rows.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct UsableRows {
    /// Indices of the rows, ascending.
    kept: Vec<usize>,
    /// Number of rows with an opacity of 0.
    invisible: usize,
    /// Number of rows with a value that is not usable, and the index of the first.
    broken: (usize, usize),
    /// Number of usable rows whose quaternion is zero, and the index of the first.
    unrotated: (usize, usize),
}

/// Counts row `i` in a count with the index of the first.
fn count((count, first): &mut (usize, usize), i: usize) {
    if *count == 0 {
        *first = i;
    }
    *count += 1;
}

impl UsableRows {
    /// Sorts the rows.
    ///
    /// # Errors
    /// If the table has no rows, if more than half of them are broken, or if none is visible.
    pub(super) fn of(table: &PlyTable, columns: &SplatColumns) -> Result<Self, PlyError> {
        let mut rows = Self { kept: Vec::new(), invisible: 0, broken: (0, 0), unrotated: (0, 0) };
        for (i, row) in table.rows().enumerate() {
            if !columns.is_usable(row) {
                count(&mut rows.broken, i);
            } else if columns.is_invisible(row) {
                rows.invisible += 1;
            } else {
                rows.kept.push(i);
                if columns.rotation(row).is_none() {
                    count(&mut rows.unrotated, i);
                }
            }
        }
        let (total, (broken, first)) = (table.rows().len(), rows.broken);
        if total == 0 {
            return bad("element vertex", "the file has no splats; export the scene again");
        }
        if 2 * broken > total {
            return bad(
                format!("vertex {first}"),
                format!(
                    "has a value that is infinite, not a number or above 1e12, as {broken} of {total} splats; export the scene again"
                ),
            );
        }
        if rows.kept.is_empty() {
            return bad("property opacity", format!("is 0 in all of the {total} usable splats"));
        }
        Ok(rows)
    }

    /// Number of rows that become Gaussians.
    pub(super) fn len(&self) -> usize {
        self.kept.len()
    }

    /// The row of the file that became Gaussian `i`.
    pub(super) fn row_of(&self, i: usize) -> Option<usize> {
        self.kept.get(i).copied()
    }

    /// The rows that become Gaussians.
    pub(super) fn kept<'a>(&'a self, table: &'a PlyTable) -> impl Iterator<Item = &'a [f64]> {
        self.kept.iter().filter_map(|i| table.rows().nth(*i))
    }

    /// Notes on splats that the import omits or repairs.
    pub(super) fn notes(&self) -> Vec<String> {
        let (broken, first) = self.broken;
        let total = self.kept.len() + self.invisible + broken;
        let mut notes = Vec::new();
        if broken > 0 {
            notes.push(format!(
                "{broken} of {total} splats were left out, because a value is infinite, not a number or above 1e12; the first is vertex {first}"
            ));
        }
        if self.invisible > 0 {
            notes.push(format!(
                "{} of {total} splats were left out, because their opacity is 0",
                self.invisible
            ));
        }
        let (unrotated, first) = self.unrotated;
        if unrotated > 0 {
            notes.push(format!(
                "{unrotated} of {total} splats have a rotation of zero, and were imported without a rotation; the first is vertex {first}"
            ));
        }
        notes
    }
}
