//! Objects in memory.

use super::Blobs;
use anyhow::Result;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Objects in memory, gone with the program.
#[derive(Debug, Default)]
pub struct MemoryBlobs {
    objects: Mutex<BTreeMap<String, Vec<u8>>>,
}

impl MemoryBlobs {
    /// Forgets all objects but those whose names are wanted.
    pub fn retain(&self, is_wanted: impl Fn(&str) -> bool) {
        self.locked().retain(|name, _| is_wanted(name));
    }

    /// Every section leaves the objects whole.
    fn locked(&self) -> MutexGuard<'_, BTreeMap<String, Vec<u8>>> {
        self.objects.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Blobs for MemoryBlobs {
    fn get(&self, name: &str) -> Result<Option<Vec<u8>>> {
        Ok(self.locked().get(name).cloned())
    }

    fn has(&self, name: &str) -> Result<bool> {
        Ok(self.locked().contains_key(name))
    }

    fn put(&self, name: &str, bytes: &[u8]) -> Result<()> {
        if let Entry::Vacant(place) = self.locked().entry(name.to_owned()) {
            place.insert(bytes.to_vec());
        }
        Ok(())
    }

    fn list(&self, prefix: &str) -> Result<Vec<String>> {
        Ok(self.locked().keys().filter(|name| name.starts_with(prefix)).cloned().collect())
    }

    fn address(&self, name: &str) -> String {
        format!("{name} in memory")
    }
}
