//! The open connections, and the choice of the connection to close for a new one.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio_util::sync::CancellationToken;

use crate::server::connections::ConnectionLimits;
use crate::server::connections::activity::Activity;

/// The open connections.
pub(super) struct Registry {
    limits: ConnectionLimits,
    open: Mutex<OpenConnections>,
}

#[derive(Default)]
struct OpenConnections {
    next: u64,
    connections: HashMap<u64, ConnectionEntry>,
}

struct ConnectionEntry {
    address: IpAddr,
    activity: Arc<Activity>,
    close: CancellationToken,
}

/// The slot of a connection. It is released when it is dropped.
pub(super) struct ConnectionSlot {
    registry: Arc<Registry>,
    id: u64,
    pub(super) activity: Arc<Activity>,
    /// Cancelled when another connection takes the slot.
    pub(super) close: CancellationToken,
}

impl Registry {
    pub(super) fn new(limits: ConnectionLimits) -> Self {
        Self { limits, open: Mutex::default() }
    }

    /// A slot for a connection from `address`; `None` if all slots are used by requests that are being answered.
    pub(super) fn admit(self: &Arc<Self>, address: IpAddr) -> Option<ConnectionSlot> {
        let mut open = self.lock();
        let same = |entry: &ConnectionEntry| entry.address == address;
        let of_address = open.connections.values().filter(|e| same(e)).count();
        if !address.is_loopback() && of_address >= self.limits.per_address && !open.evict(same) {
            return None;
        }
        if open.connections.len() >= self.limits.connections && !open.evict(|_| true) {
            return None;
        }
        let (activity, close) = (Activity::new(), CancellationToken::new());
        let entry = ConnectionEntry { address, activity: activity.clone(), close: close.clone() };
        let id = open.next;
        open.next += 1;
        open.connections.insert(id, entry);
        Some(ConnectionSlot { registry: self.clone(), id, activity, close })
    }

    /// Closes the connection that has waited longest, if any is waiting.
    pub(super) fn close_longest_waiting(&self) {
        self.lock().evict(|_| true);
    }

    fn lock(&self) -> MutexGuard<'_, OpenConnections> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl OpenConnections {
    /// Closes the connection that has waited longest among those that match; false if none of them is waiting.
    fn evict(&mut self, matches: impl Fn(&ConnectionEntry) -> bool) -> bool {
        let waiting = self.connections.iter().filter(|(_, entry)| matches(entry));
        let waiting = waiting.filter_map(|(id, entry)| Some((entry.activity.waiting_since()?, *id)));
        let Some((_, id)) = waiting.min() else { return false };
        if let Some(entry) = self.connections.remove(&id) {
            entry.close.cancel();
        }
        true
    }
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        self.registry.lock().connections.remove(&self.id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn registry(connections: usize, per_address: usize) -> Arc<Registry> {
        Arc::new(Registry::new(ConnectionLimits { connections, per_address, ..ConnectionLimits::default() }))
    }

    fn from(registry: &Arc<Registry>, last: u8) -> Option<ConnectionSlot> {
        registry.admit(IpAddr::from([192, 0, 2, last]))
    }

    #[tokio::test(start_paused = true)]
    async fn at_the_limit_the_longest_idle_connection_is_closed() {
        let registry = registry(3, 9);
        let answered = from(&registry, 1).unwrap();
        let _busy = answered.activity.begin();
        let step = || tokio::time::advance(std::time::Duration::from_secs(1));
        step().await;
        let older = from(&registry, 2).unwrap();
        step().await;
        let newer = from(&registry, 3).unwrap();
        let next = from(&registry, 4).unwrap();
        let closed = [&answered, &older, &newer, &next].map(|t| t.close.is_cancelled());
        assert_eq!(closed, [false, true, false, false]);
    }

    #[test]
    fn new_connections_are_refused_while_all_are_busy() {
        let registry = registry(2, 9);
        let (one, two) = (from(&registry, 1).unwrap(), from(&registry, 2).unwrap());
        let _busy = (one.activity.begin(), two.activity.begin());
        assert!(from(&registry, 3).is_none());
        drop(one);
        assert!(from(&registry, 3).is_some());
    }

    #[test]
    fn per_address_limit_closes_own_connections_except_loopback() {
        let registry = registry(100, 2);
        let other = from(&registry, 9).unwrap();
        let own = [1, 1, 1].map(|last| from(&registry, last).unwrap());
        assert_eq!(own.each_ref().map(|t| t.close.is_cancelled()).iter().filter(|c| **c).count(), 1);
        assert!(!other.close.is_cancelled());
        let local = [(); 5].map(|()| registry.admit(IpAddr::from([127, 0, 0, 1])).unwrap());
        assert!(local.iter().all(|t| !t.close.is_cancelled()));
    }
}
