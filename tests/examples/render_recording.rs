//! Renders one of the test motions to a recording on disk:
//! `cargo run -p loopbox-tests --example render_recording -- MOTION COUNT FOLDER`,
//! MOTION one of `sideways`, `hand_held`, `orbit`.

use loopbox_tests::{Encoding, Recording, World, trajectory};
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [motion, count, folder] = arguments.as_slice() else {
        return Err("usage: render_recording MOTION COUNT FOLDER".into());
    };
    let count = count.parse()?;
    let path = match motion.as_str() {
        "sideways" => trajectory::sideways(count, 0.06 * count as f64),
        "hand_held" => trajectory::hand_held(count, 0.4),
        "orbit" => trajectory::orbit(count, 4.0, 1.15),
        other => return Err(format!("no motion {other}: sideways, hand_held or orbit").into()),
    };
    let world = World::yard(1);
    let start = Instant::now();
    let recording = Recording::render(&world, Recording::SMALL_CAMERA, &path, 30.0);
    println!("{:.2} ms a frame", 1e3 * start.elapsed().as_secs_f64() / count as f64);
    recording.write(Path::new(folder), Encoding::Png)?;
    Ok(())
}
