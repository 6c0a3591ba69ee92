//! The order of Gaussians in memory: along a Morton curve through their centres, so that Gaussians of the same image
//! tile are close in memory.

/// Bits per coordinate.
const BITS: u32 = 10;

/// Positions of points on the curve through their bounding box. Points that are not finite do not affect the
/// box; a NaN coordinate maps to the lowest cell.
pub(super) fn morton_codes(points: &[[f32; 3]]) -> Vec<u32> {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for point in points.iter().filter(|point| point.iter().all(|x| x.is_finite())) {
        for k in 0..3 {
            (low[k], high[k]) = (low[k].min(point[k]), high[k].max(point[k]));
        }
    }
    let cells = (1 << BITS) as f32;
    let cell = |point: &[f32; 3], k: usize| {
        let share = (point[k] - low[k]) / (high[k] - low[k]).max(f32::MIN_POSITIVE);
        // The cast converts NaN to 0.
        (share * cells).clamp(0.0, cells - 1.0) as u32
    };
    points.iter().map(|point| (0..3).map(|k| spread(cell(point, k)) << k).sum()).collect()
}

/// Spreads the lowest ten bits to every third bit.
fn spread(x: u32) -> u32 {
    (0..BITS).map(|bit| (x >> bit & 1) << (3 * bit)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn morton_codes_interleave_the_coordinate_bits() {
        let corners = [[0.0, 0.0, 0.0], [4.0, 2.0, 8.0]];
        let codes =
            morton_codes(&[corners[0], corners[1], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 4.0]]);
        assert_eq!(codes, [0, (1 << 30) - 1, 1 << 27, 1 << 28, 1 << 29]);
    }

    #[test]
    fn neighbours_on_the_morton_curve_are_close_in_space() {
        let point = |i: usize| [i % 16, i / 16 % 16, i / 256].map(|x| x as f32);
        let points: Vec<[f32; 3]> = (0..4096).map(|i| point(i * 1031 % 4096)).collect();
        let codes = morton_codes(&points);
        let mut order: Vec<usize> = (0..points.len()).collect();
        let mean_step = |order: &[usize]| {
            let step = |w: &[usize]| (0..3).map(|k| (points[w[0]][k] - points[w[1]][k]).abs()).sum::<f32>();
            order.windows(2).map(step).sum::<f32>() / order.len() as f32
        };
        let before = mean_step(&order);
        order.sort_unstable_by_key(|&i| codes[i]);
        assert!(mean_step(&order) < 2.5 && before > 8.0, "{} from {before}", mean_step(&order));
    }

    #[test]
    fn non_finite_points_do_not_change_other_codes() {
        let sound = morton_codes(&[[0.0; 3], [1.0; 3]]);
        let codes = morton_codes(&[[0.0; 3], [f32::NAN, 0.0, 0.0], [1.0; 3], [0.0, f32::INFINITY, 0.0]]);
        assert_eq!([codes[0], codes[2]], sound[..]);
        assert_eq!(morton_codes(&[[0.3; 3]; 2]), [0, 0]);
        assert!(morton_codes(&[]).is_empty());
    }
}
