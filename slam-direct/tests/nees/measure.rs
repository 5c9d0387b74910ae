//! How far poses are from the truth, over what is stated.

use geometry::{Se3, umeyama};
use loopbox_tests::Recording;
use map::FramePose;
use nalgebra::{Matrix6, Vector6};
use place_recog::ThumbnailIndex;
use slam_direct::{Agent, Frame, Params};

/// A frame's normalised squared errors: each is 1 in the mean where what is stated is true.
#[derive(Clone, Copy, Debug)]
pub struct Nees {
    /// Of the whole pose, over its six degrees of freedom.
    pub pose: f64,
    /// Of the position, over three.
    pub position: f64,
    /// Of the rotation, over three.
    pub rotation: f64,
}

/// Tracks a recording, and compares each frame's pose as it was handed out with the truth: relative to its keyframe, since what the map errs
/// is not stated, and in metres.
pub fn measure(recording: &Recording) -> Vec<Nees> {
    let mut agent =
        Agent::new(recording.camera, Box::new(ThumbnailIndex::default()), Params::default()).unwrap();
    let mut live: Vec<(FramePose, u64, Matrix6<f64>)> = Vec::new();
    for (index, shot) in (0..).zip(&recording.shots) {
        let (timestamp, image) = (shot.timestamp, shot.image.as_ref().clone());
        let report = agent.process(Frame { index, timestamp, image, color: None }).unwrap();
        if report.deltas.iter().any(|delta| delta.sequence == 0) {
            // Another map begins: the one before was of no use.
            live.clear();
        }
        if let (Some(covariance), Some(frame)) = (report.covariance, agent.map().frames.last()) {
            let keyframe = agent.map().keyframes[&frame.reference].frame_index;
            live.push((*frame, keyframe, covariance));
        }
    }
    agent.finish();
    let map = agent.into_map();
    let truth = |frame_index: u64| recording.shots[frame_index as usize].world_from_camera;
    let found: Vec<_> = map.trajectory().iter().map(|p| p.world_from_camera.translation).collect();
    let true_places: Vec<_> = map.frames.iter().map(|f| truth(f.frame_index).translation).collect();
    let Ok(fit) = umeyama::sim3(&found, &true_places) else { return Vec::new() };
    // A keyframe's own frame is where its keyframe is.
    let apart = live.iter().filter(|(frame, keyframe, _)| frame.frame_index != *keyframe);
    apart
        .map(|(frame, keyframe, covariance)| {
            let step = frame.keyframe_from_frame;
            let step = Se3::new(step.rotation, step.translation * fit.scale);
            let true_step = truth(*keyframe).inverse() * truth(frame.frame_index);
            normalised(&(true_step.inverse() * step).log(), covariance, fit.scale)
        })
        .collect()
}

/// An error `(υ, ω)` in metres and radians over a covariance whose unit is so many metres.
fn normalised(error: &Vector6<f64>, covariance: &Matrix6<f64>, scale: f64) -> Nees {
    let to_metres = Matrix6::from_diagonal(&Vector6::new(scale, scale, scale, 1.0, 1.0, 1.0));
    let covariance = to_metres * covariance * to_metres;
    let part = |first: usize| {
        let error = error.fixed_rows::<3>(first);
        let covariance = covariance.fixed_view::<3, 3>(first, first).into_owned();
        covariance.cholesky().map_or(f64::INFINITY, |known| error.dot(&known.solve(&error)) / 3.0)
    };
    let pose = covariance.cholesky().map_or(f64::INFINITY, |known| error.dot(&known.solve(error)) / 6.0);
    Nees { pose, position: part(0), rotation: part(3) }
}

/// The mean.
pub fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    sum / f64::from(count)
}
