//! What rests on the disk between pairs says the same as what stays in memory.

use super::verdicts::CameraVerdicts;
use super::{Input, KnownBefore, MergingParams, load, merge_knowing};
use crate::results::digest::MapDigest;
use crate::swapping::SwapFiles;
use crate::verdicts::Verdicts;
use geometry::{Se3, Sim3, Swap, Swapped};
use loopbox_tests::{Recording, World, render, trajectory};
use map::{AgentInfo, Keyframe, KeyframeId, Map, SemiDense, save_map};
use place_recog::Vocabulary;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

/// Writes a map of exact keyframes at `path`, recorded from `time` on, s.
fn save(file: &Path, name: &str, world: &World, path: &[Se3], time: f64) {
    let camera = Recording::SMALL_CAMERA;
    let mut map = Map::new(camera);
    map.agents.values_mut().for_each(|agent: &mut AgentInfo| agent.name = name.into());
    for (index, pose) in path.iter().enumerate() {
        let (image, inverse_depth) = render(world, &camera, pose);
        let (id, time) = (KeyframeId(index as u32), time + index as f64);
        let mut keyframe = Keyframe::of_image(id, time, index as u64, Sim3::from(*pose), Arc::new(image));
        let seen = inverse_depth.data().iter().enumerate().filter(|(_, depth)| **depth > 0.0);
        let mut depths = SemiDense::default();
        for (pixel, &depth) in seen.step_by(3) {
            depths.pixel.push(pixel as u32);
            depths.inverse_depth.push(depth);
            depths.variance.push((0.01 * depth).powi(2));
        }
        keyframe.semi_dense = depths.into();
        map.keyframes.insert(id, keyframe);
    }
    save_map(file, &map).unwrap();
}

/// Two maps that share a place and one of another, without features.
fn maps(folder: &Path) -> Vec<PathBuf> {
    let way = trajectory::sideways(13, 3.0);
    let cuts = [("a", 3, &way[..9], 0.0), ("b", 3, &way[4..], 100.0), ("c", 8, &way[..5], 200.0)];
    let file = |(name, seed, path, time)| {
        let file = folder.join(format!("{name}.mcap"));
        save(&file, name, &World::yard(seed), path, time);
        file
    };
    cuts.map(file).into()
}

/// What came of merging `maps` with what is swapped: the bytes of the verdicts by name, and the common maps.
fn merged(maps: &[PathBuf], swap: &SwapFiles, folder: &Path) -> (BTreeMap<String, Vec<u8>>, Vec<Map>) {
    let (vocabulary, params) = (Vocabulary::shipped(), MergingParams::default());
    let inputs = load(maps, &vocabulary, swap, &(), &mut |_| Ok(())).unwrap();
    let digests = maps.iter().map(|map| MapDigest::of(map).unwrap()).collect();
    let verdicts = CameraVerdicts::among(Verdicts::at(folder).unwrap(), digests, &params);
    let known = KnownBefore { verdicts: Some(&verdicts), ..KnownBefore::default() };
    let merging = merge_knowing(&inputs, &vocabulary, &params, known, &mut |_| Ok(())).unwrap();
    let files = fs::read_dir(folder).unwrap().map(|file| file.unwrap());
    let bytes =
        |file: fs::DirEntry| (file.file_name().into_string().unwrap(), fs::read(file.path()).unwrap());
    (files.map(bytes).collect(), merging.fused.into_iter().map(|fused| fused.map).collect())
}

