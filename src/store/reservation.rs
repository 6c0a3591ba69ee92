//! Reservations: bytes of pending uploads count as stored, so that concurrent uploads together cannot exceed a limit.

use crate::store::pending_quota::Reservation;
use crate::store::{Store, StoreError};
use relume_api::TenantId;

/// Bytes that are reserved in addition to those that have arrived.
const RESERVE_AHEAD_BYTES: u64 = 16 << 20;

impl Store {
    /// Opens an empty reservation.
    pub(super) fn reservation(&self, tenant: &TenantId) -> Reservation {
        self.pending_quota.open(tenant)
    }

    /// Reserves at least `bytes`.
    ///
    /// # Errors
    /// [`StoreError::ByteQuotaExceeded`] and [`StoreError::StorageLimitExceeded`] if a limit would be exceeded. Then nothing
    /// changes.
    pub(super) async fn reserve(&self, held: &mut Reservation, bytes: u64) -> Result<(), StoreError> {
        let asked = bytes.saturating_sub(held.bytes());
        if asked == 0 {
            return Ok(());
        }
        // Publication removes bytes from the pending quota under this lock, so that no byte is counted twice or missed.
        let _publish_guard = self.publish_lock.lock().await;
        let quota = self.quota_allowance(held.tenant()).await?;
        let disk = self.disk_allowance().await?;
        quota.admit(asked).and_then(|()| disk.admit(asked))?;
        // If little space is left, little is reserved in advance.
        let left = quota.left().min(disk.left()) - asked;
        held.set(bytes + RESERVE_AHEAD_BYTES.min(left / 64));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Quota;

    #[tokio::test]
    async fn concurrent_reservations_share_quota_and_are_released() {
        let folder = tempfile::tempdir().unwrap();
        let quota = Quota { jobs: None, bytes: Some(100) };
        let store = Store::open(folder.path()).await.unwrap().with_quota(quota);
        store.limit_disk(150);
        let (a, b) = (TenantId::from("a"), TenantId::from("b"));
        let mut held = [&a, &a, &b].map(|tenant| store.reservation(tenant));
        store.reserve(&mut held[0], 60).await.unwrap();
        held[0].shrink_to(60);
        let refused = store.reserve(&mut held[1], 41).await;
        assert!(
            matches!(refused, Err(StoreError::ByteQuotaExceeded { most: 100, taken: 60, asked: 41 })),
            "{refused:?}"
        );
        store.reserve(&mut held[1], 40).await.unwrap();
        assert!(store.admit_bytes_of(&a, 1).await.is_err(), "a new upload is refused as well");
        let refused = store.reserve(&mut held[2], 51).await;
        assert!(
            matches!(refused, Err(StoreError::StorageLimitExceeded { limit: 150, taken: 100, asked: 51 })),
            "{refused:?}"
        );
        assert_eq!(
            (store.pending_quota.all(), store.pending_quota.of(&b)),
            (100, 0),
            "a refused reservation reserves nothing"
        );
        drop(held);
        assert_eq!((store.pending_quota.all(), store.pending_quota.of(&a)), (0, 0));
        let mut alone = store.reservation(&a);
        store.reserve(&mut alone, 20).await.unwrap();
        assert_eq!(store.pending_quota.of(&a), 21, "little is reserved in advance if little is left");
    }
}
