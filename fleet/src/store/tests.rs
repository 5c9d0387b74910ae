//! Folders as programs and machines leave them.

use super::*;
use crate::manifest::Manifest;
use std::path::Path;
use std::time::{Duration, Instant};

const AGENT: Identity = Identity { uuid: Uuid::from_u128(7), epoch: 2 };
const PATIENCE: Duration = Duration::from_secs(30);

fn object(number: u8) -> (ObjectHash, Arc<[u8]>) {
    let bytes = vec![number; 9000 + usize::from(number)];
    (ObjectHash::of(&bytes), bytes.into())
}

fn manifest() -> (ObjectHash, Arc<[u8]>) {
    let list = Manifest { agent: AGENT, begun: 1, revision: 1, finished: false, pages: Vec::new() };
    let bytes = list.to_bytes();
    (ObjectHash::of(&bytes), bytes.into())
}

fn on(disk: &Cut) -> FolderStore {
    FolderStore::on(Box::new(disk.clone()), Path::new("/there")).unwrap()
}

/// Waits for an event.
fn wait<T>(store: &FolderStore, wanted: impl Fn(&StoreEvent) -> Option<T>) -> T {
    let since = Instant::now();
    while since.elapsed() < PATIENCE {
        if let Some(found) = store.events().iter().find_map(&wanted) {
            return found;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    panic!("nothing is said")
}

/// Puts objects and a manifest, and says that the map is whole.
fn put(store: &FolderStore, objects: &[u8]) -> Head {
    let (hash, bytes) = manifest();
    objects.iter().map(|number| object(*number)).for_each(|(hash, bytes)| store.put(&hash, bytes));
    store.put(&hash, bytes);
    let head = Head { manifest: hash, own: true, peer: Some(AGENT.uuid) };
    store.set_head(AGENT, head);
    head
}

fn is_kept(event: &StoreEvent) -> Option<()> {
    matches!(event, StoreEvent::Head(..)).then_some(())
}

#[test]
fn what_a_folder_was_given_is_there_when_it_is_opened_again() {
    let room = tempfile::tempdir().unwrap();
    let (hash, bytes) = object(5);
    let head = {
        let store = FolderStore::open(room.path()).unwrap();
        let head = put(&store, &[5, 6]);
        assert!(FolderStore::open(room.path()).is_err(), "another one keeps out");
        wait(&store, is_kept);
        head
    };
    // What killed programs leave, an earlier version of this one too.
    let name = hash.to_string();
    std::fs::write(room.path().join("objects").join(&name[..2]).join("ab.tmp"), b"half").unwrap();
    std::fs::write(room.path().join("new").join(object(9).0.to_string()), b"half").unwrap();
    std::fs::write(room.path().join("new").join(object(8).0.to_string()), &object(8).1).unwrap();
    let store = FolderStore::open(room.path()).unwrap();
    assert_eq!(store.get(&hash).unwrap(), bytes);
    assert_eq!(store.get(&object(8).0).unwrap(), object(8).1);
    assert!(!store.has(&object(9).0));
    assert_eq!(store.heads(), [(AGENT, head)].into());
    store.remove(&[hash]);
    assert!(!store.has(&hash) && store.has(&head.manifest) && store.get(&hash).is_none());
    drop(store);
    let store = FolderStore::open(room.path()).unwrap();
    assert!(!store.has(&hash) && store.has(&object(6).0));
}

#[test]
fn what_is_acknowledged_outlasts_a_power_cut_at_any_moment() {
    let disk = Cut::default();
    let store = on(&disk);
    put(&store, &[1, 2, 3]);
    wait(&store, is_kept);
    // More is on its way.
    store.put(&object(4).0, object(4).1);
    let after = on(&disk.cut());
    assert!(after.heads().contains_key(&AGENT));
    for number in 1..=3 {
        assert_eq!(after.get(&object(number).0), Some(object(number).1), "{number}");
    }
    // Of what was not said to be kept there is nothing, or all.
    assert!(after.get(&object(4).0).is_none_or(|bytes| bytes == object(4).1));
}

#[test]
fn what_a_sync_refused_is_written_again_and_not_acknowledged_before() {
    // The content of files, their names, and the head's.
    for before in 0..3 {
        let disk = Cut::default();
        let store = on(&disk);
        disk.refuse_after(before);
        put(&store, &[1, 2]);
        wait(&store, |event| match event {
            StoreEvent::Failed(reason) => {
                assert!(reason.contains("does not take it"), "{reason}");
                Some(())
            }
            StoreEvent::Head(..) => panic!("it is not kept"),
            StoreEvent::Lost(_) => None,
        });
        assert!(store.get(&object(2).0).is_some());
        wait(&store, is_kept);
        assert_eq!(store.unwritten(), 0);
        let after = on(&disk.cut());
        assert!(after.heads().contains_key(&AGENT));
        assert!([1, 2].iter().all(|number| after.get(&object(*number).0) == Some(object(*number).1)));
    }
}

#[test]
fn a_damaged_object_is_not_there_and_what_is_put_again_is_whole() {
    let disk = Cut::default();
    let (hash, bytes) = object(5);
    {
        let store = on(&disk);
        put(&store, &[5]);
        wait(&store, is_kept);
    }
    disk.rot(&hash.to_string());
    let store = on(&disk);
    assert!(store.has(&hash) && store.get(&hash).is_none() && !store.has(&hash));
    wait(&store, |event| matches!(event, StoreEvent::Lost(lost) if *lost == hash).then_some(()));
    put(&store, &[5]);
    wait(&store, is_kept);
    // Nobody may have seen that it is rotten.
    disk.rot(&hash.to_string());
    drop(store);
    let store = on(&disk);
    put(&store, &[5]);
    wait(&store, is_kept);
    drop(store);
    assert_eq!(on(&disk).get(&hash), Some(bytes));
}

/// For as long as anybody likes: nobody waits for it who has links to serve.
#[test]
fn a_disk_that_stands_still_keeps_nobody() {
    let disk = Cut::default();
    let store = on(&disk);
    put(&store, &[1]);
    wait(&store, is_kept);
    disk.set_stalled(true);
    let since = Instant::now();
    put(&store, &[1, 2, 3]);
    assert_eq!(store.get(&object(1).0), Some(object(1).1), "from the disk");
    assert_eq!(store.get(&object(3).0), Some(object(3).1), "from memory");
    store.remove(&[object(1).0]);
    assert!(store.events().is_empty() && store.unwritten() > 18_000);
    assert!(since.elapsed() < PATIENCE);
    disk.set_stalled(false);
    wait(&store, is_kept);
    assert!(store.get(&object(3).0).is_some() && !store.has(&object(1).0));
}
