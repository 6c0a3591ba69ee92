//! Dense row-major f64 arrays.

/// A dense array of f64, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    shape: Vec<usize>,
    data: Vec<f64>,
}

impl Array {
    /// An array of `shape` holding `data` in row-major order.
    ///
    /// # Panics
    /// When the number of values does not match the shape.
    pub fn new(shape: &[usize], data: Vec<f64>) -> Self {
        assert_eq!(shape.iter().product::<usize>(), data.len(), "values do not fit shape {shape:?}");
        Self { shape: shape.to_vec(), data }
    }

    /// An array of `shape` with the same value everywhere.
    pub fn filled(shape: &[usize], value: f64) -> Self {
        Self { shape: shape.to_vec(), data: vec![value; shape.iter().product()] }
    }

    /// An array of `shape` full of zeros.
    pub fn zeros(shape: &[usize]) -> Self {
        Self::filled(shape, 0.0)
    }

    /// A (n, W) array from n rows.
    pub fn from_rows<const W: usize>(rows: &[[f64; W]]) -> Self {
        Self { shape: vec![rows.len(), W], data: rows.as_flattened().to_vec() }
    }

    /// Sizes of the axes, outermost first.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The values in row-major order.
    pub fn data(&self) -> &[f64] {
        &self.data
    }

    /// The values in row-major order, mutable.
    pub fn data_mut(&mut self) -> &mut [f64] {
        &mut self.data
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        self.data.len()
    }

    /// True when there are no values.
    pub fn is_empty(&self) -> bool {
        self.data.is_empty()
    }

    /// Row `i` of the array, viewed as a matrix whose columns are the last axis.
    pub fn row(&self, i: usize) -> &[f64] {
        let width = self.shape.last().copied().unwrap_or(1);
        &self.data[i * width..(i + 1) * width]
    }

    /// The same values under another shape.
    #[must_use]
    pub fn reshaped(&self, shape: &[usize]) -> Self {
        Self::new(shape, self.data.clone())
    }

    /// `f` of every value.
    #[must_use]
    pub fn map(&self, f: impl Fn(f64) -> f64) -> Self {
        Self { shape: self.shape.clone(), data: self.data.iter().map(|&x| f(x)).collect() }
    }

    /// The column of each row's smallest value, the first on a tie.
    pub(super) fn smallest_columns(&self) -> Vec<usize> {
        let smallest =
            |row: &[f64]| (1..row.len()).fold(0, |best, k| if row[k] < row[best] { k } else { best });
        (0..self.shape[0]).map(|i| smallest(self.row(i))).collect()
    }

    /// The shape seen from one axis: (product of the axes before, its size, product of the axes after).
    pub(super) fn around(&self, axis: usize) -> (usize, usize, usize) {
        let (before, rest) = self.shape.split_at(axis);
        (before.iter().product(), rest[0], rest[1..].iter().product())
    }

    /// The shape with `axis` resized.
    pub(super) fn shape_with(&self, axis: usize, size: usize) -> Vec<usize> {
        let mut shape = self.shape.clone();
        shape[axis] = size;
        shape
    }

    /// The array with its last two axes exchanged.
    pub(super) fn transposed(&self) -> Self {
        let (batch, rows, cols) = self.matrices();
        let mut shape = self.shape.clone();
        let rank = shape.len();
        shape.swap(rank - 1, rank - 2);
        let mut data = Vec::with_capacity(self.len());
        for b in 0..batch {
            for c in 0..cols {
                data.extend((0..rows).map(|r| self.data[(b * rows + r) * cols + c]));
            }
        }
        Self { shape, data }
    }

