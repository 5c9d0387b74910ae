//! Renders recordings of a camera that is covered and uncovered in a place of one kind or its double:
//! `cargo run -p loopbox-tests --example render_covered -- FOLDER KIND SEED GRAIN WHERE SHARE`,
//! WHERE one of `there`, `passing`, `elsewhere`, `passing-elsewhere`. `whole/` has all, `first/` what is before, `second/` what is after.

use loopbox_tests::covered::{BEFORE, COVERED, Uncovered, covered};
use loopbox_tests::doubles::Kind;
use loopbox_tests::{Encoding, Recording};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, kind, seed, grain, place, share] = arguments.as_slice() else {
        return Err("usage: render_covered FOLDER KIND SEED GRAIN WHERE SHARE".into());
    };
    let mut kinds = Kind::TUNED.iter().chain(&Kind::HELD_OUT);
    let kind = kinds.find(|known| format!("{known:?}") == *kind).ok_or("no such kind")?;
    let share = share.parse()?;
    let uncovered = match place.as_str() {
        "there" => Uncovered::There(share),
        "passing" => Uncovered::Passing(share),
        "elsewhere" => Uncovered::Elsewhere(share),
        "passing-elsewhere" => Uncovered::PassingElsewhere(share),
        other => return Err(format!("no place {other}").into()),
    };
    let recording = covered(*kind, seed.parse()?, uncovered, grain.parse()?);
    let part = |name: &str, frames: std::ops::Range<usize>| {
        let shots = recording.shots[frames].to_vec();
        Recording { camera: recording.camera, shots }.write(&Path::new(folder).join(name), Encoding::Png)
    };
    part("whole", 0..recording.shots.len())?;
    part("first", 0..BEFORE)?;
    part("second", BEFORE + COVERED..recording.shots.len())?;
    Ok(())
}
