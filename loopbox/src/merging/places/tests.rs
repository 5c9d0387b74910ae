use super::*;
use crate::merging::{load, load_appearances, proposed};
use crate::swapping::SwapFiles;
use geometry::{Pinhole, Sim3};
use loopbox_tests::Texture;
use map::{AgentInfo, Map, SemiDense};
use std::path::{Path, PathBuf};

/// Six views along a texture from the `first` on, recorded at `time`.
fn save(folder: &Path, name: &str, first: usize, time: f64) -> PathBuf {
    let camera = Pinhole { width: 160, height: 120, fx: 100.0, fy: 100.0, cx: 79.5, cy: 59.5 };
    let mut map = Map::new(camera);
    map.agents.values_mut().for_each(|agent: &mut AgentInfo| agent.name = name.into());
    let texture = Texture::procedural(3);
    for i in 0..6 {
        let pixel =
            |p: usize| texture.sample((p % 160 + 40 * (first + i)) as f32, (p / 160) as f32, 1.0) as u8;
        let image = GrayImage::from_vec(160, 120, (0..160 * 120).map(pixel).collect()).unwrap();
        let id = KeyframeId(i as u32);
        let mut keyframe = Keyframe::of_image(id, time + i as f64, i as u64, Sim3::identity(), image.into());
        let (pixel, inverse_depth, variance) = (vec![500].into(), vec![1.0].into(), vec![0.1].into());
        keyframe.semi_dense = SemiDense { pixel, inverse_depth, variance }.into();
        map.keyframes.insert(id, keyframe);
    }
    let path = folder.join(format!("{name}.mcap"));
    map::save_map(&path, &map).unwrap();
    path
}

#[test]
fn what_is_kept_of_maps_proposes_what_the_maps_do() {
    let folder = tempfile::tempdir().unwrap();
    // Of two that begin at one time the first images decide on the order.
    let maps = [("a", 0, 9.0), ("b", 3, 2.0), ("c", 2, 2.0), ("d", 30, 4.0)]
        .map(|(name, first, time)| save(folder.path(), name, first, time));
    let vocabulary = Vocabulary::shipped();
    let memory = SwapFiles::new(folder.path().to_owned());
    let mut quiet = |_: &str| Ok(());
    let inputs = load(&maps, &vocabulary, &memory, &(), &mut quiet).unwrap();
    for method in [IndexMethod::BagOfWords, IndexMethod::FabMap, IndexMethod::Thumbnails] {
        let mut params = MergingParams::default();
        params.places.method = method;
        let of_maps: Vec<_> = inputs.iter().map(|input| Appearances::of(input, &params.places)).collect();
        let expected = proposed(&of_maps, &vocabulary, &params);
        assert!(expected.iter().any(|(pair, ..)| *pair == [1, 0]), "{method:?}: {expected:?}");
        let (numbers, alone): (Vec<usize>, Vec<_>) =
            load_appearances(&maps, &vocabulary, &params.places, &(), &mut quiet)
                .unwrap()
                .into_iter()
                .unzip();
        assert_eq!((numbers, proposed(&alone, &vocabulary, &params)), (vec![0, 1, 2, 3], expected.clone()));
        let disk = SwapFiles::beyond(folder.path().to_owned(), 0);
        let on_disk: Vec<_> = of_maps.into_iter().map(|map| map.apart(&disk)).collect();
        assert!(disk.on_disk() > 0);
        assert_eq!(proposed(&on_disk, &vocabulary, &params), expected);
    }
}

/// An index scores so many keyframes and no more: those of other maps must not take the place of a pair's own.
#[test]
fn the_places_of_a_pair_do_not_depend_on_other_maps() {
    let folder = tempfile::tempdir().unwrap();
    let maps = [("a", 0, 9.0), ("b", 3, 2.0), ("c", 2, 5.0), ("d", 5, 4.0), ("e", 1, 7.0)]
        .map(|(name, first, time)| save(folder.path(), name, first, time));
    let vocabulary = Vocabulary::shipped();
    let inputs =
        load(&maps, &vocabulary, &SwapFiles::new(folder.path().to_owned()), &(), &mut |_| Ok(())).unwrap();
    let mut params = MergingParams::default();
    params.places.bow.scored = 6;
    let all: Vec<_> = inputs.iter().map(|input| Appearances::of(input, &params.places)).collect();
    let together = places(&all, &vocabulary, &params, &|_| true);
    assert_eq!(together.len(), 10);
    for ([target, source], found) in together {
        let alone = places(&[all[target].clone(), all[source].clone()], &vocabulary, &params, &|_| true);
        assert_eq!(found.proposals, alone[&[0, 1]].proposals, "{target} and {source}");
        assert!(!found.proposals.is_empty());
    }
}

#[test]
fn no_map_is_held_by_what_is_kept_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = save(folder.path(), "a", 0, 1.0);
    let input =
        Input::load(&path, &Vocabulary::shipped(), &SwapFiles::new(folder.path().to_owned())).unwrap();
    for (method, images) in [(IndexMethod::BagOfWords, 1), (IndexMethod::Thumbnails, 6)] {
        let params = ProposeParams { method, ..ProposeParams::default() };
        let kept = Appearances::of(&input, &params).apart(&SwapFiles::new(folder.path().to_owned()));
        assert_eq!(kept.images.len(), images);
        let shares =
            |keyframe: &Keyframe| kept.images.values().any(|image| Arc::ptr_eq(image, &keyframe.image));
        assert!(!input.map.keyframes.values().any(shares));
    }
}
