//! How far the scale of a map differs from keyframe to keyframe, over what is stated.

use geometry::median;
use loopbox_tests::{Recording, World, render};
use map::Keyframe;
use place_recog::ThumbnailIndex;
use slam_direct::{Agent, Frame, Params};

/// Keyframes on either side of a cut of which the scale is told: as many as see much of what the cut's own do.
const SIDE: usize = 5;

/// Maps a recording as a whole.
pub fn mapped(recording: &Recording) -> Agent {
    let mut agent =
        Agent::new(recording.camera, Box::new(ThumbnailIndex::default()), Params::default()).unwrap();
    for (index, shot) in (0..).zip(&recording.shots) {
        let (timestamp, image) = (shot.timestamp, shot.image.as_ref().clone());
        agent.process(Frame { index, timestamp, image, color: None }).unwrap();
    }
    agent.finish();
    agent
}

/// Maps a recording of a world: of each cut between keyframes the error of the logarithm of scale across it, and the standard deviation that is
/// stated. A keyframe's scale is the median of its depths over the true ones.
pub fn measure_scale(recording: &Recording, world: &World) -> Vec<[f64; 2]> {
    let agent = mapped(recording);
    let known = agent.carried_scale().deviations;
    let map = agent.into_map();
    let scale = |keyframe: &Keyframe| {
        let pose = &recording.shots[keyframe.frame_index as usize].world_from_camera;
        let truth = render(world, &recording.camera, pose).1;
        let pixels =
            keyframe.semi_dense.iter().map(|(pixel, found, _)| (found, truth.data()[pixel as usize]));
        let seen = pixels.filter(|(_, truth)| *truth > 0.0);
        let mut logs: Vec<f64> = seen.map(|(found, truth)| f64::from(truth / found).ln()).collect();
        Some(keyframe.world_from_keyframe.scale.ln() + median(&mut logs)?)
    };
    let scales: Vec<_> = map.keyframes.values().map(|keyframe| (keyframe.id, scale(keyframe))).collect();
    let error = |before| {
        let cut = scales.iter().position(|(id, _)| *id == before)? + 1;
        let side = |keyframes: &[(_, Option<f64>)]| {
            let known: Option<Vec<f64>> = keyframes.iter().map(|(_, scale)| *scale).collect();
            known.map(|known| known.iter().sum::<f64>() / known.len() as f64)
        };
        let (earlier, later) = scales.split_at(cut);
        Some(side(&later[..later.len().min(SIDE)])? - side(&earlier[cut.saturating_sub(SIDE)..])?)
    };
    known.iter().filter_map(|known| Some([error(known.before)?, known.deviation])).collect()
}
