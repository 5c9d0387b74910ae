//! Verdicts on doubles of places and on the same places changed, one line a pair:
//! `cargo run -p loopbox-merge --example doubles -- KIND|tuned|shown PLACES GRAIN NOISE`
//! with exact maps of ways past PLACES places of each share that differs; or on parts of the maps in two files, which show one place:
//! `… -- files PARTS A B`, each cut into so many.

#[path = "../tests/meetings/rendered.rs"]
mod rendered;

use backend::verdict::PieceKind;
use loopbox_tests::doubles::{Kind, Version};
use map::{KeyframeId, Map};
use merge::further::FurtherParams;
use merge::key_points::KeyPointParams;
use merge::place_verdict::{PlaceParams, place_verdict};
use merge::prepared::PreparedMap;
use merge::verification::{Place, TestedPlace, VerificationParams, meet};
use place_recog::features::{SiftParams, sift};
use place_recog::{FeatureWords, KeyframeFeatures, ProposeParams, Vocabulary, WordBag, propose};
use std::collections::BTreeMap;

const KEYFRAMES: usize = 8;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [files, parts, a, b] = arguments.as_slice()
        && files == "files"
    {
        return files_of(parts.parse().unwrap(), [a, b]);
    }
    let [kinds, places, grain, noise] = arguments.as_slice() else {
        eprintln!("usage: doubles KIND|tuned|shown PLACES GRAIN NOISE");
        std::process::exit(2);
    };
    let (places, grain, noise): (u64, f32, f64) =
        (places.parse().unwrap(), grain.parse().unwrap(), noise.parse().unwrap());
    let kinds: Vec<Kind> = match kinds.as_str() {
        "tuned" => Kind::TUNED.to_vec(),
        "shown" => Kind::HELD_OUT.to_vec(),
        one => [&Kind::TUNED[..], &Kind::HELD_OUT[..]]
            .concat()
            .into_iter()
            .filter(|kind| format!("{kind:?}") == one)
            .collect(),
    };
    let here = Version::first(1, grain);
    for kind in kinds {
        for number in 0..places {
            let seed = number + 1;
            let version = Version { seed, ..here };
            let first = map(kind, &version, 2 * number, noise);
            for share in shares("DIFFERING", &[0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0]) {
                let other = Version { place: number + 1, share, ..version };
                line(kind, "double", share, &first, &map(kind, &other, 2 * number + 1, noise));
            }
            for moved in shares("MOVED", &[0.0, 0.05, 0.1, 0.2, 0.3, 0.5]) {
                let other = Version { time: 1, moved, ..version };
                line(kind, "same", moved, &first, &map(kind, &other, 2 * number + 1, noise));
            }
        }
    }
}

/// The shares that a variable lists, or else the usual ones.
fn shares(variable: &str, usual: &[f64]) -> Vec<f64> {
    let listed = |text: String| text.split(',').filter_map(|share| share.parse().ok()).collect();
    std::env::var(variable).map_or(usual.to_vec(), listed)
}

fn map(kind: Kind, version: &Version, pass: u64, noise: f64) -> Map {
    rendered::noisy_map(&kind.world(version), &kind.path(pass, KEYFRAMES), (noise, pass))
}

/// The features of all keyframes of a map.
fn features(map: &Map) -> KeyframeFeatures {
    let find = |(id, keyframe): (&KeyframeId, &map::Keyframe)| {
        (*id, sift(&keyframe.image, &SiftParams { halvings: 0, ..SiftParams::default() }).expect("an image"))
    };
    map.keyframes.iter().map(find).collect()
}

/// Places that two maps may share.
fn places([target, source]: [&KeyframeFeatures; 2]) -> Vec<Place> {
    let vocabulary = &Vocabulary::shipped();
    let words = |features: &KeyframeFeatures| -> BTreeMap<KeyframeId, WordBag> {
        let of = |id| FeatureWords::of(&features.get(id).expect("its own"), vocabulary).bag();
        features.keyframes().map(|id| (id, of(id))).collect()
    };
    let found = propose(&words(target), &words(source), vocabulary, &ProposeParams::default());
    found.iter().map(|p| Place { source: p.query, target: p.keyframe }).collect()
}

/// Every part of one map with every part of another.
fn files_of(parts: usize, files: [&String; 2]) {
    let [a, b] = files.map(|file| map::load_map(std::path::Path::new(file)).expect("a map").map);
    let all = (0..parts).flat_map(|i| (0..parts).map(move |j| (i, j)));
    let (of_a, of_b) = (features(&a), features(&b));
    let of = |features: &KeyframeFeatures, map: &Map| -> KeyframeFeatures {
        map.keyframes.keys().filter_map(|id| Some((*id, (*features.get(*id)?).clone()))).collect()
    };
    let name = |file: &str| file.rsplit('/').nth(1).unwrap_or("map").to_owned();
    // Of one map no part meets itself.
    for (i, j) in all.filter(|(i, j)| files[0] != files[1] || i < j) {
        let (one, other) = (part(&a, i, parts), part(&b, j, parts));
        let names = format!("{}:{i}+{}:{j}of{parts}", name(files[0]), name(files[1]));
        met(names, "one", 0.0, [&one, &other], [&of(&of_a, &one), &of(&of_b, &other)]);
    }
}

