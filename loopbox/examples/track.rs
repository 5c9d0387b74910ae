//! Tracks a folder of images with its calibration and says where the camera is at each:
//! `cargo run --release -p loopbox-core --example track -- demo/parking_a`.

use anyhow::Error;
use slam_direct::{Agent, Frame, Params};
use sources::correction::{CameraOptions, correction};

fn main() -> anyhow::Result<()> {
    let folder = std::env::args_os().nth(1).ok_or_else(|| Error::msg("usage: track FOLDER"))?;
    let mut source = sources::open(folder.as_ref(), &Default::default())?;
    let correction = correction(&CameraOptions::default(), source.info())?;
    let places = Box::new(place_recog::ThumbnailIndex::default());
    let mut agent = Agent::new(correction.camera(), places, Params::default())?;
    while let Some(frame) = source.next_frame() {
        let image = correction.apply(frame.picture.into_grey().map_err(Error::msg)?).map_err(Error::msg)?;
        let report =
            agent.process(Frame { index: frame.index, timestamp: frame.timestamp, image, color: None })?;
        println!("{:.3} {:?} {:?}", frame.timestamp, report.state, report.world_from_camera);
    }
    agent.finish();
    println!("{} keyframes", agent.map().keyframes.len());
    Ok(())
}
