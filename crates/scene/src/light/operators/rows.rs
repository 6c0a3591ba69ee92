//! Sums of weighted rows: the inner loops of the operators.

use multiversion::multiversion;

/// Floats in a block of a row.
pub(super) const LANES: usize = 16;

/// `out += sum over entries (k, weight) of weight * row k`, where `rows` are as wide as `out`. Each float is summed in the order of the
/// entries on every CPU.
#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "aarch64+neon"))]
pub(super) fn add_rows(out: &mut [f32], entries: &[(u32, f32)], rows: &[f32]) {
    // Sums of a width known at compile time stay in registers: three colours of 16, 32, 48 or 64 coefficients.
    match out.len() {
        48 => add_blocks::<3>(out, entries, rows),
        96 => add_blocks::<6>(out, entries, rows),
        144 => add_blocks::<9>(out, entries, rows),
        192 => add_blocks::<12>(out, entries, rows),
        width => {
            for &(k, weight) in entries {
                let row = &rows[k as usize * width..(k as usize + 1) * width];
                out.iter_mut().zip(row).for_each(|(o, v)| *o += weight * v);
            }
        }
    }
}

#[inline(always)]
fn add_blocks<const BLOCKS: usize>(out: &mut [f32], entries: &[(u32, f32)], rows: &[f32]) {
    let rows = rows.as_chunks::<LANES>().0;
    let Some(out) = out.as_chunks_mut::<LANES>().0.first_chunk_mut::<BLOCKS>() else { return };
    let mut sums = *out;
    for &(k, weight) in entries {
        let row = &rows[k as usize * BLOCKS..(k as usize + 1) * BLOCKS];
        for (sum, block) in sums.iter_mut().zip(row) {
            for i in 0..LANES {
                sum[i] += weight * block[i];
            }
        }
    }
    *out = sums;
}

/// Colours of sixteen rows, `[rgb][lane]`.
pub(super) type Slice = [[f32; LANES]; 3];

/// Sparse rows in slices of sixteen. A slice has every column that one of its rows has. Each lane sums the colours of one
/// row.
#[derive(Debug, Clone)]
pub(super) struct SlicedRows {
    /// First entry of each slice, and the end.
    start: Vec<u32>,
    columns: Vec<u32>,
    weights: Vec<[f32; LANES]>,
}

impl SlicedRows {
    /// From the rows, `(column, weight)` by ascending column.
    pub(super) fn new<'a>(rows: impl Iterator<Item = &'a [(u32, f32)]>) -> Self {
        let mut out = Self { start: vec![0], columns: Vec::new(), weights: Vec::new() };
        let rows: Vec<_> = rows.collect();
        let columns = rows.iter().filter_map(|row| row.last()).map(|(column, _)| column + 1).max();
        let mut slice: Vec<Option<[f32; LANES]>> = vec![None; columns.unwrap_or(0) as usize];
        for rows in rows.chunks(LANES) {
            for (lane, row) in rows.iter().enumerate() {
                for (column, weight) in *row {
                    slice[*column as usize].get_or_insert_default()[lane] = *weight;
                }
            }
            for (column, weights) in (0..).zip(&mut slice) {
                if let Some(weights) = weights.take() {
                    out.columns.push(column);
                    out.weights.push(weights);
                }
            }
            out.start.push(out.columns.len() as u32);
        }
        out
    }

    /// Number of slices.
    pub(super) fn len(&self) -> usize {
        self.start.len() - 1
    }

    /// Adds the sums of a slice's rows over `colours`, one colour per column, in the order of the columns.
    pub(super) fn add(&self, slice: usize, colours: &[[f32; 3]], out: &mut Slice) {
        let entries = self.start[slice] as usize..self.start[slice + 1] as usize;
        add_slice(&self.columns[entries.clone()], &self.weights[entries], colours, out);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "aarch64+neon"))]
fn add_slice(columns: &[u32], weights: &[[f32; LANES]], colours: &[[f32; 3]], out: &mut Slice) {
    let mut sums = *out;
    for (column, weight) in columns.iter().zip(weights) {
        let colour = colours[*column as usize];
        for (sum, value) in sums.iter_mut().zip(colour) {
            for i in 0..LANES {
                sum[i] += weight[i] * value;
            }
        }
    }
    *out = sums;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(count: usize) -> Vec<f32> {
        (0..count).map(|i| ((i * 37 + 11) % 101) as f32 / 50.0 - 1.0).collect()
    }

    #[test]
    fn add_rows_sums_in_entry_order_for_every_width() {
        let entries: Vec<(u32, f32)> = (0..50).map(|i| ((i * 7) % 20, 0.1 + i as f32)).collect();
        for width in [48, 96, 144, 192, 7] {
            let rows = numbers(20 * width);
            let mut expected = numbers(width);
            for (k, weight) in &entries {
                (0..width).for_each(|i| expected[i] += weight * rows[*k as usize * width + i]);
            }
            let mut sums = numbers(width);
            add_rows(&mut sums, &entries, &rows);
            assert_eq!(sums, expected, "{width}");
        }
    }

    #[test]
    fn sliced_row_sums_equal_single_row_sums() {
        let colours: Vec<[f32; 3]> = numbers(60).as_chunks::<3>().0.to_vec();
        let rows: Vec<Vec<(u32, f32)>> = (0..37u32)
            .map(|r| (0..20).filter(|k| (k * r) % 3 == 1).map(|k| (k, 0.5 + k as f32)).collect())
            .collect();
        let sliced = SlicedRows::new(rows.iter().map(Vec::as_slice));
        assert_eq!(sliced.len(), 3);
        for (r, row) in rows.iter().enumerate() {
            let mut found = [[1.0; LANES]; 3];
            sliced.add(r / LANES, &colours, &mut found);
            for c in 0..3 {
                let sum = row.iter().fold(1.0f32, |sum, (k, w)| sum + w * colours[*k as usize][c]);
                assert_eq!(found[c][r % LANES], sum, "{r} {c}");
            }
        }
    }
}