/// One of so many equal parts of a map.
fn part(map: &Map, number: usize, parts: usize) -> Map {
    let mut part = map.clone();
    let mut ids: Vec<KeyframeId> = map.keyframes.keys().copied().collect();
    ids.sort_by(|a, b| map.keyframes[a].timestamp.total_cmp(&map.keyframes[b].timestamp));
    let within = |count: usize| number * count / parts..(number + 1) * count / parts;
    let kept: Vec<KeyframeId> = ids[within(ids.len())].to_vec();
    part.keyframes.retain(|id, _| kept.contains(id));
    part.edges.retain(|edge| kept.contains(&edge.from) && kept.contains(&edge.to));
    part.frames.clear();
    part
}

fn line(kind: impl std::fmt::Debug, what: &str, share: f64, target: &Map, source: &Map) {
    let (of_target, of_source) = (features(target), features(source));
    met(kind, what, share, [target, source], [&of_target, &of_source]);
}

/// How many things of one kind agree, and how many do not.
fn things(found: &backend::verdict::Weighed, kind: PieceKind) -> [f64; 2] {
    let of_kind = || found.pieces.iter().map(|(piece, _)| piece).filter(|piece| piece.kind == kind);
    [true, false].map(|agrees| of_kind().filter(|p| (p.ln_agreement > 0.0) == agrees).map(|p| p.things).sum())
}

/// Prints what is said of two maps, and by what.
fn met(
    kind: impl std::fmt::Debug,
    what: &str,
    share: f64,
    [target, source]: [&Map; 2],
    [of_target, of_source]: [&KeyframeFeatures; 2],
) {
    let key_points = KeyPointParams::default();
    let prepared =
        [PreparedMap::new(target, of_target, &key_points), PreparedMap::new(source, of_source, &key_points)];
    let restricted = [target, source].map(|map| map.keyframes.keys().copied().collect::<Vec<_>>());
    let places = places([of_target, of_source]);
    let places: Vec<Place> = places
        .into_iter()
        .filter(|place| restricted[0].contains(&place.target) && restricted[1].contains(&place.source))
        .collect();
    let met =
        meet(&prepared[1], &prepared[0], &places, &VerificationParams::default(), &FurtherParams::default());
    let evaluated = |tested: &&TestedPlace| {
        tested.outcome.evaluated().is_some_and(|evaluated| evaluated.joined.is_some())
    };
    let doubt = met.iter().filter_map(|tested| tested.outcome.evaluated()?.verdict.doubt()).next();
    let before =
        if met.iter().any(|tested| tested.outcome.accepted().is_some()) { "JOINED" } else { "apart" };
    let mut evaluated: Vec<&TestedPlace> = met.iter().filter(evaluated).collect();
    evaluated
        .sort_by_key(|tested| std::cmp::Reverse((tested.outcome.accepted().is_some(), tested.match_count)));
    let Some(tested) = evaluated.first() else {
        println!("{kind:?} {what} {share:.2} {before} - no closure of {}", met.len());
        return;
    };
    let evaluated = tested.outcome.evaluated().unwrap();
    let edges = &evaluated.joined.as_ref().unwrap().edges;
    let off = evaluated.closure.motion.a_from_b.translation.norm();
    let params = PlaceParams::default();
    let found = place_verdict(&prepared[1], &prepared[0], edges, &params).weighed;
    let [[la, ld], [wa, wd]] = [PieceKind::Look, PieceKind::Wear].map(|kind| things(&found, kind));
    let later = backend::verdict::Prior { days_apart: 30.0, ..params.prior.clone() };
    let pieces: Vec<_> = found.pieces.iter().map(|(piece, _)| *piece).collect();
    let later = backend::verdict::weigh(&pieces, &later);
    println!(
        "{kind:?} {what} {share:.2} {before} -> {:?} {:.1} later {:?} {:.1} | look {la:.1} : {ld:.1} wear {wa:.1} : {wd:.1} edges {} off {off:.2} {}",
        found.answer,
        found.ln_ratio,
        later.answer,
        later.ln_ratio,
        edges.len(),
        doubt.filter(|_| before == "apart").map_or(String::new(), |doubt| doubt.to_string()),
    );
    let failed = evaluated.verdict.lines.iter().filter(|line| line.says != merge::acceptance::Says::For);
    println!("    failed: {}", failed.map(|line| &*line.name).collect::<Vec<_>>().join(", "));
    if std::env::var("PIECES").is_ok() {
        for (piece, part) in &found.pieces {
            println!(
                "    {:?} share {:.3} things {:.2} l {:.2} part {part:.2}",
                piece.kind, piece.share, piece.things, piece.ln_agreement
            );
        }
    }
}
