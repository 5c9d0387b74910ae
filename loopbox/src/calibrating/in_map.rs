//! A board in the keyframes of a map.

use crate::placing::board::Sighting;
use anyhow::{Result, bail};
use boards::Detector;
use calib::Board;
use geometry::GrayImage;
use map::{Keyframe, Map};
use rayon::prelude::*;

/// Images that are looked at for what else they show when no board was found.
const LOOKED_AT: usize = 3;

/// The board in each keyframe of a map that shows it, in their order.
///
/// # Errors
/// When the board is not known, or no keyframe shows it; says what they show instead.
pub fn sightings(map: &Map, board: &Board) -> Result<Vec<Sighting>> {
    let detector = Detector::new(board, None)?;
    let with_image =
        map.keyframes.values().filter_map(|keyframe| Some((keyframe, *map.camera_of(keyframe)?)));
    let with_image: Vec<_> = with_image.filter(|(keyframe, _)| !keyframe.image.data().is_empty()).collect();
    let looked = |(keyframe, camera): &(&Keyframe, _)| {
        let corners = detector.corners(&keyframe.image)?;
        let world_from_camera = keyframe.world_from_keyframe.rigid();
        Ok(Sighting { world_from_camera, camera: *camera, corners })
    };
    let all = with_image.par_iter().map(looked).collect::<Result<Vec<Sighting>>>()?;
    let count = all.len();
    let found: Vec<Sighting> =
        all.into_iter().filter(|sighting: &Sighting| !sighting.corners.is_empty()).collect();
    if found.is_empty() {
        let some = with_image.iter().step_by(count.div_ceil(LOOKED_AT).max(1));
        let images: Vec<GrayImage> = some.map(|(keyframe, _)| GrayImage::clone(&keyframe.image)).collect();
        bail!("no keyframe of {count} shows the board {board}: {}", detector.what_else(&images));
    }
    Ok(found)
}
