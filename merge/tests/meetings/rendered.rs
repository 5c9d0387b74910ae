//! Maps with exact poses and depths, straight from the renderer.

use geometry::{GrayImage, Se3, Sim3};
use loopbox_tests::{Recording, World, render, with_noise};
use map::{AgentId, Edge, EdgeKind, Keyframe, KeyframeId, Map, SemiDense};
use nalgebra::SMatrix;
use rayon::prelude::*;
use std::sync::Arc;

/// What depth a rendered keyframe has: every how many pixels, and with what relative standard deviation.
const DEPTH_EVERY: usize = 3;
const DEPTH_DEVIATION: f32 = 0.01;

/// A map of keyframes at `path`, in the true world and in metres.
pub fn rendered_map(world: &World, path: &[Se3]) -> Map {
    let camera = Recording::SMALL_CAMERA;
    let keyframes: Vec<Keyframe> = path
        .par_iter()
        .enumerate()
        .map(|(index, pose)| {
            let (image, inverse_depth) = render(world, &camera, pose);
            Keyframe {
                id: KeyframeId(index as u32),
                agent: AgentId(0),
                timestamp: index as f64,
                frame_index: index as u64,
                world_from_keyframe: Sim3::from(*pose),
                semi_dense: depth_of(&image, inverse_depth.data()).into(),
                image: Arc::new(image),
                color: None,
                scan: None,
                points: Vec::new(),
                features: None,
                words: None,
            }
        })
        .collect();
    let mut map = Map::new(camera);
    for (earlier, later) in keyframes.iter().zip(keyframes.iter().skip(1)) {
        map.edges.push(Edge {
            from: earlier.id,
            to: later.id,
            from_from_to: earlier.world_from_keyframe.inverse() * later.world_from_keyframe,
            information: SMatrix::identity() * 1e6,
            kind: EdgeKind::Odometry,
        });
    }
    map.keyframes = keyframes.into_iter().map(|keyframe| (keyframe.id, keyframe)).collect();
    map
}

/// The same with noise of this standard deviation in its images, grey levels; another `pass`, other noise.
pub fn noisy_map(world: &World, path: &[Se3], (deviation, pass): (f64, u64)) -> Map {
    let mut map = rendered_map(world, path);
    for (id, keyframe) in &mut map.keyframes {
        let seed = 1 + pass * 1000 + u64::from(id.0);
        keyframe.image = Arc::new(with_noise(&keyframe.image, deviation, seed));
    }
    map
}

/// Depth where the image has an edge, as a tracker finds it.
fn depth_of(image: &GrayImage, inverse_depth: &[f32]) -> SemiDense {
    let mut semi_dense = SemiDense::default();
    let (width, height) = (image.width(), image.height());
    for pixel in (0..width * height).step_by(DEPTH_EVERY) {
        let (x, y) = (pixel % width, pixel / width);
        let inside = x > 1 && y > 1 && x + 2 < width && y + 2 < height;
        let steep = |a: u8, b: u8| a.abs_diff(b) > 12;
        let textured = inside
            && (steep(image.get(x - 1, y), image.get(x + 1, y))
                || steep(image.get(x, y - 1), image.get(x, y + 1)));
        let depth = inverse_depth[pixel];
        if textured && depth > 0.0 {
            semi_dense.pixel.push(pixel as u32);
            semi_dense.inverse_depth.push(depth);
            semi_dense.variance.push((DEPTH_DEVIATION * depth).powi(2));
        }
    }
    semi_dense
}
