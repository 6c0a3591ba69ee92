//! Locks.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// A lock whose data is whole whatever happened to its last holder.
pub(super) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
