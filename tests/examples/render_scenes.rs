//! Renders views of many different rooms, one in each, to train a vocabulary on:
//! `cargo run --release -p loopbox-tests --example render_scenes -- WORLDS VIEWS FOLDER`
//! writes WORLDS × VIEWS PNG images of 640×480 pixels into FOLDER.

use geometry::Pinhole;
use loopbox_tests::{Encoding, World, render, trajectory};
use std::path::Path;

const CAMERA: Pinhole = Pinhole { width: 640, height: 480, fx: 480.0, fy: 480.0, cx: 319.5, cy: 239.5 };

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [worlds, views, folder] = arguments.as_slice() else {
        return Err("usage: render_scenes WORLDS VIEWS FOLDER".into());
    };
    let (worlds, views): (u64, usize) = (worlds.parse()?, views.parse()?);
    std::fs::create_dir_all(folder)?;
    for seed in 0..worlds {
        let world = World::varied(seed);
        for (i, pose) in trajectory::scattered(views, 2.0, seed).iter().enumerate() {
            let (image, _) = render(&world, &CAMERA, pose);
            let path = Path::new(folder).join(format!("{seed:04}_{i:02}.png"));
            std::fs::write(path, Encoding::Png.encode(&image)?)?;
        }
    }
    Ok(())
}
