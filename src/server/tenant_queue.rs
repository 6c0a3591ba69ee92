//! A queue in which tenants take turns.

use std::collections::{HashMap, VecDeque};

use relume_api::TenantId;

/// Waiting items of tenants. The items of a tenant leave in the order of their arrival; each of them waits for at most one item of every
/// other tenant.
pub(super) struct TenantQueue<T> {
    /// The tenants with items, in the order of their turns.
    turns: VecDeque<TenantId>,
    items: HashMap<TenantId, VecDeque<T>>,
}

impl<T> Default for TenantQueue<T> {
    fn default() -> Self {
        Self { turns: VecDeque::new(), items: HashMap::new() }
    }
}

impl<T> TenantQueue<T> {
    /// Adds an item of a tenant.
    pub(super) fn push(&mut self, tenant: &TenantId, item: T) {
        let of_tenant = self.items.entry(tenant.clone()).or_default();
        if of_tenant.is_empty() {
            self.turns.push_back(tenant.clone());
        }
        of_tenant.push_back(item);
    }

    /// Removes the oldest item of the tenant whose turn it is. The next turn of this tenant comes after those of all other tenants.
    pub(super) fn pop(&mut self) -> Option<T> {
        let tenant = self.turns.pop_front()?;
        let of_tenant = self.items.get_mut(&tenant)?;
        let item = of_tenant.pop_front();
        if of_tenant.is_empty() {
            self.items.remove(&tenant);
        } else {
            self.turns.push_back(tenant);
        }
        item
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tenants_take_turns_and_leave_no_entry() {
        let mut queue = TenantQueue::default();
        let (a, b) = (TenantId::from("a"), TenantId::from("b"));
        for item in ["a1", "a2", "a3"] {
            queue.push(&a, item);
        }
        assert_eq!(queue.pop(), Some("a1"));
        queue.push(&b, "b1");
        queue.push(&b, "b2");
        let order: Vec<_> = std::iter::from_fn(|| queue.pop()).collect();
        assert_eq!(order, ["a2", "b1", "a3", "b2"]);
        assert!(queue.turns.is_empty() && queue.items.is_empty());
    }
}