    /// Matrix product over the last two axes; a batch of one is repeated over the other's batch.
    pub(super) fn matmul(&self, other: &Self) -> Self {
        let (batch_a, rows, inner) = self.matrices();
        let (batch_b, inner_b, cols) = other.matrices();
        assert_eq!(inner, inner_b, "matrix product of {:?} and {:?}", self.shape, other.shape);
        assert!(batch_a == batch_b || batch_a == 1 || batch_b == 1, "batches differ");
        let batched = if batch_b == 1 { self } else { other };
        let mut shape = batched.shape.clone();
        let rank = shape.len();
        (shape[rank - 2], shape[rank - 1]) = (rows, cols);
        let batch = if batch_a == 1 { batch_b } else { batch_a };
        let mut data = vec![0.0; batch * rows * cols];
        for (i, out) in data.chunks_exact_mut(cols.max(1)).enumerate() {
            let (b, r) = (i / rows, i % rows);
            let a_row = (b % batch_a * rows + r) * inner;
            let b_start = b % batch_b * inner * cols;
            for k in 0..inner {
                let a = self.data[a_row + k];
                let b_row = &other.data[b_start + k * cols..][..cols];
                out.iter_mut().zip(b_row).for_each(|(o, &b)| *o += a * b);
            }
        }
        Self { shape, data }
    }

    /// Sums over the axes along which broadcasting repeated an array of `shape`.
    pub(super) fn reduced_to(&self, shape: &[usize]) -> Self {
        if self.shape == shape {
            return self.clone();
        }
        let mut out = Self::zeros(shape);
        for (&source, &value) in broadcast_indices(shape, &self.shape).iter().zip(&self.data) {
            out.data[source] += value;
        }
        out
    }

    fn matrices(&self) -> (usize, usize, usize) {
        let rank = self.shape.len();
        assert!(rank >= 2, "a matrix has two axes, got shape {:?}", self.shape);
        (self.shape[..rank - 2].iter().product(), self.shape[rank - 2], self.shape[rank - 1])
    }
}

/// The common shape of two arrays under broadcasting: axes aligned at the end, size 1 repeats.
pub(super) fn broadcast_shape(a: &[usize], b: &[usize]) -> Vec<usize> {
    let rank = a.len().max(b.len());
    let size = |shape: &[usize], axis: usize| (axis + shape.len()).checked_sub(rank).map_or(1, |i| shape[i]);
    (0..rank)
        .map(|axis| match (size(a, axis), size(b, axis)) {
            (x, y) if x == y => x,
            (1, y) => y,
            (x, 1) => x,
            _ => panic!("shapes {a:?} and {b:?} do not broadcast"),
        })
        .collect()
}

/// For every element of shape `out`, the index of the element of an array of `shape` that broadcasting maps to it.
pub(super) fn broadcast_indices(shape: &[usize], out: &[usize]) -> Vec<usize> {
    let mut indices = vec![0];
    let mut stride: usize = shape.iter().product();
    for (axis, &size) in out.iter().enumerate() {
        let own = (axis + shape.len()).checked_sub(out.len()).map_or(1, |i| shape[i]);
        stride /= own.max(1);
        let step = if own == 1 { 0 } else { stride };
        indices = indices.iter().flat_map(|&i| (0..size).map(move |k| i + k * step)).collect();
    }
    indices
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn broadcasting_repeats_axes_of_size_one_and_missing_axes() {
        assert_eq!(broadcast_shape(&[2, 1], &[3]), [2, 3]);
        assert_eq!(broadcast_indices(&[2, 1], &[2, 3]), [0, 0, 0, 1, 1, 1]);
        assert_eq!(broadcast_indices(&[3], &[2, 3]), [0, 1, 2, 0, 1, 2]);
        assert_eq!(Array::filled(&[2, 3], 1.0).reduced_to(&[2, 1]).data(), [3.0, 3.0]);
    }

    #[test]
    fn single_matrix_is_broadcast_in_batched_matmul() {
        let swap = Array::new(&[1, 2, 2], vec![0.0, 1.0, 1.0, 0.0]);
        let pair = Array::new(&[2, 2, 1], vec![1.0, 2.0, 3.0, 4.0]);
        assert_eq!(swap.matmul(&pair), Array::new(&[2, 2, 1], vec![2.0, 1.0, 4.0, 3.0]));
        assert_eq!(pair.transposed().shape(), [2, 1, 2]);
    }
}
