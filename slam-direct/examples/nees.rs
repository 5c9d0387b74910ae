//! Prints how true the stated uncertainties of live poses, readout times, scales and depths are, on rendered recordings.
//!
//! ```text
//! cargo run --release -p loopbox-slam-direct --example nees -- SEEDS [FIRST SEED]
//! cargo run --release -p loopbox-slam-direct --example nees -- readout SEEDS [FIRST SEED]
//! cargo run --release -p loopbox-slam-direct --example nees -- scale SEEDS [FIRST SEED]
//! cargo run --release -p loopbox-slam-direct --example nees -- depths SEEDS [FIRST SEED]
//! ```

#[path = "../tests/nees/measure.rs"]
mod measure;
#[path = "../tests/nees/points.rs"]
mod points;
#[path = "../tests/nees/scale.rs"]
mod scale;

use geometry::median;
use loopbox_tests::doubles::{Kind as Place, Version};
use loopbox_tests::moving::{Mover, moving};
use loopbox_tests::robot::Drive;
use loopbox_tests::{Recording, World, trajectory};
use map::AgentInfo;
use measure::{Nees, mean, measure};
use scale::{mapped, measure_scale};

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

fn world(kind: Place, seed: u64) -> World {
    kind.world(&Version::first(seed, 4.0))
}

