//! Reverse-mode differentiation over dense arrays. Every operation appends its value and its pullback to a tape; one backward
//! pass along the tape computes the gradient of a scalar.

use std::cell::RefCell;
use std::rc::Rc;

use super::array::Array;

/// Maps the gradient at a node's value to one gradient per parent.
type Pullback = Box<dyn Fn(&Array) -> Vec<Array>>;

struct Node {
    value: Rc<Array>,
    parents: Vec<usize>,
    pullback: Pullback,
}

/// The record of a computation.
#[derive(Default)]
pub struct Tape {
    nodes: RefCell<Vec<Node>>,
}

/// A value on a tape. Cheap to copy; operators and methods record new values.
#[derive(Clone, Copy)]
pub struct Var<'t> {
    pub(super) tape: &'t Tape,
    id: usize,
}

impl Tape {
    /// An empty tape.
    pub fn new() -> Self {
        Self::default()
    }

    /// Records a value without parents.
    pub fn input(&self, value: Array) -> Var<'_> {
        self.custom(&[], value, |_| Vec::new())
    }

    /// Records a single number, shape (1).
    pub fn scalar(&self, value: f64) -> Var<'_> {
        self.input(Array::new(&[1], vec![value]))
    }

    /// Records an operation: its `value`, and a `pullback` from the gradient at the value to the gradients
    /// at the `parents`, in their order and shapes.
    pub fn custom<'t>(
        &'t self,
        parents: &[Var<'t>],
        value: Array,
        pullback: impl Fn(&Array) -> Vec<Array> + 'static,
    ) -> Var<'t> {
        let parents = parents.iter().map(|p| p.id).collect();
        let mut nodes = self.nodes.borrow_mut();
        nodes.push(Node { value: Rc::new(value), parents, pullback: Box::new(pullback) });
        Var { tape: self, id: nodes.len() - 1 }
    }

    /// Gradients of the sum of `of` with respect to everything recorded before it.
    pub fn gradients(&self, of: Var<'_>) -> TapeGradients {
        let nodes = self.nodes.borrow();
        let mut grads: Vec<Option<Array>> = vec![None; of.id + 1];
        grads[of.id] = Some(Array::filled(nodes[of.id].value.shape(), 1.0));
        for (id, node) in nodes.iter().enumerate().take(of.id + 1).rev() {
            let Some(grad) = &grads[id] else { continue };
            for (&parent, by_parent) in node.parents.iter().zip((node.pullback)(grad)) {
                match &mut grads[parent] {
                    Some(sum) => sum.data_mut().iter_mut().zip(by_parent.data()).for_each(|(s, p)| *s += p),
                    empty => *empty = Some(by_parent),
                }
            }
        }
        TapeGradients { grads }
    }
}

/// Result of [`Tape::gradients`].
pub struct TapeGradients {
    grads: Vec<Option<Array>>,
}

impl TapeGradients {
    /// The gradient with respect to `var`; zeros where the result does not depend on it.
    pub fn of(&self, var: Var<'_>) -> Array {
        let found = self.grads.get(var.id).and_then(Clone::clone);
        found.unwrap_or_else(|| Array::zeros(var.value().shape()))
    }
}

impl<'t> Var<'t> {
    /// The tape of the value.
    pub fn tape(self) -> &'t Tape {
        self.tape
    }

    /// The value itself.
    pub fn value(self) -> Rc<Array> {
        self.tape.nodes.borrow()[self.id].value.clone()
    }

    /// The same value as a constant, without a gradient.
    pub fn detached(self) -> Var<'t> {
        self.tape.input((*self.value()).clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradients_of_all_uses_add_up_and_detached_uses_add_none() {
        let tape = Tape::new();
        let x = tape.input(Array::new(&[2], vec![2.0, -3.0]));
        let y = (x * x + x * 5.0 + x.detached() * x).sum();
        assert_eq!(tape.gradients(y).of(x).data(), [2.0 * 2.0 + 5.0 + 2.0, -2.0 * 3.0 + 5.0 - 3.0]);
    }
}
