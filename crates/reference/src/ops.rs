//! The operations on tape values: arithmetic with broadcasting, element-wise functions, sums, products and
//! rearrangements along an axis. At a kink of a function the derivative is one-sided or zero, as documented.

use std::ops::{Add, Div, Mul, Neg, Range, Sub};

use super::array::{Array, broadcast_indices, broadcast_shape};
use super::tape::{Tape, Var};

impl<'t> Var<'t> {
    /// `f` of every value; `df(x, f(x))` is its derivative.
    pub fn map(self, f: impl Fn(f64) -> f64, df: impl Fn(f64, f64) -> f64 + 'static) -> Var<'t> {
        let x = self.value();
        let y = x.map(f);
        let derivative: Vec<f64> = x.data().iter().zip(y.data()).map(|(&x, &y)| df(x, y)).collect();
        self.tape.custom(&[self], y, move |g| {
            let scaled = g.data().iter().zip(&derivative).map(|(g, d)| g * d).collect();
            vec![Array::new(g.shape(), scaled)]
        })
    }

    /// `f` of every row of a (P, A) value, (P, B); `f` returns its value and its Jacobian `[B][A]`. This records functions
    /// outside of the tape, such as table look-ups.
    pub fn map_rows<const A: usize, const B: usize>(
        self,
        f: impl Fn([f64; A]) -> ([f64; B], [[f64; A]; B]),
    ) -> Var<'t> {
        let x = self.value();
        assert_eq!(x.shape().last(), Some(&A), "rows of {A} wanted");
        let rows = x.data().as_chunks::<A>().0.iter().map(|row| f(*row));
        let (values, jacobians): (Vec<_>, Vec<_>) = rows.unzip();
        self.tape.custom(&[self], Array::from_rows(&values), move |g| {
            let backward = |(g, j): (&[f64; B], &[[f64; A]; B])| -> [f64; A] {
                std::array::from_fn(|a| (0..B).map(|b| g[b] * j[b][a]).sum())
            };
            let rows: Vec<_> = g.data().as_chunks::<B>().0.iter().zip(&jacobians).map(backward).collect();
            vec![Array::from_rows(&rows)]
        })
    }

