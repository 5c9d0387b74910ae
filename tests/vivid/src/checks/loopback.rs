//! What all other checks rest on: pictures that are played come out of the capture device as they are.

use super::pattern;
use crate::driver::{CAPTURE, Mode};
use crate::layout::{self, FORMATS};
use crate::player::{Pace, Player};
use anyhow::{Context, Result, ensure};
use std::fs::File;
use std::io::Read;

/// Plays one picture in each format and reads it back with plain system calls.
pub fn every_format() -> Result<String> {
    for format in FORMATS {
        let mode = Mode { format, ..Mode::USUAL };
        let picture = pattern(mode.width, mode.height, 0);
        let player = Player::start(std::slice::from_ref(&picture), &mode, Pace::OnDemand)?;
        let expected = layout::bytes(&picture, format)?;
        let mut device = File::open(CAPTURE).context(CAPTURE)?;
        let mut got = vec![0; expected.len()];
        // The first frames may still show what was there before.
        for _ in 0..4 {
            let length = device.read(&mut got).context(CAPTURE)?;
            ensure!(length == expected.len(), "{format}: {length} bytes instead of {}", expected.len());
        }
        drop(device);
        player.stop()?;
        let different = got.iter().zip(&expected).filter(|(a, b)| a != b).count();
        ensure!(different == 0, "{format}: {different} of {} bytes differ", expected.len());
    }
    Ok(FORMATS.join(" "))
}
