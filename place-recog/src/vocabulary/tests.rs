use super::chow_liu::Occurrence;
use super::*;
use crate::features::Keypoint;
use geometry::Random;
use miniz_oxide::deflate::compress_to_vec_zlib;

/// Features around `kinds` different descriptors, each a little changed; the same seed gives the same.
pub(crate) fn image(kinds: &[u64], each: usize, seed: u64) -> Features {
    let mut random = Random::new(seed);
    let mut features = Features::default();
    for &kind in kinds {
        let mut centre = Random::new(kind);
        let centre: Descriptor = std::array::from_fn(|_| centre.below(60) as u8);
        for _ in 0..each {
            features.keypoints.push(Keypoint { pixel: [0.0; 2], size: 1.0, angle: 0.0 });
            features.descriptors.push(centre.map(|v| v.saturating_add(random.below(4) as u8)));
        }
    }
    features
}

fn images() -> Vec<Features> {
    (0..20).map(|i| image(&[i, i + 1, i + 2, i % 5 + 100, i % 3 + 200], 8, i)).collect()
}

fn trained(seed: u64) -> Vocabulary {
    let params = TrainParams { branching: 4, levels: 3, seed, ..TrainParams::default() };
    Vocabulary::train(&images(), &params).unwrap()
}

#[test]
fn the_same_seed_gives_the_same_vocabulary_on_any_number_of_cores() {
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| trained(7).to_bytes())
    };
    assert_eq!(on(1), on(3));
    assert_ne!(trained(7), trained(8));
}

#[test]
fn similar_descriptors_share_a_word_and_others_do_not() {
    let vocabulary = trained(1);
    assert!(vocabulary.len() > 20, "{} words", vocabulary.len());
    let word = |kind, seed| vocabulary.lookup(&image(&[kind], 1, seed).descriptors[0]);
    let same = (0..20).filter(|&kind| word(kind, 1) == word(kind, 2)).count();
    let different = (0..20).filter(|&kind| word(kind, 1) != word((kind + 7) % 20, 1)).count();
    assert!(same >= 12 && different >= 18, "{same} same, {different} different");
}

#[test]
fn rare_words_weigh_more() {
    let mut images = images();
    images.iter_mut().for_each(|i| i.descriptors.extend(image(&[999], 3, 5).descriptors));
    let vocabulary =
        Vocabulary::train(&images, &TrainParams { levels: 3, ..TrainParams::default() }).unwrap();
    let weight = |kind| vocabulary.weight(vocabulary.lookup(&image(&[kind], 1, 9).descriptors[0]));
    assert!(weight(999) < 0.5 && weight(3) > 1.0, "{} {}", weight(999), weight(3));
    assert_eq!(vocabulary.weight(WordId(u32::MAX)), 0.0);
}

#[test]
fn a_file_gives_the_vocabulary_back() {
    let vocabulary = trained(1);
    assert!(vocabulary.to_bytes().len() < vocabulary.to_plain_bytes().len());
    assert_eq!(Vocabulary::from_bytes(&vocabulary.to_plain_bytes()).as_ref(), Ok(&vocabulary));
    assert_eq!(Vocabulary::from_bytes(&vocabulary.to_bytes()), Ok(vocabulary));
}

#[test]
fn damage_is_named() {
    let bytes = trained(1).to_plain_bytes();
    let read = |bytes: &[u8]| Vocabulary::from_bytes(bytes).unwrap_err();
    assert_eq!(read(b""), VocabularyError::NotAVocabulary);
    assert_eq!(read(b"%PDF-1.5 and so on"), VocabularyError::NotAVocabulary);
    assert_eq!(read(&compress_to_vec_zlib(b"LBVOCAB but no more", 6)), VocabularyError::NotAVocabulary);
    for length in [8, 13, 20, bytes.len() / 2, bytes.len() - 1] {
        assert!(matches!(read(&bytes[..length]), VocabularyError::Truncated { .. }), "{length}");
    }
    let mut other = bytes.clone();
    other[8] = 9;
    assert_eq!(read(&other), VocabularyError::OtherVersion { found: 9, expected: 1 });
    for at in [12, 30, bytes.len() / 2, bytes.len() - 1] {
        let mut changed = bytes.clone();
        changed[at] ^= 0x40;
        assert_eq!(read(&changed), VocabularyError::Damaged, "byte {at}");
    }
    let mut longer = bytes;
    longer.push(0);
    assert_eq!(read(&longer), VocabularyError::Damaged);
}

#[test]
fn damage_of_a_compressed_file_is_named() {
    let bytes = trained(1).to_bytes();
    let cut = Vocabulary::from_bytes(&bytes[..bytes.len() / 2]);
    assert!(matches!(cut, Err(VocabularyError::Truncated { .. })), "{cut:?}");
    let mut changed = bytes;
    *changed.last_mut().unwrap() ^= 1;
    assert_eq!(Vocabulary::from_bytes(&changed), Err(VocabularyError::Damaged));
}

#[test]
fn counts_that_no_tree_has_are_damage_even_with_a_right_checksum() {
    for at in 28..32 {
        let mut bytes = trained(1).to_plain_bytes();
        bytes[at] = 200;
        let checksum = crc32fast::hash(&bytes[16..]);
        bytes[12..16].copy_from_slice(&checksum.to_le_bytes());
        assert_eq!(Vocabulary::from_bytes(&bytes), Err(VocabularyError::Damaged));
    }
}

#[test]
fn too_few_images_are_refused() {
    for images in [vec![], vec![Features::default(); 9], vec![image(&[1, 2, 3], 50, 1)]] {
        let refused = Vocabulary::train(&images, &TrainParams::default()).unwrap_err();
        assert!(matches!(refused, VocabularyError::TooFew { .. }), "{refused}");
    }
}

#[test]
fn the_shipped_vocabulary_is_whole_and_small() {
    assert!(include_bytes!("shipped.vocabulary").len() <= 3_000_000);
    let vocabulary = Vocabulary::shipped();
    assert!(vocabulary.len() >= 5000, "{} words", vocabulary.len());
    assert!(vocabulary.images >= 500);
}

#[test]
fn the_chow_liu_tree_finds_the_chain_that_made_the_words() {
    // 0 – 3 – 1 – 4 – 2: each word copies its neighbour in the chain nine times in ten.
    let chain = [0, 3, 1, 4, 2];
    let mut random = Random::new(3);
    let images: Vec<Vec<u32>> = (0..4000)
        .map(|_| {
            let mut on = random.below(2) == 1;
            let mut words = Vec::new();
            for word in chain {
                on ^= random.below(10) == 0;
                words.extend(on.then_some(word));
            }
            words
        })
        .collect();
    let occurrence = Occurrence::new(5, &images);
    let ties = occurrence.tree();
    let parents: Vec<Option<u32>> = ties.iter().map(|tie| tie.parent).collect();
    assert_eq!(parents, [None, Some(3), Some(4), Some(0), Some(1)]);
    for (word, tie) in ties.iter().enumerate().skip(1) {
        let parent = tie.parent.unwrap();
        let both = images.iter().filter(|i| i.contains(&parent) && i.contains(&(word as u32))).count();
        assert_eq!(tie.together as usize, both);
    }
}