    /// `f(a, b)` over the broadcast of two arrays; `df(a, b)` are its two partial derivatives.
    fn zip(
        self,
        other: Var<'t>,
        f: impl Fn(f64, f64) -> f64,
        df: impl Fn(f64, f64) -> (f64, f64) + 'static,
    ) -> Var<'t> {
        let (a, b) = (self.value(), other.value());
        let shape = broadcast_shape(a.shape(), b.shape());
        let (ia, ib) = (broadcast_indices(a.shape(), &shape), broadcast_indices(b.shape(), &shape));
        let pairs = ia.iter().zip(&ib).map(|(&i, &j)| f(a.data()[i], b.data()[j])).collect();
        self.tape.custom(&[self, other], Array::new(&shape, pairs), move |g| {
            let (mut ga, mut gb) = (Array::zeros(a.shape()), Array::zeros(b.shape()));
            for ((&i, &j), &g) in ia.iter().zip(&ib).zip(g.data()) {
                let (da, db) = df(a.data()[i], b.data()[j]);
                ga.data_mut()[i] += g * da;
                gb.data_mut()[j] += g * db;
            }
            vec![ga, gb]
        })
    }

    /// Exponential.
    pub fn exp(self) -> Var<'t> {
        self.map(f64::exp, |_, y| y)
    }

    /// Natural logarithm.
    pub fn ln(self) -> Var<'t> {
        self.map(f64::ln, |x, _| 1.0 / x)
    }

    /// Square root; the derivative at 0 is defined as 0, so that the length of a zero vector has a finite gradient.
    pub fn sqrt(self) -> Var<'t> {
        self.map(f64::sqrt, |_, y| if y > 0.0 { 0.5 / y } else { 0.0 })
    }

    /// Integer power, `n >= 1`.
    pub fn powi(self, n: i32) -> Var<'t> {
        self.map(|x| x.powi(n), move |x, _| f64::from(n) * x.powi(n - 1))
    }

    /// Absolute value; derivative 0 at 0.
    pub fn abs(self) -> Var<'t> {
        self.map(f64::abs, |x, _| if x == 0.0 { 0.0 } else { x.signum() })
    }

    /// Logistic function.
    pub fn sigmoid(self) -> Var<'t> {
        self.map(|x| 1.0 / (1.0 + (-x).exp()), |_, y| y * (1.0 - y))
    }

    /// `ln(1 + e^x)`.
    pub fn softplus(self) -> Var<'t> {
        self.map(|x| x.max(0.0) + (-x.abs()).exp().ln_1p(), |x, _| 1.0 / (1.0 + (-x).exp()))
    }

    /// Limits to `[low, high]`; derivative 1 inside and on the limits, 0 outside.
    pub fn clamp(self, low: f64, high: f64) -> Var<'t> {
        self.map(|x| x.clamp(low, high), move |x, _| f64::from(u8::from((low..=high).contains(&x))))
    }

    /// Limits from below.
    pub fn at_least(self, low: f64) -> Var<'t> {
        self.clamp(low, f64::INFINITY)
    }

    /// Limits from above.
    pub fn at_most(self, high: f64) -> Var<'t> {
        self.clamp(f64::NEG_INFINITY, high)
    }

    /// Limits to `[low, high]`. Outside a gradient passes only if descent leads back inside, so that a saturated value neither
    /// diverges nor gets stuck.
    pub fn clamp_recoverable(self, low: f64, high: f64) -> Var<'t> {
        let x = self.value();
        self.tape.custom(&[self], x.map(|x| x.clamp(low, high)), move |g| {
            let backward = |(&x, &g): (&f64, &f64)| match x {
                x if x < low => g.min(0.0),
                x if x > high => g.max(0.0),
                _ => g,
            };
            vec![Array::new(g.shape(), x.data().iter().zip(g.data()).map(backward).collect())]
        })
    }

    /// Sum along `axis`, which stays with size 1.
    pub fn sum_axis(self, axis: usize) -> Var<'t> {
        let x = self.value();
        let value = x.reduced_to(&x.shape_with(axis, 1));
        self.tape.custom(&[self], value, move |g| {
            let repeated = broadcast_indices(g.shape(), x.shape()).iter().map(|&i| g.data()[i]).collect();
            vec![Array::new(x.shape(), repeated)]
        })
    }

    /// Sum along the last axis, which stays with size 1.
    pub fn sum_last(self) -> Var<'t> {
        self.sum_axis(self.value().shape().len() - 1)
    }

    /// Sum of all values, shape (1).
    pub fn sum(self) -> Var<'t> {
        let count = self.value().len();
        self.reshaped(&[count]).sum_axis(0)
    }

    /// Mean of all values, shape (1); 0 for an empty array.
    pub fn mean(self) -> Var<'t> {
        self.sum() * (1.0 / self.value().len().max(1) as f64)
    }

    /// Mean along the last axis, which stays with size 1.
    pub fn mean_last(self) -> Var<'t> {
        let size = self.value().shape().last().copied().unwrap_or(1);
        self.sum_last() * (1.0 / size as f64)
    }

    /// Inner product along the last axis, which stays with size 1.
    pub fn dot(self, other: Var<'t>) -> Var<'t> {
        (self * other).sum_last()
    }

    /// Rows scaled to unit length; a zero row stays zero.
    pub fn normalised(self) -> Var<'t> {
        self / self.dot(self).sqrt().at_least(1e-12)
    }

    /// Softmax along the last axis.
    pub fn softmax(self) -> Var<'t> {
        let x = self.value();
        let width = x.shape().last().copied().unwrap_or(1).max(1);
        let largest = x.data().chunks(width).map(|row| row.iter().copied().fold(f64::MIN, f64::max));
        let largest = Array::new(&x.shape_with(x.shape().len() - 1, 1), largest.collect());
        let e = (self - self.tape.input(largest)).exp();
        e / e.sum_last()
    }

    /// Matrix product over the last two axes; a batch of one is repeated.
    pub fn matmul(self, other: Var<'t>) -> Var<'t> {
        let (a, b) = (self.value(), other.value());
        self.tape.custom(&[self, other], a.matmul(&b), move |g| {
            let ga = g.matmul(&b.transposed());
            let gb = a.transposed().matmul(g);
            vec![ga.reduced_to(a.shape()), gb.reduced_to(b.shape())]
        })
    }

    /// The value with its last two axes exchanged.
    pub fn transposed(self) -> Var<'t> {
        self.tape.custom(&[self], self.value().transposed(), |g| vec![g.transposed()])
    }

    /// The same values under another shape.
    pub fn reshaped(self, shape: &[usize]) -> Var<'t> {
        let x = self.value();
        self.tape.custom(&[self], x.reshaped(shape), move |g| vec![g.reshaped(x.shape())])
    }

    /// Entries `range` along `axis`.
    pub fn slice(self, axis: usize, range: Range<usize>) -> Var<'t> {
        self.gather(axis, &range.collect::<Vec<_>>())
    }

    /// Column `i` of the last axis, which stays with size 1.
    pub fn column(self, i: usize) -> Var<'t> {
        self.slice(self.value().shape().len() - 1, i..i + 1)
    }

    /// Entries `indices` along `axis`, in that order; an index may repeat.
    pub fn gather(self, axis: usize, indices: &[usize]) -> Var<'t> {
        let x = self.value();
        let (outer, size, inner) = x.around(axis);
        let blocks = (0..outer).flat_map(|o| indices.iter().map(move |i| (o * size + i) * inner));
        let blocks: Vec<usize> = blocks.collect();
        let value = blocks.iter().flat_map(|&at| x.data()[at..at + inner].iter().copied()).collect();
        let value = Array::new(&x.shape_with(axis, indices.len()), value);
        self.tape.custom(&[self], value, move |g| {
            let mut gx = Array::zeros(x.shape());
            for (&at, g) in blocks.iter().zip(g.data().chunks(inner.max(1))) {
                gx.data_mut()[at..at + inner].iter_mut().zip(g).for_each(|(x, g)| *x += g);
            }
            vec![gx]
        })
    }

    /// Product of all entries before (`Forward`) or after (`Backward`) each along the last axis.
    pub fn exclusive_product(self, direction: ScanDirection) -> Var<'t> {
        let x = self.value();
        let width = x.shape().last().copied().unwrap_or(1).max(1);
        let mut y = Array::filled(x.shape(), 1.0);
        for (y, x) in y.data_mut().chunks_mut(width).zip(x.data().chunks(width)) {
            direction.steps(width).for_each(|(from, to)| y[to] = y[from] * x[from]);
        }
        let values = y.clone();
        self.tape.custom(&[self], y, move |g| {
            // The recurrence y[to] = y[from] x[from], from its last product to the first. There is no division, so x may be 0.
            let mut gy = g.clone();
            let mut gx = Array::zeros(x.shape());
            for (row, gy) in gy.data_mut().chunks_mut(width).enumerate() {
                let (x, y) = (&x.data()[row * width..], &values.data()[row * width..]);
                let gx = &mut gx.data_mut()[row * width..];
                for (from, to) in direction.steps(width).rev() {
                    gx[from] += gy[to] * y[from];
                    gy[from] += gy[to] * x[from];
                }
            }
            vec![gx]
        })
    }

    /// Convolution with an odd `kernel` along `axis`, same size, zeros outside.
    pub fn convolved(self, axis: usize, kernel: &[f64]) -> Var<'t> {
        let flipped: Vec<f64> = kernel.iter().rev().copied().collect();
        let value = correlated(&self.value(), axis, &flipped);
        let kernel = kernel.to_vec();
        self.tape.custom(&[self], value, move |g| vec![correlated(g, axis, &kernel)])
    }
}

