//! How far depths are from the truth, over what is stated.

use crate::scale::mapped;
use geometry::{Image, median};
use loopbox_tests::{Recording, World, render};
use map::{DEFAULT_MAX_RELATIVE_VARIANCE, Keyframe};

/// A depth's error over its stated standard deviation: of the depth at its pixel, and of that of the nearest surface that its patch shows. Where
/// something stands in front, a patch beside its edge shows both, and its depth is that of the edge.
pub type Error = [f64; 2];

/// Errors of the depths that a map is handed out with.
#[derive(Default)]
pub struct DepthErrors {
    /// Of semi-dense depths that a cloud contains.
    pub dense: Vec<Error>,
    /// Of points that two and more other keyframes see.
    pub confirmed: Vec<Error>,
    /// Of points that one other keyframe sees.
    pub seen_once: Vec<Error>,
}

/// Pixels that are compared on either side of a semi-dense depth's pixel and of a point's.
const REACH: [usize; 2] = [2, 4];

impl DepthErrors {
    /// Maps a recording of a world, and compares each keyframe's depths with the truth, in a unit of its own.
    pub fn add(&mut self, recording: &Recording, world: &World) {
        for keyframe in mapped(recording).into_map().keyframes.values() {
            let pose = &recording.shots[keyframe.frame_index as usize].world_from_camera;
            self.compare(keyframe, &render(world, &recording.camera, pose).1);
        }
    }

    fn compare(&mut self, keyframe: &Keyframe, truth: &Image<f32>) {
        let (width, height) = (truth.width(), truth.height());
        let dense: Vec<Depth> = keyframe
            .semi_dense
            .iter()
            .filter(|(_, found, variance)| *variance <= DEFAULT_MAX_RELATIVE_VARIANCE * found * found)
            .map(|(pixel, found, variance)| {
                ([pixel as usize % width, pixel as usize / width], found, variance)
            })
            .collect();
        let at = |[x, y]: [usize; 2]| {
            (x < width && y < height).then(|| truth.get(x, y)).filter(|inverse_depth| *inverse_depth > 0.0)
        };
        let mut ratios: Vec<f32> =
            dense.iter().filter_map(|(pixel, found, _)| Some(at(*pixel)? / found)).collect();
        let Some(unit) = median(&mut ratios) else { return };
        let error = |(pixel, found, variance): &Depth, reach: usize| {
            let off = |truth: f32| f64::from((found - truth / unit).abs() / variance.sqrt());
            let [x, y] = pixel.map(|v| v.saturating_sub(reach)..=v + reach);
            let patch = y.flat_map(|y| x.clone().map(move |x| [x, y])).filter_map(at).map(off);
            Some([off(at(*pixel)?), patch.fold(f64::INFINITY, f64::min)])
        };
        self.dense.extend(dense.iter().filter_map(|depth| error(depth, REACH[0])));
        for point in &keyframe.points {
            let depth = (point.pixel.map(|v| v.round() as usize), point.inverse_depth, point.variance);
            match point.observations.len() {
                0 => {}
                1 => self.seen_once.extend(error(&depth, REACH[1])),
                _ => self.confirmed.extend(error(&depth, REACH[1])),
            }
        }
    }
}

/// A depth that is compared: its pixel, inverse depth and variance.
type Depth = ([usize; 2], f32, f32);
