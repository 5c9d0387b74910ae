//! What versions of maps list, and by how many of them each object is needed.

use super::quota::Load;
use crate::assembling::in_order;
use crate::hash::ObjectHash;
use crate::manifest::{Entry, Manifest, Page, sensor_of};
use crate::wire::MapVersion;
use map::SensorKind;
use std::collections::HashMap;
use std::collections::hash_map::Entry::{Occupied, Vacant};
use std::sync::Arc;

/// A version of a map.
pub(super) struct Lists {
    pub map_version: MapVersion,
    pub manifest: Manifest,
    /// In the order of the manifest.
    pages: Vec<Page>,
    /// All objects, in order of their kinds and numbers.
    pub entries: Arc<[Entry]>,
    pub load: Load,
    pub sensor: Option<SensorKind>,
}

impl Lists {
    /// A manifest and its pages.
    ///
    /// # Errors
    /// When an object is listed twice.
    pub fn new(map_version: MapVersion, manifest: Manifest, pages: Vec<Page>) -> Result<Self, String> {
        let entries = in_order(&pages)?;
        let (load, sensor) = (Load::of(&entries), sensor_of(&entries));
        Ok(Self { map_version, manifest, pages, entries: entries.into(), load, sensor })
    }
}

/// Which pages are in use, and by that how many of them need each object. A version of a map differs from the one before by
/// few pages, and costs these, whatever else there is.
#[derive(Default)]
pub(super) struct Ledger {
    pages: HashMap<ObjectHash, (Page, usize)>,
    objects: HashMap<ObjectHash, usize>,
    /// Whether what stands in for others counts.
    has_previews: bool,
    /// Objects that were looked at.
    #[cfg(test)]
    pub touched: usize,
}

impl Ledger {
    /// One in which what stands in for others counts, or does not.
    pub fn new(has_previews: bool) -> Self {
        Self { has_previews, ..Self::default() }
    }

    /// Whether an object is needed.
    pub fn has(&self, hash: &ObjectHash) -> bool {
        self.objects.contains_key(hash)
    }

    /// A page as it was read, if it is in use.
    pub fn page(&self, hash: &ObjectHash) -> Option<&Page> {
        self.pages.get(hash).map(|(page, _)| page)
    }

    /// A version is in use.
    pub fn add(&mut self, lists: &Lists) {
        *self.objects.entry(lists.map_version.hash).or_default() += 1;
        for (named, page) in lists.manifest.pages.iter().zip(&lists.pages) {
            let (page, times) = self.pages.entry(named.hash).or_insert_with(|| (Arc::clone(page), 0));
            *times += 1;
            if *times > 1 {
                continue;
            }
            let listed = page.iter().filter(|entry| self.has_previews || !entry.kind.is_preview());
            for hash in listed.map(|entry| entry.hash).chain([named.hash]) {
                *self.objects.entry(hash).or_default() += 1;
                #[cfg(test)]
                (self.touched += 1);
            }
        }
    }

    /// A version is in use no more; the objects that no other one needs.
    pub fn remove(&mut self, lists: &Lists) -> Vec<ObjectHash> {
        let mut unused = Vec::new();
        self.drop_one(lists.map_version.hash, &mut unused);
        for named in &lists.manifest.pages {
            let Occupied(mut used) = self.pages.entry(named.hash) else { continue };
            used.get_mut().1 -= 1;
            if used.get().1 > 0 {
                continue;
            }
            let (page, _) = used.remove();
            let listed = page.iter().filter(|entry| self.has_previews || !entry.kind.is_preview());
            let hashes: Vec<ObjectHash> = listed.map(|entry| entry.hash).chain([named.hash]).collect();
            hashes.into_iter().for_each(|hash| self.drop_one(hash, &mut unused));
        }
        unused
    }

    fn drop_one(&mut self, hash: ObjectHash, unused: &mut Vec<ObjectHash>) {
        #[cfg(test)]
        (self.touched += 1);
        match self.objects.entry(hash) {
            Occupied(mut times) if *times.get() > 1 => *times.get_mut() -= 1,
            Occupied(times) => {
                times.remove();
                unused.push(hash);
            }
            Vacant(_) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::{Kind, PageRef, page_to_bytes};
    use crate::test_support::agent;
    use std::collections::BTreeSet;

    fn lists(pages: &[&[u32]]) -> Lists {
        let entry = |number: &u32| {
            let hash = ObjectHash::of(&number.to_le_bytes());
            Entry { kind: Kind::Depth, number: *number, revision: 0, size: 4, hash }
        };
        let pages: Vec<Page> = pages.iter().map(|page| page.iter().map(entry).collect()).collect();
        let named = pages.iter().map(|page| {
            let bytes = page_to_bytes(page);
            PageRef { size: bytes.len() as u32, hash: ObjectHash::of(&bytes) }
        });
        let manifest =
            Manifest { agent: agent(1), begun: 0, revision: 0, finished: false, pages: named.collect() };
        let bytes = manifest.to_bytes();
        let (size, hash) = (bytes.len() as u32, ObjectHash::of(&bytes));
        let version = MapVersion { agent: agent(1), begun: 0, revision: 0, newest: 0, size, hash };
        Lists::new(version, manifest, pages).unwrap()
    }

    #[test]
    fn an_object_is_needed_until_no_version_lists_it_and_only_pages_that_differ_are_looked_at() {
        let old: Vec<u32> = (0..100).collect();
        let versions = [lists(&[&old, &[200, 201]]), lists(&[&old, &[200, 202]])];
        let mut ledger = Ledger::new(true);
        ledger.add(&versions[0]);
        let before = ledger.touched;
        ledger.add(&versions[1]);
        let unused: BTreeSet<ObjectHash> = ledger.remove(&versions[0]).into_iter().collect();
        assert!(ledger.touched - before < 10, "{}", ledger.touched - before);
        let named = versions[0].manifest.pages[1].hash;
        let gone = [ObjectHash::of(&201u32.to_le_bytes()), named, versions[0].map_version.hash];
        assert_eq!(unused, gone.into());
        assert!(ledger.has(&ObjectHash::of(&200u32.to_le_bytes())) && !ledger.has(&gone[0]));
        assert_eq!(ledger.remove(&versions[1]).len(), 100 + 2 + 2 + 1);
        assert!(ledger.objects.is_empty() && ledger.pages.is_empty());
    }
}
