//! The depth filter on rendered images with exact depth; skipped where the sequences are not at hand.

#[path = "support/parking.rs"]
mod parking;

use geometry::sensor::Shift;
use parking::{Sequence, backbone};
use slam_direct::{DepthFilter, DepthParams, StereoFrame, choose_references};
use std::path::Path;

#[test]
fn parking_depth_is_accurate_dense_and_honest() -> parking::Result<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/parking_a");
    if !folder.exists() {
        eprintln!("SKIPPED: no {}: depth was not measured", folder.display());
        return Ok(());
    }
    let sequence = Sequence::open(&folder)?;
    let params = DepthParams::default();
    let (mut relative, mut normalised2, mut pixels) = (Vec::new(), Vec::new(), 0);
    for keyframe in [50, 150, 250] {
        let Some(truth) = sequence.inverse_depth(keyframe)? else { continue };
        let image = sequence.image(keyframe)?;
        let around: Vec<usize> = (keyframe - 16..keyframe + 16).filter(|&i| i != keyframe).collect();
        let poses: Vec<_> = around
            .iter()
            .map(|&i| sequence.world_from_camera[i].inverse() * sequence.world_from_camera[keyframe])
            .collect();
        let mean =
            truth.data().iter().sum::<f32>() / truth.data().iter().filter(|&&d| d > 0.0).count() as f32;
        let shift = Shift::none(sequence.camera);
        let mut filter = DepthFilter::new(&image, &sequence.camera, shift, &params);
        filter.seed(&backbone(&truth, &mut geometry::Random::new(keyframe as u64)));
        for chosen in choose_references(&poses, mean, &sequence.camera, &params) {
            let reference = sequence.image(around[chosen])?;
            filter.update(
                &image,
                &StereoFrame {
                    image: &reference,
                    frame_from_keyframe: poses[chosen],
                    brightness: (0.0, 0.0),
                    pose_sigma_px: 0.05,
                    shift,
                },
            );
        }
        filter.regularise();
        pixels += truth.data().len();
        for (pixel, d, v) in filter.to_semi_dense().iter() {
            let exact = truth.data()[pixel as usize];
            // A depth where there is none counts as an outlier.
            relative.push(if exact > 0.0 { (d - exact).abs() / exact } else { f32::INFINITY });
            normalised2.push((d - exact) * (d - exact) / v);
        }
    }
    relative.sort_by(f32::total_cmp);
    normalised2.sort_by(f32::total_cmp);
    let median = relative[relative.len() / 2];
    let outliers = relative.iter().filter(|&&r| r > 0.1).count() as f32 / relative.len() as f32;
    let density = relative.len() as f32 / pixels as f32;
    let middle = normalised2[normalised2.len() / 2];
    assert!(median <= 0.005, "median relative error {median}");
    assert!(outliers <= 0.02, "outliers {outliers}");
    assert!(density >= 0.09, "density {density}");
    // 0.45 for a Gaussian; below it the variances are cautious.
    assert!((0.1..0.7).contains(&middle), "median normalised squared error {middle}");
    Ok(())
}
