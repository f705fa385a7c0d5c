//! A bounded least-recently-used store of immutable values, shared between threads.
//!
//! What is stored is the result of a pure function of its key, so hits and misses change only the time, never the
//! answer.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Least-recently-used store bounded by the bytes of its values.
#[derive(Debug)]
pub struct Lru<K, V> {
    max_bytes: usize,
    state: Mutex<State<K, V>>,
}

#[derive(Debug)]
struct State<K, V> {
    entries: HashMap<K, Entry<V>>,
    bytes: usize,
    clock: u64,
}

#[derive(Debug)]
struct Entry<V> {
    value: Arc<V>,
    bytes: usize,
    used: u64,
}

impl<K: Eq + Hash + Clone, V> Lru<K, V> {
    /// An empty store that holds at most `max_bytes` of values.
    #[must_use]
    pub fn new(max_bytes: usize) -> Self {
        let state = State {
            entries: HashMap::new(),
            bytes: 0,
            clock: 0,
        };
        Self {
            max_bytes,
            state: Mutex::new(state),
        }
    }

    /// The value of `key`, if it is still here.
    #[must_use]
    pub fn get(&self, key: &K) -> Option<Arc<V>> {
        let mut state = self.lock();
        state.clock += 1;
        let now = state.clock;
        let entry = state.entries.get_mut(key)?;
        entry.used = now;
        Some(Arc::clone(&entry.value))
    }

    /// Stores a value of `bytes` and drops the values longest unused until the bound holds again. A value larger than
    /// the bound is not kept.
    pub fn put(&self, key: K, value: Arc<V>, bytes: usize) {
        if bytes > self.max_bytes {
            return;
        }
        let mut state = self.lock();
        state.clock += 1;
        let used = state.clock;
        let entry = Entry { value, bytes, used };
        state.bytes += bytes;
        if let Some(old) = state.entries.insert(key, entry) {
            state.bytes -= old.bytes;
        }
        if state.bytes > self.max_bytes {
            state.shrink_to(self.max_bytes - self.max_bytes / 16);
        }
    }

    /// Bytes held now.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.lock().bytes
    }

    fn lock(&self) -> MutexGuard<'_, State<K, V>> {
        // Every critical section leaves the state consistent, so a panic elsewhere does not spoil it.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<K: Eq + Hash + Clone, V> State<K, V> {
    /// Drops a sixteenth at once, so that the sort is paid for rarely.
    fn shrink_to(&mut self, bytes: usize) {
        let mut by_age: Vec<(u64, K)> = self
            .entries
            .iter()
            .map(|(k, e)| (e.used, k.clone()))
            .collect();
        by_age.sort_unstable_by_key(|&(used, _)| used);
        for (_, key) in by_age {
            if self.bytes <= bytes {
                break;
            }
            if let Some(old) = self.entries.remove(&key) {
                self.bytes -= old.bytes;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_unused_go_first_and_the_bound_holds() {
        let lru = Lru::new(100);
        for key in 0..10 {
            lru.put(key, Arc::new(key), 10);
        }
        assert_eq!(lru.get(&0).as_deref(), Some(&0));
        lru.put(10, Arc::new(10), 10);
        assert!(lru.bytes() <= 100);
        assert!(lru.get(&0).is_some() && lru.get(&10).is_some());
        assert!(lru.get(&1).is_none());
        lru.put(11, Arc::new(11), 1000);
        assert!(lru.get(&11).is_none(), "larger than the bound");
    }
}
