//! Renders recordings in which something moves: `cargo run -p loopbox-tests --example render_moving -- FOLDER MOVER COVERAGE SEED`,
//! MOVER one of `Board`, `Person`, `Lorry`, `Departing`, `Leaving`, COVERAGE of the image from 0 to 1. `covered.txt` has the share in each frame.

use loopbox_tests::Encoding;
use loopbox_tests::moving::{Mover, moving};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, mover, coverage, seed] = arguments.as_slice() else {
        return Err("usage: render_moving FOLDER MOVER COVERAGE SEED".into());
    };
    let mover = Mover::ALL.into_iter().find(|known| format!("{known:?}") == *mover).ok_or("no such mover")?;
    let moving = moving(mover, coverage.parse()?, seed.parse()?);
    moving.recording.write(Path::new(folder), Encoding::Png)?;
    let covered: String = moving.covered.iter().map(|share| format!("{share:.4}\n")).collect();
    Ok(std::fs::write(Path::new(folder).join("covered.txt"), covered)?)
}