/// Direction of a running product.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanDirection {
    /// Entry k holds the product of entries before k.
    Forward,
    /// Entry k holds the product of entries after k.
    Backward,
}

impl ScanDirection {
    /// The (from, to) index pairs of the product over `size` entries.
    fn steps(self, size: usize) -> impl DoubleEndedIterator<Item = (usize, usize)> {
        (1..size).map(move |k| match self {
            Self::Forward => (k - 1, k),
            Self::Backward => (size - k, size - k - 1),
        })
    }
}

fn correlated(x: &Array, axis: usize, kernel: &[f64]) -> Array {
    let (outer, size, inner) = x.around(axis);
    let half = kernel.len() / 2;
    let mut out = Array::zeros(x.shape());
    for o in 0..outer {
        for i in 0..size {
            for (tap, weight) in kernel.iter().enumerate() {
                let Some(j) = (i + tap).checked_sub(half).filter(|&j| j < size) else { continue };
                for c in 0..inner {
                    out.data_mut()[(o * size + i) * inner + c] +=
                        weight * x.data()[(o * size + j) * inner + c];
                }
            }
        }
    }
    out
}

/// Joins values along `axis`.
pub fn concat<'t>(tape: &'t Tape, axis: usize, parts: &[Var<'t>]) -> Var<'t> {
    let values: Vec<_> = parts.iter().map(|p| p.value()).collect();
    let sizes: Vec<usize> = values.iter().map(|v| v.shape()[axis]).collect();
    let (outer, _, inner) = values[0].around(axis);
    let mut data = Vec::new();
    for o in 0..outer {
        for (value, size) in values.iter().zip(&sizes) {
            data.extend_from_slice(&value.data()[o * size * inner..(o + 1) * size * inner]);
        }
    }
    let joined = Array::new(&values[0].shape_with(axis, sizes.iter().sum()), data);
    tape.custom(parts, joined, move |g| {
        let total: usize = sizes.iter().sum();
        let mut start = 0;
        let part = |&size: &usize| {
            let block = |o: usize| &g.data()[(o * total + start) * inner..][..size * inner];
            let data = (0..outer).flat_map(|o| block(o).iter().copied()).collect();
            let part = Array::new(&g.shape_with(axis, size), data);
            start += size;
            part
        };
        sizes.iter().map(part).collect()
    })
}

/// The binary operators, between values and between a value and a number on either side.
macro_rules! binary_operator {
    ($trait:ident, $method:ident, $f:expr, $df:expr) => {
        impl<'t> $trait for Var<'t> {
            type Output = Var<'t>;
            fn $method(self, other: Var<'t>) -> Var<'t> {
                self.zip(other, $f, $df)
            }
        }
        impl<'t> $trait<f64> for Var<'t> {
            type Output = Var<'t>;
            fn $method(self, other: f64) -> Var<'t> {
                self.map(|a| $f(a, other), move |a, _| $df(a, other).0)
            }
        }
        impl<'t> $trait<Var<'t>> for f64 {
            type Output = Var<'t>;
            fn $method(self, other: Var<'t>) -> Var<'t> {
                other.map(|b| $f(self, b), move |b, _| $df(self, b).1)
            }
        }
    };
}

binary_operator!(Add, add, |a: f64, b: f64| a + b, |_: f64, _: f64| (1.0, 1.0));
binary_operator!(Sub, sub, |a: f64, b: f64| a - b, |_: f64, _: f64| (1.0, -1.0));
binary_operator!(Mul, mul, |a: f64, b: f64| a * b, |a: f64, b: f64| (b, a));
binary_operator!(Div, div, |a: f64, b: f64| a / b, |a: f64, b: f64| (1.0 / b, -a / (b * b)));

impl<'t> Neg for Var<'t> {
    type Output = Var<'t>;
    fn neg(self) -> Var<'t> {
        self * -1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_compare::worst;

    /// Largest difference between the tape's gradient of `sum(f(x) * weights)` and central differences.
    fn gradient_error(x: &Array, f: impl for<'t> Fn(Var<'t>) -> Var<'t>) -> f64 {
        let loss = |x: &Array| {
            let tape = Tape::new();
            let input = tape.input(x.clone());
            let y = f(input);
            let weights = (0..y.value().len()).map(|i| 0.3 + (i as f64).sin()).collect();
            let loss = (y * tape.input(Array::new(y.value().shape(), weights))).sum();
            (loss.value().data()[0], tape.gradients(loss).of(input))
        };
        let analytic = loss(x).1;
        let h = 1e-6;
        let moved = |i: usize, by: f64| {
            let mut x = x.clone();
            x.data_mut()[i] += by;
            loss(&x).0
        };
        let error = |i: usize| ((moved(i, h) - moved(i, -h)) / (2.0 * h) - analytic.data()[i]).abs();
        worst((0..x.len()).map(error))
    }

    fn sample() -> Array {
        Array::new(&[2, 3], vec![0.4, -1.3, 0.9, 2.1, -0.2, 0.7])
    }

    #[test]
    fn each_operation_gradient_agrees_with_central_differences() {
        type Op = (&'static str, for<'t> fn(Var<'t>) -> Var<'t>);
        let ops: [Op; 14] = [
            ("exp", |x| x.exp()),
            ("ln and sqrt", |x| (x * x + 0.1).sqrt().ln()),
            ("powi and abs", |x| x.powi(3) + x.abs()),
            ("sigmoid and softplus", |x| x.sigmoid() * x.softplus()),
            ("clamp", |x| x.clamp(-0.5, 1.0)),
            ("quotients with broadcasting", |x| x.column(0) / (x + 3.0) - 2.0 / (x.column(1) + 4.0)),
            ("softmax", |x| x.softmax()),
            ("normalised", |x| x.normalised()),
            ("matmul and transposed", |x| x.matmul(x.transposed())),
            ("batched product", |x| x.slice(0, 0..1).reshaped(&[1, 1, 3]).matmul(x.reshaped(&[2, 3, 1]))),
            ("gather with repeats", |x| x.gather(1, &[2, 0, 2])),
            ("products", |x| {
                x.exclusive_product(ScanDirection::Forward) + x.exclusive_product(ScanDirection::Backward)
            }),
            ("convolved", |x| x.convolved(1, &[0.2, 0.5, -0.4]).convolved(0, &[0.1, 0.8, 0.3])),
            ("concat", |x| concat(x.tape, 1, &[x * x, x.column(1), x])),
        ];
        for (name, op) in ops {
            let error = gradient_error(&sample(), op);
            assert!(error < 1e-8, "{name}: {error:e}");
        }
    }

    #[test]
    fn recoverable_clamp_gradient_only_points_back_into_the_range() {
        let tape = Tape::new();
        let x = tape.input(Array::new(&[3], vec![-1.0, 0.5, 2.0]));
        let down = tape.gradients(x.clamp_recoverable(0.0, 1.0).sum()).of(x);
        let up = tape.gradients((-x.clamp_recoverable(0.0, 1.0)).sum()).of(x);
        assert_eq!((down.data(), up.data()), (&[0.0, 1.0, 1.0][..], &[-1.0, -1.0, 0.0][..]));
    }

    #[test]
    fn central_differences_detect_a_detached_path() {
        assert!(gradient_error(&sample(), |x| x.detached() * x) > 0.1);
    }
}
