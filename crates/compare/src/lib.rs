//! Comparisons of floats for tests. NaN on either side, an infinity on one side, and slices of different lengths
//! count as an infinite error, so that no assertion with an upper bound passes by accident. Equal infinities count as
//! equal.

/// Largest absolute difference of two sequences of equal length; 0 for empty ones.
pub fn largest_difference<'v, A, B>(
    found: impl IntoIterator<Item = &'v A>,
    expected: impl IntoIterator<Item = &'v B>,
) -> f64
where
    A: Copy + Into<f64> + 'v,
    B: Copy + Into<f64> + 'v,
{
    let (mut found, mut expected) = (found.into_iter(), expected.into_iter());
    let mut largest = 0.0;
    loop {
        match (found.next(), expected.next()) {
            (Some(a), Some(b)) => largest = worst([largest, difference((*a).into(), (*b).into())]),
            (None, None) => return largest,
            _ => return f64::INFINITY,
        }
    }
}

/// [`largest_difference`] divided by the largest absolute value of `expected`, which counts as at least 1e-9.
pub fn relative_error<'v, A, B>(
    found: impl IntoIterator<Item = &'v A>,
    expected: impl IntoIterator<Item = &'v B> + Clone,
) -> f64
where
    A: Copy + Into<f64> + 'v,
    B: Copy + Into<f64> + 'v,
{
    let scale = expected.clone().into_iter().fold(1e-9, |m: f64, v| m.max((*v).into().abs()));
    // An infinite scale would hide every other difference.
    if scale.is_finite() { largest_difference(found, expected) / scale } else { f64::INFINITY }
}

/// Root mean square difference of two sequences of equal length; 0 for empty ones.
pub fn rms_difference<A, B>(found: &[A], expected: &[B]) -> f64
where
    A: Copy + Into<f64>,
    B: Copy + Into<f64>,
{
    if found.len() != expected.len() {
        return f64::INFINITY;
    }
    let squares = found.iter().zip(expected).map(|(a, b)| difference((*a).into(), (*b).into()).powi(2));
    (squares.sum::<f64>() / found.len().max(1) as f64).sqrt()
}

/// The largest of non-negative errors; infinity if one of them is NaN.
pub fn worst<T: Into<f64>>(errors: impl IntoIterator<Item = T>) -> f64 {
    let errors = errors.into_iter().map(Into::into);
    errors.fold(0.0, |worst: f64, error: f64| if error.is_nan() { f64::INFINITY } else { worst.max(error) })
}

/// Absolute difference; infinity if a value is NaN, 0 for equal infinities.
pub fn difference(a: f64, b: f64) -> f64 {
    let apart = (a - b).abs();
    if a == b {
        0.0
    } else if apart.is_nan() {
        f64::INFINITY
    } else {
        apart
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BROKEN: [f32; 3] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];

    #[test]
    fn nan_or_infinity_on_one_side_is_an_infinite_error() {
        let good = [1.0f32, 2.0, 4.0];
        for value in BROKEN {
            for at in 0..3 {
                let mut bad = good;
                bad[at] = value;
                for (a, b) in [(&good, &bad), (&bad, &good)] {
                    assert_eq!(largest_difference(a, b), f64::INFINITY, "{value} at {at}");
                    assert_eq!(relative_error(a, b), f64::INFINITY, "{value} at {at}");
                    assert_eq!(rms_difference(a, b), f64::INFINITY, "{value} at {at}");
                }
            }
            assert_eq!(worst([0.5, value.abs(), 0.25]), f64::INFINITY);
        }
        let nan = [f32::NAN];
        assert_eq!(relative_error(&nan, &nan), f64::INFINITY, "NaN on both sides");
        let infinite = [f32::INFINITY, 1.0];
        assert_eq!(relative_error(&infinite, &[f32::INFINITY, 5.0]), f64::INFINITY, "an infinite scale");
    }

    #[test]
    fn different_lengths_are_an_infinite_error() {
        let (long, short) = ([1.0f32, 2.0], [1.0f32]);
        assert_eq!(largest_difference(&long, &short), f64::INFINITY);
        assert_eq!(relative_error(&short, &long), f64::INFINITY);
        assert_eq!(rms_difference(&long, &short), f64::INFINITY);
    }

    #[test]
    fn finite_numbers_are_compared_in_f64() {
        let (found, expected) = ([1.0f32, -2.0, 4.5], [1.0f64, -2.25, 4.0]);
        assert_eq!(largest_difference(&found, &expected), 0.5);
        assert_eq!(relative_error(&found, &expected), 0.125);
        assert_eq!(rms_difference(&[0.0f32, 0.0], &[3.0f32, 3.0]), 3.0);
        assert_eq!(worst([0.25f32, 0.5, 0.0]), 0.5);
        assert_eq!(largest_difference(&[f32::INFINITY, 1.0], &[f32::INFINITY, 1.0]), 0.0, "equal infinities");
        assert_eq!(relative_error::<f32, f32>([].iter(), [].iter()), 0.0);
    }
}
