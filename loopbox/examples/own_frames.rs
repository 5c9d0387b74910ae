//! Maps frames that another program hands over, as they come: here a thread that reads images takes the place of a camera's driver.
//! `cargo run --release -p loopbox-core --example own_frames -- demo/parking_a out`

use anyhow::{Context, Result, bail};
use loopbox::run::{PreparedRun, RunOptions, Silent};
use loopbox::{FrameSource, Picture, SourceFrame, SourceInfo, Stop, Watch};
use sources::timed_images;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;

/// An image file's bytes and its time, seconds.
type Sent = (f64, Vec<u8>);

/// Frames that come through a channel.
struct Channel {
    info: SourceInfo,
    frames: Receiver<Sent>,
    count: u64,
}

impl FrameSource for Channel {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        // Whoever sends has ended where there is no next one.
        let (timestamp, bytes) = self.frames.recv().ok()?;
        let index = self.count;
        self.count += 1;
        Some(SourceFrame { index, timestamp, captured: None, picture: Picture::Encoded(bytes) })
    }
}

fn main() -> Result<()> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [folder, out] = &arguments[..] else { bail!("usage: own_frames FOLDER OUT") };
    let (sender, frames) = sync_channel(4);
    let images = timed_images(&folder.join("times.txt"), folder)?;
    let driver = thread::spawn(move || -> Result<()> {
        for (time, file) in images {
            let bytes = std::fs::read(&file).with_context(|| file.display().to_string())?;
            // A run that ends early takes no more.
            if sender.send((time, bytes)).is_err() {
                break;
            }
        }
        Ok(())
    });
    let source = Channel { info: SourceInfo::new("frames of mine", folder), frames, count: 0 };
    let mut options = RunOptions::to(out);
    options.camera.calibration = Some(folder.join("camera.yaml"));
    let run = PreparedRun::new(Box::new(source), options)?;
    let mapped = run.go(|_, _, _| Ok(Watch::none()), &Stop::default(), &Silent);
    driver.join().expect("it does not panic")?;
    let mapped = mapped?;
    println!("{}: {} frames with a pose", mapped.folder.display(), mapped.record.frames.tracked);
    Ok(())
}
