//! A small cache that forgets what was not used for longest.

/// At most `capacity` values, most recently used last. Linear search: capacities here are tens.
pub(super) struct Lru<K, V> {
    capacity: usize,
    entries: Vec<(K, V)>,
}

impl<K: PartialEq, V: Clone> Lru<K, V> {
    pub(super) fn new(capacity: usize) -> Self {
        Self { capacity: capacity.max(1), entries: Vec::new() }
    }

    /// The value of `key`, made by `make` when it is not there.
    pub(super) fn get_or_insert<E>(&mut self, key: K, make: impl FnOnce() -> Result<V, E>) -> Result<V, E> {
        let entry = match self.entries.iter().position(|(k, _)| *k == key) {
            Some(at) => self.entries.remove(at),
            None => (key, make()?),
        };
        if self.entries.len() == self.capacity {
            self.entries.remove(0);
        }
        let value = entry.1.clone();
        self.entries.push(entry);
        Ok(value)
    }

    pub(super) fn clear(&mut self) {
        self.entries.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_recently_used_value_is_forgotten_first() {
        let mut cache = Lru::new(2);
        let mut made = Vec::new();
        for key in [1, 2, 1, 3, 1, 2] {
            cache
                .get_or_insert(key, || {
                    made.push(key);
                    Ok::<_, ()>(key)
                })
                .unwrap();
        }
        assert_eq!(made, [1, 2, 3, 2], "1 was used again before 3 came, so 2 had to go");
    }
}
