//! Basin and accuracy of direct Sim(3) alignment on rendered sequences with ground-truth depth. Run with
//! `LOOPBOX_DATA=… cargo test -p loopbox-slam-direct --release -- --ignored sim3 --nocapture`.

use super::*;
use crate::test_data::{camera, data, keyframe, poses};
use nalgebra::SVector;

#[test]
#[ignore = "needs the sequences with ground truth"]
fn sim3_basin_and_accuracy_on_rendered_keyframes() {
    let params = Sim3AlignParams::default();
    let mut random = geometry::Random::new(3);
    let mut uniform = || 2.0 * random.unit() - 1.0;
    for (name, gap) in [("parking_a", 10), ("parking_a", 20), ("parking_c", 10)] {
        let sequence = data().join(name);
        let poses = poses(&sequence);
        for (rotation, translation, scale) in [(0.0, 0.0, 0.0), (3.0, 0.2, 0.1), (5.0, 0.3, 0.2)] {
            let (mut tested, mut good, mut consistent, mut refused) = (0, 0, 0, 0);
            let (mut errors, mut mahalanobis, mut nees) = (Vec::new(), Vec::new(), Vec::new());
            let mut milliseconds = 0.0;
            let mut baseline = 0.0;
            for first in (0..poses.len() - gap).step_by(30).map(|i| i / 10 * 10) {
                let second = first + gap;
                let target_scale = 1.5;
                let (source_pyramid, source_depth) = keyframe(&sequence, first, 1.0, 0.02);
                let (target_pyramid, target_depth) = keyframe(&sequence, second, target_scale, 0.02);
                let source = KeyframeView::new(&source_pyramid, &source_depth, &camera());
                let target = KeyframeView::new(&target_pyramid, &target_depth, &camera());
                let to = Sim3::new(poses[second].rotation, poses[second].translation, target_scale);
                let truth = to.inverse() * Sim3::from(poses[first]);
                let step = truth.translation.norm();
                baseline += step * target_scale;
                let mut disturbance = SVector::<f64, 7>::from_fn(|_, _| uniform());
                disturbance.fixed_rows_mut::<3>(0).normalize_mut();
                disturbance.fixed_rows_mut::<3>(0).scale_mut(translation * step);
                disturbance.fixed_rows_mut::<3>(3).normalize_mut();
                disturbance.fixed_rows_mut::<3>(3).scale_mut(f64::to_radians(rotation));
                disturbance[6] = scale * disturbance[6].signum();
                let guess = Sim3::exp(&disturbance) * truth;
                tested += 1;
                let start = std::time::Instant::now();
                let forward = align_from(&source, &target, &turned_starts(guess, 0.1), &params);
                milliseconds += start.elapsed().as_secs_f64() * 1e3;
                let backward = align_from(&target, &source, &turned_starts(guess.inverse(), 0.1), &params);
                let (Ok(forward), Ok(backward)) = (&forward, &backward) else {
                    refused += 1;
                    println!("  refused: {first} {:?} {:?}", forward.as_ref().err(), backward.as_ref().err());
                    continue;
                };
                let error = (truth * forward.target_from_source.inverse()).log();
                let difference = (forward.target_from_source.inverse() * truth).log();
                let relative = difference.fixed_rows::<3>(0).norm() * 1.0 / (step * target_scale);
                let verdict = reciprocal(forward, backward, &params).unwrap();
                let turned = difference.fixed_rows::<3>(3).norm().to_degrees();
                let is_good = turned < 0.3 && relative < 0.03 && difference[6].abs() < 0.02;
                good += is_good as usize;
                consistent += verdict.consistent as usize;
                if is_good {
                    errors.push([turned, relative, difference[6].abs()]);
                    mahalanobis.push(verdict.mahalanobis);
                    nees.push(error.dot(&(forward.information * error)).sqrt());
                } else {
                    println!(
                        "  bad: {first} turned {turned:.2} relative {relative:.3} scale {:.3} mahalanobis {:.1} inliers {:.2} rmse {:.1}",
                        difference[6], verdict.mahalanobis, forward.inlier_share, forward.rmse
                    );
                }
            }
            let median = |mut v: Vec<f64>| {
                v.sort_by(f64::total_cmp);
                v.get(v.len() / 2).copied().unwrap_or(f64::NAN)
            };
            let of = |i: usize| median(errors.iter().map(|e| e[i]).collect());
            println!(
                "{name} +{gap} ({:.2} m), guess off by {rotation}° {translation} {scale}: good {good}/{tested}, refused {refused}, reciprocal {consistent}; median errors {:.4}° {:.4} {:.4}, mahalanobis {:.2}, nees {:.2}, {:.0} ms",
                baseline / tested as f64,
                of(0),
                of(1),
                of(2),
                median(mahalanobis.clone()),
                median(nees.clone()),
                milliseconds / tested as f64
            );
        }
    }
}