fn place(kind: Place, seed: u64) -> Recording {
    Recording::render(&world(kind, seed), Recording::SMALL_CAMERA, &kind.path(0, FRAMES.0), FRAMES.1)
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
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let what =
        arguments.first().filter(|argument| ["readout", "scale", "depths"].contains(&argument.as_str()));
    let numbers: Vec<u64> =
        arguments.iter().skip(usize::from(what.is_some())).map(|number| number.parse().unwrap()).collect();
    let (count, first) = (numbers.first().copied().unwrap_or(3), numbers.get(1).copied().unwrap_or(1));
    match what.map(String::as_str) {
        Some("readout") => return print_readouts(first..first + count),
        Some("depths") => return print_depths(first..first + count),
        Some(_) => return print_scales(first..first + count),
        None => {}
    }
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

/// What is rendered of a seed to tell scales, and the world that it shows.
type RenderWorld = fn(u64) -> (Recording, World);

const SCALED: [(&str, RenderWorld); 8] = [
    ("a walk, noise 0", |seed| (walk(seed, 0.0), World::yard(seed))),
    ("a walk, noise 2", |seed| (walk(seed, 2.0), World::yard(seed))),
    ("a walk, noise 6", |seed| (walk(seed, 6.0), World::yard(seed))),
    ("a walk, rows read in 20 ms", |seed| (rolling(seed), World::yard(seed))),
    ("an office", |seed| (place(Place::Office, seed), world(Place::Office, seed))),
    ("an aisle", |seed| (place(Place::Aisle, seed), world(Place::Aisle, seed))),
    ("a row of houses", |seed| (place(Place::Row, seed), world(Place::Row, seed))),
    ("a robot turns on the spot", |seed| (Drive::of(seed).recording(), Drive::of(seed).world())),
];

/// Prints how true it is how well a scale is said to be known from keyframe to keyframe.
fn print_scales(seeds: std::ops::Range<u64>) {
    println!(
        "| recordings | cuts | RMS error | RMS deviation | NEES: mean, median | within two deviations |\n\
         |---|---|---|---|---|---|"
    );
    let mut all = Vec::new();
    let row = |name: &str, cuts: &[[f64; 2]]| {
        let rms = |i: usize| mean(cuts.iter().map(|cut| cut[i] * cut[i])).sqrt();
        let mut nees: Vec<f64> = cuts.iter().map(|[error, deviation]| (error / deviation).powi(2)).collect();
        let within = nees.iter().filter(|nees| **nees < 4.0).count();
        println!(
            "| {name} | {} | {:.2} % | {:.2} % | {:.2}, {:.2} | {:.0} % |",
            cuts.len(),
            100.0 * rms(0),
            100.0 * rms(1),
            mean(nees.iter().copied()),
            median(&mut nees).unwrap_or(f64::NAN),
            100.0 * within as f64 / cuts.len() as f64
        );
    };
    for (name, render) in SCALED {
        let measured =
            seeds.clone().map(render).flat_map(|(recording, world)| measure_scale(&recording, &world));
        let own: Vec<[f64; 2]> = measured.collect();
        row(name, &own);
        all.extend(own);
    }
    row("**all**", &all);
}

/// Prints how true the stated uncertainties of depths are.
fn print_depths(seeds: std::ops::Range<u64>) {
    println!(
        "| recordings | depths | count | NEES at the pixel: mean, median | within two deviations | NEES in the patch: mean | within two deviations |\n\
         |---|---|---|---|---|---|---|"
    );
    let row = |name: &str, what: &str, errors: &[points::Error]| {
        let squares = |k: usize| errors.iter().map(move |error| error[k] * error[k]);
        let within = |k| 100.0 * squares(k).filter(|nees| *nees < 4.0).count() as f64 / errors.len() as f64;
        println!(
            "| {name} | {what} | {} | {:.2}, {:.2} | {:.1} % | {:.2} | {:.1} % |",
            errors.len(),
            mean(squares(0)),
            median(&mut squares(0).collect::<Vec<f64>>()).unwrap_or(f64::NAN),
            within(0),
            mean(squares(1)),
            within(1),
        );
    };
    let rows = |name: &str, errors: &points::DepthErrors| {
        row(name, "semi-dense", &errors.dense);
        row(name, "points", &errors.confirmed);
        row(name, "points seen once more", &errors.seen_once);
    };
    let mut all = points::DepthErrors::default();
    for (name, render) in SCALED {
        let mut own = points::DepthErrors::default();
        seeds.clone().map(render).for_each(|(recording, world)| own.add(&recording, &world));
        rows(name, &own);
        all.dense.extend(own.dense);
        all.confirmed.extend(own.confirmed);
        all.seen_once.extend(own.seen_once);
    }
    rows("**all**", &all);
}

/// Readout times that are rendered, seconds.
const READOUTS: [f64; 4] = [0.0, 0.01, 0.02, 0.03];
/// Noise of their recordings, grey levels, and their frames: short ones know less.
const NOISES: [f64; 2] = [2.0, 6.0];
const LENGTHS: [usize; 2] = [100, 250];

/// Prints how true the stated uncertainty of a readout time is.
fn print_readouts(seeds: std::ops::Range<u64>) {
    println!(
        "| readout | recordings | found | median error | median deviation | NEES: mean, median | within two deviations |\n\
         |---|---|---|---|---|---|---|"
    );
    for readout in READOUTS {
        let mut found: Vec<[f64; 2]> = Vec::new();
        let mut count = 0;
        for seed in seeds.clone() {
            for (noise, frames) in NOISES.iter().flat_map(|noise| LENGTHS.map(|frames| (*noise, frames))) {
                let path = trajectory::walk(frames, FRAMES.1, seed);
                let world = World::yard(seed);
                let (camera, rate) = (Recording::SMALL_CAMERA, FRAMES.1);
                let recording = Recording::render_rolling(&world, camera, &path, rate, readout);
                count += 1;
                found.extend(found_readout(&recording.with_noise(noise, seed), readout));
            }
        }
        let values = |of: fn(&[f64; 2]) -> f64| found.iter().map(of).collect::<Vec<f64>>();
        let nees = values(|[error, deviation]| (error / deviation).powi(2));
        let within = nees.iter().filter(|nees| **nees < 4.0).count();
        let milliseconds = |mut values: Vec<f64>| 1e3 * median(&mut values).unwrap_or(f64::NAN);
        println!(
            "| {:.0} ms | {count} | {} | {:.3} ms | {:.3} ms | {:.2}, {:.2} | {within} |",
            1e3 * readout,
            found.len(),
            milliseconds(values(|[error, _]| error.abs())),
            milliseconds(values(|[_, deviation]| *deviation)),
            mean(nees.iter().copied()),
            median(&mut nees.clone()).unwrap_or(f64::NAN),
        );
    }
}

/// Error and stated deviation of the readout time that a recording reveals, seconds; none where it reveals none.
fn found_readout(recording: &Recording, truth: f64) -> Option<[f64; 2]> {
    let map = mapped(recording).into_map();
    let sensor = map.agents.values().find_map(AgentInfo::image_sensor)?;
    sensor.is_rolling().then(|| [sensor.readout[1] - truth, sensor.readout_deviation])
}
