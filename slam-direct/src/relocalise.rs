//! Relocalisation: finds the pose of a lost frame among candidate keyframes.

use crate::align::{Alignment, AlignmentReference, Brightness};
use backend::params;
use backend::sim3_align::turned_starts;
use geometry::{Pyramid, Se3, Sim3};
use map::KeyframeId;
use thiserror::Error;

params! {
    /// Parameters of the relocalisation.
    pub struct RelocaliseParams {
        /// Angle between the starts tried for a candidate, degrees. Range 1–20; about half of
        /// what the coarsest level can correct.
        pub start_angle: f64 = 6.0,
        /// Starts of a candidate that continue on the finer levels. Range 1–9.
        pub refined_starts: usize = 2,
        /// Least share of the candidate's points that must lie in the frame. Range 0–1.
        pub min_visible_share: f32 = 0.4,
        /// Least share of those that must agree. Range 0–1; a wrongly placed frame spoils the map, so this is
        /// stricter than for tracking.
        pub min_inlier_share: f32 = 0.5,
        /// Largest root mean square residual of the points that agree, grey levels. Range 3–40.
        pub max_rmse: f32 = 16.0,
    }
}

/// A frame found again.
#[derive(Clone, Copy, Debug)]
pub struct Relocalised {
    /// The keyframe that it was found against.
    pub keyframe: KeyframeId,
    /// Its pose relative to that keyframe, with evidence.
    pub alignment: Alignment,
}

/// Why a frame was not found.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum RelocaliseRefusal {
    /// There was no candidate with points.
    #[error("no keyframe with depth was proposed")]
    NoCandidates,
    /// No candidate's alignment was good enough.
    #[error("no candidate fits: the best has {inlier_share} inliers among {visible_share} visible points")]
    NoFit {
        /// Inlier share of the best alignment, 0–1.
        inlier_share: f32,
        /// Its share of visible points, 0–1.
        visible_share: f32,
    },
}

/// Finds `frame` among `candidates`, given best first; takes the first that passes all tests.
pub fn relocalise<'a>(
    frame: &Pyramid,
    candidates: impl IntoIterator<Item = (KeyframeId, &'a AlignmentReference)>,
    params: &RelocaliseParams,
) -> Result<Relocalised, RelocaliseRefusal> {
    let mut best: Option<Alignment> = None;
    for (keyframe, reference) in candidates.into_iter().filter(|(_, reference)| !reference.is_empty()) {
        for alignment in try_candidate(frame, reference, params) {
            if accepts(&alignment, params) {
                return Ok(Relocalised { keyframe, alignment });
            }
            if best.as_ref().is_none_or(|best| quality(&alignment) > quality(best)) {
                best = Some(alignment);
            }
        }
    }
    Err(best.map_or(RelocaliseRefusal::NoCandidates, |best| RelocaliseRefusal::NoFit {
        inlier_share: best.inlier_share,
        visible_share: best.visible_share,
    }))
}

/// Alignments from the best starts at the coarsest level, best first.
fn try_candidate(
    frame: &Pyramid,
    reference: &AlignmentReference,
    params: &RelocaliseParams,
) -> Vec<Alignment> {
    let brightness = Brightness::default();
    let mut starts: Vec<(f64, Se3)> = turned_starts(Sim3::identity(), params.start_angle.to_radians())
        .iter()
        .map(|start| (reference.coarse_cost(frame, &start.rigid(), brightness), start.rigid()))
        .collect();
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut alignments: Vec<Alignment> = starts
        .iter()
        .take(params.refined_starts.max(1))
        .map(|(_, start)| reference.align(frame, start, brightness))
        .collect();
    alignments.sort_by(|a, b| quality(b).total_cmp(&quality(a)));
    alignments
}

fn quality(alignment: &Alignment) -> f32 {
    alignment.inlier_share * alignment.visible_share
}

