//! Prints how true the stated uncertainties of live poses are, on rendered recordings.
//!
//! ```text
//! cargo run --release -p slam-direct --example nees -- SEEDS [FIRST SEED]
//! ```

#[path = "../tests/nees/measure.rs"]
mod measure;

use loopbox_tests::doubles::{Kind as Place, Version};
use loopbox_tests::moving::{Mover, moving};
use loopbox_tests::{Recording, World, trajectory};
use measure::{Nees, mean, measure};

/// Frames of a recording, and frames a second.
const FRAMES: (usize, f64) = (150, 30.0);
/// Seconds in which the rows of an image are read.
const READOUT: f64 = 0.02;

/// What is rendered of a seed.
type Render = fn(u64) -> Recording;

fn walk(seed: u64, noise: f64) -> Recording {
    let path = trajectory::walk(FRAMES.0, FRAMES.1, seed);
    Recording::render(&World::yard(seed), Recording::SMALL_CAMERA, &path, FRAMES.1).with_noise(noise, seed)
}

fn rolling(seed: u64) -> Recording {
    let path = trajectory::walk(FRAMES.0, FRAMES.1, seed);
    Recording::render_rolling(&World::yard(seed), Recording::SMALL_CAMERA, &path, FRAMES.1, READOUT)
        .with_noise(2.0, seed)
}

fn place(kind: Place, seed: u64) -> Recording {
    let world = kind.world(&Version { seed, place: 0, share: 0.0, time: 0, moved: 0.0, grain: 4.0 });
    Recording::render(&world, Recording::SMALL_CAMERA, &kind.path(0, FRAMES.0), FRAMES.1)
        .with_noise(2.0, seed)
}

const KINDS: [(&str, Render); 8] = [
    ("a walk, noise 0", |seed| walk(seed, 0.0)),
    ("a walk, noise 2", |seed| walk(seed, 2.0)),
    ("a walk, noise 6", |seed| walk(seed, 6.0)),
    ("a walk, rows read in 20 ms", rolling),
    ("an office", |seed| place(Place::Office, seed)),
    ("an aisle", |seed| place(Place::Aisle, seed)),
    ("a row of houses", |seed| place(Place::Row, seed)),
    ("a person walks past", |seed| moving(Mover::Person, 0.3, seed).recording),
];

fn main() {
    let numbers: Vec<u64> = std::env::args().skip(1).map(|number| number.parse().unwrap()).collect();
    let (count, first) = (numbers.first().copied().unwrap_or(3), numbers.get(1).copied().unwrap_or(1));
    println!(
        "| recordings | frames | NEES of poses: mean, median | positions | rotations |\n|---|---|---|---|---|"
    );
    let mut all = Vec::new();
    for (name, render) in KINDS {
        let own: Vec<Nees> = (first..first + count).flat_map(|seed| measure(&render(seed))).collect();
        row(name, &own);
        all.extend(own);
    }
    row("**all**", &all);
}

fn row(name: &str, all: &[Nees]) {
    let mut poses: Vec<f64> = all.iter().map(|nees| nees.pose).collect();
    poses.sort_by(f64::total_cmp);
    let median = poses.get(poses.len() / 2).copied().unwrap_or(f64::NAN);
    println!(
        "| {name} | {} | {:.2}, {median:.2} | {:.2} | {:.2} |",
        all.len(),
        mean(poses.iter().copied()),
        mean(all.iter().map(|nees| nees.position)),
        mean(all.iter().map(|nees| nees.rotation)),
    );
}