#[test]
fn verdicts_and_common_map_are_the_same_to_the_byte_whatever_rests() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| {
        let at = folder.path().join(name);
        fs::create_dir(&at).unwrap();
        at
    };
    let bare = maps(&at("bare"));
    // Features in the file, as the program writes them, and found by the merge.
    let described = at("described");
    let described: Vec<PathBuf> = bare.iter().map(|map| describe(map, &described)).collect();
    for (name, maps) in [("of bare ones", &bare), ("of described ones", &described)] {
        let in_memory = SwapFiles::beyond(folder.path().to_owned(), u64::MAX);
        let on_disk = SwapFiles::beyond(folder.path().to_owned(), 0);
        let expected = merged(maps, &in_memory, &at(&format!("memory {name}")));
        assert_eq!((expected.0.len(), in_memory.on_disk()), (3, 0), "{name}");
        assert_eq!(
            expected.1.iter().filter(|map| map.agents.len() == 2).count(),
            1,
            "{name}: none is merged"
        );
        let resting = merged(maps, &on_disk, &at(&format!("disk {name}")));
        assert!(on_disk.on_disk() > 0 && resting == expected, "{name}");
    }
}

/// The same map with the features of its keyframes, in `folder`.
fn describe(map: &Path, folder: &Path) -> PathBuf {
    let mut described = map::load_map(map).unwrap().map;
    assert!(crate::describing::complete(&mut described, None) > 0);
    let file = folder.join(map.file_name().unwrap());
    save_map(&file, &described).unwrap();
    file
}

/// Remembers the sizes of what it is offered, and keeps it by `SwapFiles`.
struct Counting {
    files: SwapFiles,
    offered: Mutex<Vec<usize>>,
    kept: AtomicU64,
}

impl Swap for Counting {
    fn keep(&self, bytes: &[u8]) -> Option<Arc<dyn Swapped>> {
        if !bytes.is_empty() {
            self.offered.lock().unwrap().push(bytes.len());
        }
        let kept = self.files.keep(bytes)?;
        self.kept.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        Some(kept)
    }
}

/// What an input's keyframes take that can rest, bytes of each piece.
fn pieces(input: &Input) -> Vec<usize> {
    let of_keyframe = |keyframe: &Keyframe| {
        let described = [&keyframe.features, &keyframe.words].map(|bytes| bytes.as_ref().unwrap().len());
        let depths = keyframe.semi_dense.len() * 4;
        [keyframe.image.data().len(), depths, depths, depths, described[0], described[1]]
    };
    // Node and feature, four bytes each.
    let indices = input.words.values().map(|words| 8 * words.features());
    input.map.keyframes.values().flat_map(of_keyframe).chain(indices).collect()
}

#[test]
fn every_piece_counts_once_under_the_bound() {
    let folder = tempfile::tempdir().unwrap();
    let bare = maps(folder.path()).swap_remove(2);
    fs::create_dir(folder.path().join("described")).unwrap();
    let described = describe(&bare, &folder.path().join("described"));
    for map in [bare, described] {
        let offered_with = |in_memory: u64| {
            let files = SwapFiles::beyond(folder.path().to_owned(), in_memory);
            let counting = Counting { files, offered: Mutex::default(), kept: AtomicU64::new(0) };
            let input = Input::load(&map, &Vocabulary::shipped(), &counting).unwrap();
            (input, counting)
        };
        let (input, counting) = offered_with(0);
        let (mut offered, mut expected) = (counting.offered.into_inner().unwrap(), pieces(&input));
        offered.sort_unstable();
        expected.sort_unstable();
        assert_eq!(offered, expected, "{}", map.display());
        let all: u64 = expected.iter().map(|&size| size as u64).sum();
        assert_eq!(counting.kept.into_inner(), all);
        // All but what the bound leaves in memory, and that to less than a piece.
        let (again, counting) = offered_with(all / 2);
        let in_memory = all - counting.kept.into_inner();
        let largest = *expected.last().unwrap() as u64;
        assert!((all / 2 - largest..=all / 2).contains(&in_memory), "{in_memory} of {all}");
        again.rest();
        again.features.rest();
        assert!(
            again.map == input.map && again.direct == input.direct,
            "it reads otherwise than it was put away"
        );
        let same = |id| again.features.get(id) == input.features.get(id);
        assert!(again.features.len() == 5 && again.features.keyframes().all(same));
    }
}