fn accepts(alignment: &Alignment, params: &RelocaliseParams) -> bool {
    alignment.frame_from_reference.is_finite()
        && alignment.visible_share >= params.min_visible_share
        && alignment.inlier_share >= params.min_inlier_share
        && alignment.rmse <= params.max_rmse
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::{AlignParams, ReferencePoint};
    use crate::test_data;
    use geometry::{GrayImage, Pinhole};

    /// Points of a keyframe every third high-gradient pixel.
    fn reference(pyramid: &Pyramid, depth: &map::SemiDense, camera: &Pinhole) -> AlignmentReference {
        let width = camera.width as u32;
        let points: Vec<ReferencePoint> = depth
            .iter()
            .step_by(7)
            .map(|(pixel, inverse_depth, variance)| ReferencePoint {
                pixel: [(pixel % width) as f32, (pixel / width) as f32],
                inverse_depth,
                variance,
            })
            .collect();
        AlignmentReference::new(pyramid, camera, &points, &AlignParams::default())
    }

    /// A flat textured wall two units away, turned by the view.
    fn wall(yaw: f64, seed: f64) -> Pyramid {
        let camera = wall_camera();
        let mut image = GrayImage::filled(camera.width, camera.height, 0);
        for y in 0..camera.height {
            for x in 0..camera.width {
                let ray = nalgebra::UnitQuaternion::from_euler_angles(0.0, yaw, 0.0)
                    * camera.unproject(x as f64, y as f64);
                let (u, v) = (2.0 * ray.x / ray.z, 2.0 * ray.y / ray.z);
                let value =
                    (3.0 * u + seed).sin() + (4.0 * v - 1.7 * u * seed).sin() + (9.0 * u + 7.0 * v).sin();
                image.set(x, y, (127.0 + 40.0 * value) as u8);
            }
        }
        Pyramid::new(image, 5)
    }

    fn wall_camera() -> Pinhole {
        Pinhole { width: 320, height: 240, fx: 250.0, fy: 250.0, cx: 159.5, cy: 119.5 }
    }

    fn wall_reference(seed: f64) -> AlignmentReference {
        let camera = wall_camera();
        let pixel: Vec<u32> = (0..320 * 240).filter(|p| p % 5 == 0).collect();
        let count = pixel.len();
        let depth = map::SemiDense {
            pixel: pixel.into(),
            inverse_depth: vec![0.5; count].into(),
            variance: vec![1e-4; count].into(),
        };
        reference(&wall(0.0, seed), &depth, &camera)
    }

    #[test]
    fn a_turned_view_is_found_and_another_place_is_not() {
        let params = RelocaliseParams::default();
        let (here, elsewhere) = (wall_reference(1.0), wall_reference(2.9));
        let frame = wall(0.15, 1.0);
        let candidates = [(KeyframeId(4), &elsewhere), (KeyframeId(2), &here)];
        let found = relocalise(&frame, candidates, &params).unwrap();
        assert_eq!(found.keyframe, KeyframeId(2));
        let turned = found.alignment.frame_from_reference.rotation.angle();
        assert!((turned - 0.15).abs() < 0.01, "{turned}");
        let refusal = relocalise(&frame, [(KeyframeId(4), &elsewhere)], &params).unwrap_err();
        assert!(matches!(refusal, RelocaliseRefusal::NoFit { .. }), "{refusal}");
        let none: [(KeyframeId, &AlignmentReference); 0] = [];
        assert_eq!(relocalise(&frame, none, &params).unwrap_err(), RelocaliseRefusal::NoCandidates);
    }

    #[test]
    #[ignore = "needs the sequences with ground truth"]
    fn lost_frames_of_a_rendered_sequence_are_found() {
        let sequence = test_data::data().join("parking_a");
        let (poses, camera) = (test_data::poses(&sequence), test_data::camera());
        let params = RelocaliseParams::default();
        for gap in [2usize, 4, 6, 8, 12, 100] {
            let (mut tested, mut found, mut wrong, mut milliseconds) = (0, 0, 0, 0.0);
            for first in (0..poses.len() - gap).step_by(20) {
                let (pyramid, depth) = test_data::keyframe(&sequence, first, 1.0, 0.02);
                let reference = reference(&pyramid, &depth, &camera);
                let frame = Pyramid::new(test_data::image(&sequence, first + gap), 6);
                let start = std::time::Instant::now();
                let result = relocalise(&frame, [(KeyframeId(0), &reference)], &params);
                milliseconds += start.elapsed().as_secs_f64() * 1e3;
                tested += 1;
                let Ok(result) = result else { continue };
                let truth = poses[first + gap].inverse() * poses[first];
                let error = (result.alignment.frame_from_reference * truth.inverse()).log();
                let good = error.fixed_rows::<3>(0).norm() < 0.05 && error.fixed_rows::<3>(3).norm() < 0.01;
                found += good as usize;
                wrong += !good as usize;
                let evidence = result.alignment;
                if !good || gap > 4 {
                    println!(
                        "  {first}: right {good}, visible {:.2}, inliers {:.2}, rmse {:.1}, off by {:.3}",
                        evidence.visible_share,
                        evidence.inlier_share,
                        evidence.rmse,
                        error.norm()
                    );
                }
            }
            println!(
                "+{gap} ({:.2} m): found {found}/{tested}, wrong {wrong}, {:.0} ms",
                gap as f64 * 0.12,
                milliseconds / tested as f64
            );
        }
    }
}
